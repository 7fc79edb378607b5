"""The door: who gets through, and how much of it."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import os
import random
import re
import socket
import ssl
import threading
import tracemalloc
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.doors import behind_door
from tests.waiting import wait_for

from upwash.errors import CredentialsError, InstanceError, LinkError, Unreachable
from upwash.real.link.door import Door, leading, opened_door
from upwash.real.link.limits import PREFACE, ConnectionLimits, DoorLimits, FrameCounter, RateLimit
from upwash.real.link.link import GrpcDialer
from upwash.real.link.listener import HealthCheck, Listener, WhoIs
from upwash.real.link.proxy import GrpcSocket, announcing_at
from upwash.real.link.requests import Caller, Requests
from upwash.real.link.streams import listening_socket
from upwash.real.trust import authority as module
from upwash.real.trust.authority import keys_in, make_keys
from upwash.real.trust.credentials import Credentials, Trust, fingerprint, read_credentials
from upwash.real.trust.secrets import load_secret
from upwash.support.background import never

ReadCredentials = Callable[[str], Credentials]
PATH = "/upwash.test/name"
WATCH = "/grpc.health.v1.Health/Watch"
CHECK = "/grpc.health.v1.Health/Check"
DATA, HEADERS, RST_STREAM, PING, WINDOW_UPDATE, SETTINGS = 0, 1, 3, 6, 8, 4
ALERT = b"\x15"  # of TLS
_CLIENT_HELLO = b"\x01" + (100_000).to_bytes(3) + b"\x03\x03" + bytes(32) + b"\0" + (2**16 - 2).to_bytes(2)
ENDLESS_HELLO = b"".join(
    b"\x16\x03\x01" + len(piece).to_bytes(2) + piece for piece in (_CLIENT_HELLO, *[bytes(16_000)] * 3)
)


def name_of_caller(_path: str, _body: bytes, caller: Caller) -> bytes:
    return caller.client.name.encode()


def make(listen: str, who_is: WhoIs) -> Listener:
    requests = Requests(name_of_caller, max_message_bytes=100_000, concurrent=16, per_drone=16)
    listener = Listener(listen, requests, who_is=who_is)
    listener.add(HealthCheck(["s1"]))
    return listener


@contextmanager
def served(shown: Credentials, limits: DoorLimits | None = None) -> Iterator[tuple[Door, str]]:
    with behind_door(make, shown, limits=limits) as (_, door, address):
        yield door, address


async def ask(address: str, shown: Credentials, path: str = PATH, body: bytes = b"", times: int = 1) -> bytes:
    """The last of several answers over one link."""
    link = GrpcDialer("", shown, max_message_bytes=100_000).dial(address, server="s1")
    try:
        for _ in range(times):
            answer = await link.request(path, body, timeout_s=10.0)
        return answer
    finally:
        await link.close()


def context_of(shown: Credentials) -> ssl.SSLContext:
    context = ssl.create_default_context(cadata=shown.authority.decode())
    load_secret(context, shown.certificate + b"\n" + shown.key)
    return context


def read(folder: Path, holder: str, *, valid_now: bool = True) -> Credentials:
    files = keys_in(folder, holder)
    return read_credentials(files.authority, files.certificate, files.key, valid_now=valid_now)


@contextmanager
def connected(address: str) -> Iterator[socket.socket]:
    host, _, port = address.partition(":")
    with socket.create_connection((host, int(port)), timeout=10.0) as connection:
        yield connection


@contextmanager
def spoken_to(address: str, drone: str, credentials: ReadCredentials) -> Iterator[ssl.SSLSocket]:
    """A connection that has shown the drone's certificate and begun to speak HTTP/2."""
    context = context_of(credentials(drone))
    context.set_alpn_protocols(["h2"])
    with connected(address) as plain, context.wrap_socket(plain, server_hostname="s1") as connection:
        connection.sendall(PREFACE + frame(SETTINGS))
        yield connection


# --- certificates -------------------------------------------------------------------------------------------


async def test_a_caller_is_who_its_certificate_says(credentials: ReadCredentials) -> None:
    with served(credentials("s1")) as (_, address):
        assert await ask(address, credentials("heron")) == b"heron"
        assert await ask(address, credentials("stork")) == b"stork"


