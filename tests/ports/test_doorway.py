"""The way into an instance: who says nothing keeps nobody out, and who is let in is known."""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from upwash.core.admission.clients import Client
from upwash.real.link import proxy
from upwash.real.link.proxy import GivenSocket, GrpcSocket, announcing_at, open_proxy, take
from upwash.real.link.streams import listening_socket

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
        open_proxy(outside, GrpcSocket(str(tmp_path / "inside")), is_announced=False)
        for _ in range(SILENT):
            stack.enter_context(socket.create_connection(outside.getsockname()))
        honest = stack.enter_context(socket.create_connection(outside.getsockname(), timeout=10.0))
        honest.sendall(b"photo")
        assert honest.recv(4096) == b"photo"


@pytest.mark.parametrize("said", [b"heron\n", b"x" * 100_000], ids=["no client", "no line"])
def test_who_announces_nobody_is_hung_up_on(tmp_path: Path, said: bytes) -> None:
    outside = listening_socket(f"unix:{tmp_path}/outside")
    open_proxy(outside, GrpcSocket(str(tmp_path / "inside")), is_announced=True)
    with socket.socket(socket.AF_UNIX) as stranger:
        stranger.settimeout(10.0)
        stranger.connect(outside.getsockname())
        with contextlib.suppress(BrokenPipeError):
            stranger.sendall(said)
        with contextlib.suppress(ConnectionResetError):
            assert stranger.recv(16) == b""


def test_all_that_was_said_before_it_hung_up_arrives(tmp_path: Path) -> None:
    words = os.urandom(2**22)  # more than the sockets on the way hold

    def speak(connection: socket.socket) -> None:
        with connection:
            connection.sendall(words)

    with socket.socket(socket.AF_UNIX) as inside, socket.create_server(("127.0.0.1", 0)) as outside:
        inside.bind(str(tmp_path / "inside"))
        inside.listen()
        open_proxy(outside, GrpcSocket(str(tmp_path / "inside")), is_announced=False)
        with socket.create_connection(outside.getsockname(), timeout=10.0) as caller:
            speaking = threading.Thread(target=speak, args=inside.accept()[:1])
            speaking.start()
            with caller.makefile("rb") as heard:
                assert heard.read() == words
            speaking.join()


def test_what_is_written_to_a_connection_leaves_at_once() -> None:
    with listening_socket("127.0.0.1:0") as listening, socket.create_connection(listening.getsockname()):
        connection, _ = listening.accept()
        with connection:
            assert connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)


# --- connections that are given -----------------------------------------------------------------------------


@pytest.fixture
def pair() -> Iterator[tuple[GivenSocket, socket.socket]]:
    """A socket as its new owner has it, and the same as who gave it kept it; at the other end nobody reads."""
    near, far = socket.socketpair()
    with far, near, GivenSocket(fileno=os.dup(near.fileno())) as given:
        given.setblocking(False)
        yield given, near


def fill(connection: socket.socket) -> None:
    with contextlib.suppress(BlockingIOError):
        while True:
            connection.send(bytes(65536), socket.MSG_DONTWAIT)


@pytest.mark.parametrize(
    "use",
    [
        lambda given: given.recv(1),
        lambda given: given.recv_into(bytearray(1)),
        lambda given: given.send(bytes(65536)),
        lambda given: given.sendmsg([bytes(65536)]),
    ],
    ids=["recv", "recv_into", "send", "sendmsg"],
)
def test_who_gave_a_connection_cannot_have_the_other_end_wait(
    pair: tuple[GivenSocket, socket.socket], use: Callable[[GivenSocket], Any]
) -> None:
    given, kept = pair
    fill(kept)
    kept.setblocking(True)
    with pytest.raises(BlockingIOError):
        use(given)


def taken(*files: int) -> GivenSocket:
    """What arrives of open files that are given."""

    giving, taking = socket.socketpair()
    with taking:
        with giving:
            if files:
                socket.send_fds(giving, [b"x"], files)
        return asyncio.run(take(taking))


def test_only_a_connection_is_taken_and_nothing_else_kept() -> None:
    hearing, telling = os.pipe()
    near, far = socket.socketpair()
    with near, far, socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as mail:
        for wrong in ((), (telling,), (mail.fileno(),)):
            with pytest.raises(ConnectionAbortedError):
                taken(*wrong)
        with taken(near.fileno(), telling) as given:
            far.sendall(b"photo")
            assert given.recv(16) == b"photo"
    os.close(telling)
    assert os.read(hearing, 1) == b""  # nobody has the other end any more
    os.close(hearing)


async def test_an_instance_that_gives_nothing_does_not_hold_the_door_up(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(proxy, "_GIVEN_S", 0.05)
    silent, taking = socket.socketpair()
    with silent, taking, pytest.raises(ConnectionAbortedError, match="no connection"):
        await take(taking)


async def test_a_client_is_known_by_the_connection_that_it_is_given_until_it_hangs_up(tmp_path: Path) -> None:
    heron = Client("heron", "00aa")
    inside = GrpcSocket(str(tmp_path / "inside"))

    with socket.socket(socket.AF_UNIX) as served:
        served.bind(inside.path)
        served.listen()
        open_proxy(listening_socket(f"unix:{tmp_path}/outside"), inside, is_announced=True)
        in_thread = asyncio.to_thread
        async with announcing_at(str(tmp_path / "outside"))(heron) as end:
            connection, peer = await in_thread(served.accept)
            end.transport.write(b"photo")
            assert await in_thread(connection.recv, 16) == b"photo"
            connection.sendall(b"boxes\n")
            assert await end.line() == b"boxes"
            assert inside.client(f"unix:{peer}") == heron
        with connection:
            assert await in_thread(connection.recv, 16) == b""  # the instance has let go of it, too
        assert inside.client(f"unix:{peer}") == Client("")
