"""The demonstration with several drones, as far as it needs no flight: lanes, lines of progress, and results."""

from __future__ import annotations

import asyncio
import io
import itertools
from collections.abc import Sequence
from pathlib import Path

import pytest
from rich.console import Console
from tests.events import event, line

from upwash.cli.demonstration import read_demonstration
from upwash.cli.demonstration_fleet import (
    DemonstratedFlight,
    fleet_of,
    followed,
    print_results,
    start_of,
    summary,
)
from upwash.cli.main import main
from upwash.config.drone import DroneConfig
from upwash.config.places import server_areas, waypoints
from upwash.core.geo import Position, ground_distance_m
from upwash.eventlog.fleet import FleetProgress
from upwash.eventlog.schema import Event
from upwash.launch.processes import INTERRUPTED

SIZES = range(2, 9)


def way(drone: DroneConfig) -> list[Position]:
    """Places every few metres of the way, from take-off back to it."""
    places = [start_of(drone), *(waypoint.position for waypoint in waypoints(drone.mission)), start_of(drone)]
    return [
        Position(
            one.east_m + step / 20 * (other.east_m - one.east_m),
            one.north_m + step / 20 * (other.north_m - one.north_m),
        )
        for one, other in itertools.pairwise(places)
        for step in range(21)
    ]


def covered(drone: DroneConfig) -> list[set[str]]:
    """The servers that reach each waypoint."""
    return [
        {server for server, area in server_areas(drone).items() if area.contains(waypoint.position)}
        for waypoint in waypoints(drone.mission)
    ]


# --- the drones -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("drones", SIZES)
def test_no_way_of_a_drone_comes_near_that_of_another(drones: int) -> None:
    ways = [way(drone) for drone in fleet_of(read_demonstration(), drones)]
    nearest_m = min(
        ground_distance_m(here, there)
        for one, other in itertools.combinations(ways, 2)
        for here, there in itertools.product(one, other)
    )
    assert nearest_m > 1.4


@pytest.mark.parametrize("drones", SIZES)
def test_each_drone_is_covered_as_the_one_of_the_plain_demonstration(drones: int) -> None:
    alone = read_demonstration()
    fleet = fleet_of(alone, drones)
    assert [drone.name for drone in fleet] == [f"drone-{number + 1}" for number in range(drones)]
    assert all(covered(drone) == covered(alone) for drone in fleet)


@pytest.mark.parametrize("number", ["0", "9", "-1", "many"])
def test_so_many_drones_are_refused(number: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["demo", "--drones", number])
    assert end.value.code == 2
    assert "--drones" in capsys.readouterr().err


# --- what is printed meanwhile ----------------------------------------------------------------------------------


def progress(drones: Sequence[str]) -> tuple[FleetProgress, io.StringIO]:
    output = io.StringIO()
    return FleetProgress(drones, ["s1"], 12, Console(file=output, width=200)), output


def test_lines_begin_with_the_drone_and_the_time_of_its_own_mission() -> None:
    shown, output = progress(["heron", "kingfisher"])
    with shown:
        shown.follow("heron", event("mission_started", 1.0, policy="look-ahead", waypoints=4))
        shown.follow("heron", event("armed", 3.0))
        shown.follow("heron", event("landed", 70.0))
        shown.follow("kingfisher", event("landed", 5.5))
        shown.say("heron", "upwash: the \x1b[31mend")
    assert output.getvalue().splitlines() == [
        "heron         [0:01]    mission started, policy look-ahead; ● drone  ■ s1",
        "heron           0:00    armed",
        "heron           1:07    landed",
        "kingfisher    [0:05]    landed",
        "heron       upwash: the \\x1b[31mend",
    ]


def test_events_of_growing_logs_are_told_once_and_a_log_that_is_none_ends_alone(tmp_path: Path) -> None:
    logs = {name: tmp_path / f"{name}.jsonl" for name in ("heron", "stork")}
    for log in logs.values():
        log.touch()
    told: list[tuple[str, float]] = []

    def take(drone: str, each: Event) -> None:
        told.append((drone, each.t))

    async def run() -> None:
        async with followed(logs, take):
            for at_s in (1.0, 2.0):
                for log in logs.values():
                    with log.open("ab") as file:
                        file.write(line("landed", at_s))
                while told.count(("stork", at_s)) == 0:  # noqa: ASYNC110 - it is told by a look
                    await asyncio.sleep(0.01)
            with logs["heron"].open("ab") as file:
                file.write(b"[]\n")
            with logs["stork"].open("ab") as file:
                file.write(line("landed", 3.0))

    asyncio.run(run())
    assert sorted(told) == [("heron", 1.0), ("heron", 2.0), ("stork", 1.0), ("stork", 2.0), ("stork", 3.0)]


# --- what it came to --------------------------------------------------------------------------------------------


def call(at_s: float, place: str, delay_s: float) -> bytes:
    return line("call", at_s, operation="detector.count", place=place, delay_s=delay_s)


def flown(log: Path, *, ended_s: float, remote_s: float) -> Path:
    """The log of a mission of two calls, the first on the drone."""
    log.write_bytes(
        line("mission_started", 0.0, policy="look-ahead", waypoints=2)
        + call(4.0, "local", 3.0)
        + call(8.0, "s1", remote_s)
        + line("mission_completed", ended_s)
    )
    return log


def test_each_drone_has_its_row_and_all_have_a_mean_and_a_worst(tmp_path: Path) -> None:
    (tmp_path / "empty.jsonl").touch()
    flights = {
        "drone-1": DemonstratedFlight.of(flown(tmp_path / "1.jsonl", ended_s=10.0, remote_s=1.0), 0),
        "drone-2": DemonstratedFlight.of(flown(tmp_path / "2.jsonl", ended_s=14.0, remote_s=2.5), 0),
        "drone-3": DemonstratedFlight.of(tmp_path / "empty.jsonl", 1),
    }
    output = io.StringIO()
    print_results(flights, ["s1", "s2"], Console(file=output, width=80))
    *_, last = lines = output.getvalue().splitlines()
    assert last == (
        "2 of 3 flights completed; mission time: mean 12.0 s, worst 14.0 s; saved: mean 1.2 s, least 0.5 s"
    )
    assert [text.split() for text in lines if text.strip().startswith("drone-")] == [
        ["drone-1", "completed", "10.0", "s", "2.0", "s", "1", "1", "0", "0", "0"],
        ["drone-2", "completed", "14.0", "s", "0.5", "s", "1", "1", "0", "0", "0"],
        ["drone-3", "exit", "code", "1"],
    ]


def test_a_flight_that_was_stopped_is_not_among_those_that_were_completed(tmp_path: Path) -> None:
    log = tmp_path / "stopped.jsonl"
    log.write_bytes(line("mission_started", 0.0, policy="look-ahead", waypoints=2) + call(4.0, "local", 3.0))
    stopped = DemonstratedFlight.of(log, INTERRUPTED)
    assert stopped.in_words == "ended early"
    assert DemonstratedFlight(INTERRUPTED, None).in_words == "did not begin"
    assert summary([stopped.result]) == "no flight was completed"
