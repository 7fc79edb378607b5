"""Logs of the moments in which a pilot looks at the page: the demonstration up to then, and what comes next."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from bench.view import mission
from tests.programs import ROOT

Event = dict[str, Any]
SCENARIOS = ROOT / "scenarios"
FLYING = {"mode": "GUIDED", "armed": True, "gps": "3d", "satellites": 12, "ground_speed_m_s": 0.0}
RESERVE = "24 % is left in the battery, less than the reserve of 25 %"
SERVERS = 10
UNTIL_SILENT_S = 60.0
SILENT_S = 20.0
DEADLINE_S = 3.9


def write(folder: Path, name: str) -> list[Path]:
    """The log of that moment, in the folder."""
    log = folder / "demonstration.jsonl"
    command = [sys.executable, "-m", "upwash", "simulate", str(SCENARIOS / "demonstration.toml")]
    subprocess.run([*command, "--log", str(log)], check=True, capture_output=True)
    told = [json.loads(line) for line in log.read_text().splitlines()]
    events = MOMENTS[name](told)
    last_s = -SILENT_S if MOMENTS[name] is no_news else UNTIL_SILENT_S  # from now on: the flight goes on
    opened = datetime.now(UTC) + timedelta(seconds=last_s - events[-1]["t"])
    return [written(folder / f"{name}.jsonl", [event("log_opened", 0.0, time=opened.isoformat()), *events])]


def written(log: Path, events: Iterable[Mapping[str, Any]]) -> Path:
    """The log with these events."""
    log.write_text("".join(f"{json.dumps(event)}\n" for event in events))
    return log


def event(kind: str, t: float, **facts: object) -> Event:
    """An event of a log."""
    return {"event": kind, "t": t, **facts}


def before_arming(told: list[Event]) -> list[Event]:
    """The vehicle refuses to be armed, and says why."""
    begun = [each for each in told if each["t"] == 0.0 and each["event"] in {"planned", "mission_started"}]
    here = {"east_m": 0.0, "north_m": 0.0, "altitude_m": 0.0, "battery_percent": 99.0}
    standing = {"mode": "STABILIZE", "armed": False, "gps": "2d", "satellites": 4}
    return [
        *begun,
        event("vehicle_said", 1.0, severity=2, text="PreArm: Compass not healthy"),
        event("arming_delayed", 1.1, reasons=["PreArm: Compass not healthy", "PreArm: GPS 1: Bad fix"]),
        *(event("position", 2.0 + second, **here, **standing) for second in range(20)),
    ]


def in_a_call(told: list[Event]) -> list[Event]:
    """A server's answer is late, and the drone computes beside it."""
    before, at_s, server = _sent(told)
    return [
        *before,
        event("hedged", at_s + 2.0, server=server, check=1, after_s=2.0, deadline_s=DEADLINE_S),
        _position(before, at_s + 3.1),
    ]


def no_news(told: list[Event]) -> list[Event]:
    """The program has told nothing for a while."""
    return in_a_call(told)


def call_in_trouble(told: list[Event]) -> list[Event]:
    """The server has not answered, and the drone computes alone."""
    before, at_s, server = _sent(told)
    step = {"before": "READY", "after": "BLACKLISTED", "why": "no answer in 3.9 s", "check": 1}
    return [
        *in_a_call(told),
        event("remote_failed", at_s + 3.9, server=server, check=1, why=f"{server}: no answer in 3.9 s"),
        event("call_failed_in_range", at_s + 3.9, server=server, **step),
        _position(before, at_s + 5.3),
    ]


def server_failing(told: list[Event]) -> list[Event]:
    """The drone flies on without the server."""
    before, at_s, _ = _sent(told)
    call = next(each for each in told if each["event"] == "call")
    fell_back = {"place": "local", "delay_s": 9.0, "waited_s": 0.0, "wait": "", "fell_back": True}
    return [
        *call_in_trouble(told),
        {**call, **fell_back, "t": at_s + 9.0},
        _position(before, at_s + 11.0, battery_percent=61.0),
    ]


def taken_over(told: list[Event]) -> list[Event]:
    """The pilot has the vehicle, and the vehicle repeats a warning."""
    flying, at_s = _flown_on(told)
    why = "the vehicle is in mode LOITER (the remote control moved), GUIDED was commanded"
    return [
        *flying,
        event("control", at_s, owner="pilot", why=why),
        event("left_to_pilot", at_s + 0.1, why=f"the pilot has the vehicle: {why}"),
        *(event("vehicle_said", at_s + 1 + second, severity=4, text="GPS Glitch") for second in range(4)),
        _position(
            flying, at_s + 20.0, mode="LOITER", altitude_m=19.2, battery_percent=44.0, ground_speed_m_s=1.2
        ),
    ]


