"""Links over gRPC: the drone's end.

The options are those that were measured on WiFi-like links. Without the keep-alive and reconnect settings a
channel needs almost as long to recover from a black-out as the black-out lasted; without a pool of its own a new
channel would share a dead connection with an old one. See docs/decisions/grpc.md.
"""

from __future__ import annotations

import asyncio
import contextlib
import re
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from typing import Any

import grpc
import msgspec

from upwash.errors import DeadlineExceeded, LinkError, NoLease, Refused, Unreachable
from upwash.real.credentials import Credentials, at_second
from upwash.rpc.protocol import LONGEST_REPLY_BYTES, LONGEST_STATUS_BYTES, STATUS, service_path
from upwash.support.background import only_logged, thread
from upwash.support.text import printable

DRONE_METADATA = "upwash-drone"  # says who calls where no certificate does: on a unix socket or on loopback

# A compressed message arrives as it is, and cannot be decoded: gRPC 1.70 inflates one before it looks at its size.
NOT_INFLATED = ("grpc.per_message_decompression", 0)
_DAEMON, _STATUS = STATUS.strip("/").split("/")
CHANNEL_OPTIONS: tuple[tuple[str, int | str], ...] = (
    ("grpc.keepalive_time_ms", 2000),
    ("grpc.keepalive_timeout_ms", 3000),
    ("grpc.keepalive_permit_without_calls", 1),
    ("grpc.http2.max_pings_without_data", 0),
    ("grpc.initial_reconnect_backoff_ms", 100),
    ("grpc.min_reconnect_backoff_ms", 1500),  # for one attempt to connect: Linux repeats a lost SYN after 1 s
    ("grpc.max_reconnect_backoff_ms", 1000),
    ("grpc.dns_min_time_between_resolutions_ms", 1000),  # a name may lead elsewhere once a connection is lost
    ("grpc.enable_http_proxy", 0),
    ("grpc.use_local_subchannel_pool", 1),
    NOT_INFLATED,
    ("grpc.service_config_disable_resolution", 1),  # whoever answers for DNS has no say in it
)
_OUTDATED = {  # in what gRPC says of a handshake that failed: what a person reads
    "certificate is not yet valid": "its certificate is not valid yet",
    "certificate has expired": "its certificate has expired",
}
_ANOTHER_AUTHORITY = "its certificate is of another authority, or another server's"
_ANOTHER_PROGRAM = "another program answers there, not an upwash daemon: check the address"
_HUNG_UP = "it hung up; its log says why, such as a certificate that is revoked"
_SILENT = "it takes connections and does not answer"
_TROUBLES = {  # the same of any connection that failed; the first that fits
    "CERTIFICATE_VERIFY_FAILED": _ANOTHER_AUTHORITY,
    "Hostname Verification": _ANOTHER_AUTHORITY,
    "Connection refused": "connection refused: nobody serves there",
    "WRONG_VERSION_NUMBER": "what answers there uses no certificates: another program, or a daemon without [keys]",
    "missing selected ALPN": _ANOTHER_PROGRAM,
    "Failed parsing HTTP/2": _ANOTHER_PROGRAM,
    "before receiving SETTINGS": _SILENT,
    "Endpoint closing": _SILENT,
    "lookup failed": "no computer of that name is known",
    "No such file or directory": "no such socket: nobody serves there",
    "Socket closed": _HUNG_UP,
    "Connection reset by peer": _HUNG_UP,
}
_LARGER = re.compile(r"(CLIENT|SERVER): (Sent|Received) message larger than max \((\d+) vs\. (\d+)\)")
_AROUND = re.compile(r"^failed to connect to all addresses; last error: [A-Z]+: ((ipv4|ipv6|unix):\S+: )?")


