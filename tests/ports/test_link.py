"""A drone's link against a server's listener, over real sockets."""

from __future__ import annotations

import asyncio
import logging
import re
import socket
import socketserver
import ssl
import subprocess
import sys
import threading
import time
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, asynccontextmanager, contextmanager, suppress
from pathlib import Path
from typing import Any

import grpc
import pytest
from tests.doors import behind_door
from tests.waiting import wait_for

from upwash.errors import DeadlineExceeded, LinkError, NoLease, Refused, Unreachable, UpwashError, UsageError
from upwash.real.host.log import RateLimitedLog
from upwash.real.link.link import GrpcDialer, GrpcLink
from upwash.real.link.listener import DRONE_METADATA, Listener, WhoIs, seconds_of
from upwash.real.link.requests import Caller, Gate, Handler, Requests
from upwash.real.trust.credentials import Credentials, server_context
from upwash.rpc.protocol import AVAILABILITY, LONGEST_REPLY_BYTES, START, STATUS, service_path

MAX_MESSAGE_BYTES = 100_000
LARGE = 2**24  # bytes: more than sockets hold
PATH = "/upwash.test/echo"

ReadCredentials = Callable[[str], Credentials]


@pytest.fixture(autouse=True)
def no_line_was_written_of_a_client(monkeypatch: pytest.MonkeyPatch) -> None:
    """Log lines of one client are bounded, and the tests have the same clients."""
    for name in ("upwash.door", "upwash.listener"):
        monkeypatch.setattr(logging.getLogger(name), "filters", [RateLimitedLog()])


def echo(_path: str, body: bytes, _caller: Caller) -> bytes:
    return body


@contextmanager
def listening(
    handler: Handler,
    *,
    shown: Credentials | None = None,
    listen: str = "127.0.0.1:0",
    concurrently: int = 16,
    per_drone: int = 16,
    gate: Gate = lambda _path, _caller: None,
) -> Iterator[str]:
    def make(listen: str, who_is: WhoIs | None = None) -> Listener:
        requests = Requests(
            handler,
            max_message_bytes=MAX_MESSAGE_BYTES,
            concurrent=concurrently,
            per_drone=per_drone,
            gate=gate,
        )
        return Listener(listen, requests, who_is=who_is)

    if shown is not None:
        with behind_door(make, shown, listen=listen) as (_, _, address):
            yield address
        return
    with started(make(listen)) as listener:
        yield listener.address


@contextmanager
def started(listener: Listener) -> Iterator[Listener]:
    listener.start()
    try:
        yield listener
    finally:
        listener.stop()


@asynccontextmanager
async def linked(
    address: str, *, drone: str = "heron", server: str = "s1", shown: Credentials | None = None
) -> AsyncIterator[GrpcLink]:
    link = GrpcDialer(drone, shown, max_message_bytes=2 * MAX_MESSAGE_BYTES).dial(address, server=server)
    try:
        yield link
    finally:
        await link.close()


async def request(
    address: str, body: bytes = b"photo", *, path: str = PATH, timeout_s: float = 5.0, **dialled: Any
) -> bytes:
    """One request over a link of its own."""
    async with linked(address, **dialled) as link:
        return await link.request(path, body, timeout_s=timeout_s)


class Stuck:
    """A handler that hangs until it is let go, and knows whether its callers still wait."""

    def __init__(self) -> None:
        self.callers: list[Caller] = []
        self.entered = threading.Event()
        self.let_go = threading.Event()

    def __call__(self, _path: str, body: bytes, caller: Caller) -> bytes:
        if body == b"quick":
            return body
        self.callers.append(caller)
        self.entered.set()
        self.let_go.wait(10.0)
        return body


@contextmanager
def stuck() -> Iterator[tuple[Stuck, str]]:
    handler = Stuck()
    with listening(handler) as address:
        try:
            yield handler, address
        finally:
            handler.let_go.set()


def entering(handler: Stuck) -> Coroutine[Any, Any, bool]:
    return asyncio.to_thread(handler.entered.wait, 5.0)


# --- the queue of an instance --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("stated", "seconds"),
    [
        (None, 0.0),
        ("", 0.0),
        ("2.5", 2.5),
        (b"2.5", 2.5),
        ("-1", 0.0),
        ("nan", 0.0),
        ("inf", 0.0),
        ("1e999", 0.0),
        ("1e9", 600.0),
        ("soon", 0.0),
        (b"\xff", 0.0),
        ("9" * 8000, 0.0),
    ],
)
def test_a_time_that_a_peer_states_is_bounded(stated: str | bytes | None, seconds: float) -> None:
    assert seconds_of(stated) == seconds


