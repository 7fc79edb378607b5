"""Links over gRPC: the drone's end.

The options are those that were measured on WiFi-like links. Without the keep-alive and reconnect settings a channel
needs almost as long to recover from a black-out as the black-out lasted; without a pool of its own a new channel
would share a dead connection with an old one. See docs/decisions/grpc.md.
"""

from __future__ import annotations

import asyncio
import contextlib
import re
import time
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from typing import Any

import grpc
import msgspec

from upwash.errors import DeadlineExceeded, LinkError, NoLease, NotBegun, Refused, Unreachable
from upwash.real.link.listener import DRONE_METADATA, NOT_INFLATED, seconds_of
from upwash.real.link.requests import too_large
from upwash.real.link.way import LARGE_BYTES, Way
from upwash.real.trust.credentials import Credentials, at_second
from upwash.rpc.protocol import (
    HEALTH_CHECK,
    LONGEST_REPLY_BYTES,
    LONGEST_STATUS_BYTES,
    MAY_QUEUE_METADATA,
    QUEUE_METADATA,
    QUEUED_METADATA,
    STATUS,
    service_path,
)
from upwash.rpc.service import with_queue
from upwash.support.addresses import WITHOUT_ZONE
from upwash.support.background import only_logged, thread
from upwash.support.text import printable

_DAEMON, _STATUS = STATUS.strip("/").split("/")
CHANNEL_OPTIONS: tuple[tuple[str, int | str], ...] = (
    ("grpc.keepalive_time_ms", 2000),
    ("grpc.keepalive_permit_without_calls", 1),
    ("grpc.http2.max_pings_without_data", 0),
    ("grpc.initial_reconnect_backoff_ms", 100),
    ("grpc.max_reconnect_backoff_ms", 1000),
    ("grpc.dns_min_time_between_resolutions_ms", 1000),  # a name may lead elsewhere once a connection is lost
    ("grpc.enable_http_proxy", 0),
    ("grpc.use_local_subchannel_pool", 1),
    NOT_INFLATED,
    ("grpc.service_config_disable_resolution", 1),  # DNS must not change these rules
)
_OUTDATED = {  # in what gRPC says of a handshake that failed: what a person reads
    "certificate is not yet valid": "its certificate is not valid yet",
    "certificate has expired": "its certificate has expired",
}
_ANOTHER_AUTHORITY = "its certificate is of another authority, or another server's"
_ANOTHER_PROGRAM = "another program answers there, not an upwash daemon: check the address"
_HUNG_UP = "it hung up; its log says why, such as a certificate that is revoked"
_SILENT = "it takes connections and does not answer"
_UNHEARD = "no connection: its computer is off or out of reach, or a firewall drops packets"
_TROUBLES = {  # the same of any connection that failed; the first that fits
    "CERTIFICATE_VERIFY_FAILED": _ANOTHER_AUTHORITY,
    "Hostname Verification": _ANOTHER_AUTHORITY,
    "Connection refused": "connection refused: nobody serves there",
    "WRONG_VERSION_NUMBER": "what answers there uses no certificates: another program, or a daemon without [keys]",
    "missing selected ALPN": _ANOTHER_PROGRAM,
    "Failed parsing HTTP/2": _ANOTHER_PROGRAM,
    "before receiving SETTINGS": _SILENT,
    "Endpoint closing": _SILENT,
    "tcp handshaker shutdown": _UNHEARD,
    "connect() timed out": _UNHEARD,  # gRPC has two timers, see above
    "lookup failed": "no computer of that name is known",
    "No such file or directory": "no such socket: nobody serves there",
    "Socket closed": _HUNG_UP,
    "Connection reset by peer": _HUNG_UP,
    "error: Invalid argument": WITHOUT_ZONE,  # of connect(2)
}
_ROUND_TRIPS, _FIRST_ROUND_TRIPS = 2, 8  # of a question, without and with connecting; some are lost
_LEAST_ROUND_TRIPS = 4  # until the first answer: TCP, TLS, HTTP/2, and the question
_LONGER = 1.2
_FAR_S = 0.1
_KEEPALIVE_S = 3.0  # for the answer to a ping, beside the round trips; also for TCP's acknowledgements
_WAITED_FOR = (f"/{_DAEMON}/", HEALTH_CHECK)  # these may take a slow link's time: no call of a mission waits
_LARGER = re.compile(r"(CLIENT|SERVER): (Sent|Received) message larger than max \((\d+) vs\. (\d+)\)")
_AROUND = re.compile(r"^failed to connect to all addresses; last error: [A-Z]+: ((ipv4|ipv6|unix):\S+: )?")