async def test_a_revoked_certificate_gets_no_answer_and_its_connections_end(
    credentials: ReadCredentials,
) -> None:
    heron, stork = credentials("heron"), credentials("stork")
    without_heron = Trust(credentials("s1"), revoked=frozenset({fingerprint(heron.certificate)}))

    with served(credentials("s1")) as (door, address):
        link = GrpcDialer("", heron, max_message_bytes=100_000).dial(address, server="s1")
        assert await link.request(PATH, b"", timeout_s=10.0) == b"heron"
        await door.trust(without_heron)
        for _ in range(2):
            with pytest.raises(Unreachable):
                await link.request(PATH, b"", timeout_s=10.0)
        await link.close()
        assert await ask(address, stork) == b"stork"


async def test_two_authorities_are_believed_side_by_side_and_then_only_the_new_one(
    keys: Path, credentials: ReadCredentials
) -> None:
    old, new = credentials("s1"), credentials("other/s1")
    both = Credentials(old.authority + new.authority, old.certificate, old.key)
    with served(both) as (door, address):
        heron = credentials("heron")
        from_new = credentials("other/heron")  # which believes the daemon's old certificate too, as it has to
        believing = Credentials(both.authority, from_new.certificate, from_new.key)
        assert await ask(address, heron) == await ask(address, believing) == b"heron"
        await door.trust(Trust(new))
        with pytest.raises(Unreachable):
            await ask(address, heron)
        assert await ask(address, from_new) == b"heron"


async def test_who_is_refused_is_counted_by_the_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, credentials: ReadCredentials
) -> None:
    make_keys(tmp_path, servers=[["s1"]], drones=["heron"])
    monkeypatch.setattr(module, "_CLOCKS_MAY_DIFFER", timedelta(days=10))
    make_keys(tmp_path, drones=["mayfly"], lasts=timedelta(days=-3))
    monkeypatch.setattr(module, "_CLOCKS_MAY_DIFFER", timedelta(days=-3))
    make_keys(tmp_path, drones=["chick"])

    own, heron, mayfly, chick = (
        read(tmp_path, holder, valid_now=False) for holder in ("s1", "heron", "mayfly", "chick")
    )
    nobody = ssl.create_default_context(cadata=own.authority.decode())
    stranger = credentials("other/heron")
    foreign = Credentials(own.authority, stranger.certificate, stranger.key)

    def knock(address: str, context: ssl.SSLContext) -> None:
        with (
            contextlib.suppress(OSError),
            connected(address) as plain,
            context.wrap_socket(plain, server_hostname="s1") as connection,
        ):
            connection.recv(1)

    def counted(door: Door) -> dict[str, tuple[int, str]]:
        return {each.reason: (each.times, each.last) for each in door.refused}

    with served(own) as (door, address):
        assert counted(door) == {}
        await door.trust(Trust(own, revoked=frozenset({fingerprint(heron.certificate)})))
        knock(address, nobody)
        for shown in (foreign, mayfly, chick, heron, heron):
            knock(address, context_of(shown))
        with connected(address) as plain:
            plain.sendall(b"GET / HTTP/1.1\r\n\r\n")
            plain.recv(1)
        expected = {
            "no_certificate": (1, "127.0.0.1"),
            "other_authority": (1, "127.0.0.1"),
            "expired": (1, "127.0.0.1"),
            "not_yet_valid": (1, "127.0.0.1"),
            "revoked": (2, "heron"),
            "no_handshake": (1, "127.0.0.1"),
        }
        wait_for(lambda: counted(door) == expected, seen=lambda: counted(door))


def test_trust_tells_holders_apart(keys: Path, credentials: ReadCredentials) -> None:
    trust = Trust(credentials("s1"), revoked=frozenset({fingerprint(credentials("stork").certificate)}))

    def der(holder: str) -> bytes:
        return ssl.PEM_cert_to_DER_cert(credentials(holder).certificate.decode())

    assert trust.holder(der("heron")).client.name == "heron"
    assert trust.holder(der("heron")).client.certificate == fingerprint(credentials("heron").certificate)
    with pytest.raises(CredentialsError, match="stork is revoked"):
        trust.holder(der("stork"))
    with pytest.raises(CredentialsError, match="another authority"):
        trust.holder(der("other/heron"))


async def test_a_connection_ends_with_its_certificate(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, credentials: ReadCredentials
) -> None:
    monkeypatch.setattr(module, "_CERTIFICATE_LASTS", timedelta(seconds=3))
    make_keys(tmp_path, servers=[["s1"]], drones=["mayfly"])

    with served(read(tmp_path, "s1")) as (_, address):
        link = GrpcDialer("", read(tmp_path, "mayfly"), max_message_bytes=100_000).dial(address, server="s1")
        assert await link.request(PATH, b"", timeout_s=10.0) == b"mayfly"
        async with asyncio.timeout(10.0):
            while True:
                try:
                    await link.request(PATH, b"", timeout_s=10.0)
                except LinkError:
                    break
                await asyncio.sleep(0.1)
        await link.close()


