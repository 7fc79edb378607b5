"""A drone's state at a glance, event by event: who has the vehicle, and what it does."""

from __future__ import annotations

import re
from collections.abc import Mapping

from upwash.core.geo import Position, ground_distance_m
from upwash.core.vehicle.control import Owner
from upwash.eventlog import schema
from upwash.eventlog.schema import Event

_OTHERS = {  # a word for the bar, and its tone
    Owner.PILOT: ("PILOT", "person"),
    Owner.GROUND_STATION: ("GROUND STATION", "person"),
    Owner.FAILSAFE: ("FAIL-SAFE", "alarm"),
    Owner.EARLIER_RUN: ("COMING DOWN", "landing"),
    Owner.UNKNOWN: ("NOBODY KNOWN", "alarm"),
}
_IN_MODE = re.compile(r"\bin mode ([^,;(]+)")
_AT_HOME_M = 3.0
_DESCENDS_M = 1.0  # below the highest place of a return, above home


_PHASES: Mapping[type[Event], str] = {  # from the event on
    schema.LogResumed: "waiting",
    schema.MissionStarted: "flying",
    schema.TakingOff: "flying",
    schema.SetOff: "flying",
    schema.Returning: "returning",
    schema.Landing: "landing",
    schema.LeftHovering: "hovering",
    schema.SafeEndFailed: "disobeying",
    schema.Landed: "landed",
    schema.Stood: "landed",
    schema.Disarmed: "landed",
}


class ShownControl:
    """Who has the vehicle: `who` in a word, for people at a distance, `tone` for its colour.

    `mode` is the autopilot's, `armed` whether the motors may run; empty and None while the log does not tell.
    """

    def __init__(self) -> None:
        self.mode = ""
        self.armed: bool | None = None
        self._owner = Owner.NOBODY
        self._phase = "waiting"
        self._home = Position(0.0, 0.0)
        self._highest_m = 0.0
        self._is_silent = False

    def words(self, doing: str) -> str:
        """What the vehicle does, where the program does this and `who` does not say it."""
        if self.who == "NOBODY":
            return "hovering" if self._phase == "hovering" else "does not obey"
        return doing if self.who in {"PROGRAM", "WAITING"} else ""

    @property
    def who(self) -> str:
        """Who has it, or what becomes of it."""
        return self._shown[0]

    @property
    def tone(self) -> str:
        """`program`, `person`, `landing`, `ground` or `alarm`."""
        return self._shown[1]

    @property
    def _shown(self) -> tuple[str, str]:
        if self._phase == "landed":
            return "LANDED", "ground"
        if self._owner in _OTHERS:
            return _OTHERS[self._owner]
        match self._phase:
            case _ if self._is_silent:
                return "NOT HEARD", "alarm"
            case "hovering" | "disobeying":
                return "NOBODY", "alarm"
            case "returning" | "landing":
                return self._phase.upper(), "landing"
            case "waiting" if self._owner is Owner.NOBODY:
                return "WAITING", "ground"
        return "PROGRAM", "ground" if self.armed is False else "program"

    def take(self, event: Event) -> None:
        """Takes in the next event."""
        before, self._phase = self._phase, _PHASES.get(type(event), self._phase)
        match event:
            case schema.PositionReport():
                self._take_report(event)
            case schema.ControlChanged(owner=owner, why=why):
                self._owner = owner
                if (told := _IN_MODE.search(why)) is not None:
                    self.mode = told[1].strip()
            case schema.LogResumed():
                self._owner = Owner.NOBODY
            case schema.SafeEnd(action=action):
                self._phase = {"return": "returning", "land": "landing"}.get(action, self._phase)
            case schema.LinkLost() | schema.LinkRestored():
                self._is_silent = isinstance(event, schema.LinkLost)
            case schema.Armed() | schema.Disarmed() | schema.Stood():
                self.armed = isinstance(event, schema.Armed)
            case schema.LimitsRead(home=Position() as home):
                self._home = home
            case schema.HomeMoved(east_m=east_m, north_m=north_m):
                self._home = Position(east_m, north_m)
        if self._phase != before:
            self._highest_m = 0.0

    def _take_report(self, report: schema.PositionReport) -> None:
        if report.mode is not None:
            self.mode = report.mode
        if report.armed is not None:
            self.armed = report.armed
        if self._phase == "returning":
            self._highest_m = max(self._highest_m, report.altitude_m)
            here = Position(report.east_m, report.north_m)
            descends = report.altitude_m < self._highest_m - _DESCENDS_M
            if descends and ground_distance_m(here, self._home) <= _AT_HOME_M:
                self._phase = "landing"
