"""The edge servers of a simulated world."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import AsyncIterator, Mapping

from upwash.config.drone import DroneConfig, ServerConfig
from upwash.config.truth import ServerTruth, server_truth
from upwash.core.admission.admission import AdmissionController
from upwash.core.admission.clients import Client
from upwash.core.admission.server import ServerOffer
from upwash.lab.observer import Observation, observed_daemon, server_observer
from upwash.missions.bundled import LoadedService
from upwash.rpc.service import spec_of
from upwash.server.daemon import EdgeServer
from upwash.server.instances import Image
from upwash.sim.chance import Chance
from upwash.sim.faults import Faults, FaultyServer
from upwash.sim.link import ModelDialer, Switchboard, unobserved
from upwash.sim.loop import end_run
from upwash.sim.runtime import ModelRuntime
from upwash.sim.world import ServerComputer
from upwash.support.background import end, start


class FieldSoftware:
    """What runs on drones and servers: the services, and objects of them if they really compute."""

    def __init__(self, services: Mapping[str, LoadedService], *, computing: bool) -> None:
        self.classes = {name: service.cls for name, service in services.items()}
        self.specs = {name: spec_of(cls) for name, cls in self.classes.items()}
        parts = [
            spec_of(spec.before_sending) for spec in self.specs.values() if spec.before_sending is not None
        ]
        self.part_specs = {part.name: part for part in parts}
        self.programs = {name: service.program for name, service in services.items()}
        self.parts = {name: service.part for name, service in services.items() if service.part}
        self.objects: Mapping[str, object] = (
            {name: service.made() for name, service in services.items()} | _made_parts(services)
            if computing
            else {}
        )


def _made_parts(services: Mapping[str, LoadedService]) -> dict[str, object]:
    found = {}
    for service in services.values():
        part = spec_of(service.cls).before_sending
        if part is not None and service.part is not None:
            found[spec_of(part).name] = LoadedService(part, service.part).made()
    return found


def daemon_address(server: str) -> str:
    """The address of a simulated server's daemon."""
    return f"{server}:7070"


@contextlib.asynccontextmanager
async def serving(
    config: DroneConfig, software: FieldSoftware, *, seen: list[Observation] | None
) -> AsyncIterator[Switchboard]:
    """Runs the configured servers; drones reach them through the switchboard.

    A server is made when it gets its first request: of a thousand a drone meets a few.
    """
    board = Switchboard({})
    chance, faults = Chance(config.seed), Faults(config.faults)
    addresses = {server.name: daemon_address(server.name) for server in config.servers}
    async with contextlib.AsyncExitStack() as stack:

        def run(server: ServerConfig) -> None:
            """Runs the server's daemon, which answers at its address from now on."""
            name, truth = server.name, server_truth(server, config.services)
            outside = FaultyServer(name, addresses[name], board, faults=faults)
            computer = ServerComputer(name, truth, faults=faults, noise=config.noise, chance=chance)
            observe = unobserved if seen is None else server_observer(name, seen)
            runtime = ModelRuntime(
                software.specs,
                computer,
                outside,
                objects=software.objects,
                lanes=truth.lanes,
                observe=observe,
            )
            peers = {peer: addresses[peer] for peer in truth.peers if peer in addresses}
            edge = EdgeServer(
                AdmissionController({name: _offer(truth, software)}, peers=peers),
                images={service: Image(program) for service, program in software.programs.items()},
                runtime=runtime,
                dialer=ModelDialer(name, board),
                peers=peers,
                start_timeout_s=60.0,
                drain_s=10.0,
            )
            outside.plug_daemon(
                edge.handle if seen is None else observed_daemon(edge.handle, observe), crash=runtime.crash
            )
            stack.push_async_callback(edge.close)
            watch = start(edge.run(), name=f"daemon of {name}", failed=end_run)
            stack.push_async_callback(end, watch)

        async def answer_first(server: ServerConfig, path: str, body: bytes, client: Client) -> bytes:
            run(server)
            return await board.handlers[addresses[server.name]](path, body, client)

        for server in config.servers:
            board.plug(addresses[server.name], functools.partial(answer_first, server))
        yield board


def _offer(truth: ServerTruth, software: FieldSoftware) -> ServerOffer:
    return ServerOffer(
        frozenset(truth.images),
        truth.slots,
        truth.turn_s,
        {
            service: truth.lanes or software.specs[service].concurrency
            for service in truth.images
            if service in software.specs
        },
    )