@pytest.mark.parametrize("version", [ssl.TLSVersion.TLSv1_2, ssl.TLSVersion.TLSv1_3])
def test_tls_1_3_alone_is_spoken(version: ssl.TLSVersion, credentials: ReadCredentials) -> None:
    context = context_of(credentials("heron"))
    context.minimum_version, context.maximum_version = ssl.TLSVersion.TLSv1_2, version
    with served(credentials("s1")) as (_, address), connected(address) as plain:
        if version is ssl.TLSVersion.TLSv1_3:
            with context.wrap_socket(plain, server_hostname="s1") as connection:
                assert connection.version() == "TLSv1.3"
        else:
            with pytest.raises(ssl.SSLError):
                context.wrap_socket(plain, server_hostname="s1")


# --- how much -----------------------------------------------------------------------------------------------


async def test_silent_strangers_give_way_to_who_speaks(credentials: ReadCredentials) -> None:
    few = DoorLimits(strangers=8, strangers_per_address=4)
    with served(credentials("s1"), few) as (_, address), contextlib.ExitStack() as stack:
        silent = [stack.enter_context(connected(address)) for _ in range(20)]
        assert await ask(address, credentials("heron")) == b"heron"
        assert [connection.recv(1) for connection in silent[:15]] == [b""] * 15  # hung up on


async def test_who_begins_too_much_is_shut_out_and_nobody_else(
    credentials: ReadCredentials, caplog: pytest.LogCaptureFixture
) -> None:
    strict = DoorLimits(begun_per_s=1.0, burst_s=20.0)
    with served(credentials("s1"), strict) as (_, address):
        assert await ask(address, credentials("heron"), times=20) == b"heron"
        for _ in range(2):  # over a connection of before, and over a new one
            with pytest.raises(LinkError):
                await ask(address, credentials("heron"), times=20)
        assert await ask(address, credentials("stork"), times=20) == b"stork"
    said = "\n".join(caplog.messages)
    assert "hanging up on heron: it begins or breaks off more requests than any drone would" in said
    assert re.search("refused 127.0.0.1: heron is shut out for another [0-9]+ s", said)


async def test_room_for_replies_that_is_made_again_and_again_shuts_out(credentials: ReadCredentials) -> None:
    strict = DoorLimits(pieces_per_s=1.0, burst_s=100.0)
    with served(credentials("s1"), strict) as (_, address), spoken_to(address, "heron", credentials) as heron:
        for _ in range(100):
            heron.sendall(frame(WINDOW_UPDATE, b"\0\0\0\1"))
        heron.settimeout(10.0)
        with contextlib.suppress(OSError):  # it is hung up on
            while heron.recv(4096):
                heron.sendall(frame(WINDOW_UPDATE, b"\0\0\0\1"))
        with pytest.raises(LinkError):
            await ask(address, credentials("heron"))
        assert await ask(address, credentials("stork")) == b"stork"


def test_a_handshake_without_end_is_refused(
    credentials: ReadCredentials, caplog: pytest.LogCaptureFixture
) -> None:
    with served(credentials("s1")) as (_, address), connected(address) as stranger:
        stranger.sendall(ENDLESS_HELLO)
        assert stranger.recv(1024)[:1] in (b"", ALERT)
    assert "refused 127.0.0.1: its handshake is longer than any drone's" in caplog.text


async def test_handshakes_give_way_to_newer_ones(credentials: ReadCredentials) -> None:
    few = DoorLimits(handshakes_per_address=4, handshake_s=60.0)
    with served(credentials("s1"), few) as (_, address), contextlib.ExitStack() as stack:
        begun = [stack.enter_context(connected(address)) for _ in range(10)]
        for stranger in begun:
            stranger.sendall(ENDLESS_HELLO[:100])
        assert await ask(address, credentials("heron")) == b"heron"
        for stranger in begun[:6]:
            assert stranger.recv(1) == b""


