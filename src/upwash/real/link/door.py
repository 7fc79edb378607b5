"""Where strangers end: TLS for the daemon and for each of its instances, in front of gRPC.

Whoever shows no certificate of the authority, or a revoked one, gets no further than here, and takes no more than a
place among a bounded number of connections. What a known caller sends is handed on, with a word of who sends it, as
long as it begins and breaks off no more requests than a drone ever would. Neither gRPC nor any service holds the
daemon's key. See docs/decisions/door.md.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import logging
import resource
import socket
import ssl
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine, Mapping
from concurrent.futures import Future
from dataclasses import dataclass
from datetime import UTC, datetime
from ipaddress import IPv6Address, ip_address
from types import MappingProxyType
from typing import Any, NoReturn, get_args

from upwash.core.admission.clients import Client, DoorReason, DoorStatus
from upwash.core.admission.limits import Allowance
from upwash.errors import InstanceError
from upwash.real.host.log import Sparing
from upwash.real.link.announced import Connect
from upwash.real.link.crowd import Crowd, Recent, Turns
from upwash.real.link.frames import Counted, FrameCounter
from upwash.real.link.streams import End, endpoint_of, join, listening_socket, readable
from upwash.real.link.tls import shake_hands
from upwash.real.trust.trust import Distrusted, Holder, Trust, holder_of
from upwash.support.background import beside, end, only_logged, start, thread

_log = logging.getLogger("upwash.door")
_log.addFilter(Sparing())

Seen = Callable[[str, str], None]  # on the server of that name, the caller known by `Client.key`

_OUT_OF_SOCKETS_S = 0.1
_LAST_WORDS_S = 1.0
_MOST_FILES = 65_536
_MOST_SITES = 4096
_TOLD_PER_S = 1.0
_VERIFIED: Mapping[int, DoorReason] = {
    9: "not_yet_valid",
    10: "expired",
}  # by X509_V_ERR_...; else the authority
_IPV6_SITE_BITS = 64  # one network's, all of which one machine may use


@dataclass(frozen=True, slots=True)
class DoorLimits:
    """How many connections and requests, where not said otherwise for each certificate."""

    strangers: int = 256
    strangers_per_address: int = 64
    handshakes: int = 64  # under way at once: TLS takes 0.2 MB for a peer that announces a long message
    handshakes_per_address: int = 16
    handshakes_per_address_per_s: float = 20.0
    silence_s: float = 10.0
    handshake_s: float = 10.0  # of a round trip of 1 s, with packets lost
    connections: int = 1024
    connections_per_certificate: int = 64
    begun_per_s: float = 1000.0
    broken_off_per_s: float = 50.0
    idle_per_s: float = 500.0
    pieces_per_s: float = 20_000.0  # of bodies, to and fro: some 300 MB/s where they are whole
    burst_s: float = 2.0  # what comes at once may be what is allowed in so long
    shut_out_s: float = 10.0  # a certificate that did more than that


def door_limits(files: int) -> DoorLimits:
    """What a process can bear that may have so many files open: a caller takes three."""
    return DoorLimits(connections=min(1024, files // 6), strangers=min(256, files // 8))


def raise_limit_of_files() -> int:
    """Allows this process as many open files as the system does, within reason, and returns how many."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    most = _MOST_FILES if hard == resource.RLIM_INFINITY else min(hard, _MOST_FILES)
    if soft < most:
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))
    return max(soft, most)


class Passage:
    """A way through the door; `endpoint` is what drones are told."""

    def __init__(self, endpoint: str, address: str, close: Callable[[], Awaitable[None]]) -> None:
        self.endpoint = endpoint
        self.address = address
        self.close = close


