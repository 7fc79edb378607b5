"""What strangers and bad drones do to an edge daemon while an honest drone is served.

`python -m tests.system.hostile` does all of it and prints a table: how long the honest drone's calls took beside
those before and after it, in the same run, and by how much the memory of the daemon and its instance grew.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import gzip
import os
import socket
import ssl
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import grpc
from bench.results import leave
from tests.system.daemons import ROOT, Daemon, Guest, channel, config, daemon, guests, memory_bytes, shown

from upwash.errors import Unreachable
from upwash.real.trust.authority import keys_in, make_keys, revoke
from upwash.rpc.protocol import AVAILABILITY, service_path

HALF_OPEN = 1000
STRANGERS, CALLERS = 240, 1024
FLOCK = [f"starling{number}" for number in range(16)]
LONGEST = 2**62
STREAMED_BYTES = 300_000_000
GARBAGE_BYTES = 1_000_000
UNFINISHED = 20
PHOTO = os.urandom(430_000)
ECHO = service_path("workbench", "echo")


@dataclass(frozen=True)
class Target:
    """A daemon and its one instance, by their ports, and a folder of keys that they believe."""

    daemon_port: int
    instance_port: int
    keys: Path

    def spoken_to(
        self, drone: str, *, instance: bool = False
    ) -> contextlib.AbstractContextManager[ssl.SSLSocket]:
        """A connection that has shown the drone's certificate to the daemon, or to the instance."""
        return spoken_to(self.instance_port if instance else self.daemon_port, self.keys, drone)

    def channel(self, drone: str, *, instance: bool = False) -> grpc.Channel:
        """The same, for gRPC."""
        port = self.instance_port if instance else self.daemon_port
        return channel(f"127.0.0.1:{port}", shown(self.keys, drone))


Attack = Callable[[Target], contextlib.AbstractContextManager[None]]


# --- by strangers -------------------------------------------------------------------------------------------


@contextlib.contextmanager
def random_bytes(at: Target) -> Iterator[None]:
    """Ten times a megabyte."""
    for _ in range(10):
        with connected(at.daemon_port) as connection, contextlib.suppress(OSError):
            connection.sendall(os.urandom(GARBAGE_BYTES))
    yield


@contextlib.contextmanager
def half_open_connections(at: Target) -> Iterator[None]:
    """A thousand that say nothing."""
    with contextlib.ExitStack() as stack:
        for _ in range(HALF_OPEN):
            stack.enter_context(connected(at.daemon_port))
        yield


