"""What many drones get from one daemon: 430 KB photos, a service of 50 ms, slots for all of them, or in turns.

`python -m bench.load` (some minutes) compares each number of drones with the same drones at a bare gRPC server, in
the same run; `python -m bench.load --soak 600` watches what the daemon holds over ten minutes. See
docs/science.md.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import math
import os
import random
import shlex
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import quantiles
from typing import Literal

import msgspec
from bench.call import REQUEST_BYTES, running
from bench.echo import REPLY_BYTES, Echo
from bench.program import command_line, machine
from bench.results import leave
from bench.servers import GRPC_PATH
from tests.children import children
from tests.system.daemons import memory_bytes

from upwash.errors import LinkError, NoLease
from upwash.real.link.link import GrpcDialer
from upwash.real.trust.authority import keys_in, make_keys
from upwash.real.trust.credentials import read_credentials
from upwash.rpc.protocol import (
    AVAILABILITY,
    LEAVE,
    START,
    AvailabilityReply,
    AvailabilityRequest,
    LeaveRequest,
    StartReply,
    StartRequest,
    decode_reply,
    resolve,
    service_path,
)
from upwash.rpc.service import spec_of

TAKES_S = 0.05
VISIT_CALLS = 3  # over one connection to the bare server; in a soak a drone leaves then, and comes again
TURN_S = 5.0  # the least that can be configured: some turns fit into a minute
DEADLINE_S = 30.0  # far longer than a drone waits, so that late answers are counted
IN_TURN = 4  # times as long where drones take turns
SOAK_DRONES = 15
MAX_MESSAGE_BYTES = 16 * 2**20
MEASURE = spec_of(Echo).methods["measure"]
DAEMON = """\
listen = "127.0.0.1:0"
runtime = {{ sandbox_as_root = true }}
keys = {{ authority = "authority.pem", certificate = "s1.pem", key = "s1.key" }}
service = [{{ name = "echo", program = "bench.echo:Echo", pace_s = {takes_s} }}]
server = [{{ name = "s1", slots = {slots}, turn_s = {turn_s} }}]
"""
Slots = int | Literal["auto"] | None  # None: the bare server


@dataclass(frozen=True)
class Pace:
    """How fast all goes."""

    fly_s: float  # from an answer to a drone's next call
    warm_up_s: float
    look_s: float  # between two looks at what the daemon holds in a soak


FULL = Pace(
    fly_s=1.0, warm_up_s=10.0, look_s=10.0
)  # ten times as often as a drone that flies from photo to photo
QUICK = Pace(fly_s=0.2, warm_up_s=0.5, look_s=0.5)
QUICK_DRONES, QUICK_S = 1, 1.0

Tell = Callable[[str, bytes], Awaitable[bytes]]


@dataclass
class Seen:
    """What the drones saw."""

    from_s: float = 0.0  # calls that begin earlier do not count: connections are made, the service started
    delays_s: list[float] = field(default_factory=list)
    served: Counter[str] = field(default_factory=Counter)
    turned_away: int = 0  # questions without a free slot
    failed: Counter[str] = field(default_factory=Counter)  # calls, by why
    leases: set[str] = field(default_factory=set)
    most_leases: int = 0

    def answered(self, drone: str, began_s: float, ended_s: float) -> None:
        """Takes note of a call."""
        if began_s >= self.from_s:
            self.delays_s.append(ended_s - began_s)
            self.served[drone] += 1

    def admitted(self, drone: str) -> None:
        """Takes note that the drone holds a lease."""
        self.leases.add(drone)
        self.most_leases = max(self.most_leases, len(self.leases))


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """One line of the table; `slots` are a daemon's, None stands for the bare server."""

    drones: int
    slots: Slots
    throughput_per_s: float
    p50_s: float
    p99_s: float
    failed: int  # calls, and questions to the daemon
    turned_away: int
    most_leases: int  # that drones held at the same time
    least_calls: int  # of one drone, answered
    most_calls: int