async def test_a_connection_takes_little_memory(credentials: ReadCredentials) -> None:
    with served(credentials("s1")) as (_, address), contextlib.ExitStack() as stack:
        await ask(address, credentials("heron"))
        tracemalloc.start()
        stack.callback(tracemalloc.stop)
        for _ in range(20):
            stack.enter_context(spoken_to(address, "heron", credentials))
        await ask(address, credentials("stork"))
        assert tracemalloc.get_traced_memory()[0] < 20 * 50_000


async def test_who_reads_nothing_takes_little_memory_and_gets_all_in_the_end(
    tmp_path: Path, credentials: ReadCredentials
) -> None:
    path, answer = str(tmp_path / "talker"), os.urandom(8_000_000)

    def say_all() -> None:
        connection, _ = talker.accept()
        with connection, contextlib.suppress(OSError):
            connection.sendall(answer)
            connection.recv(1)

    with served(credentials("s1")) as (door, _), listening_socket(f"unix:{path}") as talker:
        talking = threading.Thread(target=say_all)
        talking.start()
        entrance = await door.lead(listening_socket("127.0.0.1:0"), GrpcSocket(path).connect)
        with spoken_to(f"127.0.0.1{entrance.endpoint}", "heron", credentials) as heron:
            tracemalloc.start()
            heard = bytearray()
            while len(heard) < len(answer):
                heard += heron.recv(1000)
                assert tracemalloc.get_traced_memory()[1] - len(heard) < 1_000_000
            tracemalloc.stop()
            assert heard == answer
        talking.join()


async def test_a_service_whose_connection_blocks_keeps_nobody_else_waiting(
    tmp_path: Path, credentials: ReadCredentials
) -> None:
    path, kept = str(tmp_path / "hostile"), contextlib.ExitStack()

    def give_one_that_blocks() -> None:
        asked, _ = asking.accept()
        read, given = (kept.enter_context(each) for each in socket.socketpair())
        with asked:
            asked.recv(4096)
            socket.send_fds(asked, [b"x"], [given.fileno()])
            read.recv(1)  # the door has it, and hands on what comes
            given.setblocking(True)
            asked.recv(1)  # until the door hangs up

    context = context_of(credentials("stork"))
    with kept, served(credentials("s1")) as (door, address):
        asking = kept.enter_context(listening_socket(f"unix:{path}"))
        hostile = threading.Thread(target=give_one_that_blocks)
        hostile.start()
        listening = listening_socket("127.0.0.1:0")
        # Otherwise the system may keep for its reader all that is sent, and no sender waits.
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2**16)
        entrance = await door.lead(listening, announcing_at(path))
        plain = socket.create_connection(("127.0.0.1", int(entrance.endpoint[1:])))
        with context.wrap_socket(plain, server_hostname="s1") as stork:
            stork.settimeout(0.5)
            with pytest.raises(TimeoutError):  # nobody reads
                stork.sendall(PREFACE + (2**24 - 1).to_bytes(3) + bytes(6 + 2**24 - 1))
            assert await ask(address, credentials("heron")) == b"heron"
    hostile.join()


async def test_a_health_check_is_answered_and_nothing_is_watched(credentials: ReadCredentials) -> None:
    heron = credentials("heron")
    with served(credentials("s1")) as (_, address):
        assert (
            await ask(address, heron, CHECK) == await ask(address, heron, CHECK, b"\x0a\x02s1") == b"\x08\x01"
        )
        with pytest.raises(LinkError, match="NOT_FOUND"):
            await ask(address, heron, CHECK, b"\x0a\x02s3")
        with pytest.raises(LinkError, match="UNIMPLEMENTED"):
            await ask(address, heron, WATCH)


def unused_ports() -> Iterator[int]:
    """From below those that the system hands out, so that no other test takes one meanwhile."""
    for port in random.sample(range(20_000, 30_000), 200):
        with contextlib.suppress(OSError):
            socket.create_server(("127.0.0.1", port)).close()
            yield port


def test_instances_are_reached_at_the_ports_that_are_given_and_at_no_others(
    credentials: ReadCredentials,
) -> None:
    nowhere = GrpcSocket("/nowhere").connect

    async def lead_three() -> list[str]:
        async with opened_door(Trust(credentials("s1"))) as door:
            lead = leading(door, "127.0.0.1", dict.fromkeys((taken.getsockname()[1], *free), 0))
            first, second = await lead("s1", nowhere), await lead("s1", nowhere)
            with pytest.raises(InstanceError, match=r"cannot listen on 127.0.0.1, ports \d+ to \d+"):
                await lead("s1", nowhere)
            await first.close()
            again = await lead("s1", nowhere)
            return [first.endpoint, second.endpoint, again.endpoint]

    with socket.create_server(("127.0.0.1", 0)) as taken:
        free = list(itertools.islice(unused_ports(), 2))
        assert asyncio.run(lead_three()) == [f":{free[0]}", f":{free[1]}", f":{free[0]}"]