def low_battery(told: list[Event]) -> list[Event]:
    """The reserve has ended the mission, and the drone returns."""
    flying, at_s = _flown_on(told)
    return [
        *flying,
        event("stopping", at_s, why=RESERVE),
        event("safe_end", at_s + 0.1, action="return", why=RESERVE),
        _position(flying, at_s + 5.0, mode="RTL", altitude_m=15.0, battery_percent=19.0, down_s=47.0),
    ]


def fail_safe(told: list[Event]) -> list[Event]:
    """The vehicle's own fail-safe lands it."""
    flying, at_s = _flown_on(told)
    return [
        *flying,
        event("vehicle_said", at_s, severity=2, text="Battery 1 is critical 9.9V used 4900 mAh"),
        event(
            "control", at_s + 0.2, owner="fail-safe", why="the vehicle is in mode LAND (its battery is low)"
        ),
        _position(flying, at_s + 5.0, mode="LAND", altitude_m=13.0, battery_percent=8.0),
    ]


def returning(told: list[Event]) -> list[Event]:
    """The mission is done, and the drone flies home."""
    return _after(told, 5.0, mode="RTL", altitude_m=12.0, down_s=12.0)


def landing(told: list[Event]) -> list[Event]:
    """The drone comes down at home."""
    at_home = {"east_m": 0.0, "north_m": 0.0, "altitude_m": 4.0}
    return [*returning(told), *_after(told, 14.0, mode="RTL", down_s=3.0, **at_home)[-1:]]


def landed(told: list[Event]) -> list[Event]:
    """The flight is over."""
    return told


MOMENTS: Mapping[str, Callable[[list[Event]], list[Event]]] = {
    moment.__name__.replace("_", "-"): moment
    for moment in (
        before_arming, in_a_call, no_news, call_in_trouble, server_failing, taken_over, low_battery, fail_safe,
        returning, landing, landed,
    )
}  # fmt: skip


def long_flight(folder: Path) -> list[Path]:
    """A mission of 2,000 waypoints, with a photo at each."""
    told = (each for each in mission(2_000) if each["event"] != "decided")
    log = written(folder / "long.jsonl", [*told, event("mission_completed", 12_000.0)])
    log.write_text(re.sub(r'("altitude_m": )[\d.]+', r"\g<1>20.0", log.read_text()))
    return [log]


def ten_servers(folder: Path) -> list[Path]:
    """The thesis's field with ten servers along its rows."""
    field, first, _ = (SCENARIOS / "thesis.toml").read_text().partition("[[server]]")
    server = (first + _).split("[[server]]")[1].split("\n[[")[0]
    servers = [
        server.replace('"s1"', f'"s{number}"')
        .replace("east_m = 70.0", f"east_m = {20.0 * number}")
        .replace("range_m = 100.0", "range_m = 45.0")
        for number in range(1, 1 + SERVERS)
    ]
    (folder / "ten.toml").write_text("\n[[server]]".join([field, *servers]))
    command = [sys.executable, "-m", "upwash", "simulate", str(folder / "ten.toml")]
    subprocess.run([*command, "--log", str(folder / "ten.jsonl")], check=True, capture_output=True)
    return [folder / "ten.jsonl"]


def _sent(told: list[Event]) -> tuple[list[Event], float, str]:
    """What came before a server answers, when the call was sent, and to which server."""
    sent = next(
        number
        for number, each in enumerate(told)
        if each["event"] == "decided" and each["decision"] == "remote"
    )
    return [*told[:sent], {**told[sent], "deadline_s": DEADLINE_S}], told[sent]["t"], told[sent]["server"]


def _flown_on(told: list[Event]) -> tuple[list[Event], float]:
    flying = server_failing(told)
    return flying, flying[-1]["t"] + 1.0


def _after(told: list[Event], seconds: float, **facts: object) -> list[Event]:
    back = next(number for number, each in enumerate(told) if each["event"] == "returning")
    return [*told[: back + 1], _position(told[: back + 1], told[back]["t"] + seconds, **facts)]


def _position(before: list[Event], t: float, **facts: object) -> Event:
    arrived = next(each for each in reversed(before) if "east_m" in each)
    here = {
        "east_m": arrived["east_m"],
        "north_m": arrived["north_m"],
        "altitude_m": 10.0,
        "battery_percent": 78.0,
    }
    return event("position", t, **{**here, **FLYING, **facts})
