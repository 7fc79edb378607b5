"""Where a return ends, by each firmware's rule."""

from __future__ import annotations

import math

import pytest
from msgspec.structs import replace

from upwash.core.geo import Position, Velocity
from upwash.core.vehicle.energy import FlightEnergy, FlightReport, Reserve
from upwash.core.vehicle.return_place import NO_RALLY_POINTS, RallyPoints, ReturnPlace
from upwash.core.vehicle.way_home import ARDUCOPTER, EnergyFacts, WayHome, time_home_s

HOME = Position(0.0, 0.0)
ONE, TWO = (
    ReturnPlace("rally point 1", Position(100.0, 0.0)),
    ReturnPlace("rally point 2", Position(200.0, 0.0), 60.0),
)
POINTS = (ONE, TWO)


@pytest.mark.parametrize(
    ("rally", "east_m", "name"),
    [
        (NO_RALLY_POINTS, 90.0, "home"),
        (RallyPoints(POINTS), 49.0, "home"),
        (RallyPoints(POINTS), 50.0, "home"),  # not nearer
        (RallyPoints(POINTS), 51.0, "rally point 1"),
        (RallyPoints(POINTS), 160.0, "rally point 2"),
        (RallyPoints(POINTS, nearer_by_m=2.0), 50.5, "home"),
        (RallyPoints(POINTS, nearer_by_m=2.0), 150.5, "rally point 1"),
        (RallyPoints(POINTS, home_counts=False), 0.0, "rally point 1"),
        (RallyPoints((), home_counts=False), 90.0, "home"),
        (RallyPoints(POINTS, limit_m=300.0), 499.0, "rally point 2"),
        (RallyPoints(POINTS, limit_m=300.0), 501.0, "home"),  # though home is farther
        (RallyPoints(POINTS, home_counts=False, limit_m=50.0), 0.0, "home"),
    ],
)
def test_the_nearest_place_is_chosen_as_the_firmware_does(
    rally: RallyPoints, east_m: float, name: str
) -> None:
    assert rally.chosen(Position(east_m, 0.0, 20.0), HOME).name == name


def needed_s(rally: RallyPoints, here: Position, velocity: Velocity) -> float:
    energy = FlightEnergy(Reserve(0.0), endurance_s=1000.0)
    report = FlightReport(1.0, here, charges_percent={1: 90.0}, velocity=velocity)
    energy.take(report)
    margin = energy.margin(report, HOME, EnergyFacts(home=HOME, way_home=ARDUCOPTER, rally=rally))
    assert margin is not None
    return margin.home_s


def test_the_reserve_counts_the_way_to_the_place_of_the_return() -> None:
    here, still = Position(190.0, 0.0, 20.0), Velocity()
    to_point_s = needed_s(RallyPoints(POINTS), here, still)
    assert to_point_s == 2.0 + time_home_s(here, TWO.position, ARDUCOPTER.to(TWO))
    assert needed_s(NO_RALLY_POINTS, here, still) == 2.0 + time_home_s(here, HOME, ARDUCOPTER)
    higher_s = (60.0 - 20.0) / ARDUCOPTER.climb_m_s
    assert to_point_s > higher_s + (60.0 - 10.0) / ARDUCOPTER.descent_m_s + 10.0 / ARDUCOPTER.landing_m_s


def test_the_reserve_counts_the_farther_place_before_the_vehicle_leaves_the_limit() -> None:
    rally = RallyPoints((ONE,), limit_m=300.0)
    here = Position(390.0, 0.0, 20.0)
    assert needed_s(rally, here, Velocity()) < needed_s(rally, here, Velocity(-0.1)) + 1.0
    assert needed_s(rally, here, Velocity(8.0)) > 390.0 / ARDUCOPTER.speed_m_s, "in a moment it returns home"


def test_a_wait_on_the_way_down_counts_until_the_program_lands_the_vehicle() -> None:

    def home_s(way: WayHome) -> float:
        return time_home_s(Position(50.0, 0.0, 20.0), HOME, way)

    plain_s = home_s(ARDUCOPTER)
    for wait_s, counted_s in ((0.0, 0.0), (30.0, 30.0), (600.0, 71.0), (math.inf, 11.0)):
        assert home_s(replace(ARDUCOPTER, low_m=5.0, waits_s=wait_s)) == pytest.approx(plain_s + counted_s)
    climbs = replace(ARDUCOPTER, low_m=40.0, waits_s=math.inf)
    assert home_s(climbs) > plain_s + 10.0 + 20.0 / 2.5 + 20.0 / 1.5 - 2.0, "it rises to its last altitude"
