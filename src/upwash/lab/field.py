"""The edge servers of a simulated world, for whichever drones come by."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import AsyncIterator, Mapping
from dataclasses import dataclass

from upwash.config import DroneConfig, ServerConfig, ServerTruth, server_truth
from upwash.core.admission.admission import AdmissionController, ServerOffer
from upwash.core.admission.clients import Client
from upwash.lab.observer import Seen, ServerObserver
from upwash.ports import Program, Runtime
from upwash.rpc.service import ServiceSpec
from upwash.server.daemon import EdgeServer, Image
from upwash.sim.chance import Chance
from upwash.sim.faults import Faults, FaultyServer
from upwash.sim.link import ModelDialer, Switchboard
from upwash.sim.loop import end_run
from upwash.sim.runtime import ModelRuntime
from upwash.sim.world import ServerComputer, Wire
from upwash.support.background import end, start


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
    async with contextlib.AsyncExitStack() as stack:
        yield _Field(config, software, seen, stack).switchboard


class _Field:
    """The servers, each of which is made as somebody first speaks to it: of a thousand a drone meets a few."""

    def __init__(
        self,
        config: DroneConfig,
        software: Software,
        seen: list[Seen] | None,
        stack: contextlib.AsyncExitStack,
    ) -> None:
        self.switchboard = Switchboard({})
        self._config = config
        self._software = software
        self._seen = seen
        self._stack = stack  # ends those that were made
        self._chance = Chance(config.seed)
        self._faults = Faults(config.faults)
        self._addresses = {server.name: daemon_address(server.name) for server in config.servers}
        for server in config.servers:
            self.switchboard.plug(self._addresses[server.name], functools.partial(self._answer_first, server))

    async def _answer_first(self, server: ServerConfig, path: str, body: bytes, client: Client) -> bytes:
        self._make(server)
        return await self.switchboard.handlers[self._addresses[server.name]](path, body, client)

    def _make(self, server: ServerConfig) -> None:
        """Runs the server's daemon, which answers at its address from now on."""
        truth = server_truth(server, self._config.services)
        outside = FaultyServer(
            server.name, self._addresses[server.name], self.switchboard, faults=self._faults
        )
        computer = ServerComputer(
            server.name, truth, faults=self._faults, noise=self._config.noise, chance=self._chance
        )
        runtime = ModelRuntime(
            self._software.specs, computer, outside, objects=self._software.objects, lanes=truth.lanes
        )
        observer = ServerObserver(server.name, self._seen) if self._seen is not None else None
        edge = self._daemon(server.name, truth, observer.runtime(runtime) if observer else runtime)
        handle = observer.daemon(edge.handle) if observer else edge.handle
        outside.plug_daemon(handle, crash=runtime.crash)
        self._stack.push_async_callback(edge.close)
        watch = start(edge.run(), name=f"daemon of {server.name}", failed=end_run)
        self._stack.push_async_callback(end, watch)

    def _daemon(self, name: str, truth: ServerTruth, runtime: Runtime) -> EdgeServer:
        peers = {peer: self._addresses[peer] for peer in truth.peers if peer in self._addresses}
        return EdgeServer(
            AdmissionController({name: _offer(truth, self._software.specs)}, peers=peers),
            images={service: Image(program) for service, program in self._software.programs.items()},
            runtime=runtime,
            dialer=ModelDialer(name, self.switchboard, Wire()),
            peers=peers,
            start_timeout_s=60.0,
            drain_s=10.0,
        )


def _offer(truth: ServerTruth, specs: Mapping[str, ServiceSpec]) -> ServerOffer:
    return ServerOffer(
        frozenset(truth.images),
        truth.slots,
        truth.turn_s,
        {service: truth.lanes or specs[service].concurrency for service in truth.images if service in specs},
    )