# --- answers ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("body", [b"", b"\x00\xff" * 40_000])
async def test_a_request_gets_its_reply(body: bytes) -> None:
    with listening(echo) as address:
        assert await request(address, body) == body


async def test_a_request_gets_its_reply_over_a_unix_socket(tmp_path: Path) -> None:
    with listening(echo, listen=f"unix:{tmp_path}/socket") as address:
        assert address == f"unix:{tmp_path}/socket"
        assert await request(address) == b"photo"


async def test_a_unix_socket_carries_no_certificates_even_for_a_drone_that_has_some(
    tmp_path: Path, credentials: ReadCredentials
) -> None:
    with listening(echo, listen=f"unix:{tmp_path}/socket") as address:
        assert await request(address, shown=credentials("heron")) == b"photo"


async def test_requests_on_one_link_do_not_wait_for_each_other() -> None:
    with stuck() as (handler, address):
        async with linked(address) as link:
            hanging = [asyncio.create_task(link.request(PATH, b"", timeout_s=30.0)) for _ in range(12)]
            await asyncio.to_thread(wait_for, lambda: len(handler.callers) == 12, within_s=5.0)
            assert await link.request(PATH, b"quick", timeout_s=3.0) == b"quick"
            handler.let_go.set()
            assert await asyncio.gather(*hanging) == [b""] * 12


async def test_the_handler_learns_how_much_time_is_left() -> None:
    left_s: list[float | None] = []

    def handler(_path: str, body: bytes, caller: Caller) -> bytes:
        left_s.append(caller.time_left_s())
        return body

    with listening(handler) as address:
        await request(address, timeout_s=4.0)
    assert left_s[0] is not None
    assert 2.0 < left_s[0] <= 4.1


ASK_BY_NAME = """
import asyncio, sys
from upwash.real.link.link import GrpcDialer
async def ask(address):
    link = GrpcDialer("heron", None, max_message_bytes=100_000).dial(address, server="s1")
    print((await link.request("/upwash.test/echo", b"photo", timeout_s=4.0)).decode())
    await link.close()
asyncio.run(ask(sys.argv[1]))
"""
FIELD = 'mount --bind hosts /etc/hosts && mount --bind resolv.conf /etc/resolv.conf && exec "$@"'


def test_a_name_of_the_hosts_file_needs_no_dns_server(tmp_path: Path) -> None:
    (tmp_path / "hosts").write_text("127.0.0.1 edge.example.org\n")
    (tmp_path / "resolv.conf").write_text("nameserver 192.0.2.53\n")  # where nobody answers
    inside = ["unshare", "--map-root-user", "--mount", "sh", "-c", FIELD, "sh"]
    if subprocess.run([*inside, "true"], check=False, cwd=tmp_path, capture_output=True).returncode != 0:
        pytest.skip("needs namespaces of users and mounts")
    with listening(echo) as address:
        port = address.rpartition(":")[2]
        ask = [sys.executable, "-c", ASK_BY_NAME, f"edge.example.org:{port}"]
        said = subprocess.run([*inside, *ask], check=False, cwd=tmp_path, capture_output=True, text=True)
    assert said.stdout == "photo\n", said.stderr


# --- no answer ----------------------------------------------------------------------------------------------


async def test_a_server_that_gives_up_at_the_deadline_is_as_late_as_one_that_says_nothing() -> None:
    def handler(*_: object) -> bytes:
        raise DeadlineExceeded("the drone's deadline is over")

    with listening(handler) as address, pytest.raises(DeadlineExceeded, match=r"no answer within 4\.0 s"):
        await request(address, timeout_s=4.0)


async def test_no_answer_in_time_is_said_in_time() -> None:
    with stuck() as (handler, address):
        began_s = time.monotonic()
        with pytest.raises(DeadlineExceeded, match=rf"s1 at {address}: no answer within 0\.3 s"):
            await request(address, timeout_s=0.3)
        assert 0.25 < time.monotonic() - began_s < 2.0
        wait_for(lambda: not handler.callers[0].is_waiting(), within_s=5.0)


