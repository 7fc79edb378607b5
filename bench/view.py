"""How soon a page shows what a log says: `python -m bench.view`.

A headless Chromium on this machine shows a log with ten positions a second. First the program prints the time to open
two pages: a mission of 2,000 waypoints near its end, and a finished mission with a log of 100 MB. Each is opened
while the program reads the log, and again afterwards. `--against DIR` has another checkout serve in the same rounds.
For the first mission the program then prints two more figures: the delay from the write of a position or a call to
the frame with it, and the page's busy time. At last the program opens the page as a file, with that mission and with
30 flights. It plays the mission, which has a photo at each waypoint, and prints the time of a frame beside the time
of an empty page's frame.
"""

from __future__ import annotations

import itertools
import json
import tempfile
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from statistics import median, quantiles
from typing import Any

from bench.program import command_line, machine
from tests.system.browser import Browser, browser, why_not

from upwash.launch.processes import ready_program
from upwash.report.record import read_records
from upwash.view.file import write_page

COLUMNS, SPACING_M = 50, 20.0
PERIOD_S = 0.1
FIXES_A_WAYPOINT = 60
LIMIT_S = 0.5
FRAME_MS = 33.0
GEOMETRY: dict[str, object] = {"size_px": [1440, 1080], "lens": {"fov_deg": 62.0, "up_deg": 0.0}}
PLAY = """
const speed = document.getElementById("speed");
speed.value = "100";
speed.dispatchEvent(new Event("change"));
document.getElementById("play").click();
"""
FRAMES = """
return new Promise((done) => {
  const times = [];
  const frame = (at) => {
    times.push(at);
    if (at - times[0] < arguments[0]) requestAnimationFrame(frame);
    else done(times);
  };
  requestAnimationFrame(frame);
});
"""
ROOT = Path(__file__).parents[1]
PATIENCE_S = 300.0
DRAWN = "return new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"
WATCH = """
window.shown = {where: [], calls: []};
const watch = (selector, pattern, into) => {
  const element = document.querySelector(selector);
  let last = null;
  new MutationObserver(() => {
    const value = Number(pattern.exec(element.textContent)?.[1]);
    if (value === last) return;
    last = value;
    requestAnimationFrame(() => into.push([value, performance.timeOrigin + performance.now()]));
  }).observe(element, {childList: true, characterData: true, subtree: true});
};
watch(".where", /(\\d+)\\sm\\sup/, shown.where);
watch(".totals", /(\\d+)\\scalls/, shown.calls);
"""


@dataclass(frozen=True)
class Extent:
    """How much is measured."""

    waypoints: int
    done: int  # calls done before the page opens
    watched_s: float
    finished: int  # waypoints of a flight that is over
    flights: int  # in a file
    played_s: float


FULL = Extent(waypoints=2_000, done=1_950, watched_s=30.0, finished=14_000, flights=30, played_s=10.0)
QUICK = Extent(
    waypoints=12, done=10, watched_s=7.0, finished=20, flights=4, played_s=1.0
)  # a waypoint's call
EACH_FLIGHT = 60  # waypoints


def main() -> None:
    """Measures, and prints."""
    parser = command_line("view", __doc__)
    parser.add_argument("--against", type=Path, metavar="DIR", help="let this checkout's program serve too")
    parser.add_argument("--rounds", type=int, default=3, help="how often each page is opened")
    options = parser.parse_args()
    extent, rounds = (QUICK, 1) if options.quick else (FULL, options.rounds)
    checkouts = {"before": options.against.resolve()} if options.against else {}
    checkouts["now"] = ROOT
    if missing := why_not():
        print(f"not measured: {missing}")
        return
    with tempfile.TemporaryDirectory() as folder, browser(Path(folder) / "profile") as page:
        log, finished = Path(folder) / "events.jsonl", Path(folder) / "finished.jsonl"
        events = mission(extent.waypoints)
        before = list(itertools.takewhile(lambda event: event.get("waypoint") != extent.done, events))
        log.write_text("".join(map(line, before)))
        with finished.open("w") as file:
            file.writelines(map(line, mission(extent.finished)))
            file.write(
                line({"t": extent.finished * FIXES_A_WAYPOINT * PERIOD_S, "event": "mission_completed"})
            )
        print(machine())
        for each, calls, limit_s in (log, extent.done, 1.0), (finished, extent.finished, 5.0):
            open_in_turns(page, each, calls, checkouts, rounds=rounds, limit_s=limit_s)
        print(machine())
        with ready_program("view", log.parent, "view", str(log), "--port", "0") as address:
            watch(page, address, log, events, extent, began_s=before[-1]["t"])
        print(machine())
        open_files(page, Path(folder), extent, rounds=rounds)


