"""The network path to a server: its round-trip time, and packet sizes that it loses, measured by own connections."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import ssl
import struct
import time
from dataclasses import dataclass
from datetime import UTC, datetime

from upwash.real.trust.credentials import Credentials
from upwash.real.trust.secrets import load_secret
from upwash.support.background import begin, in_thread

LARGE_BYTES = 1200  # a longer request needs packets that a tunnel with a small MTU may lose
_THREAD = "a look at the way to a server"
_QUICK_ATTEMPT_S = 1.5  # Linux repeats a lost SYN after 1 s
_ROUND_TRIPS = 6  # TCP, TLS and HTTP/2 take three, and a lost packet costs three more
_LONGEST_ROUND_TRIP_S = 5.0
_LOOK_S = 3.0  # at TLS, beside the round trips
_VALID_S = 60.0
_SMALL_SEGMENT_BYTES = 536  # every network carries packets of that size
_LONG_HELLO = ["h2", *(f"{number:0250}" for number in range(12))]  # TLS then begins with packets of full size
_BYTES_RECEIVED = struct.Struct("128xQ")  # in Linux's tcp_info
_LOSES_LARGE = (
    "small packets pass and large ones are lost: lower the MTU of the VPN or of the interface (most networks carry "
    "1280), or set net.ipv4.tcp_mtu_probing = 1 on both computers"
)


@dataclass(frozen=True, slots=True)
class _Tried:
    """One attempt of TLS: seconds until TCP connected and TLS was done (or None), and whether bytes came back."""

    connect_s: float
    heard: bool
    shaken_s: float | None


class Way:
    """The network path to one server, at its latest `address`; without credentials it is local, and not measured.

    `round_trip_s` is 0 until it was measured. The last `look` found `trouble`, which keeps requests from getting
    through, and `silence`: why a server that takes connections does not answer. Both are "" for none.
    """

    def __init__(self, server: str, address: str, credentials: Credentials | None) -> None:
        self.address = address
        self.round_trip_s = 0.0
        self.trouble = self.silence = ""
        self._server = server
        self._credentials = credentials
        self._looked_s = -_VALID_S
        self._look: asyncio.Task[None] | None = None

    @property
    def attempt_s(self) -> float:
        """The longest time (s) of one attempt to connect."""
        return _QUICK_ATTEMPT_S + self.more_s(_ROUND_TRIPS)

    def more_s(self, round_trips: float) -> float:
        """The seconds that these round trips take."""
        return round_trips * self.round_trip_s

    def own_trouble(self) -> str:
        """Why others refuse this end's certificate now; "" if it is valid."""
        return self._credentials.problem_at(datetime.now(UTC)) if self._credentials else ""

    def answered(self, seconds: float, *, large: bool) -> None:
        """Note that a request was answered; its round trip took at most these seconds."""
        self.round_trip_s = min(self.round_trip_s or _LONGEST_ROUND_TRIP_S, seconds)
        if large:
            self.trouble = ""

    async def measure(self) -> bool:
        """Measures the round trip by the time that TCP takes to connect; returns whether it connects."""
        if self._credentials is None:
            return False
        try:
            self._learn(await in_thread(lambda: _connect_s(self.address), name=_THREAD))
        except OSError:
            return False
        return True

    async def look(self) -> None:
        """Finds the trouble of the path, or of the daemon at its end; at most once a minute."""
        if self._credentials is None:
            return
        if self._look is None or (self._look.done() and time.monotonic() - self._looked_s > _VALID_S):
            self._look = begin(self._find_trouble(self._credentials))
        await asyncio.shield(self._look)

    def suspect(self) -> None:
        """Begins `look` in the background; `trouble` has the result later."""
        if self._look is None or self._look.done():
            begin(self.look())

    def _learn(self, round_trip_s: float) -> None:
        self.round_trip_s = min(round_trip_s, _LONGEST_ROUND_TRIP_S)

    async def _find_trouble(self, shown: Credentials) -> None:
        limit_s = _LOOK_S + self.more_s(_ROUND_TRIPS)
        self.trouble = self.silence = ""
        with contextlib.suppress(OSError):  # no TCP: the failure itself says why
            full, small = await asyncio.gather(
                self._try(shown, limit_s), self._try(shown, limit_s, _SMALL_SEGMENT_BYTES)
            )
            if full.shaken_s is None and small.shaken_s is not None:
                full = await self._try(shown, limit_s)  # as chance may have lost a packet
            self.silence = _silence(full, small, limit_s)
            self.trouble = self.silence if self.silence == _LOSES_LARGE else ""
            self._learn(max(full.connect_s, (full.shaken_s or 0.0) / 3))
        self._looked_s = time.monotonic()

    async def _try(self, shown: Credentials, limit_s: float, segment_bytes: int | None = None) -> _Tried:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        context.set_alpn_protocols(_LONG_HELLO)
        context.load_verify_locations(cadata=shown.authority.decode())
        load_secret(context, shown.certificate + b"\n" + shown.key)
        return await in_thread(
            lambda: _shaken(self.address, context, self._server, limit_s, segment_bytes), name=_THREAD
        )


def _silence(full: _Tried, small: _Tried, limit_s: float) -> str:
    if full.shaken_s is not None:
        return f"TLS is done after {full.shaken_s:.1f} s, and then the daemon is silent: see its log, and restart it"
    if small.shaken_s is not None:
        return _LOSES_LARGE
    so_far = f"TCP connects in {full.connect_s:.2f} s"
    if full.heard or small.heard:
        return (
            f"{so_far}, and TLS has begun but is not done after {limit_s:.1f} s: the link loses most packets, or the "
            "computer there is overloaded"
        )
    return (
        f"{so_far}, and not a byte of TLS came back in {limit_s:.1f} s: the daemon, or its computer, is stuck: "
        "restart it"
    )


def _connect_s(address: str) -> float:
    connection, began_s = _connected(address, _LOOK_S)
    connection.close()
    return time.monotonic() - began_s


def _connected(address: str, limit_s: float, segment_bytes: int | None = None) -> tuple[socket.socket, float]:
    """A TCP connection to the first address that accepts, and when that attempt began; raises OSError."""
    host, _, port = address.rpartition(":")
    failure = OSError("no address")
    for family, kind, _, _, place in socket.getaddrinfo(host.strip("[]"), port, type=socket.SOCK_STREAM):
        connection = socket.socket(family, kind)
        connection.settimeout(limit_s)
        try:
            if segment_bytes is not None:
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_MAXSEG, segment_bytes)
            began_s = time.monotonic()
            connection.connect(place)
        except OSError as error:
            connection.close()
            failure = error
        else:
            return connection, began_s
    raise failure


def _shaken(
    address: str, context: ssl.SSLContext, server: str, limit_s: float, segment_bytes: int | None
) -> _Tried:
    """Tries TLS, in packets of that size at most; raises OSError if TCP does not connect."""
    connection, began_s = _connected(address, limit_s, segment_bytes)
    connect_s = time.monotonic() - began_s
    connection.settimeout(limit_s)
    with context.wrap_socket(connection, server_hostname=server, do_handshake_on_connect=False) as tls:
        shaken_s = None
        with contextlib.suppress(OSError):
            tls.do_handshake()
            shaken_s = time.monotonic() - began_s
        state = tls.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _BYTES_RECEIVED.size)
        return _Tried(connect_s, _BYTES_RECEIVED.unpack(state)[0] > 0, shaken_s)