async def test_nobody_at_the_address_is_said_at_once(tmp_path: Path) -> None:
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        port = unused.getsockname()[1]
    for address in (f"127.0.0.1:{port}", f"unix:{tmp_path}/nobody"):
        began_s = time.monotonic()
        with pytest.raises(Unreachable, match="s1 at"):
            await request(address, timeout_s=10.0)
        assert time.monotonic() - began_s < 5.0


async def test_a_server_that_stops_ends_the_request_under_way() -> None:
    handler = Stuck()
    stuck = Listener(
        "127.0.0.1:0", Requests(handler, max_message_bytes=MAX_MESSAGE_BYTES, concurrent=4, per_drone=4)
    )
    with started(stuck) as listener:
        async with linked(listener.address) as link:
            asking = asyncio.create_task(link.request(PATH, b"", timeout_s=30.0))
            await entering(handler)
            stopping = asyncio.create_task(asyncio.to_thread(listener.stop))
            with pytest.raises(Unreachable):
                await asyncio.wait_for(asking, 5.0)
            handler.let_go.set()
            await stopping


async def test_a_cancelled_request_tells_the_server() -> None:
    with stuck() as (handler, address):
        async with linked(address) as link:
            asking = asyncio.create_task(link.request(PATH, b"", timeout_s=30.0))
            await entering(handler)
            assert handler.callers[0].is_waiting()
            asking.cancel()
            with pytest.raises(asyncio.CancelledError):
                await asking
            await asyncio.to_thread(wait_for, lambda: not handler.callers[0].is_waiting(), within_s=5.0)
            assert await link.request(PATH, b"quick", timeout_s=5.0) == b"quick"


async def test_closing_a_link_ends_its_requests_and_it_takes_no_more() -> None:
    with stuck() as (handler, address):
        async with linked(address) as link:
            asking = asyncio.create_task(link.request(PATH, b"", timeout_s=30.0))
            await entering(handler)
            await link.close()
            with pytest.raises(Unreachable):
                await asyncio.wait_for(asking, 5.0)
            for path in (PATH, "/upwash.test/another"):
                with pytest.raises(Unreachable, match="closed"):
                    await link.request(path, b"", timeout_s=5.0)
            await asyncio.to_thread(wait_for, lambda: not handler.callers[0].is_waiting(), within_s=5.0)


# HTTP/2's frames of a server that lets its client send 2 GB on each stream and altogether.
BOUNDLESS = bytes.fromhex(
    "000006 0400 00000000 0004 7fffffff"  # SETTINGS: INITIAL_WINDOW_SIZE
    "000000 0401 00000000"  # SETTINGS, acknowledged
    "000004 0800 00000000 7fff0000"  # WINDOW_UPDATE
)


@contextmanager
def deaf(folder: Path) -> Iterator[str]:
    """A server that lets its clients send whatever they want, and reads none of it."""
    with socket.socket(socket.AF_UNIX) as listening, ExitStack() as connections:
        listening.bind(str(folder / "deaf"))
        listening.listen()

        def answer() -> None:
            with suppress(OSError):  # the test is over
                while True:
                    connection = connections.enter_context(listening.accept()[0])
                    connection.sendall(BOUNDLESS)

        thread = threading.Thread(target=answer)
        thread.start()
        try:
            yield f"unix:{folder}/deaf"
        finally:
            listening.shutdown(socket.SHUT_RDWR)
            thread.join()


@pytest.mark.timeout(20)
async def test_a_request_that_nobody_reads_ends_at_its_deadline_and_with_its_link(tmp_path: Path) -> None:
    with deaf(tmp_path) as address:
        link = GrpcDialer("heron", None, max_message_bytes=LARGE).dial(address, server="s1")
        with pytest.raises(DeadlineExceeded, match=r"no answer within 0\.3 s"):
            await link.request(PATH, bytes(LARGE), timeout_s=0.3)
        asking = asyncio.create_task(link.request(PATH, bytes(LARGE), timeout_s=30.0))
        await asyncio.sleep(0)
        await link.close()
        with pytest.raises(Unreachable, match="the link is closed"):
            await asking


@pytest.mark.parametrize("greeting", [b"", b"\x00garbage" * 100, b"HTTP/1.1 200 OK\r\n\r\n"])
async def test_something_else_at_the_address_is_no_server(greeting: bytes) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:

        def answer() -> None:
            with other.accept()[0] as connection:
                connection.sendall(greeting)

        thread = threading.Thread(target=answer)
        thread.start()
        try:
            with pytest.raises((Unreachable, DeadlineExceeded)):
                await request(f"127.0.0.1:{other.getsockname()[1]}", timeout_s=1.0)
        finally:
            thread.join()


