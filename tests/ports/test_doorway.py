"""The way into a sandbox: who says nothing keeps nobody out."""

from __future__ import annotations

import contextlib
import socket
import threading
from pathlib import Path

from upwash.real.announced import Inside
from upwash.real.socket_proxy import SocketProxy
from upwash.real.streams import listening_socket

SILENT = 200


def echo(listening: socket.socket) -> None:
    def answer(connection: socket.socket) -> None:
        with connection, contextlib.suppress(OSError):
            while data := connection.recv(4096):
                connection.sendall(data)

    with contextlib.suppress(OSError):
        while True:
            threading.Thread(target=answer, args=listening.accept()[:1], daemon=True).start()


def test_connections_that_say_nothing_keep_nobody_out(tmp_path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as inside, contextlib.ExitStack() as stack:
        inside.bind(str(tmp_path / "inside"))
        inside.listen(SILENT + 1)
        threading.Thread(target=echo, args=(inside,), daemon=True).start()
        outside = stack.enter_context(socket.create_server(("127.0.0.1", 0), backlog=SILENT + 1))
        SocketProxy(outside, Inside(str(tmp_path / "inside")), is_announced=False).open()
        for _ in range(SILENT):
            stack.enter_context(socket.create_connection(outside.getsockname()))
        honest = stack.enter_context(socket.create_connection(outside.getsockname(), timeout=10.0))
        honest.sendall(b"photo")
        assert honest.recv(4096) == b"photo"


def test_what_is_written_to_a_connection_leaves_at_once() -> None:
    with listening_socket("127.0.0.1:0") as listening, socket.create_connection(listening.getsockname()):
        connection, _ = listening.accept()
        with connection:
            assert connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
