"""Defects planted in what decides whose the vehicle is, and where: `planted.py` lists them."""

from __future__ import annotations

import contextlib
from typing import Any
from unittest.mock import patch

from tests.sim.planting import Planting, plant, planted, planting

from upwash.core.geo import Position
from upwash.core.vehicle import control
from upwash.core.vehicle.continuity import Continuity, PositionSeries
from upwash.core.vehicle.control import Control, ControlChange, Heartbeat, Latch, Owner
from upwash.core.vehicle.return_place import ReturnPlace
from upwash.core.vehicle.return_watch import ReturnWatch
from upwash.core.vehicle.telemetry import Telemetry
from upwash.core.vehicle.way_home import EnergyFacts, WayHome
from upwash.drone import coming_down as safety
from upwash.drone import flight as drone
from upwash.drone.coming_down import Homecoming
from upwash.eventlog import schema
from upwash.sim.autopilot import ModelAutopilot
from upwash.sim.vehicle_link import ModelVehicleLink


def first_battery(told: Telemetry) -> dict[int, float]:
    return {
        number: percent for number, percent in told.batteries.items() if number == 1 and percent is not None
    }


@planting("commands are sent whoever has the vehicle")
def latch_not_asked() -> Planting:
    planted = contextlib.ExitStack()
    planted.enter_context(patch.object(Latch, "require", lambda *_: None))
    planted.enter_context(patch.object(drone.Flight, "_hear_vehicle", lambda *_: None))
    return planted


@planted("the program's mode alone gives the vehicle back", Latch, "report")
def latch_opens_again(report: Any, self: Latch, heard: Heartbeat, now_s: float) -> None:
    was_claimed = self.control.owner is not Owner.NOBODY
    report(self, heard, now_s)
    if was_claimed and not self.control.is_ours and heard.mode == "GUIDED" and heard.armed:
        self.control = Control(Owner.PROGRAM, now_s, "in the program's mode again")


@planted("a fail-safe's mode is overlooked", Latch, "report")
def failsafe_overlooked(report: Any, self: Latch, heard: Heartbeat, now_s: float) -> None:
    if not heard.failsafe:
        report(self, heard, now_s)


@planting("a lost vehicle is commanded to end safely")
def ended_safely_all_the_same() -> Planting:
    async def end(autopilot: Any, journal: Any, **_: Any) -> None:
        homecoming = Homecoming(autopilot, journal)
        await safety.end_safely(autopilot, "return", journal, why="lost", homecoming=homecoming)

    planted = contextlib.ExitStack()
    planted.enter_context(patch.object(Latch, "require", lambda *_: None))
    planted.enter_context(patch.object(drone, "follow", end))
    return planted


plant("an arrival counts though the position jumped", Continuity, "doubt_m", 0.0)


plant("a doubt about the position is never over", PositionSeries, "believe", lambda *_: None)


plant("the vehicle's target is not watched", Latch, "report_target", lambda *_: None)


@planting("a restart is taken for the pilot's act")
def restart_blamed_on_pilot() -> Planting:
    restarts = {(owner, ControlChange.RESTARTED): Owner.PILOT for owner in Owner}
    return patch.dict(control.TRANSITIONS, restarts)


plant("an autopilot that restarted is flown on", Latch, "report_restart", lambda *_: None)


@planted("a restart on the ground ends the flight", Latch, "report_restart")
def restart_on_ground_is_loss(original: Any, self: Latch, why: str, now_s: float) -> None:
    if self.control.is_ours:
        self._take(ControlChange.RESTARTED, why, now_s)


@planted("altitudes follow a home that is moved", ModelAutopilot, "_above_sea")
def altitudes_follow_home(original: Any, self: ModelAutopilot, place: Position) -> Any:
    return place.at_altitude(place.altitude_m + self._vehicle.home.altitude_m)


plant("a return that hovers is waited for", ReturnWatch, "hovers", False)


@planted("every landing is said to be at home", Homecoming, "landed")
def landed_at_home(original: Any, self: Homecoming) -> schema.Landed:
    return schema.Landed(position=original(self).position, at="home", from_home_m=0.0)


@planted("the way home counts as one to home alone", EnergyFacts, "returns_to")
def rally_points_not_counted(original: Any, self: EnergyFacts, here: Position, **_: Any) -> ReturnPlace:
    return ReturnPlace("home", self.home or Position(0.0, 0.0))


plant("the time until a hover is seen is not counted", WayHome, "rests_s", property(lambda way: way.hover_s))
plant("the first battery alone counts", Telemetry, "charges_percent", property(first_battery))


@planting("a change of the mode that was commanded is called the pilot's")
def commanded_mode_blamed_on_pilot() -> Planting:
    commanded = {(owner, ControlChange.MODE_COMMANDED): Owner.PILOT for owner in Owner}
    return patch.dict(control.TRANSITIONS, commanded)


plant("another program's heartbeat is believed", ModelVehicleLink, "_is_believed", lambda *_, **__: True)