# --- refusals -----------------------------------------------------------------------------------------------


async def test_a_refusal_arrives_with_its_reason() -> None:
    def refuse(_path: str, _body: bytes, caller: Caller) -> bytes:
        raise Refused(f"drone {caller.client.name} has no lease here")

    with listening(refuse) as address, pytest.raises(Refused, match="drone heron has no lease here"):
        await request(address)


async def test_another_error_of_upwash_arrives_as_a_refusal_too() -> None:
    def fail(_path: str, _body: bytes, _caller: Caller) -> bytes:
        raise UpwashError("no room on the disk")

    with listening(fail) as address, pytest.raises(Refused, match="no room on the disk"):
        await request(address)


@pytest.mark.parametrize("error", [RuntimeError("the password is 1234"), SystemExit("the password is 1234")])
async def test_a_bug_of_the_handler_is_logged_and_its_text_kept_from_the_caller(
    error: BaseException, caplog: pytest.LogCaptureFixture
) -> None:
    def fail(_path: str, _body: bytes, _caller: Caller) -> bytes:
        raise error

    with (
        caplog.at_level(logging.ERROR, "upwash.listener"),
        listening(fail) as address,
        pytest.raises(LinkError) as caught,
    ):
        await request(address, timeout_s=2.0)
    assert isinstance(caught.value, Refused)
    assert "1234" not in str(caught.value)
    assert "1234" in caplog.text


async def test_a_path_that_is_not_upwashs_is_refused() -> None:
    with listening(echo) as address, pytest.raises(Refused, match="UNIMPLEMENTED"):
        await request(address, path="/another.package/echo")


async def test_a_message_that_is_too_large_is_refused_by_either_end() -> None:
    def grow(_path: str, _body: bytes, _caller: Caller) -> bytes:
        return bytes(3 * MAX_MESSAGE_BYTES)

    with listening(grow) as address:
        for body, said in (
            (bytes(MAX_MESSAGE_BYTES + 1), "the request has .* of the computer that runs the service"),
            (bytes(2 * MAX_MESSAGE_BYTES + 1), "the request has .* of the drone"),
            (b"grow", "the result has .* of the computer that runs the service"),
        ):
            with pytest.raises(Refused, match=said):
                await request(address, body)


@pytest.mark.parametrize(
    ("path", "most"),
    [(AVAILABILITY, LONGEST_REPLY_BYTES), (START, LONGEST_REPLY_BYTES), (STATUS, MAX_MESSAGE_BYTES)],
)
async def test_a_daemons_reply_is_not_received_beyond_what_one_may_be(path: str, most: int) -> None:
    def grow(_path: str, body: bytes, _caller: Caller) -> bytes:
        return bytes(int(body))

    with listening(grow) as address:
        assert len(await request(address, str(most).encode(), path=path)) == most
        with pytest.raises(Refused, match=r"larger than max|more than max_message_bytes"):
            await request(address, str(most + 1).encode(), path=path)


async def test_a_call_without_a_lease_is_told_from_other_refusals_and_by_a_status_that_is_none_else() -> None:
    """A drone of the last release takes both for refusals; of a daemon of that release both arrive as such."""

    def refuse(_path: str, body: bytes, _caller: Caller) -> bytes:
        raise NoLease("no lease") if body == b"late" else Refused("no lease")

    with listening(refuse) as address:
        with pytest.raises(NoLease, match="no lease"):
            await request(address, b"late")
        with pytest.raises(Refused, match="no lease") as refused:
            await request(address, b"else")
        assert not isinstance(refused.value, NoLease)
        with grpc.insecure_channel(address) as channel, pytest.raises(grpc.RpcError) as raised:
            channel.unary_unary(PATH)(b"late", metadata=((DRONE_METADATA, "heron"),), timeout=5.0)
        assert raised.value.code() is grpc.StatusCode.PERMISSION_DENIED


ESCAPES = "\x1b[2J\x9b31m\u202e\r\nall is well"
SHOWN = "\\x1b[2J\\x9b31m\\u202e\\r\\nall is well"