class _Pace:
    """What one certificate may do in a second, over all its connections."""

    def __init__(self, limits: DoorLimits) -> None:
        self.shut_out_until_s = 0.0
        self._shut_out_s = limits.shut_out_s
        self._allowances = [
            Allowance(per_s, at_once=per_s * limits.burst_s)
            for per_s in (limits.begun_per_s, limits.broken_off_per_s, limits.idle_per_s, limits.pieces_per_s)
        ]

    def take(self, counted: Counted, now_s: float) -> None:
        """Raises ConnectionAbortedError where it is too much."""
        for allowance, number in zip(
            self._allowances,
            (counted.begun, counted.broken_off, counted.idle, counted.pieces + counted.room),
            strict=True,
        ):
            if number and not allowance.take(number, now_s=now_s):
                self.shut_out_until_s = now_s + self._shut_out_s
                raise ConnectionAbortedError("it begins or breaks off more requests than any drone would")


class Door:
    """Lets known callers through, in a thread of its own; there, `seen` is told who calls, once a second at most."""

    def __init__(
        self, trust: Trust, limits: DoorLimits | None = None, *, seen: Seen = lambda _server, _key: None
    ) -> None:
        self._seen = seen
        self._trust = trust
        self._limits = limits or DoorLimits()
        self._loop = asyncio.new_event_loop()
        self._thread = thread(self._run, name="door", failed=self._break)
        self._broken: Future[NoReturn] = Future()
        limits = self._limits
        self._strangers: Crowd[asyncio.Task[Any]] = Crowd(
            limits.strangers, most_of_group=limits.strangers_per_address
        )
        self._callers: Crowd[asyncio.Task[Any]] = Crowd(
            limits.connections, most_of_group=limits.connections_per_certificate
        )
        self._certificates: dict[asyncio.Task[Any], bytes] = {}
        self._paces = Recent(lambda: _Pace(self._limits), most=limits.connections)
        self._handshakes: Crowd[asyncio.Task[Any]] = Crowd(
            limits.handshakes, most_of_group=limits.handshakes_per_address
        )
        self._turns = Recent(self._new_site, most=_MOST_SITES)
        # Of every reason from the start, so that another thread can go through them.
        self._refused = dict.fromkeys(get_args(DoorReason), (0, "", 0.0))

    @property
    def refused(self) -> list[DoorStatus]:
        """Who was refused, by reason; from any thread."""
        return [
            DoorStatus(reason, times, last, time.monotonic() - last_s)
            for reason, (times, last, last_s) in self._refused.items()
            if times
        ]

    def open(self) -> None:
        """Begins to work."""
        self._thread.start()

    async def broken(self) -> NoReturn:
        """Raises what has ended the door, or a way in, where a defect does."""
        await asyncio.wrap_future(self._broken)
        raise AssertionError("it has no result")

    async def close(self) -> None:
        """Hangs up on everybody; returns when that is done."""
        await self._there(self._hang_up())
        self._loop.call_soon_threadsafe(self._loop.stop)
        await asyncio.to_thread(self._thread.join)

    async def lead(self, listening: socket.socket, inside: Connect, *, server: str = "") -> Passage:
        """Lets callers of that socket, which becomes the door's, through to `inside`, an instance of that server."""
        host, port = listening.getsockname()[:2]
        address = f"[{host}]:{port}" if listening.family == socket.AF_INET6 else f"{host}:{port}"
        listening.setblocking(False)
        accepting: asyncio.Task[None] | None = None

        def open_it() -> None:
            nonlocal accepting
            accept = self._accept(listening, inside, server)
            accepting = start(accept, name=f"the way in at {address}", failed=self._break)

        async def shut() -> None:
            await end(accepting)

        self._loop.call_soon_threadsafe(open_it)
        return Passage(endpoint_of(listening), address, lambda: self._there(shut()))

    async def trust(self, trust: Trust) -> None:
        """Believes these from now on; connections of whom it believes no more are ended."""
        await self._there(self._change_trust(trust))

    def _break(self, defect: Exception) -> None:
        if not self._broken.done():
            self._broken.set_exception(defect)

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        try:
            self._loop.run_forever()
        finally:
            self._loop.close()

    async def _there(self, work: Coroutine[Any, Any, Any]) -> Any:
        return await asyncio.wrap_future(asyncio.run_coroutine_threadsafe(work, self._loop))

    async def _hang_up(self) -> None:
        others = [task for task in asyncio.all_tasks() if task is not asyncio.current_task()]
        for task in others:
            task.cancel()
        await asyncio.wait(others, timeout=_LAST_WORDS_S) if others else None

    async def _change_trust(self, trust: Trust) -> None:
        self._trust = trust
        for task, certificate in list(self._certificates.items()):
            try:
                trust.holder(certificate)
            except Distrusted as error:
                self._count(error.reason, holder_of(certificate).client.name)
                _log.warning("hanging up: %s", error)
                task.cancel()

    async def _accept(self, listening: socket.socket, inside: Connect, server: str) -> None:
        """Each newcomer is a stranger first."""
        with listening:
            while True:
                await readable(listening)
                try:
                    connection, peer = listening.accept()
                except BlockingIOError:
                    continue  # it hung up before
                except OSError as error:
                    _log.warning("cannot take a connection: %s", error)
                    await asyncio.sleep(_OUT_OF_SOCKETS_S)
                    continue
                connection.setblocking(False)
                address = _site(peer[0])
                welcome = self._welcome(connection, address, inside, server)
                task = start(welcome, name=f"serving {address}", failed=only_logged)
                leaving = self._strangers.enter(task, address)
                task.add_done_callback(self._strangers.leave)
                task.add_done_callback(functools.partial(_close_unseen, connection))
                _make_room(leaving)

    async def _welcome(self, connection: socket.socket, address: str, inside: Connect, server: str) -> None:
        """From the first byte of a connection to its last."""
        try:
            async with asyncio.timeout(self._limits.silence_s):
                await readable(connection)  # who says nothing takes nobody's turn
            await self._turns.of(address).turn()  # nothing that a stranger may do costs more
            outer = await self._shake_hands(connection, address)
        except (OSError, asyncio.CancelledError) as error:
            connection.close()
            why = _plainly(error) if isinstance(error, OSError) else "it took long while others waited"
            self._count(_reason(error), address)
            _log.warning("refused %s: %s", address, why)
            return
        certificate = outer.transport.get_extra_info("ssl_object").getpeercert(binary_form=True)
        try:
            holder = self._trust.holder(certificate)
            self._refuse_shut_out(holder)
        except Exception as error:
            # Without a word: gRPC's clients would take any for the beginning of a connection, and try again at once.
            outer.hang_up()
            if not isinstance(error, Distrusted):
                raise
            self._count(error.reason, holder_of(certificate).client.name)
            _log.warning("refused %s: %s", address, error)
            await asyncio.wait([outer.lost])
            return
        await self._serve(outer, certificate, holder, inside, server)

    async def _shake_hands(self, connection: socket.socket, address: str) -> End:
        task = _own_task()
        _make_room(self._handshakes.enter(task, address))
        try:
            return await shake_hands(connection, self._trust.context, within_s=self._limits.handshake_s)
        finally:
            self._handshakes.leave(task)

    def _new_site(self) -> Turns:
        return Turns(self._limits.handshakes_per_address_per_s)

    def _refuse_shut_out(self, holder: Holder) -> None:
        pace = self._paces.of(holder.client.certificate)
        left_s = pace.shut_out_until_s - asyncio.get_running_loop().time()
        if left_s > 0:
            raise Distrusted("shut_out", f"{holder.client.name} is shut out for another {left_s:.0f} s")

    def _count(self, reason: DoorReason, who: str) -> None:
        times, _, _ = self._refused[reason]
        self._refused[reason] = (times + 1, who, time.monotonic())

    def _watch(self, client: Client, server: str) -> Callable[[bytes], None]:
        """Is shown what comes on one connection; raises ConnectionAbortedError where it is too much."""
        counter, pace = FrameCounter(), self._paces.of(client.certificate)
        tellings, now_s = Allowance(_TOLD_PER_S, at_once=1), asyncio.get_running_loop().time

        def shown(chunk: bytes) -> None:
            counted = counter.count(chunk)
            pace.take(counted, now_s())
            if server and (counted.begun or counted.pieces) and tellings.take(1, now_s=now_s()):
                self._seen(server, client.key)

        return shown

    async def _serve(
        self, outer: End, certificate: bytes, holder: Holder, inside: Connect, server: str
    ) -> None:
        client, task = holder.client, _own_task()
        self._strangers.leave(task)
        self._certificates[task] = certificate
        _make_room(self._callers.enter(task, client.certificate))
        left_s = (holder.ends - datetime.now(UTC)).total_seconds()
        try:
            async with asyncio.timeout(left_s), inside(client) as inner:
                await join(outer, inner, seen=self._watch(client, server))
        except TimeoutError:
            self._count("expired", client.name)
            _log.warning("hanging up: the certificate of %s has expired", client.name)
        except OSError as error:
            _log.warning("hanging up on %s: %s", client.name, error)
        except asyncio.CancelledError:
            pass  # it makes room, is revoked, or the door is closed
        finally:
            await _hang_up_on(outer)
            self._callers.leave(task)
            del self._certificates[task]