_NOWHERE = "unix:/nowhere"


class _Silent(Unreachable):
    """Raised when the other end takes connections and does not answer."""


class _Unheard(Unreachable):
    """Raised when TCP did not connect in the time of an attempt."""


class GrpcDialer:
    """Opens links that show `drone`'s certificate and trust only servers of the same authority.

    A message has at most `max_message_bytes`, and a reply of a service at most its `max_reply_bytes`.
    """

    def __init__(
        self,
        drone: str,
        credentials: Credentials | None,
        *,
        max_message_bytes: int,
        max_reply_bytes: Mapping[str, int] | None = None,
    ) -> None:
        self._drone = drone
        self._max_message_bytes = max_message_bytes
        self._options = [
            *CHANNEL_OPTIONS,
            ("grpc.max_receive_message_length", max_message_bytes),
            ("grpc.max_send_message_length", max_message_bytes),
            ("grpc.service_config", _longest_replies(max_reply_bytes or {})),
        ]
        self._shown = credentials
        self._ways: dict[str, Way] = {}  # by server
        # With a channel gRPC's engine runs: an engine that starts where no file is left aborts the program.
        self._engine = grpc.insecure_channel(_NOWHERE)
        self._credentials = credentials and grpc.ssl_channel_credentials(
            root_certificates=credentials.authority,
            private_key=credentials.key,
            certificate_chain=credentials.certificate,
        )

    def dial(self, address: str, *, server: str) -> GrpcLink:
        """A link to `HOST:PORT` or `unix:PATH` that trusts only `server`; connects when first used.

        A unix socket carries no certificates: the permissions of its folder say who may use it.
        """
        is_certified = self._shown is not None and not address.startswith("unix:")
        if is_certified:
            way = self._ways.setdefault(server, Way(server, address, self._shown))
            way.address = address
        else:
            way = Way(server, address, None)

        def connect() -> grpc.Channel:
            patience_s = _KEEPALIVE_S + way.more_s(_FIRST_ROUND_TRIPS)
            options = [
                *self._options,
                ("grpc.min_reconnect_backoff_ms", round(1000 * way.attempt_s)),  # gRPC's limit of an attempt
                ("grpc.keepalive_timeout_ms", round(1000 * patience_s)),
            ]
            if not is_certified:
                return grpc.insecure_channel(address, options)
            options.append(("grpc.ssl_target_name_override", server))
            return grpc.secure_channel(address, self._credentials, options)

        return GrpcLink(
            connect,
            way,
            peer=f"{server} at {address}",
            drone=self._drone,
            max_message_bytes=self._max_message_bytes,
        )

    async def trouble(self, server: str) -> str:
        """The trouble of the network path to a dialled server, "" for none; may take seconds."""
        way = self._ways.get(server)
        if way is None:
            return ""
        await way.look()
        return way.trouble