class Rude(grpc.GenericRpcHandler):  # type: ignore[misc]
    """Refuses all requests in a way that no listener would."""

    def service(self, _: Any) -> Any:
        def refuse(_: bytes, context: grpc.ServicerContext) -> bytes:
            context.abort(grpc.StatusCode.FAILED_PRECONDITION, ESCAPES * 20)
            return b""

        return grpc.unary_unary_rpc_method_handler(refuse)


async def test_a_refusal_arrives_in_print_and_is_no_longer_than_a_reason() -> None:
    server = grpc.server(ThreadPoolExecutor(1))
    server.add_generic_rpc_handlers((Rude(),))
    address = f"127.0.0.1:{server.add_insecure_port('127.0.0.1:0')}"
    server.start()
    try:
        with pytest.raises(Refused) as refused:
            await request(address)
    finally:
        server.stop(None).wait()
    assert SHOWN in str(refused.value)
    assert str(refused.value).isprintable()
    assert len(str(refused.value)) < 1100


async def test_who_is_refused_and_what_for_is_logged_in_print(caplog: pytest.LogCaptureFixture) -> None:
    def refuse(_path: str, body: bytes, _caller: Caller) -> bytes:
        raise Refused(f"there is no {body.decode()}")

    with (
        caplog.at_level(logging.WARNING, "upwash.listener"),
        listening(refuse) as address,
        pytest.raises(Refused) as refused,
    ):
        await request(address, ESCAPES.encode())
    assert SHOWN in str(refused.value)
    assert SHOWN in caplog.messages[0]
    assert all(message.isprintable() for message in caplog.messages)


# --- who is who ---------------------------------------------------------------------------------------------


def test_a_request_is_refused_at_the_gate_before_its_body_is_there() -> None:
    def gate(path: str, caller: Caller) -> None:
        raise Refused(f"{caller.client.name} may not {path}")

    with (
        listening(echo, gate=gate) as address,
        grpc.insecure_channel(address, [("grpc.enable_http_proxy", 0)]) as channel,
    ):
        let_go = threading.Event()
        call = channel.stream_unary(PATH).future(
            iter(let_go.wait, True), timeout=10.0, metadata=((DRONE_METADATA, "heron"),)
        )
        try:
            assert call.exception().details() == f"heron may not {PATH}"
        finally:
            let_go.set()


async def test_a_request_that_does_not_end_holds_up_no_other() -> None:
    with (
        listening(echo, concurrently=2) as address,
        grpc.insecure_channel(address, [("grpc.enable_http_proxy", 0)]) as channel,
    ):
        let_go = threading.Event()
        channel.stream_unary(PATH).future(iter(let_go.wait, True), timeout=10.0)
        try:
            assert await request(address) == b"photo"
        finally:
            let_go.set()


@pytest.mark.parametrize(
    ("concurrently", "per_drone", "refused", "why"),
    [
        (16, 1, "heron", "this drone has 1 request under way already"),
        (1, 16, "stork", "1 request under way already"),
    ],
)
async def test_requests_beyond_a_drones_share_or_the_servers_bound_are_refused_at_once_and_in_the_log(
    caplog: pytest.LogCaptureFixture, concurrently: int, per_drone: int, refused: str, why: str
) -> None:
    handler = Stuck()

    with listening(handler, concurrently=concurrently, per_drone=per_drone) as address:
        async with linked(address) as heron, linked(address, drone="stork") as stork:
            waiting = asyncio.create_task(heron.request(PATH, b"photo", timeout_s=10.0))
            assert await entering(handler)
            if refused == "heron":
                assert await stork.request(PATH, b"quick", timeout_s=5.0) == b"quick"
            with pytest.raises(Refused, match=why):
                await (heron if refused == "heron" else stork).request(PATH, b"quick", timeout_s=5.0)
            handler.let_go.set()
            assert await waiting == b"photo"
            for link in (heron, stork):
                assert await link.request(PATH, b"quick", timeout_s=5.0) == b"quick"
    assert f"refused /upwash.test/echo to {refused}: {why}" in caplog.text


async def test_a_request_that_is_too_large_is_refused_in_the_log_too(
    caplog: pytest.LogCaptureFixture,
) -> None:
    with listening(echo) as address:
        with pytest.raises(Refused, match="more than max_message_bytes"):
            await request(address, bytes(MAX_MESSAGE_BYTES + 1))
        wait_for(lambda: f"larger than max_message_bytes = {MAX_MESSAGE_BYTES}" in caplog.text, within_s=5.0)


