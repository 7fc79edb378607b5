"""TLS for the daemon and for each of its instances, in front of gRPC.

A peer without a certificate of the authority, or with a revoked certificate, is refused here, and takes one of a
bounded number of connections. The bytes of a known caller are handed on, with its name, while it keeps within the
limits. The daemon's key stays here. See docs/decisions/door.md.
"""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import functools
import logging
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

from upwash.core.admission.clients import DoorReason, DoorStatus
from upwash.core.admission.limits import Allowance
from upwash.errors import InstanceError
from upwash.real.host.log import RateLimitedLog
from upwash.real.link.limits import CertificateLimit, ConnectionLimits, DoorLimits, FrameCounter, RateLimit
from upwash.real.link.proxy import Connect
from upwash.real.link.streams import StreamEnd, endpoint_of, join, listening_socket, readable
from upwash.real.link.tls import shake_hands
from upwash.real.trust.credentials import Distrusted, Holder, Trust, holder_of
from upwash.support.addresses import address_of
from upwash.support.background import beside, end, only_logged, start, thread

_log = logging.getLogger("upwash.door")
_log.addFilter(RateLimitedLog())

OnTraffic = Callable[[str, str], None]  # to the server of that name, from the caller known by `Client.key`

_OUT_OF_SOCKETS_S = 0.1
_LAST_WORDS_S = 1.0
_MOST_SITES = 4096
_TRAFFIC_PER_S = 1.0
_VERIFIED: Mapping[int, DoorReason] = {
    9: "not_yet_valid",
    10: "expired",
}  # by X509_V_ERR_...; else the authority
_IPV6_SITE_BITS = 64  # of a network: one machine may use all its addresses


@dataclass(frozen=True, slots=True)
class Entrance:
    """A listening socket of the door: the `endpoint` that drones get, its address, and how to close it."""

    endpoint: str
    address: str
    close: Callable[[], Awaitable[None]]