class GrpcLink:
    """One channel; requests are futures of the synchronous stack, settled on the event loop.

    gRPC ends a request, at its deadline or when its channel closes, only after it has written what it began to write:
    perhaps never, if the other end reads nothing. So deadlines are kept here, and nothing waits for gRPC.

    If a server takes connections and is silent, the path is measured; if its round trips take longer than known, a
    new connection gets that time. The deadline of a call is hard; a daemon's answer may take longer by the path's
    round trips.
    """

    def __init__(
        self,
        connect: Callable[[], grpc.Channel],
        way: Way,
        *,
        peer: str,
        drone: str,
        max_message_bytes: int,
    ) -> None:
        self._connect = connect
        self._way = way
        self._dial()
        self._answered = False  # ever
        self._looked_for = False  # as TCP did not connect
        self._peer = peer
        self._max_message_bytes = max_message_bytes
        self._metadata: tuple[tuple[str, str], ...] = ((DRONE_METADATA, drone),)
        self._under_way: set[Callable[[], None]] = set()  # wakes each request
        self._closed = False

    @property
    def is_far(self) -> bool:
        """Whether the measured round trip is long, as over a mobile network."""
        return self._way.round_trip_s > _FAR_S

    async def request(
        self, path: str, body: bytes, *, timeout_s: float, may_queue_s: float | None = None
    ) -> bytes:
        """Sends one request and returns its reply; raises LinkError. Cancelling it cancels the call."""
        waited_for, large = path.startswith(_WAITED_FOR), len(body) > LARGE_BYTES
        while True:
            round_trips = _ROUND_TRIPS if self._answered else _FIRST_ROUND_TRIPS
            more_s = self._way.more_s(round_trips) if waited_for else 0.0
            began_s = time.monotonic()
            try:
                reply = await self._request(path, body, timeout_s + more_s, may_queue_s)
            except _Silent as silence:
                if not waited_for:
                    self._way.suspect()
                    raise
                if not await self._learned_more():
                    raise Unreachable(_with(silence, self._way.silence)) from None
            except _Unheard:
                # A lost packet, or a very long way, looks the same; a near server that has answered before is gone.
                may_be_there = waited_for and (self.is_far or not self._way.round_trip_s)
                if self._looked_for or not may_be_there:
                    raise
                self._looked_for = True
                if not await self._way.measure() or self._closed:
                    raise
                self._hang_up()
                self._dial()
            except DeadlineExceeded as late:
                if large:
                    self._way.suspect()
                raise DeadlineExceeded(_with(late, self._way.trouble)) from None
            else:
                took_s = time.monotonic() - began_s
                self._way.answered(took_s if self._answered else took_s / _LEAST_ROUND_TRIPS, large=large)
                self._answered = True
                return reply

    async def close(self) -> None:
        """Closes the connection at once; every request under way fails."""
        if self._closed:
            return
        self._closed = True
        for settle in self._under_way:
            settle()
        self._hang_up()

    async def _learned_more(self) -> bool:
        """Measure the path; if it is slower than known, begin a connection with more time, and return True."""
        for learn in (self._way.measure, self._way.look):
            await learn()
            if self._way.attempt_s > _LONGER * self._attempt_s and not self._closed:
                self._hang_up()
                self._dial()
                return True
        return False

    def _dial(self) -> None:
        self._attempt_s = self._way.attempt_s
        self._channel = self._connect()
        self._methods: dict[str, Any] = {}

    def _hang_up(self) -> None:
        with contextlib.suppress(RuntimeError):  # no thread is left: the channel closes once it is collected
            thread(self._channel.close, name="a link that closes", failed=only_logged).start()

    async def _request(self, path: str, body: bytes, timeout_s: float, may_queue_s: float | None) -> bytes:
        if self._closed:
            raise self._is_closed()
        method = self._methods.get(path)
        if method is None:
            method = self._methods[path] = self._channel.unary_unary(path)
        loop = asyncio.get_running_loop()
        ended = loop.create_future()

        def settle() -> None:
            if not ended.done():
                ended.set_result(None)

        def wake(_: object) -> None:
            with contextlib.suppress(RuntimeError):  # the loop is closed: nothing waits any more
                loop.call_soon_threadsafe(settle)

        metadata = self._metadata
        if may_queue_s is not None:
            metadata += ((MAY_QUEUE_METADATA, f"{may_queue_s:.3f}"),)
        try:
            call = method.future(bytes(body), timeout=timeout_s, metadata=metadata)
        except RuntimeError as error:  # no thread is left
            raise Unreachable(f"{self._peer}: {error}") from error
        call.add_done_callback(wake)
        deadline = loop.call_later(timeout_s, settle)
        self._under_way.add(settle)
        try:
            await ended
        except asyncio.CancelledError:
            call.cancel()
            raise
        finally:
            deadline.cancel()
            self._under_way.remove(settle)
        if not call.done():
            call.cancel()
            raise self._is_closed() if self._closed else self._is_late(timeout_s)
        told = dict(call.trailing_metadata() or ())
        queue_s = seconds_of(told.get(QUEUE_METADATA))
        if call.code() is grpc.StatusCode.OK:
            queued_s = seconds_of(told.get(QUEUED_METADATA))
            return with_queue(call.result(), queued_s=queued_s, queue_s=queue_s)
        if call.code() is grpc.StatusCode.OUT_OF_RANGE:
            raise NotBegun(queue_s, self._peer)
        raise self._error(path, call.code(), printable(call.details() or ""), timeout_s)

    def _is_closed(self) -> Unreachable:
        return Unreachable(f"{self._peer}: the link is closed")

    def _is_late(self, timeout_s: float) -> DeadlineExceeded:
        return DeadlineExceeded(f"{self._peer}: no answer within {timeout_s:.1f} s")

    def _error(self, path: str, code: grpc.StatusCode, details: str, timeout_s: float) -> LinkError:
        match code:
            case grpc.StatusCode.DEADLINE_EXCEEDED:
                return self._is_late(timeout_s)
            case grpc.StatusCode.UNAVAILABLE | grpc.StatusCode.CANCELLED:
                own, trouble = self._way.own_trouble(), _plainly(details)
                why = f"{self._peer}: {trouble}{f'; {own}' if own else ''}"
                kinds = {_SILENT: _Silent, _UNHEARD: _Unheard}
                return Unreachable(why) if own else kinds.get(trouble, Unreachable)(why)
            case grpc.StatusCode.PERMISSION_DENIED:
                return NoLease(f"{self._peer}: {details}")
            case grpc.StatusCode.RESOURCE_EXHAUSTED if not path.startswith(f"/{_DAEMON}/"):
                return Refused(f"{self._peer}: {_in_words(details, self._max_message_bytes)}")
            case _:
                return Refused(f"{self._peer}: {code.name}: {details}")


