"""What an onlooker sees of a simulated world: facts that no program knows or tells, as events of a journal.

A witness stands between a program and a port and lets everything through as it is.

| event | with |
|---|---|
| `dialled` | a drone opens a link: server, and the address |
| `sent` | a drone sends a request: server, path, and where the drone is |
| `joined`, `left` | a drone, a network, and by which radio |
| `computed` | a drone's own service has done a call: the operation, and how long it took |
| `asked`, `answered` | a drone's request reaches a daemon, and is answered: server, path |
| `held` | a daemon holds a slot for a drone, for so long at most, as the peer `by` has asked it to |
| `instance_started`, `instance_ended` | server, service, endpoint; from the first moment of its start |
| `admitted` | the drones that an instance answers from now on |
| `served` | an instance begins a drone's call |
| `commanded`, `taken` | a command of the drone's program reaches its vehicle; a pilot or a fail-safe takes it |
| `given_back_unheard` | a pilot gives it back, all of whose turn lay within one silence of the vehicle's link |
| `flight_over` | the drone, and how high it is |
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import msgspec

from upwash.core.estimates import Operation
from upwash.core.geo import Position
from upwash.core.visitors import Visitor
from upwash.errors import UpwashError
from upwash.ports import Answered, Dialer, Instance, InstanceSpec, Journal, Link, Network, Runtime, unheard
from upwash.protocol import HOLD, HoldReply, HoldRequest
from upwash.sim.link import Handler
from upwash.sim.runtime import Computer


@dataclass(frozen=True, slots=True)
class DroneWitness:
    """Sees what one drone does."""

    drone: str
    journal: Journal
    position: Callable[[], Position]

    def dialer(self, dialer: Dialer) -> Dialer:
        """Sees the requests that are sent over links of the dialer."""
        return _Dialer(dialer, self)

    def networks(self, networks: Sequence[Network]) -> list[Network]:
        """Sees networks being joined and left, by each radio."""
        return [_Network(network, radio, self) for radio, network in enumerate(networks)]

    def computer(self, computer: Computer) -> Computer:
        """Sees how long the drone's own services take."""
        return _Computer(computer, self)

    def record(self, event: str, **facts: object) -> None:
        """Notes what the drone did."""
        self.journal.record(event, drone=self.drone, **facts)


@dataclass(frozen=True, slots=True)
class ServerWitness:
    """Sees what one server does."""

    server: str
    journal: Journal

    def daemon(self, handle: Handler) -> Handler:
        """Sees the requests that reach the daemon."""

        async def answer(path: str, body: bytes, visitor: Visitor) -> bytes:
            self.record("asked", path=path, drone=visitor.name)
            reply = await handle(path, body, visitor)
            self.record("answered", path=path, drone=visitor.name)
            if path == HOLD and msgspec.msgpack.decode(reply, type=HoldReply).held:
                hold = msgspec.msgpack.decode(body, type=HoldRequest)
                self.record("held", drone=hold.drone, by=visitor.name, for_s=hold.for_s)
            return reply

        return answer

    def runtime(self, runtime: Runtime) -> Runtime:
        """Sees instances start, end and serve."""
        return _Runtime(runtime, self)

    def record(self, event: str, **facts: object) -> None:
        """Notes what the server did."""
        self.journal.record(event, server=self.server, **facts)


@dataclass(frozen=True, slots=True)
class _Dialer:
    seen: Dialer
    witness: DroneWitness

    def dial(self, address: str, *, server: str) -> Link:
        self.witness.record("dialled", server=server, address=address)
        return _Link(self.seen.dial(address, server=server), server, self.witness)


@dataclass(frozen=True, slots=True)
class _Link:
    seen: Link
    server: str
    witness: DroneWitness

    async def request(self, path: str, body: bytes, *, timeout_s: float) -> bytes:
        position = msgspec.to_builtins(self.witness.position())
        self.witness.record("sent", server=self.server, path=path, position=position)
        return await self.seen.request(path, body, timeout_s=timeout_s)

    async def close(self) -> None:
        await self.seen.close()


@dataclass(frozen=True, slots=True)
class _Network:
    seen: Network
    radio: int
    witness: DroneWitness

    async def join(self, network: str, *, timeout_s: float) -> None:
        await self.seen.join(network, timeout_s=timeout_s)
        self.witness.record("joined", network=network, radio=self.radio)

    async def lost(self) -> str:
        return await self.seen.lost()

    async def leave(self) -> None:
        await self.seen.leave()
        self.witness.record("left", radio=self.radio)


@dataclass(frozen=True, slots=True)
class _Computer:
    seen: Computer
    witness: DroneWitness

    async def start(self, spec: InstanceSpec) -> None:
        await self.seen.start(spec)

    async def compute(self, spec: InstanceSpec, operation: Operation) -> None:
        began_s = asyncio.get_running_loop().time()
        await self.seen.compute(spec, operation)
        took_s = asyncio.get_running_loop().time() - began_s
        self.witness.record("computed", operation=str(operation), took_s=took_s)


@dataclass(frozen=True, slots=True)
class _Runtime:
    seen: Runtime
    witness: ServerWitness

    async def start(
        self, spec: InstanceSpec, *, called: Callable[[str], None], answered: Answered = unheard
    ) -> Instance:
        def served(drone: str) -> None:
            self.witness.record("served", service=spec.service, drone=drone)
            called(drone)

        self.witness.record("instance_started", service=spec.service)
        try:
            instance = await self.seen.start(spec, called=served, answered=answered)
        except (UpwashError, asyncio.CancelledError):
            self.witness.record("instance_ended", service=spec.service)
            raise
        return _Instance(instance, spec.service, self.witness)


@dataclass(slots=True)
class _Instance:
    seen: Instance
    service: str
    witness: ServerWitness
    ended: bool = False

    @property
    def endpoint(self) -> str:
        return self.seen.endpoint

    async def admit(self, drones: frozenset[str]) -> None:
        self.witness.record("admitted", service=self.service, drones=sorted(drones))
        await self.seen.admit(drones)

    async def drain(self, why: str) -> None:
        await self.seen.drain(why)

    async def exited(self) -> str:
        how = await self.seen.exited()
        self._end()
        return how

    async def stop(self) -> None:
        self._end()
        await self.seen.stop()

    def _end(self) -> None:
        if not self.ended:
            self.ended = True
            self.witness.record("instance_ended", service=self.service)
