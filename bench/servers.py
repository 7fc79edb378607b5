"""The server ends that upwash is compared with: `python -m bench.servers raw|grpc HOST FOLDER [SECONDS]`.

A request to gRPC's takes the seconds, none if not told.
Each prints its address once it answers, and serves one client after the other until it is ended.
"""

from __future__ import annotations

import socket
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NoReturn

import grpc
from bench.echo import answer

from upwash.real.link.listener import SERVER_OPTIONS
from upwash.real.trust.credentials import read_credentials

LENGTH_BYTES = 4  # before each raw request, big-endian
GRPC_PATH = "/bench.Echo/Measure"


def serve_raw(host: str) -> NoReturn:
    """Serves length-prefixed requests over TCP."""
    with socket.create_server((host, 0)) as listener:
        _announce(f"{host}:{listener.getsockname()[1]}")
        while True:
            connection, _ = listener.accept()
            with connection, connection.makefile("rb") as requests:
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                while length := requests.read(LENGTH_BYTES):
                    connection.sendall(answer(requests.read(int.from_bytes(length))))


def serve_grpc(host: str, folder: Path, takes_s: float) -> NoReturn:
    """Serves unary requests of plain bytes over gRPC with mutual TLS, with the options that upwash uses."""

    def measure(body: bytes, _: object) -> bytes:
        time.sleep(takes_s)
        return answer(body)

    credentials = read_credentials(folder / "authority.pem", folder / "s1.pem", folder / "s1.key")
    server = grpc.server(ThreadPoolExecutor(max_workers=1), options=SERVER_OPTIONS)
    service, _, method = GRPC_PATH[1:].partition("/")
    handler = grpc.unary_unary_rpc_method_handler(measure)
    server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler(service, {method: handler}),))
    port = server.add_secure_port(
        f"{host}:0",
        grpc.ssl_server_credentials(
            [(credentials.key, credentials.certificate)],
            root_certificates=credentials.authority,
            require_client_auth=True,
        ),
    )
    server.start()
    _announce(f"{host}:{port}")
    threading.Event().wait()
    raise AssertionError("it serves until it is ended")


def _announce(address: str) -> None:
    print(f"ready at {address}", flush=True)


if __name__ == "__main__":
    kind, host, folder, *takes_s = sys.argv[1:]
    if kind == "raw":
        serve_raw(host)
    serve_grpc(host, Path(folder), float(takes_s[0]) if takes_s else 0.0)
