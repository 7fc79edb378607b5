"""How long the vehicle still needs to the ground, as the program follows its way down."""

from __future__ import annotations

from typing import Any

import pytest

from upwash.core.geo import Position
from upwash.core.vehicle.control import Control, Owner
from upwash.core.vehicle.way_home import ARDUCOPTER, UNKNOWN, EnergyFacts, WayDown, WayHome
from upwash.drone.coming_down import ComingDown, Descent
from upwash.sim.loop import run_virtually

HERE = Position(300.0, 40.0, 20.0)


class Vehicle:
    """What a descent reads of an autopilot."""

    def __init__(self, facts: EnergyFacts = EnergyFacts()) -> None:  # noqa: B008 - frozen
        self.energy = facts
        self.position = HERE
        self.control = Control(Owner.PROGRAM, 0.0, "claimed")
        self.stands = False


def left_s(vehicle: Any, *, doing: ComingDown | None = "return") -> float | None:
    async def look() -> float | None:
        return Descent(vehicle, doing=lambda: doing).left_s

    return run_virtually(look())


def needed_s(way: WayHome, home: Position | None) -> float:
    return WayDown(way, HERE, home).left_s(HERE, now_s=0.0)


@pytest.mark.parametrize("home", [Position(300.0, 0.0, 0.0), Position(-500.0, 0.0, 0.0), None])
@pytest.mark.parametrize("way", [ARDUCOPTER, None])
def test_a_return_goes_to_the_home_and_in_the_manner_that_the_vehicle_reports(
    way: WayHome | None, home: Position | None
) -> None:
    facts = EnergyFacts(home=home, way_home=way)
    assert left_s(Vehicle(facts)) == needed_s(way or UNKNOWN, home or Position(0.0, 0.0))
    assert left_s(Vehicle(facts), doing="land") == needed_s(way or UNKNOWN, None)


def test_nothing_is_known_of_a_vehicle_that_stands_or_flies_on_or_for_another() -> None:
    vehicle = Vehicle()
    assert left_s(vehicle) is not None
    assert left_s(vehicle, doing=None) is None
    vehicle.stands = True
    assert left_s(vehicle) is None
    vehicle = Vehicle()
    vehicle.control = Control(Owner.PILOT, 0.0, "stick")
    assert left_s(vehicle) is None
