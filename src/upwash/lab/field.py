"""The edge servers of a simulated world, for whichever drones come by."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Mapping
from dataclasses import dataclass

from upwash.config import DroneConfig, ServerConfig, ServerTruth, server_truth
from upwash.core.admission import AdmissionController, ServerOffer
from upwash.lab.observer import Seen, ServerObserver
from upwash.ports import Dialer, Program
from upwash.rpc.service import ServiceSpec
from upwash.server.daemon import EdgeServer, Image
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
    config: DroneConfig, software: Software, *, seen: list[Seen] | None
) -> AsyncIterator[Switchboard]:
    """Runs the configured servers; drones reach them through the switchboard."""
    switchboard, chance, faults = Switchboard({}), Chance(config.seed), Faults(config.faults)
    addresses = {server.name: daemon_address(server.name) for server in config.servers}
    async with contextlib.AsyncExitStack() as stack:
        for server in config.servers:
            truth = server_truth(server, config.services)
            outside = FaultyServer(server.name, addresses[server.name], switchboard, faults=faults)
            computer = ServerComputer(server.name, truth, faults=faults, noise=config.noise, chance=chance)
            edge = _edge_server(
                server, truth,
                ModelRuntime(software.specs, computer, outside, objects=software.objects, lanes=truth.lanes),
                outside=outside, specs=software.specs, programs=software.programs, addresses=addresses,
                dialer=ModelDialer(server.name, switchboard, Wire()),
                observer=ServerObserver(server.name, seen) if seen is not None else None,
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
    specs: Mapping[str, ServiceSpec],
    programs: Mapping[str, Program],
    addresses: Mapping[str, str],
    dialer: Dialer,
    observer: ServerObserver | None,
) -> EdgeServer:
    peers = {name: addresses[name] for name in truth.peers if name in addresses}
    edge = EdgeServer(
        AdmissionController({server.name: _offer(truth, specs)}, peers=peers),
        images={name: Image(program) for name, program in programs.items()},
        runtime=observer.runtime(runtime) if observer else runtime,
        dialer=dialer,
        peers=peers,
        start_timeout_s=60.0,
        drain_s=10.0,
    )
    handle = observer.daemon(edge.handle) if observer else edge.handle
    outside.plug_daemon(handle, crash=runtime.crash)
    return edge


def _offer(truth: ServerTruth, specs: Mapping[str, ServiceSpec]) -> ServerOffer:
    return ServerOffer(
        frozenset(truth.images),
        truth.slots,
        truth.turn_s,
        {service: truth.lanes or specs[service].concurrency for service in truth.images if service in specs},
    )


def _end(watch: asyncio.Task[None]) -> None:
    if watch.done():
        watch.result()  # a daemon never ends by itself: this raises what ended it
    watch.cancel()