def open_files(page: Browser, folder: Path, extent: Extent, *, rounds: int) -> None:
    """Opens the page as a file, of a long flight and of many, and plays the long one; prints how long that took."""
    for flights, waypoints, limit_s in (1, extent.waypoints, 1.0), (extent.flights, EACH_FLIGHT, 3.0):
        logs = [folder / f"flight-{flights}-{number}.jsonl" for number in range(flights)]
        for log in logs:
            over = {"t": waypoints * FIXES_A_WAYPOINT * PERIOD_S, "event": "mission_completed"}
            log.write_text("".join(map(line, [*mission(waypoints), over])))
        file = folder / f"flights-{flights}.html"
        file.write_bytes(b"".join(write_page(logs, read_records(logs))))
        took_s = [opened_s(page, file.as_uri(), waypoints) for _ in range(rounds)]
        print(
            f"a file of {flights} flights of {waypoints} waypoints, {file.stat().st_size / 1e6:.1f} MB: opened in "
            f"{median(took_s):.2f} s (median), {max(took_s):.2f} s (longest), limit {limit_s} s"
            f"{' MISS' * (median(took_s) > limit_s)}"
        )
    page.open((folder / "flights-1.html").as_uri())
    page.run(PLAY)
    playing = frame_ms(page, extent.played_s)
    page.open("about:blank")
    empty = frame_ms(page, extent.played_s)
    print(
        f"a frame while {extent.waypoints} photos play at 100 times: {median(playing):.1f} ms (median), "
        f"{quantiles(playing, n=20)[-1]:.1f} ms (95 %), {median(playing) / median(empty):.2f} of an empty page's "
        f"{median(empty):.1f} ms{' MISS' * (quantiles(playing, n=20)[-1] > FRAME_MS)}"
    )


def frame_ms(page: Browser, for_s: float) -> list[float]:
    """The times between the frames that the page draws in `for_s` seconds."""
    times = page.run(FRAMES, for_s * 1000)
    return [later - earlier for earlier, later in itertools.pairwise(times)]


def open_in_turns(
    page: Browser, log: Path, calls: int, checkouts: Mapping[str, Path], *, rounds: int, limit_s: float
) -> None:
    """Opens the page of the log as each checkout's program is ready, and again, and prints how long that took."""
    took_s: dict[str, tuple[list[float], list[float]]] = {name: ([], []) for name in checkouts}
    for _ in range(rounds):
        for name, checkout in checkouts.items():
            through = ["env", f"PYTHONPATH={checkout / 'src'}"]
            command = ["view", str(log), "--port", "0"]
            with ready_program("view", log.parent, *command, through=through) as address:
                for each in took_s[name]:
                    each.append(opened_s(page, address, calls))
                page.open("about:blank")
    print(f"{calls} waypoints, {log.stat().st_size / 1e6:.1f} MB, limit {limit_s} s:")
    (base, base_s), *_ = took_s.items()
    for name, both in took_s.items():
        for what, each, other in zip(("opened at once", "opened again"), both, base_s, strict=True):
            print(f"  {name}, {what}: {median(each):.2f} s (median), {max(each):.2f} s (longest)", end="")
            print(" MISS" * (median(each) > limit_s), end="")
            ratio = median(mine / its for mine, its in zip(each, other, strict=True))
            print("" if name == base else f", {ratio:.2f} of {base}")


def opened_s(page: Browser, address: str, calls: int) -> float:
    """The seconds until the page shows that number of calls."""
    began_s = time.monotonic()
    page.open(address)
    page.wait_until(lambda: f"{calls} calls" in page.text(".totals"), within_s=PATIENCE_S)
    page.run(DRAWN)
    return time.monotonic() - began_s


def watch(
    page: Browser,
    address: str,
    log: Path,
    events: Iterator[dict[str, Any]],
    extent: Extent,
    *,
    began_s: float,
) -> None:
    """Writes what comes next at its time, and compares with when the page shows it."""
    opened_s(page, address, extent.done)
    page.run(WATCH)
    worked_s = busy_s(page)
    fixes, calls = write(log, events, extent, began_s=began_s)
    time.sleep(2 * LIMIT_S)
    worked_s = busy_s(page) - worked_s
    page.wait_until(lambda: shows(page, "where", max(fixes)) and shows(page, "calls", max(calls)))
    for name, written, shown in (
        ("positions", fixes, page.run("return shown.where")),
        ("calls", calls, page.run("return shown.calls")),
    ):
        report(name, written, shown)
    print(f"the page was busy for {100 * worked_s / extent.watched_s:.0f} % of the time")


def shows(page: Browser, name: str, value: int) -> bool:
    """Whether the page has shown that value, or a later one."""
    return any(other >= value for other, _ in page.run(f"return shown.{name}"))