class GrpcDialer:
    """Opens links that show `drone`'s certificate and believe only servers of the same authority.

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
        self._longest_replies = _longest_replies(max_reply_bytes or {})
        self._own_trouble = _certificate_trouble(credentials)
        self._credentials = (
            grpc.ssl_channel_credentials(
                root_certificates=credentials.authority,
                private_key=credentials.key,
                certificate_chain=credentials.certificate,
            )
            if credentials
            else None
        )

    def dial(self, address: str, *, server: str) -> GrpcLink:
        """A link to `HOST:PORT` or `unix:PATH` where only `server` is believed; connects when first used.

        A unix socket carries no certificates: the folder that it lies in says who may use it.
        """
        options: list[tuple[str, int | str]] = [
            *CHANNEL_OPTIONS,
            ("grpc.max_receive_message_length", self._max_message_bytes),
            ("grpc.max_send_message_length", self._max_message_bytes),
            ("grpc.service_config", self._longest_replies),
        ]
        own_trouble = self._own_trouble
        if self._credentials is None or address.startswith("unix:"):
            channel, own_trouble = grpc.insecure_channel(address, options), lambda: ""
        else:
            options.append(("grpc.ssl_target_name_override", server))
            channel = grpc.secure_channel(address, self._credentials, options)
        return GrpcLink(
            channel,
            peer=f"{server} at {address}",
            drone=self._drone,
            max_message_bytes=self._max_message_bytes,
            own_trouble=own_trouble,
        )


class GrpcLink:
    """One channel; requests are futures of the synchronous stack, settled on the event loop.

    gRPC ends no request, at its deadline or as its channel closes, before what it has begun to write is written:
    where the other end reads nothing, perhaps never. So deadlines are kept here, and nobody waits for gRPC.

    `own_trouble` says what makes others refuse this end's certificate now, "" where nothing does.
    """

    def __init__(
        self,
        channel: grpc.Channel,
        *,
        peer: str,
        drone: str,
        max_message_bytes: int,
        own_trouble: Callable[[], str],
    ) -> None:
        self._channel = channel
        self._own_trouble = own_trouble
        self._methods: dict[str, Any] = {}
        self._peer = peer
        self._max_message_bytes = max_message_bytes
        self._metadata = ((DRONE_METADATA, drone),)
        self._under_way: set[Callable[[], None]] = set()  # what has each request be looked at
        self._closed = False

    async def request(self, path: str, body: bytes, *, timeout_s: float) -> bytes:
        """Sends one request and returns its reply; raises LinkError. Cancelling it cancels the call."""
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
            with contextlib.suppress(RuntimeError):  # the loop is closed: nobody waits any more
                loop.call_soon_threadsafe(settle)

        call = method.future(body, timeout=timeout_s, metadata=self._metadata)
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
        if call.code() is grpc.StatusCode.OK:
            reply: bytes = call.result()
            return reply
        raise self._error(path, call.code(), printable(call.details() or ""), timeout_s)

    async def close(self) -> None:
        """Breaks the connection off, with every request under way."""
        if self._closed:
            return
        self._closed = True
        for settle in self._under_way:
            settle()
        thread(self._channel.close, name="a link that closes", failed=only_logged).start()

    def _is_closed(self) -> Unreachable:
        return Unreachable(f"{self._peer}: the link is closed")

    def _is_late(self, timeout_s: float) -> DeadlineExceeded:
        return DeadlineExceeded(f"{self._peer}: no answer within {timeout_s:.1f} s")

    def _error(self, path: str, code: grpc.StatusCode, details: str, timeout_s: float) -> LinkError:
        match code:
            case grpc.StatusCode.DEADLINE_EXCEEDED:
                return self._is_late(timeout_s)
            case grpc.StatusCode.UNAVAILABLE | grpc.StatusCode.CANCELLED:
                own = self._own_trouble()
                return Unreachable(f"{self._peer}: {_plainly(details)}{f'; {own}' if own else ''}")
            case grpc.StatusCode.PERMISSION_DENIED:
                return NoLease(f"{self._peer}: {details}")
            case grpc.StatusCode.RESOURCE_EXHAUSTED if not path.startswith(f"/{_DAEMON}/"):
                return Refused(f"{self._peer}: {_in_words(details, self._max_message_bytes)}")
            case _:
                return Refused(f"{self._peer}: {code.name}: {details}")


def _longest_replies(max_reply_bytes: Mapping[str, int]) -> str:
    """gRPC's own rules of a channel: a longer reply is not even received."""
    rules = [
        ({"service": _DAEMON}, LONGEST_REPLY_BYTES),
        ({"service": _DAEMON, "method": _STATUS}, LONGEST_STATUS_BYTES),
        *(({"service": service_path(name, "").strip("/")}, most) for name, most in max_reply_bytes.items()),
    ]
    methods = [{"name": [name], "maxResponseMessageBytes": most} for name, most in rules]
    return msgspec.json.encode({"methodConfig": methods}).decode()


def _in_words(details: str, max_message_bytes: int) -> str:
    """gRPC's words about a size, with what to do; other words stay as they are."""
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


def too_large(what: str, size: int, most: int, *, whose: str, key: str = "max_message_bytes") -> str:
    """Why a request or a result of that size is not carried, and what to do; `whose` configuration limits it."""
    return (
        f"the {what} has {size} bytes, more than {key} = {most}: make it smaller, or raise that in the "
        f"configuration of {whose}"
    )


def _certificate_trouble(credentials: Credentials | None) -> Callable[[], str]:
    """What is wrong with the dates of these certificates when it is asked, "" where nothing is."""
    return lambda: credentials.problem_at(datetime.now(UTC)) if credentials is not None else ""


def _plainly(details: str) -> str:
    """What gRPC says of a connection that failed, without what it says around that."""
    for sign, trouble in _OUTDATED.items():
        if sign in details:
            return f"{trouble}; this computer's clock says {at_second(datetime.now(UTC))}"
    troubles = (trouble for sign, trouble in _TROUBLES.items() if sign in details)
    return next(troubles, None) or _AROUND.sub("", details)
