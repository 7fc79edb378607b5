"""A drone's state at a glance, event by event: who has the vehicle, what it does, and the call under way."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace

from upwash.core.geo import Position, ground_distance_m
from upwash.core.vehicle.control import Owner
from upwash.eventlog import schema
from upwash.eventlog.schema import Event

_OTHERS = {  # a word for the bar, and its tone
    Owner.PILOT: ("PILOT", "person"),
    Owner.GROUND_STATION: ("GROUND STATION", "person"),
    Owner.FAILSAFE: ("FAIL-SAFE", "alarm"),
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


class Control:
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
        return "PROGRAM", "program"

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
            case schema.Armed() | schema.Disarmed():
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


@dataclass(frozen=True, slots=True)
class Calling:
    """The call under way: what is done, since when, and the `limit_s` that it takes `at most` or `about`.

    Without `words` there is none; `more` is what is done besides.
    """

    words: str = ""
    since_s: float = 0.0
    bound: str = ""
    limit_s: float | None = None
    more: str = ""


class CallUnderWay:
    """Follows the last call that began: at its place, while the drone joins in, and after the server failed."""

    def __init__(self) -> None:
        self.now = Calling()
        self._server: str | None = None
        self._alone = Calling()  # on the drone

    def take(self, event: Event) -> None:
        """Takes in the next event."""
        match event:
            case schema.Decided():
                self._begin(event)
            case schema.Hedged(server=server, deadline_s=deadline_s) if self._is_at(server):
                self._alone = replace(self._alone, since_s=event.t)
                self.now = replace(self.now, limit_s=deadline_s, more=", also on the drone")
            case schema.RemoteFailed(server=server) | schema.RemoteRaised(server=server) if self._is_at(
                server
            ):
                since_s = self._alone.since_s if self.now.more else event.t
                self._server = None
                self.now = replace(
                    self._alone, words=f"{server} failed, {self._alone.words}", since_s=since_s
                )
            case schema.Call() | schema.MissionCompleted() | schema.MissionEnded() | schema.LogResumed():
                self._end()
            case schema.AnswerTaken(failed=why) if why:  # no event reports the end of a failed call
                self._end()
            case schema.ControlChanged(owner=owner) if owner is not Owner.PROGRAM:
                self._end()

    def _is_at(self, server: str) -> bool:
        return self._server == server and bool(self.now.words)

    def _begin(self, decided: schema.Decided) -> None:
        computes = bool(self.now.words) and self.now == self._alone
        began_s = self._alone.since_s if computes else decided.t
        bound = "" if decided.local_s is None else "about"
        self._alone = Calling("computing on the drone", began_s, bound, decided.local_s)
        self._server = decided.server
        match decided:
            case schema.Decided(decision="remote", server=server, deadline_s=limit_s, raced=raced):
                more = ", also on the drone" if raced else ""
                self.now = Calling(f"calling {server}", decided.t, "at most", limit_s, more)
            case schema.Decided(decision="wait", server=server, at_most_s=limit_s):
                self.now = Calling(f"waiting for {server}", decided.t, "at most", limit_s)
            case _:
                self.now = self._alone

    def _end(self) -> None:
        self.now, self._server = Calling(), None
