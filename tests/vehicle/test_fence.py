"""The stand-in's fence: which kinds of it are switched on when, what it says, and which modes it refuses then."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import GeoPosition, Position
from upwash.vehicle.ardupilot.copter import Copter
from upwash.vehicle.ardupilot.settings import CopterMode, VehicleSettings
from upwash.vehicle.body.copter import Result
from upwash.vehicle.body.fence import FenceItem

STAY_IN = mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION
KEEP_OUT = mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION


class Flown:
    """A copter on its own clock, and all that it says."""

    def __init__(self, **parameters: float) -> None:
        settings = VehicleSettings(
            home=GeoPosition(39.3666, 22.9507), armable_after_s=0.0, parameters=parameters
        )
        self.copter = Copter(settings, now_s=0.0)
        self.said: list[str] = []
        self.now_s = 0.0

    def box(self, command: int, west_m: float, south_m: float, east_m: float, north_m: float) -> None:
        corners = (west_m, south_m), (east_m, south_m), (east_m, north_m), (west_m, north_m)
        items = tuple(FenceItem(command, 4, Position(*corner), 0, 0) for corner in corners)
        self.copter.fence.set((*self.copter.fence.items, *items))

    def fly(self, for_s: float) -> None:
        for _ in range(round(for_s * 10)):
            self.now_s += 0.1
            self.copter.notice(self.now_s)
            self.said += [text.words for text in self.copter.said()]

    def take_off(self, altitude_m: float = 10.0) -> None:
        self.fly(1.0)
        self.copter.change_mode(self.now_s, CopterMode.GUIDED)
        assert self.copter.arm(self.now_s) is Result.ACCEPTED
        self.copter.take_off(self.now_s, altitude_m)
        self.fly(20.0)

    def goes_to(self, east_m: float, north_m: float = 0.0, altitude_m: float = 10.0) -> bool:
        return self.copter.steer(self.now_s, Position(east_m, north_m, altitude_m))


@pytest.mark.parametrize(
    ("autoenable", "said"),
    [
        (0, None),
        (1, "Circle fence auto-enabled"),
        (2, "Circle fence auto-enabled"),
        (3, "Circle fence auto-enabled"),
    ],
)
def test_autoenable_switches_the_fence_on_whatever_enable_says(autoenable: int, said: str | None) -> None:
    flown = Flown(FENCE_AUTOENABLE=autoenable, FENCE_TYPE=2, FENCE_RADIUS=30)
    assert flown.goes_to(40.0) is False, "it stands"
    flown.take_off()
    assert [words for words in flown.said if "auto" in words] == ([] if said is None else [said])
    assert flown.goes_to(40.0) is (said is None)
    assert flown.goes_to(30.0)


def test_before_a_take_off_has_ended_an_autoenable_of_1_holds_nothing_and_one_of_3_does() -> None:
    for autoenable, mode in (1, CopterMode.GUIDED), (3, CopterMode.RTL):
        flown = Flown(FENCE_AUTOENABLE=autoenable, FENCE_TYPE=1, FENCE_ALT_MAX=8)
        flown.fly(1.0)
        flown.copter.change_mode(flown.now_s, CopterMode.GUIDED)
        flown.copter.arm(flown.now_s)
        flown.copter.take_off(flown.now_s, 10.0)
        while flown.copter.position(flown.now_s).altitude_m < 8.2 and flown.copter.mode is CopterMode.GUIDED:
            flown.fly(0.1)
        assert flown.copter.mode is mode


def test_an_autoenable_of_1_ends_with_the_landing() -> None:
    flown = Flown(FENCE_AUTOENABLE=1, FENCE_TYPE=2)
    flown.take_off()
    flown.copter.change_mode(flown.now_s, CopterMode.LAND)
    flown.fly(20.0)
    assert flown.said[-1] in ("Circle fence auto-disabled", "Disarming motors")
    assert "Circle fence auto-disabled" in flown.said


def test_joined_areas_are_one() -> None:
    for options, crosses in (0, False), (2, True):
        flown = Flown(FENCE_ENABLE=1, FENCE_TYPE=4, FENCE_OPTIONS=options)
        flown.box(STAY_IN, -10, -10, 20, 10)
        flown.box(STAY_IN, -5, -10, 60, 10)
        flown.take_off()
        assert flown.goes_to(10.0)
        assert flown.goes_to(40.0) is crosses
        flown.fly(20.0)
        assert flown.copter.mode is CopterMode.GUIDED
        assert not flown.goes_to(70.0)


def test_standing_where_a_fence_forbids_it_keeps_it_from_being_armed() -> None:
    flown = Flown(FENCE_ENABLE=1, FENCE_TYPE=4)
    flown.box(KEEP_OUT, -5, -5, 5, 5)
    flown.fly(1.0)
    assert flown.copter.why_not_armable(flown.now_s) == ("Vehicle breaching Polygon fence",)


def test_a_floor_counts_from_when_it_is_passed() -> None:
    flown = Flown(FENCE_ENABLE=1, FENCE_TYPE=8, FENCE_ALT_MIN=6)
    flown.take_off(7.0)
    assert "Min Alt fence enabled (auto enable)" not in flown.said
    assert flown.goes_to(0.0, altitude_m=10.0)
    flown.fly(10.0)
    assert "Min Alt fence enabled (auto enable)" in flown.said
    assert not flown.goes_to(0.0, altitude_m=5.0)
    assert flown.goes_to(0.0, altitude_m=6.0)  # its margin keeps no target out
    while flown.copter.mode is CopterMode.GUIDED:
        flown.fly(0.1)
    assert "Min Alt fence breached" in flown.said
    assert flown.copter.fence.breach == mavlink.FENCE_BREACH_MINALT


def test_it_says_which_kinds_it_breaches_and_may_refuse_modes_until_that_is_over() -> None:
    for options, result in (0, Result.ACCEPTED), (1, Result.FAILED):
        flown = Flown(FENCE_TYPE=5, FENCE_ALT_MAX=15, FENCE_OPTIONS=options)
        flown.box(KEEP_OUT, 20, -10, 30, 10)
        flown.take_off()
        assert flown.goes_to(25.0, altitude_m=16.0)
        flown.fly(20.0)
        flown.copter.parameters.change("FENCE_ENABLE", 1)
        flown.fly(0.1)
        assert flown.said[-2:] == ["Max Alt and Polygon fences breached", "Manual recovery started"]
        assert flown.copter.change_mode(flown.now_s, CopterMode.LOITER) is result
        refusal = "Mode change to LOITER failed: in fence recovery"
        assert [text.words for text in flown.copter.said()] == ([refusal] if options else [])


def test_it_returns_below_its_ceiling_by_its_margin() -> None:
    flown = Flown(FENCE_ENABLE=1, FENCE_TYPE=1, FENCE_ALT_MAX=14, FENCE_MARGIN=2)
    flown.take_off()
    assert flown.goes_to(30.0)
    flown.fly(15.0)
    flown.copter.change_mode(flown.now_s, CopterMode.RTL)
    highest_m = 0.0
    for _ in range(200):
        flown.fly(0.1)
        highest_m = max(highest_m, flown.copter.position(flown.now_s).altitude_m)
    assert highest_m == pytest.approx(12.0, abs=0.2)
