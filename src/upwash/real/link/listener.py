"""Links over gRPC: the server's end, for the daemon and for each service instance."""

from __future__ import annotations

import functools
import socket
from collections.abc import Callable, Collection, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import grpc

from upwash.core.admission.clients import Client
from upwash.errors import DeadlineExceeded, NoLease, NotBegun, Refused, UpwashError, UsageError
from upwash.real.link.requests import Caller, Requests, words_for_caller
from upwash.rpc.protocol import HEALTH_CHECK, MAY_QUEUE_METADATA, QUEUE_METADATA, QUEUED_METADATA, SERVING
from upwash.rpc.service import Reply, bounded_queue_s
from upwash.support.addresses import WITHOUT_ZONE, lacks_zone
from upwash.support.text import printable

DRONE_METADATA = "upwash-drone"  # names the caller where no certificate does: on a unix socket or on loopback
# A compressed message arrives as it is, and cannot be decoded: gRPC 1.70 inflates one before it looks at its size.
NOT_INFLATED = ("grpc.per_message_decompression", 0)
SERVER_OPTIONS: tuple[tuple[str, int], ...] = (
    ("grpc.so_reuseport", 0),  # else two daemons could share a port, and each get half of the calls
    ("grpc.http2.min_recv_ping_interval_without_data_ms", 500),
    ("grpc.http2.max_ping_strikes", 0),
    ("grpc.keepalive_permit_without_calls", 1),
    ("grpc.keepalive_time_ms", 5000),
    ("grpc.keepalive_timeout_ms", 15_000),  # a ping waits behind a photo on a slow link, for a second or more
    ("grpc.server_handshake_timeout_ms", 10_000),  # else a silent connection stays for two minutes
    ("grpc.max_concurrent_streams", 64),  # of one connection
    ("grpc.absolute_max_metadata_size", 2**13),  # a drone sends 200 bytes
    NOT_INFLATED,
)
_NOT_SERVING = b"\x08\x02"  # a HealthCheckResponse, as SERVING is
_REFUSING = 16  # requests that get, and log, the reason of their refusal; gRPC refuses more without a reason
_LONGEST_NAME = 255
_LAST_REQUESTS_S = 5.0  # for handlers whose callers do not wait any more

WhoIs = Callable[[str], Client]  # at the other end of gRPC's peer


class Listener:
    """Answers requests at one address, each in a thread of the listener's.

    `who_is` returns the caller of a connection, as a door announced it; without `who_is` callers name themselves. A
    caller that sends its body slowly delays no other.
    """

    def __init__(self, listen: str, requests: Requests, *, who_is: WhoIs | None = None) -> None:
        if _is_in_use(listen):
            raise cannot_listen(listen)
        most = requests.concurrent + _REFUSING
        self._server = grpc.server(
            ThreadPoolExecutor(most, "upwash-request"),
            maximum_concurrent_rpcs=most,
            options=[
                *SERVER_OPTIONS,
                ("grpc.max_receive_message_length", requests.max_message_bytes),
                ("grpc.max_send_message_length", requests.max_message_bytes),
            ],
        )
        self._server.add_generic_rpc_handlers((_Handlers(requests, who_is),))
        try:
            port = self._server.add_insecure_port(listen)
        except RuntimeError as error:
            raise cannot_listen(listen) from error
        self.address = listen if listen.startswith("unix:") else f"{listen.rpartition(':')[0]}:{port}"

    def add(self, handlers: grpc.GenericRpcHandler) -> None:
        """Answers one more kind of requests at the same address; call it before `start`."""
        self._server.add_generic_rpc_handlers((handlers,))

    def start(self) -> None:
        """Begins to answer requests."""
        self._server.start()

    def stop(self, *, grace_s: float = 0.0) -> None:
        """Refuses new requests, gives those under way `grace_s`, and returns when all have ended, or soon after."""
        self._server.stop(grace_s).wait(grace_s + _LAST_REQUESTS_S)


def _is_in_use(listen: str) -> bool:
    """Asks before gRPC listens: it would take over a unix socket, and print a message for a port in use."""
    if listen.startswith("unix:"):
        with socket.socket(socket.AF_UNIX) as probe:
            return probe.connect_ex(listen.removeprefix("unix:")) == 0
    host, _, port = listen.rpartition(":")
    try:
        found = socket.getaddrinfo(host.strip("[]"), int(port), type=socket.SOCK_STREAM)[0]
        with socket.socket(found[0], found[1]) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(found[4])
    except OSError:
        return True
    return False


