"""Measures what smaller photos gain and lose: `python -m bench.less_to_send`, as root. See docs/calls.md.

Three tables, for photos of rendered solar parks of 0.4, 2 and 10 MB: bytes and AP50 by setting; real calls of the
detector over an emulated link; and missions in simulation, with and without, on the same seeds. The missions take
the bytes and the time of the part that are measured before them, and print both.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import statistics
import sys
import tempfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import msgspec
from bench.links.drone import session_with
from bench.links.visit import make_ends, visit
from bench.links.wan import Shape, wan
from bench.program import command_line, machine

from upwash import simulate
from upwash.drone.before_sending import BeforeSending, RunningPart
from upwash.drone.onboard import OnboardServices
from upwash.emulation.enclosure import require_root_and_tools, run_enclosed
from upwash.eventlog.schema import Event
from upwash.ports import InstanceSpec, Program
from upwash.profiling.agreement import LabelledBox, mean_ap50
from upwash.real.instances.runtime import OwnProcesses
from upwash.rpc.service import spec_of
from upwash.services import Detector, Shrink
from upwash.services.photo import shrunk
from upwash.services.solar_park import RenderedPhoto, render_photo
from upwash.services.solar_park import photo as camera
from upwash.support.background import beside

RATES_BIT_S = {"54 Mbit/s": 54e6, "12 Mbit/s": 12e6, "4 Mbit/s": 4e6}
SIZES = {"0.4 MB": (1440, 1080, 425_000), "2 MB": (3200, 2400, 2_000_000), "10 MB": (5600, 4200, 10_000_000)}
PHOTOS = {"0.4 MB": 40, "2 MB": 8, "10 MB": 4}  # that are judged
SETTINGS: dict[str, tuple[int, int] | None] = {
    "whole": None,
    "1080 px, 85": (1080, 85),
    "720 px, 85": (720, 85),
    "608 px, 80": (608, 80),
}
FIRST_SEED = 9_000
LONGEST_S = 120.0
MOST_BYTES = 32 * 2**20


def main() -> int:
    """Prints the tables; 1 where the enclosed program failed."""
    options = _options()
    if options.drone:
        return asyncio.run(_call(*options.drone))
    if options.enclosed:
        return _measure(options)
    require_root_and_tools()
    print(f"{machine()}\n", flush=True)
    if options.part in (None, "answers"):
        _answers(quick=options.quick)
    if options.part in (None, "calls") and run_enclosed(
        "-m", "bench.less_to_send", "--enclosed", *sys.argv[1:]
    ):
        return 1
    if options.part in (None, "missions"):
        _missions(seeds=2 if options.quick else 5, calls=1 if options.quick else options.calls)
    return 0


def _options() -> argparse.Namespace:
    parser = command_line("less_to_send", __doc__)
    parser.add_argument("--calls", type=int, default=3)
    parser.add_argument("--part", choices=("answers", "calls", "missions"), help="only that table")
    parser.add_argument("--enclosed", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--drone", nargs=4, help=argparse.SUPPRESS)
    return parser.parse_args()


# --- bytes and answers --------------------------------------------------------------------------------------


def _answers(*, quick: bool) -> None:
    print("heavy mode\n\n| photo | photos | setting | bytes | AP50 |\n|---|---|---|---|---|")
    for size in list(SIZES)[:1] if quick else SIZES:
        count = 2 if quick else PHOTOS[size]
        for row in _scores(size, count):
            print(f"| {size} | {count} | {' | '.join(row)} |", flush=True)
    print()


@cache
def photographed(size: str, seed: int) -> RenderedPhoto:
    """A photo of that size; the ground is that of the same seed at every size."""
    wide, high, target = SIZES[size]
    camera.WIDTH_PX, camera.HEIGHT_PX = wide, high
    camera._TARGET_BYTES, camera._CLOSE_BYTES = target, target // 25
    return render_photo(seed)


def _scores(size: str, count: int) -> Iterator[tuple[str, ...]]:
    detector = Detector()
    photos = [photographed(size, FIRST_SEED + number) for number in range(count)]
    truth = [
        [msgspec.convert(box, LabelledBox, from_attributes=True) for box in photo.truth] for photo in photos
    ]
    for name, setting in SETTINGS.items():
        sent = [_made(photo.jpeg, setting) for photo in photos]
        answers: list[object] = [detector.process_photo(photo, confidence=0.01) for photo in sent]
        mean_bytes = statistics.fmean(map(len, sent))
        yield name, f"{mean_bytes / 1000:,.0f} kB", f"{mean_ap50(answers, truth):.3f}"


def _made(photo: bytes, setting: tuple[int, int] | None) -> bytes:
    return photo if setting is None else shrunk(photo, *setting)


# --- calls --------------------------------------------------------------------------------------------------


def _measure(options: argparse.Namespace) -> int:
    calls = 1 if options.quick else options.calls
    sizes = list(SIZES)[:1] if options.quick else list(SIZES)
    make_ends()
    print(f"medians of {calls} calls of the detector, heavy mode, part included; {machine()}\n")
    print("| photo | link |", " | ".join(SETTINGS), "| the part takes |")
    print("|---" * (3 + len(SETTINGS)) + "|", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        for size in sizes:
            Path(folder, f"{size}.jpg").write_bytes(photographed(size, FIRST_SEED).jpeg)
        for rate, rate_bit_s in list(RATES_BIT_S.items())[: 1 if options.quick else 3]:
            with wan(Shape(round_trip_s=0.01, rate_bit_s=rate_bit_s)):
                said = visit(
                    *("bench.less_to_send", "--drone", folder, ",".join(sizes), str(calls)),
                    service="detector",
                    program="upwash.services:Detector",
                )
                for size, delays_s in json.loads(said).items():
                    cells = [f"{statistics.median(delays_s[name]):.2f} s" for name in SETTINGS]
                    parts = statistics.median(delays_s["part"])
                    print(f"| {size} | {rate} | {' | '.join(cells)} | {parts:.3f} s |", flush=True)
    print()
    return 0


class _Silence:
    def record(self, event: Event) -> None:
        """Nothing."""


async def _call(folder: str, sizes: str, calls: str, keys: str) -> int:
    """The drone's end: calls the server in turns of all settings, and prints the delays as JSON."""
    now_s, session = asyncio.get_running_loop().time, session_with(keys, "detector")
    method = spec_of(Detector).methods["process_photo"]
    parts = {name: _part(setting) for name, setting in SETTINGS.items() if setting is not None}
    for part in parts.values():
        await part.start()
    await session.ask()
    if not session.running:
        await session.start(timeout_s=60.0)
    found: dict[str, dict[str, list[float]]] = {}
    photos = {size: _read(folder, size) for size in sizes.split(",")}
    async with beside(session.keep_lease(), name="the lease"):
        for size, photo in photos.items():
            _, whole = method.encode((photo,), {})
            delays_s = found[size] = {name: [] for name in (*SETTINGS, "part")}
            for number in range(int(calls) + 1):
                for name in SETTINGS:
                    began_s, request = now_s(), whole
                    if name in parts:
                        request = await parts[name].reduce("detector", method, whole, deadline_s=LONGEST_S)
                    part_s = now_s() - began_s
                    await session.call("detector", "process_photo", request, deadline_s=LONGEST_S)
                    if number:  # the first turn warms up
                        delays_s[name].append(now_s() - began_s)
                        delays_s["part"] += [part_s] if name == "720 px, 85" else []
    await session.end(in_range=True)
    for part in parts.values():
        await part.close()
    print(json.dumps(found))
    return 0


