"""PROGRAM: the edge daemon, which answers drones, and starts and stops service instances."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, NoReturn

import msgspec

from upwash.core.admission.admission import (
    AdmissionController,
    Available,
    Command,
    Denied,
    ServerOffer,
    ServiceRunning,
    StartPending,
)
from upwash.core.admission.clients import Client, DoorStatus, DroneUsage, ServerStatus, TeamUsage
from upwash.core.admission.instances import StartInstance, StopInstance
from upwash.core.admission.leases import Admit
from upwash.core.admission.limits import NO_LIMITS, Limits
from upwash.core.admission.usage import LeaseEnded
from upwash.errors import InstanceError, LinkError, NotReadyInTime, Refused
from upwash.ports import AnsweredCall, Dialer, Instance, InstanceSpec, Program, Runtime
from upwash.rpc import protocol
from upwash.support.background import beside, start
from upwash.support.text import printable

_log = logging.getLogger("upwash.server")
_usage = logging.getLogger("upwash.usage")
_LEAST_LOOK_S = 1.0  # between two checks for leases and instances that are due
_PEER_S = 3.0  # a peer answers at once, over a wire, or is in trouble
_WATCH_S = 5.0  # between two looks at whether an instance is of use
_LAST_CALLS_S = 2.0  # for the other calls of an instance of no use
_STOP_S = 30.0  # for an instance to be gone; a process that waits in the kernel may never be


@dataclass(frozen=True, slots=True)
class Image:
    """A service that can be started: its program, the least times of its calls and its start, and its methods.

    An instance computes as many calls at a time as it has `lanes`. The `version` changes with its code and files.
    """

    program: Program
    pace_s: Mapping[str, float] = field(default_factory=dict)
    start_pace_s: float = 0.0
    methods: frozenset[str] = frozenset()
    lanes: int = 1
    version: str = ""
    limits: Limits = NO_LIMITS


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The state of a daemon: its servers, the refusals of each, and its certificates.

    `at_door` are connections that were refused before any request.
    """

    servers: Sequence[ServerStatus]
    refused: Mapping[str, int]
    certificates: Sequence[protocol.CertificateStatus]
    at_door: Sequence[DoorStatus]


@dataclass(frozen=True, slots=True)
class Observer:
    """Callables for what happens to instances: a start and its duration (s), a failure, an answered call."""

    started: Callable[[InstanceSpec, float], None] = lambda *_: None
    failed: Callable[[InstanceSpec], None] = lambda _: None
    answered: Callable[[InstanceSpec, AnsweredCall], None] = lambda *_: None


def _used(lease: LeaseEnded) -> str:
    """The log's text for the end of a lease."""
    if lease.held_by:
        return (
            f"{lease.drone} did not come: a slot was held for {lease.slot_s:.1f} s, as {lease.held_by} asked"
        )
    return (
        f"{lease.drone} had a slot for {lease.slot_s:.1f} s: calls answered {lease.calls}, "
        f"seconds of computing {lease.computed_s:.1f}"
    )


