"""What each verb asks of the autopilot, tells the core and writes into the log; the autopilot is the test's."""

from __future__ import annotations

import asyncio
import math
from types import SimpleNamespace
from typing import Any

import pytest

from upwash.core.geo import Position, Waypoint
from upwash.core.planning.acts import Acts, cheapest
from upwash.core.planning.legs import Pace
from upwash.core.planning.stay_or_go import StayRule
from upwash.core.selection import events
from upwash.core.vehicle.geofence import Fence, Polygon
from upwash.core.vehicle.way_home import EnergyFacts
from upwash.drone.coming_down import Homecoming
from upwash.drone.late_acts import LateActs
from upwash.drone.legs import Legs
from upwash.drone.objects import FlightObjects
from upwash.drone.site import Site
from upwash.drone.stops import Stops
from upwash.drone.vehicle import Vehicle
from upwash.errors import AutopilotRefused
from upwash.ports import VehicleLimits
from upwash.sim.loop import run_virtually

HOME = Position(0.0, 0.0)
NEAR, FAR = Position(40.0, 0.0, 20.0), Position(40.0, 40.0, 20.0)
CORNERS = ((15.0, -5.0), (25.0, -5.0), (25.0, 5.0), (15.0, 5.0))
FENCED = VehicleLimits(
    home=HOME,
    highest_m=30.0,
    fences=[Fence("area 1", Polygon(tuple(Position(*corner) for corner in CORNERS)), inclusion=False)],
)


class Field:
    """A vehicle without a body: it is where it was sent."""

    def __init__(self, limits: VehicleLimits | None = None, **site: Any) -> None:
        self.position = HOME
        self.energy, self.pace = EnergyFacts(), None
        self.done: list[str] = []
        self.log: list[Any] = []
        self.told: list[Any] = []
        self.took_s = 0.0
        self._limits = limits or VehicleLimits()
        facts: dict[str, Any] = {
            "waypoints": [Waypoint(0, NEAR)],
            "fences": (),
            "farthest_start_m": 500.0,
            "takeoff_m": 20.0,
        }
        this: Any = self
        journal: Any = SimpleNamespace(record=self.log.append)
        self.legs = Legs(this, journal, site=Site(**(facts | site)), tell=self.told.append, default_m_s=4.0)
        late = LateActs(
            self.legs,
            Acts((), ground_speed_m_s=4.0, pace=Pace(), photo_s=0.0, home_s=None),
            when_to_act=cheapest,
            within_s=math.inf,
            home_s=lambda _: 0.0,
            spare_s=lambda: None,
        )
        self.settling = Stops(
            legs=self.legs,
            thread=this,
            late=late,
            rule=StayRule("stay"),
            objects=FlightObjects(),
            outlook=lambda: None,
        )
        self.vehicle = Vehicle(self.settling, Homecoming(this, journal))

    def require_turn(self) -> None:
        """It is always the mission's turn."""

    def call(self, verb: Any) -> Any:
        async def timed() -> Any:
            try:
                return await verb
            finally:
                self.took_s = asyncio.get_running_loop().time()

        return run_virtually(timed())

    async def limits(self) -> VehicleLimits:
        return self._limits

    def say(self, severity: int, text: str) -> None:
        self.done.append(f"say {severity} {text}")

    async def goto(self, position: Position) -> None:
        self.done.append(f"goto {position.east_m:g} {position.north_m:g} {position.altitude_m:g}")
        assert self.vehicle.on_a_leg or self.legs.found_flying
        self.position = position

    def __getattr__(self, name: str) -> Any:
        async def verb(*about: float) -> None:
            self.done.append(" ".join([name, *(f"{each:g}" for each in about)]))

        return verb

    def kinds(self) -> list[str]:
        """What was logged since the last look."""
        kinds = [event.kind for event in self.log]
        self.log.clear()
        return kinds


def test_arming_reads_the_limits_and_holds_the_mission_against_them() -> None:
    field = Field(VehicleLimits(home=Position(0.0, 30.0), highest_m=99.0, home_above_sea_m=7.0))
    field.vehicle.arm()
    assert field.done == ["ready", "arm"]
    assert field.told == [events.TargetUnknown(), events.MissionBegun(field.energy)]
    read, doubt = field.log[:2]
    assert (read.home, read.highest_m, read.home_above_sea_m) == (Position(0.0, 30.0), 99.0, 7.0)
    assert "30 m from its own home" in doubt.why
    assert field.kinds() == ["vehicle_limits", "site_doubt", "arming", "armed"]


@pytest.mark.parametrize(
    ("limits", "site", "why"),
    [
        (FENCED, {}, "waypoint 0: the way there from where the vehicle stands"),
        (VehicleLimits(), {"farthest_start_m": 39.0}, "stands 40 m from the nearest waypoint"),
    ],
)
def test_a_mission_that_is_not_allowed_arms_nothing(limits: VehicleLimits, site: Any, why: str) -> None:
    field = Field(limits, **site)
    with pytest.raises(AutopilotRefused, match=why):
        field.vehicle.arm()
    assert (field.done, field.kinds()) == (["ready"], ["vehicle_limits"])


