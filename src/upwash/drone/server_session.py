"""One session with a server: join its network, ask for a slot, have services started, call them, leave."""

from __future__ import annotations

import asyncio
import contextlib
from collections import Counter
from collections.abc import Callable, Mapping
from typing import NoReturn, TypeVar

import msgspec
from msgspec import Struct

from upwash.errors import (
    DeadlineExceeded,
    LinkError,
    NotReadyInTime,
    Refused,
    ServerFull,
    ServicePaused,
    Unreachable,
    UpwashError,
)
from upwash.ports import Dialer, Finder, Link, Network
from upwash.rpc import protocol
from upwash.rpc.protocol import decode_reply, resolve, service_path
from upwash.support.background import now_s

_ANSWER_S = 5.0  # a daemon answers at once or is in trouble
_FAREWELL_S = 0.5
_LEAST_ASK_S, _LONGEST_ASK_S = 0.5, 30.0  # bounds of the time between two questions for a slot
_LONGEST_PAUSE_S = 600.0  # bound of the time that a server asks to be left out
MOST_MOVES = 16

R = TypeVar("R", bound=Struct)


class ServerEndpoint(Struct, frozen=True):
    """The network and address of a server, and the drone's services that are used there.

    With a `finder`, the address is looked up in the joined network. With `connects`, services are connected before
    the server is READY, so that the first call takes no longer than others.
    """

    name: str
    network: str
    address: str
    services: tuple[str, ...]
    finder: Finder | None = None
    connects: bool = False