def _own_task() -> asyncio.Task[Any]:
    task = asyncio.current_task()
    assert task is not None  # noqa: S101 - each connection has one
    return task


def _make_room(leaving: asyncio.Task[Any] | None) -> None:
    if leaving is not None:
        leaving.cancel()


async def _hang_up_on(outer: End) -> None:
    outer.hang_up()
    await asyncio.wait([outer.lost])


def _close_unseen(connection: socket.socket, task: asyncio.Task[Any]) -> None:
    """Closes the connection of one that was cancelled before it began; otherwise a transport has it."""
    if task.cancelled():
        connection.close()


def _site(address: str) -> str:
    """An IPv4 address, or the network of an IPv6 one."""
    parsed = ip_address(address.partition("%")[0])
    if isinstance(parsed, IPv6Address) and parsed.ipv4_mapped is None:
        return str(IPv6Address(int(parsed) >> _IPV6_SITE_BITS << _IPV6_SITE_BITS))
    return str(getattr(parsed, "ipv4_mapped", None) or parsed)


def _reason(error: BaseException) -> DoorReason:
    if isinstance(error, ssl.SSLCertVerificationError):
        return _VERIFIED.get(error.verify_code, "other_authority")
    if isinstance(error, ssl.SSLError) and error.reason == "PEER_DID_NOT_RETURN_A_CERTIFICATE":
        return "no_certificate"
    return "no_handshake"