def test_drones_are_told_the_port_that_they_see(credentials: ReadCredentials) -> None:
    async def lead_one() -> tuple[str, str]:
        async with opened_door(Trust(credentials("s1"))) as door:
            entrance = await leading(door, "127.0.0.1", {port: 17_100})("s1", GrpcSocket("/nowhere").connect)
            return entrance.endpoint, entrance.address

    port = next(unused_ports())
    assert asyncio.run(lead_one()) == (":17100", f"127.0.0.1:{port}")


async def test_a_door_that_closes_leaves_no_thread_and_no_connection(credentials: ReadCredentials) -> None:
    with served(credentials("s1")) as (_, address):
        assert await ask(address, credentials("heron")) == b"heron"
        host, _, port = address.partition(":")
        stranger = socket.create_connection((host, int(port)), timeout=10.0)
    with stranger, contextlib.suppress(ConnectionResetError):  # where it was not even taken yet
        assert stranger.recv(1) == b""
    assert "door" not in [thread.name for thread in threading.enumerate()]


# --- what it is made of -------------------------------------------------------------------------------------


def frame(kind: int, payload: bytes = b"") -> bytes:
    return len(payload).to_bytes(3, "big") + bytes([kind, 0]) + bytes(4) + payload


@given(
    st.lists(st.sampled_from([DATA, HEADERS, RST_STREAM, PING, WINDOW_UPDATE]), max_size=30),
    st.integers(1, 40),
    st.binary(max_size=20),
)
def test_frames_are_counted_however_they_are_cut(kinds: list[int], size: int, payload: bytes) -> None:
    spoken = PREFACE + b"".join(frame(kind, payload) for kind in kinds)
    counter, whole = FrameCounter(), Counter[str]()
    for start in range(0, len(spoken), size):
        whole += counter.count(spoken[start : start + size])
    names = {HEADERS: "begun", DATA: "data", WINDOW_UPDATE: "window", RST_STREAM: "broken_off", PING: "idle"}
    assert whole == Counter(names[kind] for kind in kinds)


async def test_the_oldest_of_a_crowded_group_goes_and_of_the_largest_where_all_are_too_many() -> None:
    limits = ConnectionLimits(3, per_group=2)
    a1, a2, b1, a3, c1 = tasks = [asyncio.create_task(never()) for _ in range(5)]
    for task, group in ((a1, "a"), (a2, "a"), (b1, "b")):
        limits.add(task, group)
    assert not any(task.cancelling() for task in tasks)
    limits.add(a3, "a")
    assert [task.cancelling() for task in tasks] == [1, 0, 0, 0, 0]
    limits.add(c1, "c")
    assert [task.cancelling() for task in tasks] == [1, 1, 0, 0, 0]
    limits.remove(b1)
    limits.remove(b1)
    assert len(limits) == 2
    for task in tasks:
        task.cancel()


@pytest.mark.virtual
async def test_who_asks_again_and_again_keeps_nobody_else_out() -> None:
    limit, now_s = RateLimit(20.0), asyncio.get_running_loop().time

    async def ask_again_and_again() -> None:
        while True:
            await limit.wait()

    crowd = [asyncio.create_task(ask_again_and_again()) for _ in range(10)]
    for _ in range(100):
        await asyncio.sleep(0.05)
        asked_s = now_s()
        await limit.wait()
        assert now_s() - asked_s < 12 / 20
    for task in crowd:
        task.cancel()


async def test_a_way_in_that_fails_ends_the_door_with_its_failure(
    credentials: Callable[[str], Credentials], caplog: pytest.LogCaptureFixture
) -> None:
    class Defective(socket.socket):
        def accept(self) -> tuple[socket.socket, object]:
            raise LookupError("a defect")

    with pytest.raises(LookupError, match="a defect"):
        async with opened_door(Trust(credentials("s1"))) as door:
            listening = Defective(fileno=listening_socket("127.0.0.1:0").detach())
            entrance = await door.lead(listening, announcing_at("/nowhere"))
            with socket.create_connection(("127.0.0.1", int(entrance.address.rpartition(":")[2]))):
                async with asyncio.timeout(10.0):
                    await never()
    assert "the way in at 127.0.0.1" in caplog.text
