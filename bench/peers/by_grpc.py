"""gRPC with a channel as it comes, and a deadline."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import grpc

TIMEOUT_S = 2.0
PATH = "/bench.Looker/Look"


def serve(address: str, compute: Callable[[bytes], str], options: Sequence[tuple[str, int]] = ()) -> None:
    """Serves until the process is ended."""
    server = grpc.server(ThreadPoolExecutor(max_workers=10), options=options)
    handler = grpc.unary_unary_rpc_method_handler(lambda photo, _: compute(photo).encode())
    service, _, method = PATH[1:].partition("/")
    server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler(service, {method: handler}),))
    server.add_insecure_port(address)
    server.start()
    print("ready", flush=True)
    threading.Event().wait()


class Client:
    """Calls with a deadline, and computes here where that fails."""

    def __init__(self, address: str, *, compute: object, local: Callable[[bytes], str]) -> None:
        self._look = grpc.insecure_channel(address).unary_unary(PATH)
        self._local = local

    def call(self, photo: bytes) -> str:
        """Where it was computed."""
        try:
            reply: bytes = self._look(photo, timeout=TIMEOUT_S)
        except grpc.RpcError:
            return self._local(photo)
        return reply.decode()