def _plainly(error: OSError) -> str:
    if isinstance(error, ssl.SSLCertVerificationError):
        return f"{error.reason}: {error.verify_message}"
    if isinstance(error, ssl.SSLError):
        return str(error.reason or error)
    return str(error) or "it hung up, or took too long"


@contextlib.asynccontextmanager
async def opened_door(
    trust: Trust, limits: DoorLimits | None = None, *, seen: Seen = lambda _server, _key: None
) -> AsyncIterator[Door]:
    """A door that is closed after the block; a defect that ends it ends the block."""
    door = Door(trust, limits, seen=seen)
    door.open()
    try:
        async with beside(door.broken(), name="the door"):
            yield door
    finally:
        await door.close()


Lead = Callable[[str, Connect], Awaitable[Passage]]  # to an instance of the server of that name


def leading(door: Door, host: str, ports: Mapping[int, int] = MappingProxyType({0: 0})) -> Lead:
    """Leads callers in at the first free one of the ports on that interface, each with the port that they see.

    Port 0 is any, of the system's choice, and seen as it is. Raises InstanceError where it cannot.
    """

    async def lead(server: str, inside: Connect) -> Passage:
        listening, seen = _first_free(host, ports)
        passage = await door.lead(listening, inside, server=server)
        passage.endpoint = f":{seen}" if seen else passage.endpoint
        return passage

    return lead


def _first_free(host: str, ports: Mapping[int, int]) -> tuple[socket.socket, int]:
    why = OSError("no port is left")
    for port, seen in ports.items():
        try:
            return listening_socket(f"{host}:{port}"), seen
        except OSError as error:
            why = error
    where = f"{host or '*'}, ports {min(ports)} to {max(ports)}" if len(ports) > 1 else host
    raise InstanceError(f"no way to an instance: cannot listen on {where}: {why}") from why
