"""Many flights: a verdict, their times by policy, and the differences within the same scenario and seed."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import pytest
from tests.events import line
from tests.report.pages import heads, of_class, parsed, table_named, text

from upwash.report.groups import differences, groups_of, in_words, verdict, what_groups
from upwash.report.record import Record, read_records
from upwash.support.text import lasting


def flight(
    folder: Path,
    policy: str,
    seed: int | None,
    time_s: float,
    *,
    completed: bool = True,
    drone: str = "",
    scenario: str = "field.toml",
) -> Path:
    """A flight of so many seconds, simulated where it has a seed."""
    lines = [] if seed is None else [line("simulated", 0.0, scenario=scenario, seed=seed)]
    lines += [
        line("mission_started", 0.0, policy=policy, drone=drone, waypoints=1),
        line("arrived", 1.0, waypoint=0),
        line("mission_completed", time_s) if completed else line("mission_ended", time_s, why="Ctrl-C"),
    ]
    file = folder / f"{policy}-{drone}-{scenario.partition('.')[0]}-{seed}-{time_s:g}.jsonl"
    file.write_bytes(b"".join(lines))
    return file


def flown(folder: Path, flights: Iterable[tuple[Any, ...]]) -> list[Record]:
    return read_records([flight(folder, *facts) for facts in flights])


FAST, SLOW = [100.0, 104.0, 102.0], [120.0, 130.0, 122.0]
BOTH = [("fast", seed, time_s) for seed, time_s in enumerate(FAST)] + [
    ("slow", seed, time_s) for seed, time_s in enumerate(SLOW)
]


def test_the_mean_of_each_policy_has_its_confidence(tmp_path: Path) -> None:
    groups = groups_of(flown(tmp_path, BOTH))
    assert [(group.name, group.time_s.value) for group in groups] == [("fast", 102.0), ("slow", 124.0)]
    assert groups[0].time_s.margin == pytest.approx(4.303 * 2.0 / math.sqrt(3), rel=1e-3)  # Student's t, of 2


def test_pairs_are_of_the_same_scenario_and_seed(tmp_path: Path) -> None:
    alone = [("slow", 9, 500.0), ("fast", None, 7.0), ("slow", None, 9.0)]
    elsewhere = read_records([flight(tmp_path, "fast", 9, 100.0, scenario="elsewhere.toml")])
    (difference,) = differences([*flown(tmp_path, [*BOTH, *alone]), *elsewhere])
    assert (difference.policy, difference.reference) == ("fast", "slow")
    assert [pair.longer_s for pair in difference.pairs] == [-20.0, -26.0, -20.0]
    assert difference.longer_s.value == -22.0
    assert difference.longer_s.margin == pytest.approx(4.303 * math.sqrt(12) / math.sqrt(3), rel=1e-3)
    words = in_words(difference).replace("\u00a0", " ")
    assert words == "fast took 22.0 ± 8.6 s less than slow on average, and was faster in 3 of 3 pairs."


def test_a_difference_within_its_confidence_is_none(tmp_path: Path) -> None:
    flights = [("a", 1, 10.0), ("a", 2, 20.0), ("b", 1, 12.0), ("b", 2, 19.0)]
    (difference,) = differences(flown(tmp_path, flights))
    assert in_words(difference).startswith("Between a and b no difference shows: -0.5")


def test_drones_of_one_simulation_are_paired_with_themselves(tmp_path: Path) -> None:
    logs = [
        flight(tmp_path, policy, 1, time_s, drone=drone)
        for policy, drone, time_s in [("a", "d1", 10.0), ("a", "d2", 50.0), ("b", "d1", 13.0), ("b", "d2", 54.0)]
    ]  # fmt: skip
    (difference,) = differences(read_records(logs))
    assert [pair.longer_s for pair in difference.pairs] == [-3.0, -4.0]


def test_flights_of_one_policy_are_told_apart_by_their_drones(tmp_path: Path) -> None:
    logs = [flight(tmp_path, "a", 1, time_s, drone=drone) for drone, time_s in [("d1", 9.0), ("d2", 5.0)]]
    records = read_records(logs)
    assert what_groups(records) == "drone"
    assert [group.name for group in groups_of(records)] == ["d2", "d1"]


def test_a_flight_that_was_not_completed_is_in_no_mean(tmp_path: Path) -> None:
    records = [*flown(tmp_path, BOTH), *read_records([flight(tmp_path, "fast", 7, 3.0, completed=False)])]
    assert groups_of(records)[0].time_s.count == 3
    assert verdict(records).replace("\u00a0", " ") == (
        "7 flights, 6 completed; the mission took on average 1:42 ± 5.0 s with fast, 2:04 ± 13.1 s with slow."
    )
    assert verdict(records[-1:]) == "1 flight, 0 completed."


def test_equal_missions_have_no_confidence(tmp_path: Path) -> None:
    equal = flown(tmp_path, [("a", seed, 10.0) for seed in range(3)])
    assert verdict(equal) == "3 flights, all completed; the mission took on average 10.0 s with a."


def logs_of(folder: Path, flights: Sequence[tuple[str, int, float]]) -> list[Path]:
    return [flight(folder, *facts) for facts in flights]


def test_from_four_flights_on_the_page_has_a_summary(tmp_path: Path) -> None:
    logs = logs_of(tmp_path, BOTH)
    few, many = parsed(*logs[:3]), parsed(*logs)
    assert "All flights" not in heads(few)
    assert [head for head in heads(many) if head not in heads(few)][:2] == [
        "Mission time by policy", "Differences within the same scenario and seed",
    ]  # fmt: skip
    rows = table_named(many, "Flights")
    assert [row[1:3] for row in rows[1:]] == [[policy, lasting(time_s)] for policy, _, time_s in BOTH]
    assert len(of_class(many, "dot")) == 6 + 3, "a dot a flight, and a dot a pair"


def test_of_many_flights_those_that_ended_ill_come_first(tmp_path: Path) -> None:
    logs = [*logs_of(tmp_path, BOTH), flight(tmp_path, "fast", 7, 3.0, completed=False)]
    page = parsed(*logs)
    block = of_class(page, "urgent")[0]
    assert "In 1 flight a person had to act" in text(block)
    assert "fast--field-7-3: At 0:03: The mission ended early: Ctrl-C." in text(block)
    assert list(page.iter()).index(block) < list(page.iter()).index(of_class(page, "lead")[0])


def test_flights_of_which_none_was_completed_have_a_page(tmp_path: Path) -> None:
    page = parsed(*[flight(tmp_path, "a", seed, 5.0, completed=False) for seed in range(4)])
    assert "4 flights, 0 completed." in text(page)
    assert "Mission time by policy" not in heads(page)