async def test_a_services_reply_is_not_received_beyond_what_one_may_be() -> None:
    def grow(_path: str, body: bytes, _caller: Caller) -> bytes:
        return bytes(int(body))

    with listening(grow) as address:
        dialer = GrpcDialer(
            "heron", None, max_message_bytes=MAX_MESSAGE_BYTES, max_reply_bytes={"small": 1024}
        )
        link = dialer.dial(address, server="s1")
        for service, size in ("small", 1024), ("other", MAX_MESSAGE_BYTES):
            assert len(await link.request(service_path(service, "look"), b"%d" % size, timeout_s=5.0)) == size
        with pytest.raises(Refused, match=r"1025 bytes, more than max_reply_bytes = 1024.* of the drone"):
            await link.request(service_path("small", "look"), b"1025", timeout_s=5.0)
        await link.close()


def test_a_compressed_request_is_not_inflated() -> None:
    with listening(echo) as address, grpc.insecure_channel(address) as channel:
        ask = channel.unary_unary(PATH)
        arrived = ask(bytes(MAX_MESSAGE_BYTES * 100), compression=grpc.Compression.Gzip, timeout=5.0)
    assert len(arrived) < MAX_MESSAGE_BYTES


async def test_a_compressed_reply_is_not_inflated() -> None:
    class Compressing(grpc.GenericRpcHandler):  # type: ignore[misc]
        def service(self, _: object) -> Any:
            return grpc.unary_unary_rpc_method_handler(self.answer)

        def answer(self, _: bytes, context: grpc.ServicerContext) -> bytes:
            context.set_compression(grpc.Compression.Gzip)
            return bytes(MAX_MESSAGE_BYTES * 100)

    server = grpc.server(ThreadPoolExecutor(1), handlers=[Compressing()])
    port = server.add_insecure_port("127.0.0.1:0")
    server.start()
    try:
        assert len(await request(f"127.0.0.1:{port}")) < MAX_MESSAGE_BYTES
    finally:
        server.stop(None)


def name_of_caller(_path: str, _body: bytes, caller: Caller) -> bytes:
    return caller.client.name.encode()


async def test_the_drone_is_who_its_certificate_says_whatever_it_calls_itself(
    credentials: ReadCredentials,
) -> None:
    with listening(name_of_caller, shown=credentials("s1")) as address:
        for server in ("s1", "s2"):
            shown = credentials("heron")
            assert await request(address, drone="stork", server=server, shown=shown) == b"heron"


async def test_without_certificates_the_drone_is_who_it_says() -> None:
    with listening(name_of_caller) as address:
        assert await request(address, drone="stork") == b"stork"


async def test_strangers_and_impostors_get_no_answer(credentials: ReadCredentials) -> None:
    ours, theirs = credentials("heron"), credentials("other/heron")
    believing = Credentials(ours.authority, theirs.certificate, theirs.key)
    with listening(echo, shown=credentials("s1")) as address:
        for dialled in (
            {"shown": ours, "server": "s3"},  # the server is another one
            {"shown": theirs},  # of another authority, which does not believe the server
            {"shown": believing},  # of another authority, and believes the server
            {"shown": None},
        ):
            with pytest.raises(Unreachable):
                await request(address, timeout_s=2.0, **dialled)
        assert await request(address, shown=ours) == b"photo"


async def test_a_server_of_another_authority_is_not_believed(credentials: ReadCredentials) -> None:
    with listening(echo, shown=credentials("other/s1")) as address, pytest.raises(Unreachable):
        await request(address, timeout_s=2.0, shown=credentials("heron"))


async def test_an_unreachable_server_is_told_in_plain_words(credentials: ReadCredentials) -> None:
    heron = credentials("heron")
    with listening(echo, shown=credentials("s1")) as address:
        with pytest.raises(Unreachable, match=r"^s3 at \S+: its certificate is .* another server's$"):
            await request(address, timeout_s=2.0, server="s3", shown=heron)
        with pytest.raises(Unreachable, match=r"^s1 at \S+: (?!failed to connect)"):
            await request(address, timeout_s=2.0)
    with pytest.raises(Unreachable, match=r"^s1 at \S+: connection refused: nobody serves there$"):
        await request(address, timeout_s=2.0, shown=heron)