class EdgeServer:
    """A daemon: `host` decides, `runtime` runs the services in `images`, `dialer` connects to peers."""

    def __init__(
        self,
        host: AdmissionController,
        *,
        images: Mapping[str, Image],
        runtime: Runtime,
        dialer: Dialer,
        start_timeout_s: float,
        drain_s: float,
        peers: Mapping[str, str] = MappingProxyType({}),
        certificates: Sequence[protocol.CertificateStatus] = (),
        at_door: Callable[[], Sequence[DoorStatus]] = tuple,
        observer: Observer = Observer(),
    ) -> None:
        self._host = host
        self._observer = observer
        self._at_door = at_door
        self._images = images
        self._runtime = runtime
        self._dialer = dialer
        self._peers = peers  # the address of each
        self._start_timeout_s = start_timeout_s
        self._drain_s = drain_s
        self._certificates = certificates
        self._began_s = self._now_s()
        self._held = asyncio.Event()  # a slot, perhaps for less than a lease
        self._used = asyncio.Event()  # wakes run() from idle
        self._defect: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._instances: dict[StartInstance, Instance] = {}
        self._begun: dict[StartInstance, Image] = {}  # of each instance that starts, runs or stops
        self._lives: dict[int, asyncio.Task[None]] = {}  # by instance number, from start to end
        self._endings: dict[int, asyncio.Task[None]] = {}  # of those that have to stop
        self._settled: dict[int, asyncio.Future[str]] = {}  # why it is not ready; "" when it is
        self._routes: Mapping[str, tuple[type[Any], Callable[[Any, Client], Awaitable[msgspec.Struct]]]] = {
            protocol.AVAILABILITY: (protocol.AvailabilityRequest, self._availability),
            protocol.START: (protocol.StartRequest, self._start),
            protocol.LEAVE: (protocol.LeaveRequest, self._leave),
            protocol.DENY: (protocol.DenyRequest, self._deny),
            protocol.PREPARE: (protocol.PrepareRequest, self._prepare),
            protocol.HOLD: (protocol.HoldRequest, self._hold),
            protocol.STATUS: (protocol.StatusRequest, self._status),
        }

    async def handle(self, path: str, body: bytes, client: Client) -> bytes:
        """The reply to a request; raises Refused for a request that is invalid or not allowed."""
        if not client.name:
            raise Refused("this request names no drone")
        if path not in self._routes:
            raise Refused(f"no such request: {printable(path)}")
        request, answer = self._routes[path]
        return msgspec.msgpack.encode(await answer(protocol.decode_request(body, request), client))

    async def reload(
        self,
        offers: Mapping[str, ServerOffer],
        *,
        images: Mapping[str, Image],
        revoked: frozenset[str],
        certificates: Sequence[protocol.CertificateStatus] = (),
    ) -> None:
        """Have the same servers offer this from now on, except to the revoked certificates."""
        self._certificates = certificates
        self._images = images
        outdated = frozenset(
            (start.server, start.service)
            for start, image in self._begun.items()
            if self._has_place(start) and images.get(start.service) != image
        )
        await self._perform(self._host.revoke(revoked, now_s=self._now_s()))
        await self._perform(self._host.offer(offers, outdated=outdated))

    async def take_up(self, server: str, drones: Sequence[Client], services: Sequence[str]) -> None:
        """Serve the drones of another daemon; returns when the services that ran there run here.

        Raises InstanceError for a service that does not start: the other daemon still has it.
        """
        await self._perform(self._host.take_up(server, drones, services, now_s=self._now_s()))
        if faults := [why for why in await asyncio.gather(*self._settled.values()) if why]:
            raise InstanceError(f"the daemon before stays, whose services run: {'; '.join(faults)}")

    def take_up_usage(self, server: str, drones: Sequence[DroneUsage], teams: Sequence[TeamUsage]) -> None:
        """Continue the counts of the daemon before, after `take_up`."""
        self._host.take_up_usage(server, drones, teams, now_s=self._now_s())

    async def emptied(self) -> None:
        """Return once no drone has a slot any more."""
        while any(self._host.leases(server.name) for server in self.standing().servers):  # noqa: ASYNC110 - they end by time
            await asyncio.sleep(_LEAST_LOOK_S)

    def standing(self) -> Snapshot:
        """The daemon's state now."""
        return Snapshot(
            self._host.servers(now_s=self._now_s()),
            dict(self._host.refused_times),
            self._certificates,
            self._at_door(),
        )

    def seen(self, server: str, drone: str) -> None:
        """Renew the lease of a drone, known by `Client.key`, whose calls passed the door."""
        self._host.seen(server, drone, now_s=self._now_s())

    async def drain(self, why: str) -> None:
        """Refuse new requests for that reason; returns when the calls in progress have ended, or had `drain_s`."""
        await self._perform(self._host.close(why))
        await asyncio.gather(*self._endings.values())
        await self._perform(self._host.end_leases(now_s=self._now_s()))

    async def run(self) -> NoReturn:
        """End leases and idle instances when they are due, until cancelled.

        Raises a failure of an instance's life or end that is no InstanceError: its state is unknown then.
        """
        async with beside(self._end_in_time(), name="the ends of leases"):
            await asyncio.shield(self._defect)
        raise AssertionError("a defect is an exception")

    def _fail(self, defect: Exception) -> None:
        if not self._defect.done():
            self._defect.set_exception(defect)

    async def _end_in_time(self) -> NoReturn:
        looked_s = self._now_s()
        while True:
            if self._host.is_idle:
                self._used.clear()
                await self._used.wait()
            due_s = max(looked_s + _LEAST_LOOK_S, self._host.next_end_s(now_s=self._now_s()))
            try:
                async with asyncio.timeout_at(due_s):
                    await self._held.wait()
            except TimeoutError:
                looked_s = self._now_s()
                await self._perform(self._host.look(now_s=looked_s))
            self._held.clear()

    async def close(self) -> None:
        """End every instance; returns when none is left."""
        self._host.close("this daemon has ended")  # or a start that waits would start another
        for ending in self._endings.values():
            ending.cancel()
        lives = list(self._lives.values())
        for number in list(self._lives):
            self._cut(number)
        await asyncio.gather(*lives, return_exceptions=True)

    async def _availability(
        self, request: protocol.AvailabilityRequest, drone: Client
    ) -> protocol.AvailabilityReply:
        answer, commands = self._host.availability(
            request.server, request.services, drone, now_s=self._now_s()
        )
        await self._perform(commands)
        match answer:
            case Available(endpoints, waiting):
                return protocol.AvailabilityReply(
                    available=True,
                    endpoints=dict(endpoints),
                    lease_s=self._host.settings.lease_s,
                    peers=list(self._host.peers),
                    waiting=waiting,
                )
            case Denied(why, waiting, ask_again_s, is_news, pause_s):
                if is_news:
                    _log.info("%s: no place for %s: %s", request.server, drone.name, why)
                return protocol.AvailabilityReply(
                    available=False,
                    reason=printable(why),
                    waiting=waiting,
                    ask_again_s=ask_again_s,
                    pause_s=pause_s,
                )

    async def _start(self, request: protocol.StartRequest, drone: Client) -> protocol.StartReply:
        while True:
            answer, commands = self._host.start(request.server, request.service, drone, now_s=self._now_s())
            await self._perform(commands)
            match answer:
                case ServiceRunning(endpoint):
                    return protocol.StartReply(endpoint=endpoint)
                case Denied(why, waiting, ask_again_s, _, pause_s):
                    return protocol.StartReply(
                        reason=printable(why), waiting=waiting, ask_again_s=ask_again_s, pause_s=pause_s
                    )
                case StartPending(number, stopping):
                    settled = self._settled.get(number)
                    why = await asyncio.shield(settled) if settled else ""
                    if why and not stopping:
                        now_s = self._now_s()
                        self._host.refused(request.server, drone.name, why, now_s=now_s)
                        pause_s = self._host.pause_s(request.server, [request.service], drone, now_s=now_s)
                        return protocol.StartReply(reason=printable(why), pause_s=pause_s)

    async def _leave(self, request: protocol.LeaveRequest, drone: Client) -> protocol.LeaveReply:
        await self._perform(self._host.leave(request.server, drone, now_s=self._now_s()))
        return protocol.LeaveReply()

    async def _deny(self, request: protocol.DenyRequest, drone: Client) -> protocol.DenyReply:
        await self._perform(self._host.deny(request.server, request.services, drone, now_s=self._now_s()))
        return protocol.DenyReply()

    async def _prepare(self, request: protocol.PrepareRequest, drone: Client) -> protocol.HoldReply:
        """Pass the request on to the peer; the reply has the reason if that fails."""
        for_s = request.arrives_in_s + request.hold_s
        denied, commands = self._host.send_ahead(
            request.server, request.peer, drone, for_s=for_s, now_s=self._now_s()
        )
        await self._perform(commands)
        if denied is not None:
            return protocol.HoldReply(held=False, reason=printable(denied.why))
        hold = protocol.HoldRequest(request.peer, drone.name, drone.certificate, request.services, for_s)
        try:
            reply = await self._ask_peer(hold)
        except LinkError as error:  # it may have heard it all the same
            return protocol.HoldReply(held=False, reason=printable(str(error)))
        if not reply.held:
            self._host.not_held(request.peer, drone)
        return reply

    async def _ask_peer(self, hold: protocol.HoldRequest) -> protocol.HoldReply:
        link = self._dialer.dial(self._peers[hold.server], server=hold.server)
        try:
            reply = await link.request(protocol.HOLD, msgspec.msgpack.encode(hold), timeout_s=_PEER_S)
        finally:
            await link.close()
        return protocol.decode_reply(reply, protocol.HoldReply, sender=hold.server)

    async def _hold(self, request: protocol.HoldRequest, peer: Client) -> protocol.HoldReply:
        answer, commands = self._host.hold(
            request.server,
            request.services,
            Client(request.drone, request.certificate),
            peer=peer,
            for_s=request.for_s,
            now_s=self._now_s(),
        )
        await self._perform(commands)
        if isinstance(answer, Denied):
            _log.info("%s: nothing held for %s: %s", request.server, request.drone, answer.why)
            return protocol.HoldReply(held=False, reason=printable(answer.why))
        self._held.set()
        _log.info("%s: a slot is held for %s, as %s asked", request.server, request.drone, peer.name)
        return protocol.HoldReply(held=True)

    async def _status(self, _: protocol.StatusRequest, client: Client) -> protocol.StatusReply:
        now_s = self._now_s()
        shown = self._host.show(client, now_s=now_s)
        if isinstance(shown, Denied):
            raise Refused(shown.why)
        servers, refusals = shown
        return protocol.StatusReply(
            up_s=now_s - self._began_s,
            servers=servers,
            refusals=refusals,
            certificates=list(self._certificates),
            closing=self._host.closing,
            at_door=list(self._at_door()),
            limits={service: image.limits for service, image in self._images.items()},
        )

    async def _perform(self, commands: Sequence[Command]) -> None:
        self._used.set()
        for command in commands:
            match command:
                case Admit():
                    await self._admit(command)
                case LeaseEnded():
                    _usage.info("%s: %s", command.server, _used(command))
                case StartInstance(_, _, number):
                    self._settled[number] = asyncio.get_running_loop().create_future()
                    name = f"the life of {command.service}"
                    self._lives[number] = start(self._live(command), name=name, failed=self._fail)
                case StopInstance(number=number):
                    if self._settled[number].done():
                        self._settled[number] = asyncio.get_running_loop().create_future()
                    name = f"the end of {command.service}"
                    self._endings[number] = start(self._end(command), name=name, failed=self._fail)

    async def _end(self, stop: StopInstance) -> None:
        """Let an instance end the calls in progress, then stop it."""
        instance = self._instances.get(StartInstance(stop.server, stop.service, stop.number))
        if stop.why and not self._host.closing:
            _log.warning("stopping %s@%s: %s", stop.service, stop.server, stop.why)
        try:
            if instance is not None and stop.why:
                async with asyncio.timeout(_LAST_CALLS_S if stop.is_useless else self._drain_s):
                    await instance.drain(stop.why)
        except TimeoutError:
            _log.warning("%s@%s was stopped in a call: %s", stop.service, stop.server, stop.why)
        except InstanceError as error:
            _log.warning("%s", error)  # it has ended by itself
        finally:
            del self._endings[stop.number]
            self._cut(stop.number)

    def _cut(self, number: int) -> None:
        """End the life of that instance, unless it is ending: a second cancellation would cut its end short."""
        life = self._lives.get(number)
        if life is not None and not life.cancelling():
            life.cancel()

    async def _admit(self, command: Admit) -> None:
        """Inform all instances at once, so that a slow instance does not delay the others."""
        await asyncio.gather(
            *(
                self._tell_whom(start, instance, command)
                for start, instance in self._instances.items()
                if start.server == command.server
            )
        )

    async def _tell_whom(self, start: StartInstance, instance: Instance, command: Admit) -> None:
        try:
            await instance.admit(command.drones, command.finishing)
        except InstanceError as error:
            why = f"it cannot be told whom to serve: {error}"
            if self._has_place(start):
                await self._perform(self._host.silent(start.server, start.service, why, now_s=self._now_s()))
            else:
                _log.warning("stopping %s@%s of a former version: %s", start.service, start.server, why)
                self._cut(start.number)

    async def _live(self, start: StartInstance) -> None:
        """The life of one instance, from its start to its end."""
        self._begun[start] = image = self._images[start.service]
        if not self._has_place(start):
            _log.info("%s@%s: another version starts beside the one that serves", start.service, start.server)
        spec = InstanceSpec(
            start.server,
            start.service,
            image.program,
            pace_s=image.pace_s,
            start_pace_s=image.start_pace_s,
            methods=image.methods,
            limits=image.limits,
        )
        instance: Instance | None = None
        why = ""  # of its end; empty if it was stopped, and those who wait for it should ask again
        began_s = self._now_s()
        try:
            async with asyncio.timeout(self._start_timeout_s):
                instance = await self._runtime.start(
                    spec,
                    called=lambda drone: self._called(start, drone),
                    answered=lambda call: self._answered(start, spec, call),
                )
            self._observer.started(spec, self._now_s() - began_s)
            self._instances[start] = instance
            await self._tell_whom(
                start, instance, self._host.admitted(start.server)
            )  # who hears of it may call
            _log.info("%s is ready at %s", spec.name, instance.endpoint)
            await self._perform(
                self._host.ready(
                    start.server, start.service, start.number, instance.endpoint, now_s=self._now_s()
                )
            )
            self._settled[start.number].set_result("")
            async with beside(self._watch(start, instance), name=f"the watch of {spec.name}"):
                why = await instance.exited()
            self._gone(start, why)
            _log.warning("%s is gone: %s", spec.name, why)
        except TimeoutError:
            why = str(NotReadyInTime(spec.name, self._start_timeout_s, whose="the daemon's"))
            _log.warning("%s", why)
        except InstanceError as error:
            why = str(error)
            _log.warning("%s", why)
        finally:
            self._instances.pop(start, None)
            if why:
                self._observer.failed(spec)
            if instance is not None:
                await self._stop(spec, instance)
            settled = self._settled.pop(start.number)
            if why and not settled.done() and not self._has_place(start):
                _log.error(
                    "%s serves on in its former version: remove the cause, and reload again", spec.name
                )
            anew = self._gone(start, why)
            del self._begun[start]
            if not settled.done():
                settled.set_result(why)
            del self._lives[start.number]
            await self._perform(anew)

    async def _stop(self, spec: InstanceSpec, instance: Instance) -> None:
        try:
            async with asyncio.timeout(_STOP_S):
                await instance.stop()
        except TimeoutError:
            _log.error(
                "%s is not gone %.0f s after it was stopped and is left behind: look for a process in state D",
                spec.name,
                _STOP_S,
            )

    def _has_place(self, start: StartInstance) -> bool:
        return self._host.has_place(start.server, start.service, start.number)

    def _gone(self, start: StartInstance, why: str) -> list[StartInstance]:
        return self._host.gone(start.server, start.service, start.number, why, now_s=self._now_s())

    async def _watch(self, start: StartInstance, instance: Instance) -> NoReturn:
        """Have the instance replaced once it is of no use; until cancelled."""
        while True:
            await asyncio.sleep(_WATCH_S)
            # The reply comes after all earlier reports: this program may have been suspended itself.
            with contextlib.suppress(TimeoutError, InstanceError):
                async with asyncio.timeout(_WATCH_S):
                    await instance.health()
                if self._has_place(start):
                    self._host.heard(start.server, start.service, now_s=self._now_s())
            if self._has_place(start):
                await self._perform(self._host.watch(start.server, start.service, now_s=self._now_s()))

    def _called(self, start: StartInstance, drone: str) -> None:
        if self._has_place(start):
            self._host.called(start.server, start.service, drone, now_s=self._now_s())

    def _answered(self, start: StartInstance, spec: InstanceSpec, call: AnsweredCall) -> None:
        now_s = self._now_s()
        self._observer.answered(spec, call)
        self._host.used(start.server, call.drone, took_s=call.took_s, outcome=call.outcome, now_s=now_s)
        if self._has_place(start):
            self._host.answered(
                start.server,
                start.service,
                call.drone,
                took_s=call.took_s,
                queued_s=call.queued_s,
                outcome=call.outcome,
                now_s=now_s,
            )

    def _now_s(self) -> float:
        return asyncio.get_running_loop().time()
