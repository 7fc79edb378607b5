"""What the card of a call says of other policies: of flights on the page, or flown in a world that is given."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import msgspec
import pytest
from tests.events import line

from upwash import simulate
from upwash.view.feed import Feed
from upwash.view.recording import reading

CALL = {"operation": "detector.count", "at_s": 2.0, "delay_s": 1.0}


def flight(file: Path, policy: str, **unlike: Any) -> Path:
    """The log of a mission with two calls, `unlike` others in its world, plan, drone or calls."""
    way = unlike.get("way_m", [[0, 0], [20, 0]])
    calls = unlike.get("calls", 2)
    events = [
        line("simulated", 0.0, scenario="field.toml", seed=unlike.get("seed", 1)),
        line("planned", 0.0, waypoints_m=way),
        line("mission_started", 0.0, policy=policy, waypoints=2, drone=unlike.get("drone", "")),
    ]
    for number in range(calls):
        events.append(line("arrived", 1.0 + 5 * number, waypoint=number))
        events.append(line("call", 3.0 + 5 * number, place="local", **CALL))
    file.write_bytes(b"".join([*events, line("mission_completed", 20.0)]))
    return file


def told(*logs: Path, **more: Any) -> dict[str, list[dict[str, Any]]]:
    """What the page is told of other policies, by the number of the log."""
    with reading(logs, lambda _: False) as recordings:
        messages = json.loads(msgspec.json.encode(list(Feed(recordings, **more).everything())))
    return dict(messages)["elsewhere"]  # type: ignore[no-any-return]


def test_flights_of_other_policies_in_the_same_world_are_named(tmp_path: Path) -> None:
    policies = ("look-ahead", "local-only", "local-only")
    logs = [flight(tmp_path / f"{number}.jsonl", policy) for number, policy in enumerate(policies)]
    ours, theirs = [{"policy": "local-only", "log": 2}], [{"policy": "look-ahead", "log": 0}]
    assert told(*logs) == {"0": ours, "1": theirs, "2": theirs}, "the last of each policy"


@pytest.mark.parametrize(
    "unlike",
    [{"seed": 2}, {"way_m": [[0, 0], [30, 0]]}, {"calls": 1}, {"drone": "d2"}],
    ids=["seed", "plan", "calls", "drone"],
)
def test_nothing_is_said_of_flights_that_are_no_comparison(tmp_path: Path, unlike: dict[str, Any]) -> None:
    one = flight(tmp_path / "1.jsonl", "look-ahead", drone="d1")
    other = flight(tmp_path / "2.jsonl", "local-only", **{"drone": "d1", **unlike})
    assert told(one, other) == {}


def test_what_is_flown_in_the_world_of_the_log_is_told_call_by_call(tmp_path: Path) -> None:
    world = {
        "mission": {"grid": {"columns": 3, "rows": 1, "spacing_m": 20.0}},
        "service": [{"name": "detector", "local_call_s": {"light": 3.0, "heavy": 10.0}}],
    }
    ours, theirs = simulate(world, policy="look-ahead"), simulate(world, policy="local-only")
    log = tmp_path / "log.jsonl"
    log.write_bytes(b"".join(msgspec.json.encode(event) + b"\n" for event in ours.events))
    flown = {"look-ahead": ours, "local-only": theirs, "opportunistic": simulate({**world, "mission": {
        "waypoints_m": [[0, 0]]}}, policy="opportunistic")}  # fmt: skip
    assert told(log, flown=flown) == {
        "0": [{"policy": "local-only", "calls": [[call.place, call.delay_s] for call in theirs.calls]}]
    }