HEAD = (
    *("drones", "server", "calls/s", "p50, ms", "p99, ms"),
    *("failed", "turned away", "leases at most", "calls of a drone"),
)


# --- drones -------------------------------------------------------------------------------------------------


class Drone:
    """A drone at one server; it stays for as long as it may, or for a number of calls a visit."""

    def __init__(
        self, name: str, keys: Path, seen: Seen, pace: Pace, *, seed: int, visit_calls: int | None = None
    ) -> None:
        files = keys_in(keys, name)
        credentials = read_credentials(files.authority, files.certificate, files.key)
        self.name = name
        self._dialer = GrpcDialer(name, credentials, max_message_bytes=MAX_MESSAGE_BYTES)
        self._seen = seen
        self._fly_s = pace.fly_s
        self._visit_calls = visit_calls
        self._chance = random.Random(seed)
        self._photo = self._chance.randbytes(REQUEST_BYTES)

    async def visit_daemon(self, address: str, until_s: float) -> None:
        """Asks for a slot until it gets one, calls for as long as its turn lasts, and asks again."""
        await self._arrive()
        while time.perf_counter() < until_s:
            try:
                await self._visit(address, until_s)
            except NoLease:
                self._seen.leases.discard(self.name)
            except LinkError as error:
                self._note(error)
                await asyncio.sleep(self._fly_s)

    async def _visit(self, address: str, until_s: float) -> None:
        async with self._linked(address) as tell:
            while not (answer := await _available(tell)).available:
                self._seen.turned_away += 1
                await asyncio.sleep(answer.ask_again_s)
                if time.perf_counter() >= until_s:
                    return
            self._seen.admitted(self.name)
            endpoint = answer.endpoints.get("echo") or await _started(tell)
            async with self._linked(resolve(endpoint, address)) as call:
                for _ in itertools.count() if self._visit_calls is None else range(self._visit_calls):
                    if time.perf_counter() >= until_s:
                        break
                    _, body = MEASURE.encode((self._photo,), {})
                    await self._timed(call, service_path("echo", "measure"), body, until_s)
            self._seen.leases.discard(
                self.name
            )  # before the message, as the daemon knows before the message arrives
            await tell(LEAVE, msgspec.msgpack.encode(LeaveRequest("s1")))

    async def visit_bare(self, address: str, until_s: float) -> None:
        """Calls."""
        await self._arrive()
        while time.perf_counter() < until_s:
            async with self._linked(address) as call:
                for _ in range(VISIT_CALLS):
                    await self._timed(call, GRPC_PATH, self._photo, until_s)

    async def _arrive(self) -> None:
        await asyncio.sleep(self._chance.uniform(0.0, self._fly_s))

    def _note(self, error: LinkError) -> None:
        if time.perf_counter() >= self._seen.from_s:
            self._seen.failed[str(error).partition(": ")[2]] += 1

    @contextlib.asynccontextmanager
    async def _linked(self, address: str) -> AsyncIterator[Tell]:
        link = self._dialer.dial(address, server="s1")
        try:
            yield lambda path, body: link.request(path, body, timeout_s=DEADLINE_S)
        finally:
            await link.close()

    async def _timed(self, call: Tell, path: str, body: bytes, until_s: float) -> None:
        began_s = time.perf_counter()
        if began_s >= until_s:
            return
        try:
            reply = await call(path, body)
        except NoLease:
            raise
        except LinkError as error:
            self._note(error)
        else:
            assert len(reply) >= REPLY_BYTES
            self._seen.answered(self.name, began_s, time.perf_counter())
        await asyncio.sleep(self._fly_s)


async def _available(tell: Tell) -> AvailabilityReply:
    request = msgspec.msgpack.encode(AvailabilityRequest("s1", ["echo"]))
    return decode_reply(await tell(AVAILABILITY, request), AvailabilityReply, sender="s1")