def test_a_take_off_is_in_the_air_from_the_attempt_on() -> None:
    field = Field()
    assert not field.vehicle.in_the_air
    field.vehicle.takeoff(20.0)
    assert (field.vehicle.in_the_air, field.done, field.told) == (
        True,
        ["takeoff 20"],
        [events.TargetUnknown()],
    )
    assert field.kinds() == ["taking_off", "took_off"]


def test_altitudes_and_legs_are_held_against_the_limits_that_were_read() -> None:
    field = Field(FENCED, waypoints=[Waypoint(0, Position(0.0, 40.0, 20.0))])
    field.vehicle.arm()
    with pytest.raises(AutopilotRefused, match="takeoff to 30 m: the vehicle's own fence forbids it"):
        field.vehicle.takeoff(30.0)
    assert field.vehicle.in_the_air, "it may have failed half-way up"
    field.vehicle.takeoff(20.0)
    field.done.clear()
    with pytest.raises(AutopilotRefused, match="area 1 is in the way"):
        field.vehicle.goto(NEAR)
    field.vehicle.goto(FAR)
    field.vehicle.goto(NEAR)
    field.position = Position(20.0, 0.0, 20.0)  # by a gust; what counts is where it was sent
    with pytest.raises(AutopilotRefused, match="area 1 is in the way"):
        field.vehicle.goto(HOME)
    field.vehicle.hold()
    field.vehicle.goto(Position(20.0, 20.0, 20.0))
    assert field.done == ["goto 40 40 20", "goto 40 0 20", "hold", "goto 20 20 20"]


def test_a_leg_sets_its_speed_once_and_holds_at_its_end() -> None:
    field = Field()
    waypoint = Waypoint(3, NEAR, hold_s=5.0, ground_speed_m_s=2.5)
    assert field.vehicle.goto(waypoint)
    assert field.done == ["set_ground_speed 2.5", "goto 40 0 20"]
    assert field.told == [events.LegBegun(NEAR, 2.5), events.LegEnded()]
    begun, ended = field.log
    assert (begun.kind, begun.waypoint, begun.east_m, begun.north_m, begun.back) == (
        "leg",
        3,
        40.0,
        0.0,
        False,
    )
    assert (ended.kind, ended.waypoint, ended.east_m, ended.hold_s) == ("arrived", 3, 40.0, 5.0)
    assert (field.took_s, field.vehicle.on_a_leg, field.vehicle.waypoint) == (5.0, False, 3)
    field.settling.fly(waypoint, back=True)
    assert field.done[2:] == ["goto 40 0 20"], "it flies at that speed already"
    assert (field.log[-2].back, field.log[-1].hold_s, field.took_s) == (True, 0.0, 0.0)
    assert field.told[2] == events.LegBegun(NEAR, 2.5, back=True)
    field.vehicle.goto(FAR)
    assert (field.log[-2].back, field.log[-1].hold_s, field.vehicle.waypoint) == (False, 0.0, None)
    assert field.done[3:] == ["goto 40 40 20"]
    field.vehicle.set_ground_speed(4.0)
    assert (field.done[-1], field.vehicle.ground_speed_m_s) == ("set_ground_speed 4", 4.0)


def test_verbs_without_a_leg_tell_the_core_and_the_log() -> None:
    field = Field()
    field.vehicle.hold()
    field.vehicle.return_home_and_land()
    assert not field.vehicle.in_the_air
    field.vehicle.land()
    field.vehicle.disarm()
    assert field.done == ["hold", "return_home_and_land", "land", "disarm"]
    descent = events.DescentBegun()
    assert field.told == [events.TargetUnknown(), descent, descent, events.TargetUnknown()]
    assert field.kinds() == ["holding", "returning", "landed", "landing", "landed", "disarmed"]
    field.vehicle.hover(3.0)
    assert field.took_s == 3.0
    field.vehicle.turn_to(0.0)
    field.vehicle.turn_to(360.0)
    assert field.done[4:] == ["turn_to 0", "turn_to 0"]
    field.vehicle.send_text("x", severity="emergency")
    field.vehicle.send_text("ä" * 100)
    assert field.done[6:] == ["say 0 x", f"say 6 {'ä' * 100}"]


def test_a_vehicle_that_was_found_flying_is_neither_armed_nor_sunk() -> None:
    field = Field(FENCED, waypoints=[Waypoint(0, Position(0.0, 40.0, 20.0))])
    field.position = Position(0.0, 40.0, 15.0)
    field.legs.take_up()
    assert (field.vehicle.in_the_air, field.told) == (True, [events.MissionBegun(field.energy)])
    field.vehicle.arm()
    field.vehicle.takeoff(15.0)
    field.vehicle.takeoff(10.0)
    assert (field.done, field.log) == ([], [])
    field.vehicle.takeoff(20.0)
    assert field.done == ["goto 0 40 20"]
    field.vehicle.land()
    field.vehicle.arm()
    assert field.done[1:] == ["land", "ready", "arm"]