def write(
    log: Path, events: Iterator[dict[str, Any]], extent: Extent, *, began_s: float
) -> tuple[dict[int, float], dict[int, float]]:
    """When, in ms since 1970, each fix was written, known by its altitude, and each call, by its number."""
    fixes, calls = dict[int, float](), dict[int, float]()
    number = extent.done
    start_s = time.monotonic()
    with log.open("ab", buffering=0) as file:
        for event in events:
            if event["t"] - began_s > extent.watched_s:
                break
            time.sleep(max(0.0, start_s + event["t"] - began_s - time.monotonic()))
            file.write(line(event).encode())
            if event["event"] == "position":
                fixes[int(event["altitude_m"])] = time.time() * 1000
            elif event["event"] == "call":
                number += 1
                calls[number] = time.time() * 1000
    return fixes, calls


def report(name: str, written: dict[int, float], shown: list[tuple[int, float]]) -> None:
    """Each is shown when it, or a later one, is."""
    delays_s = []
    for value, written_ms in written.items():
        shown_ms = next((at_ms for other, at_ms in shown if other >= value), None)
        assert shown_ms is not None, f"{name}: {value} was never shown"
        delays_s.append((shown_ms - written_ms) / 1000)
    late = sum(delay_s > LIMIT_S for delay_s in delays_s)
    print(
        f"{name}: {len(delays_s)} shown after {median(delays_s):.3f} s (median), {max(delays_s):.3f} s (longest); "
        f"{late} after more than {LIMIT_S} s{' MISS' if late else ''}"
    )


def busy_s(page: Browser) -> float:
    """For how long the page has been busy."""
    page.driver.execute_cdp_cmd("Performance.enable", {})
    metrics = page.driver.execute_cdp_cmd("Performance.getMetrics", {})["metrics"]
    return float(next(metric["value"] for metric in metrics if metric["name"] == "TaskDuration"))


def mission(waypoints: int) -> Iterator[dict[str, Any]]:
    """The events of the flight; its altitude is a number that each position has for itself, in metres."""
    places = [
        (SPACING_M * (number % COLUMNS), SPACING_M * (number // COLUMNS)) for number in range(waypoints)
    ]
    ranges = {
        f"s{number}": {
            "centre": {"east_m": 250.0 * number, "north_m": 400.0, "altitude_m": 0.0},
            "radius_m": 150.0,
        }
        for number in range(4)
    }
    home = {"latitude_deg": 39.3666, "longitude_deg": 22.9507}
    yield {"t": 0.0, "event": "log_opened", "time": "2026-01-01T00:00:00+00:00"}
    yield {"t": 0.0, "event": "planned", "home": home, "waypoints_m": places, "ranges": ranges}
    yield {"t": 0.0, "event": "mission_started", "policy": "location-aware", "waypoints": waypoints}
    fix, at_s = 0, 0.0
    for waypoint, (east_m, north_m) in enumerate(places):
        yield {"t": at_s, "event": "leg", "waypoint": waypoint, "east_m": east_m, "north_m": north_m}
        for step in range(FIXES_A_WAYPOINT):
            fix, at_s = fix + 1, at_s + PERIOD_S
            back_m = SPACING_M * max(0.0, 1 - step / 40)
            yield {
                "t": at_s,
                "event": "position",
                "east_m": east_m - back_m,
                "north_m": north_m,
                "altitude_m": fix,
            }
        place = ("local", "s0", "s1", "s2")[waypoint % 4]
        here = {"east_m": east_m, "north_m": north_m, "altitude_m": float(fix)}
        yield {"t": at_s, "event": "arrived", "waypoint": waypoint, "east_m": east_m, "north_m": north_m}
        geometry = {**GEOMETRY, "position": {**here, "altitude_m": 20.0}}
        photo = {"source": "camera", "bytes": 1, "age_s": 0.0, "position": here, "geometry": geometry}
        yield {"t": at_s, "event": "photo", **photo}
        yield {
            "t": at_s, "event": "decided", "operation": "detector.process_photo[heavy]", "decision": "local",
            "why": "no server selected", "local_s": 10.0, "selected": None, "state": None, "remote_s": None,
            "check_s": None, "check_elapsed_s": None, "position": here,
        }  # fmt: skip
        yield {
            "t": at_s, "event": "call", "operation": "detector.process_photo[heavy]", "place": place,
            "decision": "server ready", "at_s": at_s, "onboard_s": 0.0, "delay_s": 1.0 + waypoint % 7,
            "waited_s": 0.0, "wait": "", "fell_back": False,
        }  # fmt: skip


def line(event: dict[str, Any]) -> str:
    """As a log has it."""
    return json.dumps(event) + "\n"


if __name__ == "__main__":
    main()