def _read(folder: str, size: str) -> bytes:
    return Path(folder, f"{size}.jpg").read_bytes()


def _part(setting: tuple[int, int]) -> BeforeSending:
    own, journal, (px, quality) = OwnProcesses("drone", max_message_bytes=MOST_BYTES), _Silence(), setting
    program = Program("upwash.services:Shrink", {"px": px, "quality": quality})
    onboard = OnboardServices(
        [InstanceSpec("drone", spec_of(Shrink).name, program)],
        start_timeout_s=60.0,
        runtime=own,
        dialer=own,
        journal=journal,
    )
    return BeforeSending({"detector": RunningPart(spec_of(Shrink).name, LONGEST_S, onboard)}, journal)


# --- missions -----------------------------------------------------------------------------------------------

SIMULATED = {  # the photo, and the part's setting
    "0.4 MB, at 720 px": ("0.4 MB", (720, 85)),
    "10 MB, at 720 px": ("10 MB", (720, 85)),
    "10 MB, as 1 MB": ("10 MB", (2600, 85)),
}


class Made(NamedTuple):
    """What the part makes of a photo: the bytes of both, and the part's time here."""

    whole_bytes: int
    less_bytes: int
    takes_s: float


async def measured(size: str, setting: tuple[int, int], *, calls: int) -> Made:
    """The medians over `calls` calls of the running part, after a first call that warms the part up."""
    now_s, part = asyncio.get_running_loop().time, _part(setting)
    method, photo = spec_of(Detector).methods["process_photo"], photographed(size, FIRST_SEED).jpeg
    _, whole = method.encode((photo,), {})
    await part.start()
    took_s = []
    for _ in range(calls + 1):
        began_s = now_s()
        less = await part.reduce("detector", method, whole, deadline_s=LONGEST_S)
        took_s.append(now_s() - began_s)
    await part.close()
    return Made(len(whole), len(less), statistics.median(took_s[1:]))