async def _started(tell: Tell) -> str:
    reply = decode_reply(
        await tell(START, msgspec.msgpack.encode(StartRequest("s1", "echo"))), StartReply, sender="s1"
    )
    if not reply.endpoint:
        raise LinkError(f"s1 cannot start the service: {reply.reason}")
    return reply.endpoint


# --- the table ----------------------------------------------------------------------------------------------


def measure(drones: int, pace: Pace, *, seconds: float, keys: Path) -> Iterator[Row]:
    """The bare server, a daemon with a slot for each drone, and for longer two where they may have to take turns."""
    for slots in dict.fromkeys((None, drones, "auto", max(1, drones // 10))):
        lasts_s = seconds if slots in (None, drones) else IN_TURN * seconds
        seen = Seen()
        fleet = _fleet(drones, keys, seen, pace)
        with _server(slots, keys) as (_, address):
            seen.from_s = time.perf_counter() + pace.warm_up_s
            asyncio.run(_all_at(address, fleet, pace.warm_up_s + lasts_s, bare=slots is None))
        p50_s, p99_s = _middle_and_tail(seen.delays_s)
        calls = [seen.served[drone.name] for drone in fleet]
        yield Row(
            drones=drones,
            slots=slots,
            throughput_per_s=len(seen.delays_s) / lasts_s,
            p50_s=p50_s,
            p99_s=p99_s,
            failed=seen.failed.total(),
            turned_away=seen.turned_away,
            most_leases=seen.most_leases,
            least_calls=min(calls),
            most_calls=max(calls),
        )


def _middle_and_tail(delays_s: Sequence[float]) -> tuple[float, float]:
    """The median and the 99th percentile; NaN where there are too few to say."""
    if len(delays_s) < 2:
        return math.nan, math.nan
    cuts_s = quantiles(delays_s, n=100)
    return cuts_s[49], cuts_s[98]


def _fleet(drones: int, keys: Path, seen: Seen, pace: Pace, *, visit_calls: int | None = None) -> list[Drone]:
    return [
        Drone(f"drone-{number}", keys, seen, pace, seed=number, visit_calls=visit_calls)
        for number in range(drones)
    ]


async def _all_at(address: str, drones: Sequence[Drone], seconds: float, *, bare: bool) -> None:
    until_s = time.perf_counter() + seconds
    async with asyncio.TaskGroup() as group:
        for drone in drones:
            visit = drone.visit_bare if bare else drone.visit_daemon
            group.create_task(visit(address, until_s))


@contextlib.contextmanager
def _server(slots: Slots, keys: Path) -> Iterator[tuple[int, str]]:
    """The process and its address: a daemon with that many slots, or the bare server."""
    if slots is None:
        command: tuple[str, ...] = ("bench.servers", "grpc", "127.0.0.1", str(keys), str(TAKES_S))
    else:
        (keys / "daemon.toml").write_text(
            DAEMON.format(slots=msgspec.json.encode(slots).decode(), turn_s=TURN_S, takes_s=TAKES_S)
        )
        command = ("upwash", "serve", "--config", str(keys / "daemon.toml"))
    before = set(children(os.getpid()))
    with running((sys.executable, "-m", *command), log=keys / "servers.log") as address:
        (process,) = set(children(os.getpid())) - before
        yield process, address


def cells(row: Row) -> Sequence[object]:
    """The row as the table has it."""
    return (
        row.drones,
        "bare gRPC" if row.slots is None else f"upwash, {row.slots} slot{'s' * (row.slots != 1)}",
        f"{row.throughput_per_s:.1f}",
        f"{row.p50_s * 1e3:.0f}",
        f"{row.p99_s * 1e3:.0f}",
        row.failed,
        "" if row.slots is None else row.turned_away,
        "" if row.slots is None else row.most_leases,
        f"{row.least_calls} to {row.most_calls}",
    )


def _line(each: Iterable[object]) -> str:
    return f"| {' | '.join(map(str, each))} |"


# --- the soak -----------------------------------------------------------------------------------------------


class Held(msgspec.Struct, frozen=True, kw_only=True):
    """What the daemon and its instance held at a moment of the soak."""

    at_s: float
    memory_mb: float
    descriptors: int


class Soak(msgspec.Struct, frozen=True, kw_only=True):
    """What came of it."""

    seconds: float
    drones: int
    calls: int
    failed: int
    p50_s: float
    p99_s: float
    held: list[Held]


def soak(seconds: float, pace: Pace, *, keys: Path) -> Soak:
    """Fifteen drones, three quarters of what the service can do, that come and go."""
    seen = Seen()
    with _server(SOAK_DRONES, keys) as (process, address):
        held: list[Held] = []
        over = threading.Event()
        watching = threading.Thread(target=_watch, args=(process, held, over, pace.look_s))
        watching.start()
        try:
            fleet = _fleet(SOAK_DRONES, keys, seen, pace, visit_calls=VISIT_CALLS)
            asyncio.run(_all_at(address, fleet, seconds, bare=False))
        finally:
            over.set()
            watching.join()
    p50_s, p99_s = _middle_and_tail(seen.delays_s)
    return Soak(
        seconds=seconds,
        drones=SOAK_DRONES,
        calls=len(seen.delays_s),
        failed=seen.failed.total(),
        p50_s=p50_s,
        p99_s=p99_s,
        held=held,
    )


def _watch(process: int, held: list[Held], over: threading.Event, look_s: float) -> None:
    began_s = time.perf_counter()
    while not over.wait(look_s):
        everything = [process, *_below(process)]
        now = Held(
            at_s=time.perf_counter() - began_s,
            memory_mb=sum(map(memory_bytes, everything)) / 1e6,
            descriptors=sum(len(list(Path(f"/proc/{each}/fd").iterdir())) for each in everything),
        )
        held.append(now)
        print(f"{now.at_s:5.0f} s: {now.memory_mb:.1f} MB, {now.descriptors} descriptors", flush=True)


def _below(process: int) -> list[int]:
    return [each for child in children(process) for each in (child, *_below(child))]


# --- what is printed ----------------------------------------------------------------------------------------


def main() -> None:
    """Print the table, or the result of the soak."""
    parser = command_line("load", __doc__)
    parser.add_argument("--drones", type=int, nargs="+", default=[1, 10, 20, 50, 100, 200])
    parser.add_argument(
        "--seconds",
        type=float,
        default=20.0,
        help="for each line of the table, four times as long where drones take turns",
    )
    parser.add_argument("--soak", type=float, metavar="SECONDS", help="watch one load for so long instead")
    parser.add_argument("--out", type=Path, help="leave the figures there as JSON")
    options = parser.parse_args()
    if options.quick and options.out:
        parser.error("figures of a quick run mean nothing, and are not kept")
    pace = FULL
    if options.quick:
        pace, options.drones, options.seconds = QUICK, [QUICK_DRONES], QUICK_S
    print(machine(), flush=True)
    most = SOAK_DRONES if options.soak else max(options.drones)
    with tempfile.TemporaryDirectory(prefix="upwash-load-") as folder:
        keys = Path(folder)
        make_keys(keys, servers=[["s1"]], drones=[f"drone-{number}" for number in range(most)])
        figures: Soak | list[Row]
        if options.soak:
            figures = soak(options.soak, pace, keys=keys)
            print(
                f"{figures.calls} calls, {figures.failed} failed, p50 {figures.p50_s * 1e3:.0f} ms, "
                f"p99 {figures.p99_s * 1e3:.0f} ms"
            )
        else:
            figures = []
            print(_line(HEAD), _line(["---"] * len(HEAD)), sep="\n", flush=True)
            for drones in options.drones:
                for row in measure(drones, pace, seconds=options.seconds, keys=keys):
                    print(_line(cells(row)), flush=True)
                    figures.append(row)
    if options.out:
        leave(options.out, command=f"python -m bench.load {shlex.join(sys.argv[1:])}", figures=figures)


if __name__ == "__main__":
    main()
