"""Rows that the drone flies in doubt of its position, on virtual time: no spot counts where the drone is not."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace
from tests.drone.test_pending import in_the_air
from tests.drone.test_resume import fly
from tests.drone.test_resume import scenario as resumable
from tests.scenarios import scenario
from tests.surveys import transects, written

from upwash import Drone
from upwash.config.drone import DroneConfig
from upwash.config.drone_file import read_drone_config
from upwash.config.places import waypoints
from upwash.config.world import FaultConfig
from upwash.core.geo import Position
from upwash.drone.places import is_missed, nearest_on
from upwash.eventlog import schema
from upwash.lab.observer import Observation
from upwash.lab.run import Run, simulate_fleet
from upwash.services import Detector
from upwash.sim.autopilot import ModelAutopilot

# Three rows of 100 m, 20 m apart, a photo each 20 m at 4 m/s.
ROWS = [[0, 0], [100, 0], [100, 20], [0, 20], [0, 40], [100, 40]]
SIDEWAYS, ALONG, ASKEW = (0.0, 30.0, 0.0), (-40.0, 0.0, 0.0), (25.0, 25.0, 0.0)


def rows(**photos: Any) -> DroneConfig:
    """Demands at every third photo, whose answers take 6 s."""
    return scenario(
        mission={"grid": None, "waypoints_m": ROWS, "photos": {"every_m": 20.0, **photos}, "action_s": 2.0},
        event={"every": 3},
        camera={"photo_s": 0.5},
        policy={"name": "local-only"},
        service=[{"name": "detector", "local_call_s": {"light": 3.0, "heavy": 6.0}}],
    )


def flown(config: DroneConfig, *faults: FaultConfig) -> tuple[Run, list[float]]:
    """The flight, and how far truly from its place each waypoint counted."""
    seen: list[Observation] = []
    (run,) = simulate_fleet([replace(config, faults=faults)], seen=seen)
    return run, [fact.off_m for fact in seen if fact.event == "reached"]


def jump(from_s: float, lasts_s: float, moved_m: tuple[float, float, float]) -> FaultConfig:
    return FaultConfig(target="autopilot", kind="jump", from_s=from_s, to_s=from_s + lasts_s, moved_m=moved_m)


def judge(config: DroneConfig, *faults: FaultConfig) -> None:
    run, offs_m = flown(config, *faults)
    assert run.result.completed, run.failure
    assert max(offs_m) < 5.0, max(offs_m)
    assert arrived_in_doubt(run.events) == []
    counted = {event.waypoint for event in run.events if isinstance(event, schema.Arrived)}
    assert counted >= {waypoint.index for waypoint in waypoints(config.mission)}
    calls = sorted(call.waypoint for call in run.result.calls if call.waypoint is not None)
    assert calls == [waypoint.index for waypoint in waypoints(config.mission)]


def arrived_in_doubt(events: Sequence[Any]) -> list[schema.Arrived]:
    doubted, counted = False, []
    for event in events:
        if isinstance(event, schema.PositionDoubted):
            doubted = event.jumped_m > 0
        elif isinstance(event, schema.Arrived) and doubted:
            counted.append(event)
    return counted


@pytest.mark.parametrize("moved_m", [SIDEWAYS, ALONG, ASKEW])
@pytest.mark.parametrize("lasts_s", [2.0, 15.0])
@pytest.mark.parametrize("at_most", [1, 100])
def test_each_spot_has_its_photo_whenever_the_position_jumps(
    at_most: int, lasts_s: float, moved_m: tuple[float, float, float]
) -> None:
    """Before a spot, at one, at a row's end, in a brake, in a detour and in a wait."""
    config = rows(at_most=at_most)
    run, _ = flown(config)
    assert run.result.completed
    for from_s in range(15, int(run.result.mission_time_s) - 20, 13):
        judge(config, jump(float(from_s), lasts_s, moved_m))


@pytest.mark.parametrize("moved_m", [SIDEWAYS, ALONG])
def test_a_survey_with_turns_has_its_photos_too(tmp_path: Path, moved_m: tuple[float, float, float]) -> None:
    more = '[event]\nevery = 5\n[policy]\nname = "local-only"'
    config = read_drone_config(written(tmp_path, transects(), photo_s=0.1, heavy_s=1.5, more=more))
    run, _ = flown(config)
    assert run.result.completed
    for from_s in range(15, int(run.result.mission_time_s) - 20, 13):
        judge(config, jump(float(from_s), 8.0, moved_m))


@pytest.mark.parametrize("moved_m", [SIDEWAYS, ALONG])
def test_a_doubt_that_never_ends_ends_the_flight_as_at_a_stop(moved_m: tuple[float, float, float]) -> None:
    run, offs_m = flown(rows(), jump(30.0, 1e6, moved_m))
    assert "jumped" in run.failure
    (doubted,) = [event for event in run.events if isinstance(event, schema.PositionDoubted)]
    assert not [event for event in run.events if isinstance(event, schema.Arrived) and event.t > doubted.t]
    assert not [event for event in run.events if isinstance(event, schema.PhotoTaken) and event.t > doubted.t]
    assert [event.action for event in run.events if isinstance(event, schema.SafeEnd)] == ["return"]
    assert max(offs_m) < 1.0


def test_a_leg_that_ended_before_the_doubt_does_not_count_in_it() -> None:
    """A call of 10 s flies the drone on to the row's end, 2 m beyond the last spot; the position jumps meanwhile."""

    def program(drone: Drone, detector: Detector) -> None:
        for waypoint in drone.plan:
            drone.autopilot.goto(waypoint)
            detector.process_photo(drone.camera.take_photo(), mode="heavy")

    for waypoints_m in ([[0, 0], [42, 0]], [[0, 0], [40, 0]]):
        config = resumable(waypoints_m=waypoints_m, photos={"every_m": 20.0}, ground_speed_m_s=3.0)
        for from_s in range(25, 65):
            vehicle = partial(ModelAutopilot, incidents=[jump(float(from_s), 8.0, SIDEWAYS)])
            part = fly(config, mission=in_the_air(program), autopilot=vehicle)
            assert part.error is None
            assert arrived_in_doubt(part.events) == [], from_s


def test_a_spot_counts_near_the_row_only() -> None:
    start, end, spot = Position(0.0, 0.0, 20.0), Position(100.0, 0.0, 20.0), Position(40.0, 0.0, 20.0)

    def missed(east_m: float, north_m: float, altitude_m: float = 20.0, speed_m_s: float = 4.0) -> bool:
        here = Position(east_m, north_m, altitude_m)
        return is_missed(spot, here, start=start, end=end, speed_m_s=speed_m_s)

    assert not missed(40.0, 1.5)
    assert not missed(41.5, 0.0), "half a second late"
    assert missed(43.0, 0.0)
    assert missed(40.0, 5.0) and missed(40.0, 0.0, 25.0), "beside the row, above it"
    assert missed(46.0, 0.0, speed_m_s=15.0), "a fast drone is 5 m off all the same"
    assert not missed(30.0, 30.0), "it is still ahead"


def test_the_nearest_place_of_a_leg() -> None:
    start, end = Position(0.0, 0.0, 20.0), Position(100.0, 0.0, 20.0)
    assert nearest_on(start, end, Position(40.0, 30.0, 25.0)) == Position(40.0, 0.0, 20.0)
    assert nearest_on(start, end, Position(-40.0, 30.0, 20.0)) == start
    assert nearest_on(start, end, Position(140.0, 30.0, 20.0)) == end
    assert nearest_on(end, end, start) == end