def scenario(rate_bit_s: float, made: Made, most_loss: float) -> dict[str, object]:
    """The thesis's heavy mission over links of that goodput."""
    servers = [
        {
            "name": name,
            "east_m": east_m,
            "north_m": north_m,
            "range_m": 100.0,
            "bandwidth_bit_s": rate_bit_s,
            "processing_s": {"light": 0.1, "heavy": 0.6},
        }
        for name, east_m, north_m in (("s1", 70.0, 110.0), ("s2", 130.0, 90.0))
    ]
    detector = {
        "name": "detector",
        "request_bytes": made.whole_bytes,
        "local_call_s": {"light": 3.0, "heavy": 10.0},
        "before_sending": {"takes_s": made.takes_s, "request_bytes": made.less_bytes, "loss": 0.01},
    }
    return {
        "mission": {"mode": "heavy", "grid": {"columns": 11, "rows": 11, "spacing_m": 20.0}},
        "service": [detector],
        "server": servers,
        "policy": {"most_loss": most_loss},
        "noise": {"call": 0.1, "leg": 0.05, "join": 0.1, "start": 0.1},
    }


def _missions(*, seeds: int, calls: int) -> None:
    print(
        f"missions in simulation, {seeds} pairs of the same seed: time without, and saved (least to most); the time\n"
        f"of the part is the median of {calls} calls; {machine()}\n"
    )
    print("| photo | the part |", " | ".join(RATES_BIT_S), "|\n|---|---" + "|---" * len(RATES_BIT_S) + "|")
    for what, (size, setting) in SIMULATED.items():
        made = asyncio.run(measured(size, setting, calls=calls))
        cells = [
            f"{made.whole_bytes / 1000:,.0f} kB to {made.less_bytes / 1000:,.0f} kB in {made.takes_s:.3f} s"
        ]
        for rate_bit_s in RATES_BIT_S.values():
            without, saved = [], []
            for seed in range(1, seeds + 1):
                times_s = [
                    simulate(scenario(rate_bit_s, made, most_loss), seed=seed).mission_time_s
                    for most_loss in (0.0, 0.02)
                ]
                without.append(times_s[0])
                saved.append(100 * (1 - times_s[1] / times_s[0]))
            low, high = min(saved), max(saved)
            mean_s, mean = statistics.fmean(without), statistics.fmean(saved)
            cells.append(f"{mean_s:.0f} s, {mean:.1f} % ({low:.1f} to {high:.1f})")
        print(f"| {what} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    sys.exit(main())
