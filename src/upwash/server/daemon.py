"""PROGRAM: the edge daemon, which answers drones, peers and operators."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NoReturn

import msgspec

from upwash.core.admission.admission import AdmissionController, Available, ServiceRunning, StartPending
from upwash.core.admission.clients import Client, DoorStatus, DroneUsage, ServerStatus, TeamUsage
from upwash.core.admission.server import Denied, ServerOffer
from upwash.errors import InstanceError, LinkError, Refused
from upwash.ports import Dialer, Runtime
from upwash.rpc import protocol
from upwash.server.instances import UNOBSERVED, Image, Instances, Observer
from upwash.support.background import beside
from upwash.support.text import printable

_log = logging.getLogger("upwash.server")
_requests = logging.getLogger("upwash.requests")
_LEAST_LOOK_S = 1.0  # between two checks for leases and instances that are due
_PEER_S = 3.0  # a peer answers at once, over a wire, or is in trouble


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The state of a daemon: its servers, how often each refused, its certificates, and what is in force.

    `at_door` counts connections that were refused before any request.
    """

    servers: Sequence[ServerStatus]
    refused: Mapping[str, int]
    certificates: Sequence[protocol.CertificateStatus]
    at_door: Sequence[DoorStatus]
    daemon: protocol.DaemonStatus | None


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
        certificates: Callable[[], Sequence[protocol.CertificateStatus]] = tuple,
        at_door: Callable[[], Sequence[DoorStatus]] = tuple,
        status: Callable[[], protocol.DaemonStatus | None] = lambda: None,
        observer: Observer = UNOBSERVED,
    ) -> None:
        self._host = host
        self._at_door = at_door
        self._dialer = dialer
        self._peers = peers  # the address of each
        self._certificates = certificates
        self._status_of_daemon = status
        self._began_s = self._now_s()
        self._held = asyncio.Event()  # a slot, perhaps for less than a lease
        self._defect: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._instances = Instances(
            host,
            images,
            runtime,
            start_timeout_s=start_timeout_s,
            drain_s=drain_s,
            observer=observer,
            failed=self._fail,
        )
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

    def revoke(self, certificates: frozenset[str]) -> None:
        """Refuse exactly these certificates from now on; a slow instance hears of it later."""
        self._instances.perform_beside(self._host.revoke(certificates, now_s=self._now_s()))

    def reload(self, offers: Mapping[str, ServerOffer], *, images: Mapping[str, Image]) -> None:
        """Replace the offers of the daemon's servers from now on; instances start and stop meanwhile."""
        self._instances.images = images
        outdated = self._instances.outdated(images)
        self._instances.perform_beside(self._host.offer(offers, outdated=outdated))

    async def take_up(self, server: str, drones: Sequence[Client], services: Sequence[str]) -> None:
        """Serve the drones of another daemon; returns when the services that ran there run here.

        Raises InstanceError for a service that does not start: the other daemon still has it.
        """
        await self._instances.perform(self._host.take_up(server, drones, services, now_s=self._now_s()))
        if faults := await self._instances.faults():
            raise InstanceError(f"the daemon before stays, whose services run: {'; '.join(faults)}")

    def take_up_usage(self, server: str, drones: Sequence[DroneUsage], teams: Sequence[TeamUsage]) -> None:
        """Continue the usage counts of the former daemon; call it after `take_up`."""
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
            self._certificates(),
            self._at_door(),
            self._status_of_daemon(),
        )

    @property
    def is_closing(self) -> bool:
        """Whether new requests are refused, as the daemon ends."""
        return bool(self._host.closing)

    def seen(self, server: str, drone: str) -> None:
        """Renew the lease of the drone with that `Client.key`, whose calls passed the door."""
        self._host.at(server).seen(drone, now_s=self._now_s())

    async def drain(self, why: str) -> None:
        """Refuse new requests for that reason; returns when the calls in progress have ended, or had `drain_s`."""
        await self._instances.perform(self._host.close(why))
        await self._instances.ended()
        await self._instances.perform(self._host.end_leases(now_s=self._now_s()))

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
                self._instances.used.clear()
                await self._instances.used.wait()
            due_s = max(looked_s + _LEAST_LOOK_S, self._host.next_end_s(now_s=self._now_s()))
            try:
                async with asyncio.timeout_at(due_s):
                    await self._held.wait()
            except TimeoutError:
                looked_s = self._now_s()
                await self._instances.perform(self._host.look(now_s=looked_s))
            self._held.clear()

    async def close(self) -> None:
        """End every instance; returns when none is left."""
        self._host.close("this daemon has ended")  # or a start that waits would start another
        await self._instances.close()

    async def _availability(
        self, request: protocol.AvailabilityRequest, drone: Client
    ) -> protocol.AvailabilityReply:
        answer, commands = self._host.availability(
            request.server, request.services, drone, now_s=self._now_s()
        )
        await self._instances.perform(commands)
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
                    _tell_of(drone, "%s: no place for %s: %s", request.server, drone.name, why)
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
            await self._instances.perform(commands)
            match answer:
                case ServiceRunning(endpoint):
                    return protocol.StartReply(endpoint=endpoint)
                case Denied(why, waiting, ask_again_s, _, pause_s):
                    return protocol.StartReply(
                        reason=printable(why), waiting=waiting, ask_again_s=ask_again_s, pause_s=pause_s
                    )
                case StartPending(number, stopping):
                    why = await self._instances.settled(number)
                    if why and not stopping:
                        now_s = self._now_s()
                        self._host.refused(request.server, drone.name, why, now_s=now_s)
                        _, pause_s = self._host.at(request.server).pause(
                            [request.service], drone, now_s=now_s
                        )
                        return protocol.StartReply(reason=printable(why), pause_s=pause_s)

    async def _leave(self, request: protocol.LeaveRequest, drone: Client) -> protocol.LeaveReply:
        await self._instances.perform(self._host.leave(request.server, drone, now_s=self._now_s()))
        return protocol.LeaveReply()

    async def _deny(self, request: protocol.DenyRequest, drone: Client) -> protocol.DenyReply:
        await self._instances.perform(
            self._host.deny(request.server, request.services, drone, now_s=self._now_s())
        )
        return protocol.DenyReply()

    async def _prepare(self, request: protocol.PrepareRequest, drone: Client) -> protocol.HoldReply:
        """Ask the peer to hold a slot; the reply has the reason if that fails."""
        for_s = request.arrives_in_s + request.hold_s
        denied, commands = self._host.send_ahead(
            request.server, request.peer, drone, for_s=for_s, now_s=self._now_s()
        )
        await self._instances.perform(commands)
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
        denied, commands = self._host.hold(
            request.server,
            request.services,
            Client(request.drone, request.certificate),
            peer=peer,
            for_s=request.for_s,
            now_s=self._now_s(),
        )
        await self._instances.perform(commands)
        if denied is not None:
            _tell_of(
                peer,
                "%s: nothing held for %s, as %s asked: %s",
                request.server,
                request.drone,
                peer.name,
                denied.why,
            )
            return protocol.HoldReply(held=False, reason=printable(denied.why))
        self._held.set()
        _log.info("%s: a slot is held for %s, as %s asked", request.server, request.drone, peer.name)
        return protocol.HoldReply(held=True)

    async def _status(self, _: protocol.StatusRequest, client: Client) -> protocol.StatusReply:
        now_s = self._now_s()
        shown = self._host.show(client, now_s=now_s)
        if isinstance(shown, Denied):
            raise Refused(shown.why)
        _tell_of(client, "the status was told to %s", client.name)
        servers, refusals = shown
        return protocol.StatusReply(
            up_s=now_s - self._began_s,
            servers=servers,
            refusals=refusals,
            certificates=list(self._certificates()),
            closing=self._host.closing,
            at_door=list(self._at_door()),
            limits={service: image.limits for service, image in self._instances.images.items()},
            daemon=self._status_of_daemon(),
        )

    def _now_s(self) -> float:
        return asyncio.get_running_loop().time()


def _tell_of(client: Client, text: str, *values: str) -> None:
    """A line of the log that this client may cause again and again."""
    _requests.info(text, *values, extra={"whom": client.key})
