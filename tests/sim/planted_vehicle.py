"""Defects planted in what decides whose the vehicle is, and where: `planted.py` lists them."""

from __future__ import annotations

import contextlib
from typing import Any
from unittest.mock import patch

from upwash.core.geo import Position
from upwash.core.vehicle import control
from upwash.core.vehicle.continuity import Continuity, Track
from upwash.core.vehicle.control import Control, ControlChange, Heartbeat, Latch, Owner
from upwash.drone import coming_down as safety
from upwash.drone import flight as drone
from upwash.sim.autopilot import ModelAutopilot
from upwash.sim.vehicle_link import ModelVehicleLink


def latch_not_asked() -> contextlib.AbstractContextManager[object]:
    """Commands are sent whoever has the vehicle, and the flight goes on."""
    planted = contextlib.ExitStack()
    planted.enter_context(patch.object(Latch, "require", lambda *_: None))
    planted.enter_context(patch.object(drone.Flight, "_hear_vehicle", lambda *_: None))
    return planted


def latch_opens_again() -> contextlib.AbstractContextManager[object]:
    """A pilot who switches back to the program's mode is taken to have given the vehicle back."""
    report = Latch.report

    def forgiving(self: Latch, heard: Heartbeat, now_s: float) -> None:
        was_claimed = self.control.owner is not Owner.NOBODY
        report(self, heard, now_s)
        if was_claimed and not self.control.is_ours and heard.mode == "GUIDED" and heard.armed:
            self.control = Control(Owner.PROGRAM, now_s, "in the program's mode again")

    return patch.object(Latch, "report", forgiving)


def failsafe_overlooked() -> contextlib.AbstractContextManager[object]:
    """A mode that a fail-safe chose is no difference."""
    report = Latch.report

    def blind(self: Latch, heard: Heartbeat, now_s: float) -> None:
        if not heard.failsafe:
            report(self, heard, now_s)

    return patch.object(Latch, "report", blind)


def ended_safely_all_the_same() -> contextlib.AbstractContextManager[object]:
    """A flight that was lost to somebody is ended in the safe action."""

    async def end(autopilot: Any, journal: Any, **_: Any) -> None:
        await safety.end_safely(autopilot, "return", journal, why="lost")

    planted = contextlib.ExitStack()
    planted.enter_context(patch.object(Latch, "require", lambda *_: None))
    planted.enter_context(patch.object(drone, "follow", end))
    return planted


def arrived_in_doubt() -> contextlib.AbstractContextManager[object]:
    """A position that jumped is believed."""
    return patch.object(Continuity, "doubt_m", 0.0)


def doubted_for_ever() -> contextlib.AbstractContextManager[object]:
    """A position that has jumped back is still in doubt."""
    return patch.object(Track, "believe", lambda *_: None)


def target_not_watched() -> contextlib.AbstractContextManager[object]:
    """The mode and the motors alone say whose the vehicle is."""
    return patch.object(Latch, "report_target", lambda *_: None)


def restart_blamed_on_pilot() -> contextlib.AbstractContextManager[object]:
    restarts = {(owner, ControlChange.RESTARTED): Owner.PILOT for owner in Owner}
    return patch.dict(control.TRANSITIONS, restarts)


def restart_overlooked() -> contextlib.AbstractContextManager[object]:
    """A vehicle whose autopilot restarted, and is in the program's mode, is commanded as before."""
    return patch.object(Latch, "report_restart", lambda *_: None)


def restart_on_ground_is_loss() -> contextlib.AbstractContextManager[object]:
    """An autopilot that restarts before it is armed ends the flight."""

    def strict(self: Latch, why: str, now_s: float) -> None:
        if self.control.is_ours:
            self._take(ControlChange.RESTARTED, why, now_s)

    return patch.object(Latch, "report_restart", strict)


def altitudes_follow_home() -> contextlib.AbstractContextManager[object]:
    """Altitudes are commanded above the vehicle's home, wherever that is now."""

    def above_home(self: ModelAutopilot, place: Position) -> Position:
        return place.at_altitude(place.altitude_m + self._vehicle.home.altitude_m)

    return patch.object(ModelAutopilot, "_above_sea", above_home)


def any_heartbeat_believed() -> contextlib.AbstractContextManager[object]:
    return patch.object(ModelVehicleLink, "_is_believed", lambda *_, **__: True)