class ServerSession:
    """The drone's requests and calls to one server, from its selection to its de-selection."""

    def __init__(self, endpoint: ServerEndpoint, *, network: Network, dialer: Dialer) -> None:
        self._server = endpoint
        self._network = network
        self._dialer = dialer
        self._address = endpoint.address
        self._daemon: Link | None = None
        self._instances: dict[str, tuple[str, Link]] = {}  # with the addresses that they lead to
        self._moves: Counter[str] = Counter()  # of each service, since the last question
        self._former: list[Link] = []  # to former instances
        self._lease_s = protocol.LEAST_LEASE_S
        self.round_trip_s: float | None = None  # of the last question to the daemon
        self._joined = False
        self._expected = False  # the daemon keeps a slot for the drone, as it answered
        self._lost = ""  # why, once the network is
        self._denied: set[str] = set()  # services to report to the daemon
        self._calls = 0
        self._quiet = asyncio.Event()
        self._quiet.set()

    @property
    def server(self) -> str:
        """The name of the server."""
        return self._server.name

    @property
    def running(self) -> bool:
        """Whether all wanted services run there, by the last answer."""
        return all(service in self._instances for service in self._server.services)

    @property
    def calling(self) -> bool:
        """Whether calls are under way."""
        return not self._quiet.is_set()

    async def calls_over(self) -> None:
        """Returns when no call is under way; each has its deadline."""
        await self._quiet.wait()

    async def join(self, *, timeout_s: float) -> bool:
        """Joins the server's network unless it is joined; returns whether it had to. Raises NetworkError."""
        if self._lost:
            await self._network.leave()
            self._joined, self._lost = False, ""
        if self._joined:
            return False
        await self._network.join(self._server.network, timeout_s=timeout_s)
        self._joined = True
        return True

    async def lost(self) -> str:
        """Wait until the joined network is lost; close the connections, and return why."""
        self._lost = await self._network.lost()
        await self._hang_up()
        return self._lost

    async def ask(self) -> protocol.AvailabilityReply:
        """Asks the daemon for a slot, and which services run. Raises LinkError; ServerFull if it has no slot."""
        if self._daemon is None:
            self._daemon = await self._dial_daemon()
        answer = await self._availability()
        self._moves.clear()
        for service in self._server.services:
            if service in answer.endpoints:
                await self._dial(service, answer.endpoints[service])
        return answer

    async def probe(self) -> bool:
        """Waits for an answer of the daemon and each used service that runs; returns whether all used services run.

        Uses new connections, as earlier ones may be dead without showing it. Raises LinkError.
        """
        async with contextlib.AsyncExitStack() as links:
            daemon = await self._dial_daemon()
            links.push_async_callback(daemon.close)
            try:
                answer = await self._availability(daemon)
            except ServerFull:  # which is an answer too
                return False
            for service in self._server.services:
                if service in answer.endpoints:
                    link = self._link(resolve(answer.endpoints[service], self._address))
                    links.push_async_callback(link.close)
                    await _connected(link)
        return all(service in answer.endpoints for service in self._server.services)

    async def start(self, *, timeout_s: float) -> None:
        """Has stopped services started, and connects to them. Raises LinkError; ServerFull without a slot."""
        for service in self._server.services:
            if service in self._instances:
                continue
            request = protocol.StartRequest(self.server, service)
            reply = await self._asked(protocol.START, request, protocol.StartReply, timeout_s=timeout_s)
            if not reply.endpoint:
                self._refuse(reply, f"cannot start {service}")
            await self._dial(service, reply.endpoint)

    async def start_patiently(self, *, within_s: float) -> None:
        """Starts the services, before a flight, with a long limit; raises NotReadyInTime after `within_s`."""
        try:
            # Later than a daemon with the same limit, whose answer says more.
            await self.start(timeout_s=within_s + _ANSWER_S)
        except DeadlineExceeded:
            services = " and ".join(self._server.services)
            raise NotReadyInTime(f"{services} at {self.server}", within_s) from None

    async def prepare(self, peer: ServerEndpoint, *, arrives_in_s: float, hold_s: float) -> None:
        """Asks this server to have its peer start services and hold a slot; raises LinkError if it does not."""
        request = protocol.PrepareRequest(
            self.server, peer.name, list(peer.services), arrives_in_s=arrives_in_s, hold_s=hold_s
        )
        reply = await self._asked(protocol.PREPARE, request, protocol.HoldReply, timeout_s=_ANSWER_S)
        if not reply.held:
            raise Refused(reply.reason)

    async def keep_lease(
        self, renewed: Callable[[int], None] = lambda _: None, moved: Callable[[str], None] = lambda _: None
    ) -> NoReturn:
        """Renew the lease again and again, until the turn is over: then raises ServerFull.

        Calls `renewed` with the number of waiting drones at each renewal, and `moved` with each service whose address
        changed.
        """
        while True:
            await asyncio.sleep(self._lease_s / 3)
            try:
                answer = await self._availability()
                await self._follow(answer.endpoints, moved)
            except ServerFull:
                raise
            except UpwashError:
                continue  # whether the server can still be used, the next call tells
            renewed(answer.waiting)

    async def _follow(self, endpoints: Mapping[str, str], moved: Callable[[str], None]) -> None:
        """Send new calls to the services' present addresses; links to former addresses stay for calls under way.

        An address may change at most 16 times between two requests to the server, so that no server leads the drone
        from port to port.
        """
        if self._quiet.is_set():
            for link in self._former:
                await link.close()
            self._former.clear()
        for service in sorted(self._instances.keys() & endpoints.keys()):
            address = resolve(endpoints[service], self._address)
            before, link = self._instances[service]
            if address != before and self._moves[service] < MOST_MOVES:
                self._moves[service] += 1
                moved(service)
                self._former.append(link)
                self._instances[service] = address, self._link(address)

    async def call(
        self,
        service: str,
        method: str,
        request: bytes,
        *,
        deadline_s: float,
        may_queue_s: float | None = None,
    ) -> bytes:
        """Runs one call on the server and returns the encoded reply; raises LinkError.

        Raises NotBegun if the server does not begin it within `may_queue_s`; None: within any time.
        """
        if service not in self._instances:
            raise Refused(f"{self.server} does not run {service}")
        _, instance = self._instances[service]
        self._calls += 1
        self._quiet.clear()
        try:
            path = service_path(service, method)
            return await instance.request(path, request, timeout_s=deadline_s, may_queue_s=may_queue_s)
        except LinkError as error:
            if self._lost:
                raise Unreachable(f"{self.server}: its network was lost: {self._lost}") from error
            raise
        finally:
            self._calls -= 1
            if self._calls == 0:
                self._quiet.set()

    def deny(self, service: str) -> None:
        """Note that the service raised in a call, and the drone's own did not, for the next message to the daemon."""
        self._denied.add(service)

    async def tell_denied(self) -> None:
        """Sends the daemon the denied services, if any and if it can be reached."""
        denied, self._denied = sorted(self._denied), set()
        if denied and self._daemon is not None:
            with contextlib.suppress(LinkError):
                await self._tell(
                    protocol.DENY, protocol.DenyRequest(self.server, denied), timeout_s=_FAREWELL_S
                )

    async def end(self, *, in_range: bool) -> bool:
        """Leaves the server: in range after the calls under way, with a message to the daemon; out of range at once.

        Returns whether the daemon answered.
        """
        answered = False
        if in_range:
            await self.calls_over()
            if self._daemon is None and self._expected:  # a probe asked, over a connection of its own
                with contextlib.suppress(Unreachable):
                    self._daemon = self._link(self._address)
            await self.tell_denied()
            if self._daemon is not None:
                with contextlib.suppress(LinkError):
                    await self._tell(
                        protocol.LEAVE, protocol.LeaveRequest(self.server), timeout_s=_FAREWELL_S
                    )
                    answered = True
        await self._hang_up()
        await self._network.leave()
        return answered

    async def _dial_daemon(self) -> Link:
        if self._server.finder is not None:
            self._address = await self._server.finder(self.server)
        return self._link(self._address)

    def _link(self, address: str) -> Link:
        return self._dialer.dial(address, server=self.server)

    async def hang_up(self) -> None:
        """Drops the calls under way and every connection, and stays on the network."""
        await self._hang_up()
        self._instances, self._daemon, self._expected = {}, None, False

    async def _hang_up(self) -> None:
        instances = [link for _, link in self._instances.values()]
        for link in (*instances, *self._former, self._daemon):
            if link is not None:
                await link.close()

    async def _availability(self, daemon: Link | None = None) -> protocol.AvailabilityReply:
        request = protocol.AvailabilityRequest(self.server, list(self._server.services))
        asked_s = now_s()
        reply = await self._tell(protocol.AVAILABILITY, request, timeout_s=_ANSWER_S, daemon=daemon)
        self.round_trip_s = now_s() - asked_s
        answer = decode_reply(reply, protocol.AvailabilityReply, sender=self.server)
        if not answer.available:
            self._refuse(answer, "is unavailable")
        self._lease_s, self._expected = answer.lease_s, True
        return answer

    def _raise_if_full(self, reply: protocol.AvailabilityReply | protocol.StartReply) -> None:
        if reply.ask_again_s > 0:
            raise ServerFull(
                f"{self.server}: {reply.reason}",
                waiting=reply.waiting,
                ask_again_s=min(max(_LEAST_ASK_S, reply.ask_again_s), _LONGEST_ASK_S),
            )

    def _refuse(self, reply: protocol.AvailabilityReply | protocol.StartReply, what: str) -> NoReturn:
        self._raise_if_full(reply)
        if reply.pause_s > 0:
            pause_s = min(reply.pause_s, _LONGEST_PAUSE_S)
            why = f"{self.server} is left out for {pause_s:.0f} s: {reply.reason}"
            raise ServicePaused(why, pause_s=pause_s)
        raise Refused(f"{self.server} {what}: {reply.reason}")

    async def _asked(self, path: str, request: Struct, expected: type[R], *, timeout_s: float) -> R:
        reply = await self._tell(path, request, timeout_s=timeout_s)
        return decode_reply(reply, expected, sender=self.server)

    async def _tell(
        self, path: str, message: msgspec.Struct, *, timeout_s: float, daemon: Link | None = None
    ) -> bytes:
        daemon = daemon or self._daemon
        assert daemon is not None  # noqa: S101 - dialled by ask()
        return await daemon.request(path, msgspec.msgpack.encode(message), timeout_s=timeout_s)

    async def _dial(self, service: str, endpoint: str) -> None:
        address = resolve(endpoint, self._address)
        if service in self._instances:
            before, link = self._instances[service]
            if address == before:
                return
            await link.close()
        link = self._link(address)
        self._instances[service] = address, link
        if link.is_far or self._server.connects:
            await _connected(link)


async def _connected(instance: Link) -> None:
    with contextlib.suppress(Refused):  # which is an answer too
        await instance.request(protocol.HEALTH_CHECK, b"", timeout_s=_ANSWER_S)
