"""When flights turn back for their battery: by the time that the way home takes, on virtual time."""

from __future__ import annotations

import asyncio
import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.drone.test_safe_ends import ACTIONS, Scene, assert_ended_in, fly, scenario
from tests.events import written

from upwash.config.drone import DroneConfig, SafeEnd
from upwash.config.drone_file import drone_config
from upwash.core.geo import Position, Velocity
from upwash.core.vehicle.way_home import STILL, EnergyFacts, time_home_s
from upwash.errors import MissionStopped, ReserveReached
from upwash.eventlog.schema import Event
from upwash.lab.run import Run, simulate
from upwash.sim.autopilot import ModelAutopilot
from upwash.vehicle.ardupilot import airframe as arducopter
from upwash.vehicle.body.kinematics import Phase, duration_s

FAR = [[0, 0], [400, 0], [800, 0], [1200, 0], [1600, 0]]


def survey_far(
    *, reserve_s: float, endurance_s: float, speed_m_s: float = 8.0, waypoints: list[list[int]] = FAR
) -> DroneConfig:
    """A survey that an ArduCopter flies away from home."""
    document = {
        "mission": {"waypoints_m": waypoints, "ground_speed_m_s": speed_m_s, "reserve_s": reserve_s},
        "vehicle": {"profile": "arducopter", "endurance_s": endurance_s},
        "service": [{"name": "detector", "local_call_s": {"light": 3.0, "heavy": 10.0}}],
    }
    return drone_config(document, Path("scenario.toml"))


def named(events: Sequence[Event], name: str) -> list[dict[str, Any]]:
    return [event for event in written(events) if event["event"] == name]


def left_at_landing_s(run: Run, endurance_s: float) -> float:
    """Seconds of flight that were left; the simulated battery empties from the command to take off on."""
    flown_s: float = named(run.events, "landed")[0]["t"] - named(run.events, "armed")[0]["t"]
    return endurance_s - flown_s


@pytest.mark.parametrize("speed_m_s", [4.0, 8.0])
@pytest.mark.parametrize("reserve_s", [0.0, 60.0, 120.0])
def test_a_flight_turns_back_in_time_to_land_with_the_reserve(reserve_s: float, speed_m_s: float) -> None:
    run = simulate(survey_far(reserve_s=reserve_s, endurance_s=300.0, speed_m_s=speed_m_s))
    assert "to home need" in run.failure
    left_s = left_at_landing_s(run, 300.0)
    assert reserve_s <= left_s <= 1.1 * reserve_s + 25.0, "and not much sooner than it had to"


@settings(max_examples=25)
@given(
    reserve_s=st.floats(0, 150),
    endurance_s=st.floats(200, 900),
    speed_m_s=st.floats(2, 12),
    spacing_m=st.integers(50, 600),
)
def test_whatever_the_field_no_simulated_flight_lands_with_less(
    reserve_s: float, endurance_s: float, speed_m_s: float, spacing_m: int
) -> None:
    waypoints = [[number * spacing_m, 0] for number in range(12)]
    run = simulate(
        survey_far(reserve_s=reserve_s, endurance_s=endurance_s, speed_m_s=speed_m_s, waypoints=waypoints)
    )
    assert left_at_landing_s(run, endurance_s) >= reserve_s


def test_a_battery_that_lasts_ends_nothing() -> None:
    run = simulate(survey_far(reserve_s=60.0, endurance_s=3000.0))
    assert run.failure == ""


def with_second_battery(**fault: float) -> DroneConfig:
    document = {
        "mission": {"waypoints_m": FAR, "ground_speed_m_s": 8.0, "reserve_s": 60.0},
        "vehicle": {"profile": "arducopter", "endurance_s": 3000.0},
        "service": [{"name": "detector", "local_call_s": {"light": 3.0, "heavy": 10.0}}],
        "fault": [{"target": "autopilot", "kind": "battery", **fault}],
    }
    return drone_config(document, Path("scenario.toml"))


def test_a_second_battery_that_drains_faster_ends_the_flight() -> None:
    run = simulate(with_second_battery(lasts_s=300.0))
    assert "to home need" in run.failure and run.failure.endswith("in battery 2")
    assert 60.0 <= left_at_landing_s(run, 300.0) <= 100.0
    assert {event["battery"] for event in named(run.events, "energy")} == {2}


def test_a_battery_that_falls_silent_is_counted_on_and_named() -> None:
    run = simulate(with_second_battery(lasts_s=300.0, to_s=90.0))
    assert run.failure.endswith("in battery 2")
    assert 50.0 <= left_at_landing_s(run, 300.0) <= 110.0
    (named_once,) = named(run.events, "battery_watch_failed")
    assert named_once["why"] == "the vehicle does not report the charge of its battery 2"


@given(
    start=st.builds(Position, st.floats(-800, 800), st.floats(-800, 800), st.floats(5, 80)),
)
def test_the_simulated_arducopter_returns_no_slower_than_it_says(start: Position) -> None:
    home = Position(0.0, 0.0)
    flown_s = duration_s(arducopter.return_and_land(start, home))
    assert flown_s <= time_home_s(start, home, arducopter.returning) <= 1.25 * flown_s