def cannot_listen(listen: str) -> UsageError:
    """The error for an address at which this program cannot listen, with the remedy."""
    if lacks_zone(listen):
        return UsageError(f"cannot listen on {listen}: {WITHOUT_ZONE}")
    return UsageError(
        f"cannot listen on {listen}: the address is in use or not this machine's; "
        "stop the other program or choose another address"
    )


class HealthCheck(grpc.GenericRpcHandler):  # type: ignore[misc]
    """Answers gRPC's health check for the whole server (no name) or one of these names; it offers no Watch."""

    def __init__(self, names: Collection[str] = (), *, serving: Callable[[], bool] = lambda: True) -> None:
        self._questions = {_health_question(name) for name in ("", *names)}
        self._serving = serving

    def service(self, handler_call_details: Any) -> Any:
        """The handler if the request is a health check, else None."""
        if handler_call_details.method != HEALTH_CHECK:
            return None
        return grpc.unary_unary_rpc_method_handler(self._answer)

    def _answer(self, question: bytes, context: grpc.ServicerContext) -> bytes:
        if question not in self._questions:
            context.abort(grpc.StatusCode.NOT_FOUND, "no such server here")
        return SERVING if self._serving() else _NOT_SERVING


def _health_question(name: str) -> bytes:
    """A HealthCheckRequest: its first field, a text, which is left out where it is empty."""
    text = name.encode()
    return b"\x0a" + bytes([len(text)]) + text if text else b""


class _Handlers(grpc.GenericRpcHandler):  # type: ignore[misc]
    """Answers every unary request below /upwash.; its body is received once it is let in."""

    def __init__(self, requests: Requests, who_is: WhoIs | None) -> None:
        self._requests = requests
        self._who_is = who_is

    def service(self, handler_call_details: Any) -> Any:
        path: str = handler_call_details.method
        if not path.startswith("/upwash.") or path != printable(path, _LONGEST_NAME):
            return None
        # A stream of one message, on the wire the same: the caller is known before the message is there.
        return grpc.stream_unary_rpc_method_handler(functools.partial(self._answer, path))

    def _answer(self, path: str, bodies: Iterator[bytes], context: grpc.ServicerContext) -> bytes:
        stated = dict(context.invocation_metadata()).get(MAY_QUEUE_METADATA)
        may_queue_s = None if stated is None else seconds_of(stated)
        caller = Caller(self._client(context), context.time_remaining, context.is_active, may_queue_s)
        try:
            reply = self._requests.answer(path, caller, lambda: self._whole(bodies))
            if isinstance(reply, Reply):
                context.set_trailing_metadata(
                    (
                        (QUEUED_METADATA, f"{reply.queued_s:.3f}"),
                        (QUEUE_METADATA, f"{reply.queue_s:.3f}"),
                    )
                )
            return bytes(reply)  # gRPC sends no bytes of another class
        except BaseException as error:  # noqa: BLE001 - a defect of the handler must not end the listener
            if isinstance(error, NotBegun):
                context.set_trailing_metadata(((QUEUE_METADATA, f"{error.queue_s:.3f}"),))
            context.abort(_status_of(error), words_for_caller(error))
        raise AssertionError("abort raises")

    def _client(self, context: grpc.ServicerContext) -> Client:
        if self._who_is is not None:
            return self._who_is(context.peer())
        named = (value for key, value in context.invocation_metadata() if key == DRONE_METADATA)
        return Client(printable(next(named, ""), _LONGEST_NAME))

    def _whole(self, bodies: Iterator[bytes]) -> bytes:
        try:
            return next(bodies)
        except (StopIteration, grpc.RpcError):  # which of the two, and why, gRPC does not say
            most = f"max_message_bytes = {self._requests.max_message_bytes}"
            raise Refused(f"it did not arrive whole: broken off, empty, or larger than {most}") from None


def seconds_of(stated: str | bytes | None) -> float:
    """The seconds that a peer states in metadata; 0 for what is no time, and for none."""
    try:
        return bounded_queue_s(float(stated or 0.0))
    except ValueError:
        return 0.0


def _status_of(error: BaseException) -> grpc.StatusCode:
    """gRPC's code for an error. Drones of a version without turns treat both of the first two as a refusal."""
    match error:
        case DeadlineExceeded():  # as gRPC itself would say a moment later
            return grpc.StatusCode.DEADLINE_EXCEEDED
        case NoLease():
            return grpc.StatusCode.PERMISSION_DENIED
        case NotBegun():  # which gRPC never sends by itself
            return grpc.StatusCode.OUT_OF_RANGE
        case Refused():
            return grpc.StatusCode.FAILED_PRECONDITION
        case UpwashError():
            return grpc.StatusCode.ABORTED
        case _:
            return grpc.StatusCode.INTERNAL
