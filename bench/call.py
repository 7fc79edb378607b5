"""What a call costs: a 430 KB request with a small reply, over loopback and over an emulated 54 Mbit/s link.

`python -m bench.call` takes four ways in turn: raw TCP, bare gRPC with mutual TLS, a remote service call of a
mission, and a local one. First it compares decoding with msgspec alone. See docs/science.md.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
import tempfile
import timeit
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import msgspec
from bench.program import command_line, machine

from upwash.real.trust.authority import make_keys
from upwash.rpc.wire import Encoding

ROOT = Path(__file__).resolve().parent.parent
REQUEST_BYTES = 430_000
LOOPBACK_ROUNDS, LINK_ROUNDS = 200, 15
QUICK_ROUNDS = 2
RATE_BIT_S = 54e6
BITS_OVER_RATE_S = 8 * REQUEST_BYTES / RATE_BIT_S
MOST_OVER_GRPC = 1.25
MOST_OVER_RATE = 1.10
DECODED: dict[str, tuple[type, object]] = {
    "a photo of 400 kB": (bytes, bytes(400_000)),
    "a list of 20 numbers": (list[float], [0.5] * 20),
    "a list of 10,000 numbers": (list[float], [0.5] * 10_000),
    "a list of 100,000 numbers, which are counted": (list[float], [0.5] * 100_000),
}
DECODING_S = 0.02  # of each round
CLIENT_TIMEOUT_S = 120.0
STOP_S = 5.0

CONTENDERS = {
    "raw": "raw TCP",
    "grpc": "bare gRPC, mutual TLS",
    "remote": "upwash, on the server, mutual TLS",
    "local": "upwash, on the drone, socket pair",
}
DAEMON = """\
listen = "{host}:0"
runtime = {{ sandbox_as_root = true }}
service = [{{ name = "echo", program = "bench.echo:Echo" }}]
server = [{{ name = "s1" }}]
keys = {{ authority = "authority.pem", certificate = "s1.pem", key = "s1.key" }}
"""


@dataclass(frozen=True)
class Place:
    """Where the two ends run: the command that each is started with, and the server's address."""

    host: str
    server: tuple[str, ...] = ()
    drone: tuple[str, ...] = ()


def main() -> None:
    """Measures and prints; a missed limit is printed as such and is no failure."""
    quick = command_line("call", __doc__).parse_args().quick
    loopback_rounds, link_rounds = (QUICK_ROUNDS,) * 2 if quick else (LOOPBACK_ROUNDS, LINK_ROUNDS)
    print(f"request {REQUEST_BYTES} bytes, reply 100 bytes; {machine()}")
    print(f"\ndecoding, {link_rounds} rounds")
    for what, (hint, value) in DECODED.items():
        own_s, bare_s = decoding_s(hint, value, link_rounds)
        print(f"{what:46}{own_s * 1e6:>10.1f} µs{own_s / bare_s:>8.2f} of msgspec's")
    print(f"\nloopback, {loopback_rounds} rounds")
    report(measure(Place("127.0.0.1"), loopback_rounds))
    print(f"\nemulated link of {RATE_BIT_S / 1e6:.0f} Mbit/s, {link_rounds} rounds")
    if why := no_link():
        print(f"skipped: {why}")
        return
    with emulated_link() as place:
        delays_s = measure(place, link_rounds)
    report(delays_s)
    over_rate = median(delays_s["remote"]) / BITS_OVER_RATE_S
    print(
        verdict(
            f"upwash on the server / {BITS_OVER_RATE_S * 1e3:.1f} ms of bits / rate",
            over_rate,
            MOST_OVER_RATE,
        )
    )


def decoding_s(hint: type, value: object, rounds: int) -> tuple[float, float]:
    """The median times to decode the value: with upwash and with msgspec alone, in turns."""
    encoding: Encoding[object] = Encoding(hint)
    message = encoding.encode(value)
    bare: msgspec.msgpack.Decoder[object] = msgspec.msgpack.Decoder(hint)
    once_s = timeit.timeit(lambda: encoding.decode(message), number=1)
    number = max(1, round(DECODING_S / once_s))
    turns = [
        [timeit.timeit(lambda: each.decode(message), number=number) / number for each in (encoding, bare)]  # noqa: B023
        for _ in range(rounds)
    ]
    own_s, bare_s = (median(times) for times in zip(*turns, strict=True))
    return own_s, bare_s