@pytest.mark.parametrize(
    ("answer", "with_certificates", "said"),
    [
        (b"SSH-2.0-OpenSSH_9.2\r\n", False, "another program answers there"),
        (b"SSH-2.0-OpenSSH_9.2\r\n", True, "what answers there uses no certificates"),
        (b"HTTP/1.1 400 Bad Request\r\n\r\n", False, "another program answers there"),
        (b"", True, "it hung up"),
    ],
)
async def test_what_is_no_daemon_is_told_in_plain_words(
    credentials: ReadCredentials, answer: bytes, with_certificates: bool, said: str
) -> None:
    class Other(socketserver.BaseRequestHandler):
        def handle(self) -> None:
            self.request.sendall(answer)

    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), Other) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        address = f"127.0.0.1:{server.server_address[1]}"
        with pytest.raises(Unreachable) as caught:
            await request(address, timeout_s=2.0, shown=credentials("heron") if with_certificates else None)
        server.shutdown()
    assert str(caught.value).startswith(f"s1 at {address}: {said}")
    assert not re.search("SSL|TSI|HTTP/2|SETTINGS|Handshake", str(caught.value))


async def test_a_server_that_nothing_comes_back_from_is_said_to_be_out_of_reach(
    credentials: ReadCredentials,
) -> None:
    with socket.create_server(("127.0.0.1", 0), backlog=0) as full, socket.socket() as first:
        first.connect(full.getsockname())  # takes the one place: the kernel drops what else comes
        address = f"127.0.0.1:{full.getsockname()[1]}"
        with pytest.raises(
            Unreachable, match=f"s1 at {address}: no connection: its computer is off or out of"
        ):
            await request(address, path=AVAILABILITY, timeout_s=8.0, shown=credentials("heron"))


@contextmanager
def taking_connections(greet: Callable[[socket.socket], socket.socket]) -> Iterator[str]:
    """The address of a server that greets its callers, and then says nothing any more."""
    kept: list[socket.socket] = []

    def take() -> None:
        with suppress(OSError):
            while True:
                caller, _ = server.accept()
                kept.append(caller)
                with suppress(ssl.SSLError, ConnectionError):
                    kept.append(greet(caller))

    with socket.create_server(("127.0.0.1", 0)) as server:
        thread = threading.Thread(target=take)
        thread.start()
        yield f"127.0.0.1:{server.getsockname()[1]}"
        server.shutdown(socket.SHUT_RDWR)
    thread.join()
    for each in kept:
        each.close()


@pytest.mark.parametrize("greets", [False, True])
async def test_why_a_server_takes_connections_and_does_not_answer_is_found_out(
    credentials: ReadCredentials, greets: bool
) -> None:
    context, shown = server_context(credentials("s1")), credentials("heron")

    def greet(caller: socket.socket) -> socket.socket:
        return context.wrap_socket(caller, server_side=True) if greets else caller

    found = (
        r"TLS is done after \d\.\d s, and then the daemon is silent: see its log"
        if greets
        else r"TCP connects in \d\.\d\d s, and not a byte of TLS came back in \d\.\d s: .*stuck: restart it"
    )
    with (
        taking_connections(greet) as address,
        pytest.raises(
            Unreachable, match=f"s1 at {address}: it takes connections and does not answer: {found}"
        ),
    ):
        await request(address, path=AVAILABILITY, timeout_s=4.0, shown=shown)


# --- listening ----------------------------------------------------------------------------------------------


async def test_an_address_in_use_is_named(credentials: ReadCredentials) -> None:
    with listening(echo) as address:
        for shown in (None, credentials("s1")):
            with (
                pytest.raises(UsageError, match=rf"cannot listen on {address}: .*in use"),
                listening(echo, shown=shown, listen=address),
            ):
                """Not reached."""
        assert await request(address) == b"photo"


def test_a_unix_socket_in_use_is_not_taken_over(tmp_path: Path) -> None:
    address = f"unix:{tmp_path}/socket"
    with (
        listening(echo, listen=address),
        pytest.raises(UsageError, match=r"cannot listen on .*in use"),
        listening(echo, listen=address),
    ):
        """Not reached."""


def test_an_address_that_is_not_this_machines_is_named() -> None:
    with (
        pytest.raises(UsageError, match=r"cannot listen on 192\.0\.2\.1:7070"),
        listening(echo, listen="192.0.2.1:7070"),
    ):
        """Not reached."""


async def test_an_ipv6_address_is_told_as_it_can_be_dialled() -> None:
    with listening(echo, listen="[::1]:0") as address:
        assert await request(address) == b"photo"