class Door:
    """Lets callers with a trusted certificate through, in a thread of its own, until it is closed.

    That thread calls `on_traffic(server, key)` when the caller with that `Client.key` sends, at most once a second
    for a connection.
    """

    def __init__(
        self,
        trust: Trust,
        limits: DoorLimits | None = None,
        *,
        on_traffic: OnTraffic = lambda _server, _key: None,
    ) -> None:
        self._on_traffic = on_traffic
        self._trust = trust
        self._limits = limits = limits or DoorLimits()
        self._strangers = ConnectionLimits(limits.strangers, per_group=limits.strangers_per_address)
        self._handshakes = ConnectionLimits(limits.handshakes, per_group=limits.handshakes_per_address)
        self._callers = ConnectionLimits(limits.connections, per_group=limits.connections_per_certificate)
        self._certificates: dict[asyncio.Task[Any], bytes] = {}
        self._limit_of = functools.lru_cache(limits.connections)(
            lambda _certificate: CertificateLimit(limits)
        )
        self._pace_of = functools.lru_cache(_MOST_SITES)(
            lambda _site: RateLimit(limits.handshakes_per_address_per_s)
        )
        # Of every reason from the start, so that another thread can go through them.
        self._refused = dict.fromkeys(get_args(DoorReason), (0, "", 0.0))
        self._broken: Future[NoReturn] = Future()
        self._loop = asyncio.new_event_loop()
        self._thread = thread(self._run, name="door", failed=self._break)
        self._thread.start()

    @property
    def refused(self) -> list[DoorStatus]:
        """The refused connections, by reason; callable from any thread."""
        return [
            DoorStatus(reason, times, last, time.monotonic() - last_s)
            for reason, (times, last, last_s) in self._refused.items()
            if times
        ]

    async def broken(self) -> NoReturn:
        """Waits for a defect that ends the door or an entrance, and raises it."""
        await asyncio.wrap_future(self._broken)
        raise AssertionError("it has no result")

    async def close(self) -> None:
        """Closes all connections; returns when that is done."""
        await self._there(self._hang_up())
        self._loop.call_soon_threadsafe(self._loop.stop)
        await asyncio.to_thread(self._thread.join)

    async def lead(self, listening: socket.socket, inside: Connect, *, server: str = "") -> Entrance:
        """Leads callers of the listening socket, now the door's, to `inside`, an instance of the server."""
        address = address_of(listening)
        listening.setblocking(False)

        async def begin() -> asyncio.Task[None]:
            accept = self._accept(listening, inside, server)
            return start(accept, name=f"the way in at {address}", failed=self._break)

        accepting = await self._there(begin())
        return Entrance(endpoint_of(listening), address, lambda: self._there(end(accepting)))

    async def trust(self, trust: Trust) -> None:
        """Trusts exactly these certificates from now on; connections of others end."""
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
                site = _site(peer[0])
                welcome = self._welcome(connection, site, inside, server)
                task = start(welcome, name=f"serving {site}", failed=only_logged)
                task.add_done_callback(self._strangers.remove)
                task.add_done_callback(functools.partial(_close_unseen, connection))
                self._strangers.add(task, site)

    async def _welcome(self, connection: socket.socket, site: str, inside: Connect, server: str) -> None:
        try:
            async with asyncio.timeout(self._limits.silence_s):
                await readable(connection)  # a silent peer takes no turn
            await self._pace_of(site).wait()  # a handshake costs more than all else that a stranger may do
            outer = await self._shake_hands(connection, site)
        except (OSError, asyncio.CancelledError) as error:
            connection.close()
            why = _plainly(error) if isinstance(error, OSError) else "it took long while others waited"
            self._refuse(_reason(error), site, site, why)
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
            self._refuse(error.reason, holder_of(certificate).client.name, site, str(error))
            await asyncio.wait([outer.lost])
            return
        await self._serve(outer, certificate, holder, inside, server)

    async def _shake_hands(self, connection: socket.socket, site: str) -> StreamEnd:
        task = _own_task()
        self._handshakes.add(task, site)
        try:
            return await shake_hands(connection, self._trust.context, within_s=self._limits.handshake_s)
        finally:
            self._handshakes.remove(task)

    def _refuse_shut_out(self, holder: Holder) -> None:
        limit = self._limit_of(holder.client.certificate)
        left_s = limit.shut_out_until_s - asyncio.get_running_loop().time()
        if left_s > 0:
            raise Distrusted("shut_out", f"{holder.client.name} is shut out for another {left_s:.0f} s")

    def _refuse(self, reason: DoorReason, who: str, site: str, why: str) -> None:
        self._count(reason, who)
        whom = f"{reason} {who}" if who != site else f"{site}: {why}"
        _log.warning("refused %s: %s", site, why, extra={"whom": whom})

    def _count(self, reason: DoorReason, who: str) -> None:
        times, _, _ = self._refused[reason]
        self._refused[reason] = (times + 1, who, time.monotonic())

    async def _serve(
        self, outer: StreamEnd, certificate: bytes, holder: Holder, inside: Connect, server: str
    ) -> None:
        client, task = holder.client, _own_task()
        self._strangers.remove(task)
        self._certificates[task] = certificate
        self._callers.add(task, client.certificate)
        left_s = (holder.ends - datetime.now(UTC)).total_seconds()
        counter, limit = FrameCounter(), self._limit_of(client.certificate)
        reports, now_s = Allowance(_TRAFFIC_PER_S, at_once=1), asyncio.get_running_loop().time

        def watch(chunk: bytes) -> None:
            counted = counter.count(chunk)
            limit.take(counted, now_s())
            if server and (counted["begun"] or counted["data"]) and reports.take(1, now_s=now_s()):
                self._on_traffic(server, client.key)

        try:
            async with asyncio.timeout(left_s), inside(client) as inner:
                await join(outer, inner, watch=watch)
        except TimeoutError:
            self._count("expired", client.name)
            _log.warning("hanging up: the certificate of %s has expired", client.name)
        except OSError as error:
            _log.warning("hanging up on %s: %s", client.name, error)
        except asyncio.CancelledError:
            pass  # it makes room, is revoked, or the door is closed
        finally:
            outer.hang_up()
            await asyncio.wait([outer.lost])
            self._callers.remove(task)
            del self._certificates[task]


def _own_task() -> asyncio.Task[Any]:
    task = asyncio.current_task()
    assert task is not None  # noqa: S101 - each connection has one
    return task


def _close_unseen(connection: socket.socket, task: asyncio.Task[Any]) -> None:
    """Closes the connection of a task that was cancelled before it began; otherwise a transport has it."""
    if task.cancelled():
        connection.close()


def _site(address: str) -> str:
    """The part of an address that counts as one site: an IPv4 address, or the network of an IPv6 address."""
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
    trust: Trust, limits: DoorLimits | None = None, *, on_traffic: OnTraffic = lambda _server, _key: None
) -> AsyncIterator[Door]:
    """A door for the block, closed after it; a defect of the door ends the block."""
    door = Door(trust, limits, on_traffic=on_traffic)
    try:
        async with beside(door.broken(), name="the door"):
            yield door
    finally:
        await door.close()


Lead = Callable[[str, Connect], Awaitable[Entrance]]  # to an instance of the server of that name


def leading(door: Door, host: str, ports: Mapping[int, int] = MappingProxyType({0: 0})) -> Lead:
    """A function that opens an entrance at the first free port of that host.

    `ports` maps each port to the port that callers see. With port 0 the system chooses, and callers see that port.
    The function raises InstanceError if no port is free.
    """

    async def lead(server: str, inside: Connect) -> Entrance:
        listening, seen = _first_free(host, ports)
        entrance = await door.lead(listening, inside, server=server)
        return dataclasses.replace(entrance, endpoint=f":{seen}") if seen else entrance

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