def report(delays_s: dict[str, list[float]]) -> None:
    """Prints a table of medians, and of the medians of each round's ratio to bare gRPC."""
    print(f"{'':36}{'median':>10}{'/ bare gRPC':>14}")
    for name, title in CONTENDERS.items():
        print(f"{title:36}{median(delays_s[name]) * 1e3:>7.2f} ms{over_grpc(delays_s, name):>14.2f}")
    print(verdict("upwash on the server / bare gRPC", over_grpc(delays_s, "remote"), MOST_OVER_GRPC))


def over_grpc(delays_s: dict[str, list[float]], name: str) -> float:
    """The median of a contender's delay over bare gRPC's in the same round."""
    return median(own / bare for own, bare in zip(delays_s[name], delays_s["grpc"], strict=True))


def verdict(what: str, ratio: float, most: float) -> str:
    """One line that says whether a limit holds."""
    return f"{'PASS' if ratio <= most else 'MISS'}: {what} = {ratio:.3f}, at most {most:.2f}"


# --- one measurement ----------------------------------------------------------------------------------------


def measure(place: Place, rounds: int) -> dict[str, list[float]]:
    """The delays of each contender, round by round, with every server in a process of its own."""
    with tempfile.TemporaryDirectory(prefix="upwash-bench-") as name, contextlib.ExitStack() as servers:
        folder = Path(name)
        make_keys(folder, servers=[["s1"]], drones=["drone"])
        (folder / "photo.jpg").write_bytes(os.urandom(REQUEST_BYTES))
        (folder / "daemon.toml").write_text(DAEMON.format(host=place.host))
        addresses = [
            servers.enter_context(
                running((*place.server, sys.executable, "-m", *command), log=folder / "servers.log")
            )
            for command in (
                ("bench.servers", "raw", place.host, name),
                ("bench.servers", "grpc", place.host, name),
                ("upwash", "serve", "--config", f"{name}/daemon.toml"),
            )
        ]
        client = subprocess.run(
            (*place.drone, sys.executable, "-m", "bench.client", name, str(rounds), *addresses),
            cwd=ROOT,
            stdout=subprocess.PIPE,
            timeout=CLIENT_TIMEOUT_S,
            check=True,
        )
    return msgspec.json.decode(client.stdout, type=dict[str, list[float]])


@contextlib.contextmanager
def running(command: tuple[str, ...], *, log: Path) -> Iterator[str]:
    """A server's process, as the address that it printed once it answered; ended at the end."""
    with (
        log.open("a") as errors,
        subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=errors, text=True) as process,
    ):
        assert process.stdout is not None
        try:
            words = process.stdout.readline().split()
            if not words:
                raise SystemExit(f"{' '.join(command)} did not start:\n{log.read_text()}")
            yield words[-1]
        finally:
            process.terminate()
            try:
                process.wait(STOP_S)
            except subprocess.TimeoutExpired:
                process.kill()


# --- the emulated link --------------------------------------------------------------------------------------


def no_link() -> str:
    """Why a link cannot be emulated here; empty where it can."""
    if not sys.platform.startswith("linux"):
        return "network namespaces are Linux's"
    if os.geteuid() != 0:
        return "network namespaces need root"
    missing = [tool for tool in ("ip", "tc") if shutil.which(tool) is None]
    return f"no {' and no '.join(missing)} here: install iproute2" if missing else ""


@contextlib.contextmanager
def emulated_link() -> Iterator[Place]:
    """Two network namespaces joined by a cable that carries 54 Mbit/s each way."""
    drone, server = (f"upwash-{os.getpid()}-{end}" for end in ("drone", "server"))
    try:
        for namespace in (drone, server):
            _do(f"ip netns add {namespace}")
        _do(f"ip link add radio netns {drone} type veth peer name radio netns {server}")
        for namespace, address in ((drone, "10.54.0.1"), (server, "10.54.0.2")):
            _do(f"ip -n {namespace} address add {address}/24 dev radio")
            _do(f"ip -n {namespace} link set radio up")
            # The burst is small: its bytes pass faster than the link's rate. The queue takes a whole request.
            _do(
                f"tc -n {namespace} qdisc add dev radio root tbf "
                f"rate {RATE_BIT_S / 1e6:.0f}mbit burst 3200 latency 100ms"
            )
        yield Place("10.54.0.2", server=("ip", "netns", "exec", server), drone=("ip", "netns", "exec", drone))
    finally:
        for namespace in (drone, server):
            subprocess.run(("ip", "netns", "delete", namespace), check=False, stderr=subprocess.DEVNULL)


def _do(command: str) -> None:
    subprocess.run(command.split(), check=True)


if __name__ == "__main__":
    main()
