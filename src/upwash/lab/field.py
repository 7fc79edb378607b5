"""The edge servers of a simulated world, for whichever drones come by."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Mapping
from dataclasses import dataclass

from upwash.config import DroneConfig, ServerConfig, ServerTruth, server_truth
from upwash.core.instances import Host, ServerOffer
from upwash.lab.witness import ServerWitness
from upwash.ports import Dialer, Journal, Program
from upwash.server import EdgeServer, Image
from upwash.service import ServiceSpec
from upwash.sim.chance import Chance
from upwash.sim.faults import Faults, FaultyServer
from upwash.sim.link import ModelDialer, Switchboard
from upwash.sim.runtime import ModelRuntime
from upwash.sim.world import ServerComputer, Wire


@dataclass(frozen=True, slots=True)
class Software:
    """What runs on drones and servers: the services, and objects of those that really compute."""

    specs: Mapping[str, ServiceSpec]
    programs: Mapping[str, Program]
    objects: Mapping[str, object]


def daemon_address(server: str) -> str:
    """Where the daemon of a simulated server is reached."""
    return f"{server}:7070"


@contextlib.asynccontextmanager
async def serving(
    config: DroneConfig, software: Software, *, witness: Journal | None
) -> AsyncIterator[Switchboard]:
    """Runs the configured servers; drones reach them through the switchboard."""
    switchboard, chance, faults = Switchboard({}), Chance(config.seed), Faults(config.faults)
    addresses = {server.name: daemon_address(server.name) for server in config.servers}
    async with contextlib.AsyncExitStack() as stack:
        for server in config.servers:
            truth = server_truth(server, config.services)
            outside = FaultyServer(
                server.name, addresses[server.name], switchboard, faults=faults, slots=truth.slots
            )
            computer = ServerComputer(
                server.name, truth, faults=faults, noise=config.noise.call, chance=chance
            )
            edge = _edge_server(
                server, truth, ModelRuntime(software.specs, computer, outside, objects=software.objects),
                outside=outside, programs=software.programs, addresses=addresses,
                dialer=ModelDialer(server.name, switchboard, Wire()),
                witness=ServerWitness(server.name, witness) if witness else None,
            )  # fmt: skip
            stack.push_async_callback(edge.close)
            watch = asyncio.create_task(edge.run(), name=f"daemon of {server.name}")
            stack.callback(_end, watch)
        yield switchboard


def _edge_server(
    server: ServerConfig,
    truth: ServerTruth,
    runtime: ModelRuntime,
    *,
    outside: FaultyServer,
    programs: Mapping[str, Program],
    addresses: Mapping[str, str],
    dialer: Dialer,
    witness: ServerWitness | None,
) -> EdgeServer:
    peers = {name: addresses[name] for name in truth.peers if name in addresses}
    edge = EdgeServer(
        Host({server.name: ServerOffer(frozenset(truth.images), truth.slots)}, peers=peers),
        images={name: Image(program) for name, program in programs.items()},
        runtime=witness.runtime(runtime) if witness else runtime,
        dialer=dialer,
        peers=peers,
        start_timeout_s=60.0,
        drain_s=10.0,
    )
    handle = witness.daemon(edge.handle) if witness else edge.handle
    outside.plug_daemon(handle, crash=runtime.crash)
    return edge


def _end(watch: asyncio.Task[None]) -> None:
    if watch.done():
        watch.result()  # a daemon never ends by itself: this raises what ended it
    watch.cancel()