@contextlib.contextmanager
def stream_without_certificate(at: Target) -> Iterator[None]:
    """300 MB of nothing."""
    with connected(at.daemon_port) as connection, contextlib.suppress(OSError):
        for _ in range(STREAMED_BYTES // GARBAGE_BYTES):
            connection.sendall(bytes(GARBAGE_BYTES))
    yield


@contextlib.contextmanager
def endless_handshakes(at: Target) -> Iterator[None]:
    """As many as there is room for, of messages that are announced long and never end, from several addresses."""
    hello = b"\x01" + (130_000).to_bytes(3) + b"\3\3" + bytes(32) + b"\0" + (2**16 - 2).to_bytes(2)
    with contextlib.ExitStack() as stack:
        for number in range(STRANGERS):
            source = (f"127.0.0.{2 + number // 60}", 0)
            connection = stack.enter_context(connected(at.daemon_port, source=source))
            with contextlib.suppress(OSError):  # it had to give way
                connection.sendall(b"\x16\3\1" + len(hello).to_bytes(2) + hello)
        yield


# --- by drones that hold a certificate ----------------------------------------------------------------------


@contextlib.contextmanager
def declared_lengths(at: Target) -> Iterator[None]:
    """A body of 2^62 bytes, a message and values in it of 2^32 - 1: declared, and not sent."""
    with at.spoken_to("stork") as connection:
        connection.sendall(head(AVAILABILITY, length=LONGEST))
        connection.sendall(frame(0, 0, b"\0\xff\xff\xff\xff"))
        connection.settimeout(5.0)
        with contextlib.suppress(OSError):
            while connection.recv(4096):
                pass
    with at.channel("stork") as channel:
        for value in (b"\xdd", b"\xdf", b"\xdb", b"\xc6"):  # a list, a map, a text, bytes
            body = b"\x82\xa6server\xa2s1\xa8services" + value + b"\xff\xff\xff\xff"
            with contextlib.suppress(grpc.RpcError):
                channel.unary_unary(AVAILABILITY)(body, timeout=5.0)
    yield


@contextlib.contextmanager
def slow_reader(at: Target) -> Iterator[None]:
    """Reads a long reply at one byte a second."""
    with at.spoken_to("heron", instance=True) as connection:
        for each in call_of_echo(bytes(60_000)):
            connection.sendall(each)
        over = threading.Event()
        reading = threading.Thread(target=_read_slowly, args=(connection.fileno(), over))
        reading.start()
        try:
            yield
        finally:
            over.set()
            reading.join()


@contextlib.contextmanager
def unfinished_requests(at: Target) -> Iterator[None]:
    """Requests that begin and never end, as when a link dies under a photo: twenty without a lease, one with."""
    over = threading.Event()

    def nothing() -> Iterator[bytes]:
        over.wait()
        yield from ()

    with at.channel("stork", instance=True) as stork, at.channel("heron", instance=True) as heron:
        grpc.channel_ready_future(heron).result(timeout=10.0)
        heron.stream_unary(ECHO).future(nothing(), timeout=60.0)
        refused = [stork.stream_unary(ECHO).future(nothing(), timeout=60.0) for _ in range(UNFINISHED)]
        try:
            for call in refused:
                call.exception(timeout=10.0)
            yield
        finally:
            over.set()


@contextlib.contextmanager
def stream_with_certificate(at: Target) -> Iterator[None]:
    """300 MB in one request, to the daemon and to the instance."""
    over = threading.Event()

    def megabytes() -> Iterator[bytes]:
        for _ in range(STREAMED_BYTES // GARBAGE_BYTES):
            if over.is_set():
                return
            yield bytes(GARBAGE_BYTES)

    with at.channel("stork") as one, at.channel("heron", instance=True) as other:
        calls = [
            channel.stream_unary(path).future(megabytes(), timeout=30.0)
            for channel, path in ((one, AVAILABILITY), (other, ECHO))
        ]
        try:
            yield
        finally:
            over.set()
            for call in calls:
                call.cancel()


@contextlib.contextmanager
def idle_callers(at: Target) -> Iterator[None]:
    """As many connections as the door has places, of sixteen drones that ask nothing."""
    with contextlib.ExitStack() as stack:
        for drone in FLOCK:
            for _ in range(CALLERS // len(FLOCK)):
                stack.enter_context(at.spoken_to(drone))
        yield


@contextlib.contextmanager
def readers_of_nothing(at: Target) -> Iterator[None]:
    """As many connections as one drone may have, each of which asks for much and reads none of it.

    The honest drone has two of them, to the daemon and to the instance. One more would replace the older of the two,
    in the midst of a call where the door takes the new one up late.
    """
    with contextlib.ExitStack() as stack:
        for _ in range(CALLERS // len(FLOCK) - 2):
            connection = stack.enter_context(at.spoken_to("heron", instance=True))
            connection.settimeout(1.0)
            with contextlib.suppress(OSError):
                connection.sendall(frame(8, 0, (2**30).to_bytes(4), stream=0))
                for each in call_of_echo(PHOTO):
                    connection.sendall(each)
        yield


def flood(kind: int, payload: bytes, *, stream: int = 0) -> Attack:
    """Frames of that kind over eight connections, as fast as they are taken, a million or until it is shut out."""

    @contextlib.contextmanager
    def attack(at: Target) -> Iterator[None]:
        many = frame(kind, 0, payload, stream=stream) * max(1, 16_000 // (len(payload) + 9))
        with contextlib.ExitStack() as stack:
            for _ in range(8):
                with contextlib.suppress(OSError):
                    connection = stack.enter_context(at.spoken_to("stork"))
                    connection.settimeout(1.0)
                    connection.sendall(frame(1, 0, b"\x83") if stream else b"")  # a head that goes on
                    for _ in range(125_000 * len(frame(kind, 0, payload)) // len(many)):
                        connection.sendall(many)
            yield

    return attack


@contextlib.contextmanager
def inflating_request(at: Target) -> Iterator[None]:
    """512 MB of zeros in 0.5 MB."""
    small = gzip.compress(bytes(2**29))
    body = b"\1" + len(small).to_bytes(4) + small
    with at.spoken_to("stork") as connection:
        connection.settimeout(5.0)
        with contextlib.suppress(OSError):  # it is not received
            connection.sendall(head(AVAILABILITY, encoding="gzip"))
            for start in range(0, len(body), 16_000):
                connection.sendall(frame(0, 0, body[start : start + 16_000]))
        yield


# --- by programs of their own -------------------------------------------------------------------------------


def program(name: str, drone: str, *, at_instance: bool = False) -> Attack:
    """The attack of that name in attacks/endless.py, with the keys of that drone."""

    @contextlib.contextmanager
    def attack(at: Target) -> Iterator[None]:
        port = at.instance_port if at_instance else at.daemon_port
        # What it takes of this machine itself is not what it does to the daemon.
        command = ["nice", "-n", "19", sys.executable, "-m", "tests.system.attacks.endless"]
        command += [name, str(port), str(at.keys), drone]
        with subprocess.Popen(
            command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
        ) as process:
            try:
                assert process.stdout is not None
                assert process.stdout.readline() == b"attacking\n"
                yield
            finally:
                process.kill()

    return attack


ATTACKS: dict[str, Attack] = {
    "240 handshakes that never end": endless_handshakes,
    "10 x 1 MB of random bytes": random_bytes,
    "1,000 half-open connections": half_open_connections,
    "300 MB streamed without a certificate": stream_without_certificate,
    "lengths declared up to 2^62": declared_lengths,
    "a drone that reads one byte a second": slow_reader,
    "requests that begin and never end": unfinished_requests,
    "300 MB streamed by a drone": stream_with_certificate,
    "1,024 connections of 16 drones that ask nothing": idle_callers,
    "64 connections of a drone that read nothing": readers_of_nothing,
    "settings, again and again": flood(4, b""),
    "pings": flood(6, bytes(8)),
    "room made for replies": flood(8, b"\0\0\0\1"),
    "headers that go on and on": flood(9, b"\0\6x-head\x7f\x81\x7c" + b"a" * 16_000, stream=1),
    "512 MB in 0.5 MB": inflating_request,
    "health watches opened and cancelled by a drone": program("health_watches", "stork"),
    "health watches opened and cancelled by a revoked drone": program("health_watches", "vulture"),
    "rapid reset by a drone": program("rapid_reset", "stork"),
    "rapid reset by a drone, at an instance": program("rapid_reset", "stork", at_instance=True),
    "rapid reset by a revoked drone": program("rapid_reset", "vulture"),
    "1,200 silent strangers": program("silent_strangers", "stork"),
    "1,200 silent strangers, at an instance": program("silent_strangers", "stork", at_instance=True),
}


def attacked_site(folder: Path) -> tuple[str, Path]:
    """The configuration of a daemon and its keys: heron and stork are its drones, vulture was one."""
    keys = folder / "keys"
    make_keys(keys, servers=[["s1", "s2"]], drones=["heron", "stork", "vulture", *FLOCK])
    listed = revoke(keys, ["vulture"])
    return config(keys, keys={"revoked": str(listed)}), keys


# --- HTTP/2 as nobody sends it ------------------------------------------------------------------------------


def connected(port: int, *, source: tuple[str, int] | None = None) -> socket.socket:
    return socket.create_connection(("127.0.0.1", port), timeout=10.0, source_address=source)


@contextlib.contextmanager
def spoken_to(port: int, keys: Path, drone: str) -> Iterator[ssl.SSLSocket]:
    """A connection that has shown the drone's certificate and begun to speak HTTP/2."""
    files = keys_in(keys, drone)
    context = ssl.create_default_context(cafile=str(files.authority))
    context.load_cert_chain(files.certificate, files.key)
    context.set_alpn_protocols(["h2"])
    with connected(port) as plain, context.wrap_socket(plain, server_hostname="s1") as connection:
        connection.sendall(b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + frame(4, 0, b"", stream=0))
        yield connection


def frame(kind: int, flags: int, payload: bytes, *, stream: int = 1) -> bytes:
    return len(payload).to_bytes(3) + bytes([kind, flags]) + stream.to_bytes(4) + payload


def head(path: str, *, length: int | None = None, encoding: str = "identity", stream: int = 1) -> bytes:
    """The frame of headers that begins a request."""
    headers = {":method": "POST", ":scheme": "https", ":path": path, ":authority": "s1"}
    headers |= {"te": "trailers", "content-type": "application/grpc", "grpc-encoding": encoding}
    if length is not None:
        headers["content-length"] = str(length)
    literals = (
        b"\0" + bytes([len(name)]) + name.encode() + bytes([len(value)]) + value.encode()
        for name, value in headers.items()
    )
    return frame(1, 4, b"".join(literals), stream=stream)


def _read_slowly(descriptor: int, over: threading.Event) -> None:
    with contextlib.suppress(OSError):
        while not over.wait(1.0) and os.read(descriptor, 1):
            pass


def call_of_echo(data: bytes) -> Iterator[bytes]:
    """The frames of a call that sends these bytes and gets them back."""
    message = b"\x81\xa4data\xc6" + len(data).to_bytes(4) + data
    body = b"\0" + len(message).to_bytes(4) + message
    yield head(ECHO)
    for start in range(0, len(body), 16_000):
        yield frame(0, 1 if start + 16_000 >= len(body) else 0, body[start : start + 16_000])


# --- what comes of it ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Attacked:
    """How an honest drone was served, and how much more memory was held than without the attack, at most."""

    usual_s: float
    attacked_s: float
    grown_bytes: int
    attack: str


class Peak:
    """The most memory that some processes hold."""

    def __init__(self, processes: Sequence[int]) -> None:
        self._processes = processes
        self.taken()

    def taken(self) -> int:
        """How many bytes it was since the last time that this was asked."""
        most = sum(memory_bytes(process, "VmHWM") for process in self._processes)
        for process in self._processes:
            Path(f"/proc/{process}/clear_refs").write_text("5")  # from now on: proc(5)
        return most


async def _is_welcome(newcomer: Guest) -> bool:
    """Whether a drone that comes now can use the service; as drones do, it asks again after silence.

    The attack's own handshakes can keep a computer with other work busy for longer than one question waits.
    """
    for _ in range(3):
        with contextlib.suppress(Unreachable):
            return (await newcomer.availability("workbench")).available
    return False


async def attacked(at: Daemon, keys: Path, services: Path, name: str, *, calls: int) -> Attacked:
    """Has an honest drone call before and during the attack of that name; raises where a call is not answered."""
    believed = shown(keys, "heron")
    async with guests(at, services, ("heron", believed, "s1")) as (heron,):
        endpoint = (await heron.start()).endpoint
        target = Target(at.port, int(endpoint.rpartition(":")[2]), keys)
        await _served(heron, endpoint, 10 * calls)  # what is allocated once
        peak = Peak([at.process.pid, *at.instances()])
        usual_s = await _served(heron, endpoint, 2 * calls)
        usual_bytes = peak.taken()
        attacking = ATTACKS[name](target)
        await asyncio.to_thread(attacking.__enter__)
        try:
            attacked_s = await _served(heron, endpoint, 2 * calls)
            async with guests(at, services, ("heron", believed, "s1")) as (newcomer,):
                assert await _is_welcome(newcomer)
        finally:
            await asyncio.to_thread(attacking.__exit__, None, None, None)
        usual_s += await _served(
            heron, endpoint, 2 * calls
        )  # while what the attack left behind is dealt with
        return Attacked(median(usual_s), median(attacked_s), peak.taken() - usual_bytes, name)


async def _served(drone: Guest, endpoint: str, calls: int) -> list[float]:
    """How long each of some calls took, with a question to the daemon before it."""
    delays_s = []
    for _ in range(calls):
        began_s = time.perf_counter()
        assert (await drone.availability("workbench")).available
        assert await drone.call(endpoint, "echo", PHOTO) == PHOTO
        delays_s.append(time.perf_counter() - began_s)
    return delays_s


def main() -> None:
    """Prints the table."""
    services = Path(__file__).parents[1] / "services_for_tests.py"
    parser = argparse.ArgumentParser(prog="python -m tests.system.hostile", description=__doc__)
    parser.add_argument("--out", type=Path, help="leave the figures there as JSON")
    parser.add_argument("--only", default="", metavar="TEXT", help="attacks with this in their names")
    options = parser.parse_args()
    figures = []
    print("| attack | usual, ms | attacked, ms | ratio | memory, MB |\n|---|---|---|---|---|")
    for name in ATTACKS:
        if options.only not in name:
            continue
        with tempfile.TemporaryDirectory() as folder:
            text, keys = attacked_site(Path(folder))
            with daemon(Path(folder), text) as at:
                outcome = asyncio.run(attacked(at, keys, services, name, calls=150))
        ratio = outcome.attacked_s / outcome.usual_s
        print(
            f"| {name} | {outcome.usual_s * 1e3:.1f} | {outcome.attacked_s * 1e3:.1f} | {ratio:.2f} "
            f"| {outcome.grown_bytes / 1e6:.1f} |",
            flush=True,
        )
        figures.append(outcome)
    if options.out:
        leave(options.out, command="python -m tests.system.hostile", figures=figures)


if __name__ == "__main__":
    main()