def _with(error: LinkError, trouble: str) -> str:
    return f"{error}: {trouble}" if trouble else str(error)


def _longest_replies(max_reply_bytes: Mapping[str, int]) -> str:
    """gRPC's configuration of a channel that bounds the length of replies, by service and method."""
    rules = [
        ({"service": _DAEMON}, LONGEST_REPLY_BYTES),
        ({"service": _DAEMON, "method": _STATUS}, LONGEST_STATUS_BYTES),
        *(({"service": service_path(name, "").strip("/")}, most) for name, most in max_reply_bytes.items()),
    ]
    methods = [{"name": [name], "maxResponseMessageBytes": most} for name, most in rules]
    return msgspec.json.encode({"methodConfig": methods}).decode()


def _in_words(details: str, max_message_bytes: int) -> str:
    """gRPC's message about a size, replaced by ours with the remedy; other messages stay unchanged."""
    found = _LARGER.search(details)
    if found is None:
        return details
    end, did, size, most = found.groups()
    what = "request" if (end, did) in (("CLIENT", "Sent"), ("SERVER", "Received")) else "result"
    return too_large(
        what,
        int(size),
        int(most),
        whose="the drone" if end == "CLIENT" else "the computer that runs the service",
        key="max_reply_bytes" if end == "CLIENT" and int(most) < max_message_bytes else "max_message_bytes",
    )


def _plainly(details: str) -> str:
    for sign, trouble in _OUTDATED.items():
        if sign in details:
            return f"{trouble}; this computer's clock says {at_second(datetime.now(UTC))}"
    troubles = (trouble for sign, trouble in _TROUBLES.items() if sign in details)
    return next(troubles, None) or _AROUND.sub("", details)
