"""gRPC tuned by hand for a radio: dead connections are replaced, and a failed server is avoided for a while."""

from __future__ import annotations

import time
from collections.abc import Callable

import grpc
from bench.peers import by_grpc

SHUNNED_S = 5.0
CHANNEL = (
    ("grpc.keepalive_time_ms", 2000),
    ("grpc.keepalive_timeout_ms", 1000),
    ("grpc.keepalive_permit_without_calls", 1),
    ("grpc.http2.max_pings_without_data", 0),
    ("grpc.initial_reconnect_backoff_ms", 100),
    ("grpc.min_reconnect_backoff_ms", 1000),
    ("grpc.max_reconnect_backoff_ms", 1000),
)
SERVER = (
    ("grpc.http2.min_recv_ping_interval_without_data_ms", 500),
    ("grpc.http2.max_ping_strikes", 0),
    ("grpc.keepalive_permit_without_calls", 1),
)


def serve(address: str, compute: Callable[[bytes], str]) -> None:
    """Serves until the process is ended; what the channel asks for is allowed."""
    by_grpc.serve(address, compute, SERVER)


class Client:
    """Calls with a deadline; where that fails it computes here, and for a while does not ask."""

    def __init__(self, address: str, *, compute: object, local: Callable[[bytes], str]) -> None:
        self._look = grpc.insecure_channel(address, CHANNEL).unary_unary(by_grpc.PATH)
        self._local = local
        self._asks_from_s = 0.0

    def call(self, photo: bytes) -> str:
        """Where it was computed."""
        if time.monotonic() < self._asks_from_s:
            return self._local(photo)
        try:
            reply: bytes = self._look(photo, timeout=by_grpc.TIMEOUT_S)
        except grpc.RpcError:
            self._asks_from_s = time.monotonic() + SHUNNED_S
            return self._local(photo)
        return reply.decode()