def test_the_margin_is_told_when_it_is_known_when_it_changes_and_each_minute() -> None:
    run = simulate(survey_far(reserve_s=60.0, endurance_s=400.0))
    armed_s, stopped_s = named(run.events, "armed")[0]["t"], named(run.events, "stopping")[0]["t"]
    told = [event for event in named(run.events, "energy") if event["t"] <= stopped_s]
    assert told[0]["t"] <= armed_s + 1.0, "the configured endurance is known from the start"
    for before, after in itertools.pairwise(told[:-1]):
        assert (
            abs(after["margin_percent"] - before["margin_percent"]) > 2.9 or after["t"] - before["t"] >= 60.0
        )
        assert abs(after["margin_percent"] - before["margin_percent"]) < 5.0, "it is told soon"
    last = told[-1]
    assert last["margin_percent"] <= 0 and last["t"] == stopped_s
    assert last["needed_percent"] == pytest.approx(last["home_s"] * last["rate_percent_s"], abs=0.1)
    assert last["floor_percent"] == pytest.approx(60.0 * last["rate_percent_s"], abs=0.1)


@pytest.mark.parametrize("action", ACTIONS)
def test_it_ends_in_the_configured_action(action: SafeEnd) -> None:
    config = scenario(
        mission={"reserve_s": 20.0}, vehicle={"endurance_s": 90.0}, autopilot={"on_failure": action}
    )
    scene, error = fly(config)
    assert isinstance(error, MissionStopped)
    assert "s to home need" in str(error) and "20 s of reserve 22 %" in str(error)
    assert_ended_in(action, scene)


class Windy(ModelAutopilot):
    """An ArduCopter in a wind that blows away from home; it reports a whole percent, as real ones do."""

    blows_m_s = 6.0
    says_so = True

    def __init__(self, *arguments: Any, **keywords: Any) -> None:
        super().__init__(*arguments, **{**keywords, "manner": arducopter, "endurance_s": 300.0})

    @property
    def battery_percent(self) -> float | None:
        percent = super().battery_percent
        return None if percent is None else float(math.floor(percent))

    @property
    def wind(self) -> Velocity | None:
        return Velocity(self.blows_m_s) if self.says_so else None

    async def return_home_and_land(self) -> None:
        here, home = self.position, Position(0.0, 0.0)
        parts = arducopter.way_home(
            here, STILL, home, ground_speed_m_s=10.0 - self.blows_m_s, altitude_m=15.0
        )
        way = [part for part in parts if isinstance(part, Phase)]  # from rest all are straight
        await self._move("return", (*way, *arducopter.landing(way[-1].end)), end=home)


def turned_back(kind: type[ModelAutopilot], **mission: Any) -> tuple[Scene, float]:
    """The flight, and what was left in the battery at touchdown, in percent."""
    config = scenario(mission={"reserve_s": 60.0, "waypoints_m": FAR, "ground_speed_m_s": 8.0, **mission})
    scene, error = fly(config, autopilot=kind)
    assert isinstance(error, MissionStopped)
    armed_s = scene.events("armed")[0]["t"]
    return scene, 100.0 - (scene.events("landed")[0]["t"] - armed_s) / 3.0


def test_a_flight_against_the_wind_on_the_way_home_turns_back_sooner_and_lands_with_the_reserve() -> None:
    class Calm(Windy):
        blows_m_s = 0.0

    calm, calm_left_percent = turned_back(Calm)
    windy, windy_left_percent = turned_back(Windy)
    assert windy.events("stopping")[0]["t"] < calm.events("stopping")[0]["t"] - 10.0
    for left_percent in (calm_left_percent, windy_left_percent):
        assert left_percent >= 100 * 60 / 300, "nothing told it the endurance: it was measured"


def test_the_vehicles_own_low_battery_stage_is_kept_clear_of() -> None:
    class Staged(Windy):
        @property
        def energy(self) -> EnergyFacts:
            return EnergyFacts(low_percent=35.0, way_home=arducopter.returning)

    scene, left_percent = turned_back(Staged)
    assert left_percent >= 35.0
    assert "own low-battery stage is at 35 %" in scene.events("safe_end")[0]["why"]


def test_of_two_reserves_the_higher_counts_at_touchdown() -> None:
    scene, left_percent = turned_back(Windy, reserve_percent=40.0)
    assert left_percent >= 40.0
    assert "the reserve is 40 %" in scene.events("safe_end")[0]["why"]


def test_a_vehicle_that_says_nothing_of_its_way_home_is_believed_slow() -> None:
    class Silent(Windy):
        blows_m_s = 0.0
        wind = None
        velocity = None
        energy = EnergyFacts()

    _, left_percent = turned_back(Silent)
    assert left_percent >= 20.0


def test_too_little_for_the_reserve_keeps_the_drone_on_the_ground() -> None:
    class Empty(ModelAutopilot):
        battery_percent = 10.0

    scene, error = fly(scenario(mission={"reserve_s": 60.0}, vehicle={"endurance_s": 300.0}), autopilot=Empty)
    assert isinstance(error, ReserveReached) and "60 s of reserve 20 %, 10 % is left" in str(error)
    assert not scene.events("took_off") and not scene.events("safe_end")


def test_a_mission_that_has_landed_is_not_ended_by_its_reserve() -> None:
    def land_empty(drone: Any) -> None:
        drone.autopilot.arm()
        drone.autopilot.takeoff(10)
        drone.autopilot.land()
        drone.autopilot._thread.call(asyncio.sleep(80.0))
        drone.autopilot.disarm()

    scene, error = fly(scenario(mission={"reserve_s": 5.0}, vehicle={"endurance_s": 100.0}), land_empty)
    assert error is None
    assert not scene.events("stopping")


def test_a_battery_that_nobody_reports_is_said_to_be_unwatched() -> None:
    scene, error = fly(scenario(mission={"reserve_s": 60.0}))
    assert error is None
    assert len(scene.events("battery_watch_failed")) == 1
    assert not scene.events("energy")
