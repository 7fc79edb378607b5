"""What a person has to act on, or should know, of a flight: each notice from its event until its cause is over.

Laws:

1. The most urgent notice has the lowest rank, by what it is about alone: a person who reads one at a time reads that.
2. A notice ends with its cause. Reasons against arming end when the vehicle is armed, notices of a flight when the
   vehicle stands, and notices of the program's work with that work. A text of the vehicle ends unless it is repeated.
3. While a person flies the vehicle, no notice says to take over.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

from upwash.core.knowledge.servers import State
from upwash.core.knowledge.supplies import Supply
from upwash.core.vehicle.control import Owner
from upwash.eventlog import schema
from upwash.eventlog.schema import SEVERITIES, Event
from upwash.support.text import clock, clocks_apart, counted

SAFE_ENDS = {
    "return": "returning to land",
    "land": "landing where it is",
    "hold": "stopping to hover",
    "disarm": "disarming on the ground",
}
WARNING = 4
_NO_LINKS = "no server is dialled until it has more"
_SPARED: Mapping[Supply, str] = {
    "files": _NO_LINKS,
    "threads": _NO_LINKS,
    "memory": _NO_LINKS,
    "disk": "photos are not kept, and positions are logged less often, until it has more",
}
_OWNERS = {
    Owner.NOBODY: "nobody",
    Owner.PROGRAM: "the program",
    Owner.PILOT: "the pilot",
    Owner.GROUND_STATION: "a ground station or another program",
    Owner.FAILSAFE: "a fail-safe",
    Owner.EARLIER_RUN: "an earlier run of the program",
    Owner.UNKNOWN: "nobody known",
}
_TAKE_OVER = "Take over with the remote control."
_BE_READY = "Be ready to take over."
_LOOK = "Look where it is."
_NO_ARRIVAL = "no arrival counts"
_TAKES_OVER = frozenset({_TAKE_OVER, _BE_READY})
_SAID_AT_ONCE = 3  # of the vehicle's texts, the newest
_SAID_FOR_S = 60.0  # a text that is not repeated
_CRITICAL = 2
TEXTS = ("critical", "said", "prearm")
_PEOPLE = frozenset({Owner.PILOT, Owner.GROUND_STATION})  # who fly it themselves
_NO_OTHER = frozenset({Owner.PROGRAM, Owner.NOBODY})
_COUNTED = ("link", "server", "local", "whole", *TEXTS)  # how often it began, in this flight
_URGENT_FIRST = (
    "hovering", "disobeys", "left", "link", "position", "control", "critical", "reserve", "return", "safe end",
    "stopping", "unfollowed", "home",
    "arming", "prearm", "waiting", "dead man", "battery", "said", "supply", "offloading", "local", "server", "border",
    "trouble", "late", "better", "site", "setting", "version", "clock", "unsigned", "ended", "fallbacks", "whole",
    "photos", "place", "network", "coverage", "demands", "handover", "log", "shortened", "events",
)  # fmt: skip
_RANKS = {about: rank for rank, about in enumerate(_URGENT_FIRST)}
# Most events of a long log are of few kinds: each case of a match takes time.
_NEVER_NOTICED = frozenset(
    {schema.PositionReport, schema.Arrived, schema.PhotoTaken, schema.AutopilotPhoto, schema.Decided}
)


def left_of(supply: Supply, left: float) -> str:
    """What is left of a supply, in words."""
    match supply:
        case "files":
            return f"{counted(int(left), 'file')} left to open"
        case "threads":
            return f"{counted(int(left), 'thread')} left to start"
    return f"{left / 1e6:.0f} MB of {supply} left"


def known(value: float | None) -> str:
    """A value as text, or "not known"."""
    return "not known" if value is None else f"{value:g}"


def who_has_it(owner: str) -> str:
    """The owner of the vehicle as text."""
    return _OWNERS[Owner(owner)]


class Level(StrEnum):
    """How urgent it is: a person has to act now, or should know."""

    ALARM = "alarm"
    CAUTION = "caution"


@dataclass(frozen=True, slots=True)
class Notice:
    """What holds from now on under a key; without a `cause` what held under it is over.

    `about` is the first part of the key, which ranks it. `action` says what a person can do, empty where there is
    nothing. It began at `since_s`, and began `times` times.
    """

    about: str
    cause: str = ""
    action: str = ""
    level: Level = Level.CAUTION
    of: str = ""
    since_s: float = 0.0
    times: int = 1

    @property
    def key(self) -> str:
        """What it is about, and the server, setting or other thing that it concerns."""
        return f"{self.about} {self.of}".rstrip()

    @property
    def words(self) -> str:
        """The cause and the action, without the full stop at the end."""
        return f"{self.cause}. {self.action.removesuffix('.')}" if self.action else self.cause

    @property
    def rank(self) -> int:
        """Its place in the order of urgency, the most urgent at 0."""
        return _RANKS[self.about]


class Notices:
    """Follows the events of one flight in their order."""

    def __init__(self) -> None:
        self._held: dict[str, Notice] = {}
        self._times = Counter[str]()
        self._fell_back = self._lost = 0  # calls, and events of the log
        self._said_s: dict[str, float] = {}  # by the key of a text, the newest last
        self._owner = Owner.NOBODY
        self._stands: bool | None = None  # None: not known
        self._works = True  # the program, on its mission

    def is_stale(self, now_s: float) -> bool:
        """Whether a text of the vehicle is too old by now, which `take` ends with any event."""
        return now_s > next(iter(self._said_s.values()), math.inf) + _SAID_FOR_S

    def take(self, event: Event) -> Iterator[Notice]:
        """What the next event begins, changes or ends."""
        while self.is_stale(event.t):
            yield from self._put(_over(self._held[next(iter(self._said_s))]), event.t)
        if type(event) in _NEVER_NOTICED:
            return
        for notice in self._of(event):
            yield from self._put(notice, event.t)

    def _put(self, notice: Notice, now_s: float) -> Iterator[Notice]:
        held = self._held.pop(notice.key, None)
        if not notice.cause:
            self._said_s.pop(notice.key, None)
            if held is not None:
                yield notice
            return
        if notice.about in _COUNTED and (held is None or notice.about in TEXTS):
            self._times[notice.key] += 1
        since_s = held.since_s if held is not None and held.cause == notice.cause else now_s
        action = "" if self._owner in _PEOPLE and notice.action in _TAKES_OVER else notice.action
        notice = replace(notice, action=action, since_s=since_s, times=max(1, self._times[notice.key]))
        self._held[notice.key] = notice
        yield notice

    def _about(self, *about: str) -> Sequence[Notice]:
        return [notice for notice in self._held.values() if notice.about in about]

    def _of(self, event: Event) -> Iterator[Notice]:
        yield from map(_over, self._about(*_OVER.get(type(event), ())))
        yield from self._follow(event)
        if (notice := notice_of(event)) is not None:
            yield replace(notice, cause=notice.cause[:1].upper() + notice.cause[1:])
        match event:
            case schema.ServerStep(server=server, after=after, why=why):
                failed = f"{server} is not used: {why.removeprefix(f'{server}: ') or 'it failed'}"
                is_news = after is State.BLACKLISTED and self._works
                yield Notice("server", failed if is_news else "", of=server)
            case schema.LeftToPilot(why=why) if self._owner in _NO_OTHER:  # or "control" tells it
                yield _alarm("left", f"Nothing is sent to the vehicle any more: {why}", _TAKE_OVER)
            case schema.MissionEnded(why=why):
                level = Level.CAUTION if self._stands else Level.ALARM
                said = why.removeprefix("mission: ")
                yield Notice("ended", f"The mission ended early: {said}", level=level)
            case schema.Call(fell_back=True):
                self._fell_back += 1
                fell = counted(self._fell_back, "call")
                why = "a server gave no usable answer, or the drone left its range"
                yield Notice("fallbacks", f"{fell} fell back to the drone: {why}")
            case schema.EventsLost(count=count):
                self._lost += count
                yield Notice("events", f"{counted(self._lost, 'event')} of the log could not be kept")
            case schema.VehicleSaid(severity=severity) if severity <= WARNING:
                yield from self._say(event)

    def _follow(self, event: Event) -> Iterator[Notice]:
        """Take in who flies, whether the vehicle stands and whether the program works; end what is over by that."""
        match event:
            case schema.ControlChanged(owner=owner):
                self._owner = owner
                if owner is not Owner.PROGRAM:
                    self._works = False
                    yield from map(_over, self._about(*_OF_COMMANDS, *_OF_WORK, *_OF_ARMING))
                yield from [notice for notice in self._held.values() if notice.action in _TAKES_OVER]
            case schema.Landed() | schema.Disarmed() | schema.Stood():
                self._stands = True
                yield from [replace(ended, level=Level.CAUTION) for ended in self._about("ended")]
            case schema.Armed() | schema.TakingOff() | schema.SetOff():
                self._stands = False
            case schema.MissionCompleted() | schema.MissionEnded():
                self._works = False
            case schema.LogResumed():
                self._owner, self._stands, self._works = Owner.NOBODY, False, True

    def _say(self, said: schema.VehicleSaid) -> Iterator[Notice]:
        """A text of the vehicle; its reasons not to arm are left to `arming_delayed`."""
        forbids = said.text.startswith(("PreArm: ", "Arm: "))
        if forbids and (self._stands is False or "arming" in self._held):
            return
        is_critical = said.severity <= _CRITICAL and not forbids
        about = "prearm" if forbids else "critical" if is_critical else "said"
        words = f"The vehicle says: {said.text} ({SEVERITIES[said.severity]})"
        notice = Notice(about, words, of=said.text, level=Level.ALARM if is_critical else Level.CAUTION)
        self._said_s.pop(notice.key, None)
        self._said_s[notice.key] = said.t
        yield notice
        if len(self._said_s) > _SAID_AT_ONCE:
            yield _over(self._held[next(iter(self._said_s))])


def _over(notice: Notice) -> Notice:
    return Notice(notice.about, of=notice.of)


def _alarm(about: str, cause: str, action: str = "") -> Notice:
    return Notice(about, cause, action, Level.ALARM)


_OF_ARMING = ("arming", "prearm")
_OF_COMMANDS = ("hovering", "disobeys", "safe end", "left", "return", "reserve")
_OF_WORK = ("server", "late", "waiting", "whole")  # of the program's
_OF_FLIGHTS = (*_OF_COMMANDS, "link", "position", "home", "control", "trouble", *TEXTS)
_OVER: Mapping[type[Event], Sequence[str]] = {  # what the notices are about that an event ends
    schema.LeftHovering: ("safe end", "disobeys"),
    schema.MissionEnded: ("stopping", *_OF_WORK),
    schema.MissionCompleted: ("stopping", *_OF_WORK),
    schema.LogResumed: ("ended", "unfollowed", "stopping", "handover", *_OF_FLIGHTS),
    schema.ArmingDelayed: ("prearm",),
    schema.Armed: _OF_ARMING,
    schema.TakingOff: _OF_ARMING,
    schema.VehicleFound: ("waiting",),
    schema.LinkRestored: ("link",),
    schema.Landed: _OF_FLIGHTS,
    schema.Disarmed: _OF_FLIGHTS,
    schema.Stood: _OF_FLIGHTS,
}
_BEGUN: Mapping[type[Event], Notice] = {  # the notice that an event begins, with fields of the event in it
    schema.LeftHovering: _alarm(
        "hovering", "the vehicle hovers where it is, and nobody flies it", _TAKE_OVER
    ),
    schema.ReturnHovers: Notice("return", "{event.why}; the program lands it there"),
    schema.NoNearer: _alarm(
        "return",
        "the return comes no nearer: {event.away_m:.0f} m from {event.to} for {event.for_s:.0f} s",
        _TAKE_OVER,
    ),
    schema.ReserveOnTheWayDown: _alarm(
        "reserve", "the reserve is used up on the way down: {event.why}", _BE_READY
    ),
    schema.Stopping: _alarm("stopping", "the mission is being ended: {event.why}"),
    schema.FollowingEnded: _alarm("unfollowed", "the log ends before the vehicle stands: {event.why}"),
    schema.WaitingForVehicle: Notice("waiting", "the vehicle is waited for: {event.why}"),
    schema.LinkLost: _alarm("link", "the vehicle is not heard any more", _BE_READY),
    schema.LinkTrouble: Notice("trouble", "{event.why}", of="{event.about}"),
    schema.OffloadingFailed: Notice(
        "offloading", "every call runs on the drone from now on, after a defect: {event.why}"
    ),
    schema.LocalEnded: Notice(
        "local",
        "the service {event.service} on the drone ended ({event.how}), and is started again",
        of="{event.service}",
    ),
    schema.LocalFailed: Notice(
        "local", "the service {event.service} on the drone failed: {event.why}", of="{event.service}"
    ),
    schema.LocalReady: Notice("local", of="{event.service}"),
    schema.SentWhole: Notice(
        "whole",
        "calls of {event.operation} are not made smaller before sending: {event.why}{event.then}",
        of="{event.operation}",
    ),
    schema.NoBetterAnswer: Notice("better", "{event.why}"),
    schema.UnsignedPort: Notice("unsigned", "{event.why}"),
    schema.SiteDoubt: Notice("site", "{event.why}", of="{event.why}"),
    schema.DeadManFailed: Notice(
        "dead man", "the autopilot will not notice a silence of this program: {event.why}"
    ),
    schema.BatteryWatchFailed: Notice("battery", "the battery is not watched: {event.why}"),
    schema.BorderWatchFailed: Notice("border", "borders of ranges are noticed late: {event.why}"),
    schema.PhotosNotKept: Notice("photos", "photos are not kept: {event.why}"),
    schema.PhotoPlaceDoubted: Notice("place", "photo {event.source}: {event.why}"),
    schema.LeaveFailed: Notice(
        "network", "the drone cannot leave {event.network}: {event.why}", of="{event.network}"
    ),
    schema.ClockDiffers: Notice(
        "clock",
        "this computer's clock says {event.clock}, the vehicle's GPS {event.gps}: left as it is, {event.why}",
    ),
    schema.CoverageNotKept: Notice(
        "coverage", "the coverage map is as it was before the flight: {event.why}"
    ),
    schema.DemandsNotKept: Notice(
        "demands", "the map of demands is as it was before the flight: {event.why}"
    ),
}
LEFT_HOVERING = _BEGUN[schema.LeftHovering].words


def notice_of(event: Event) -> Notice | None:
    """The notice that an event begins, or without a cause ends; the cause begins as within a sentence.

    Notices that depend on earlier events are those of `Notices` alone.
    """
    if (notice := _BEGUN.get(type(event))) is not None:
        return replace(notice, of=notice.of.format(event=event), cause=notice.cause.format(event=event))
    return _of_flight(event) or _of_vehicle(event) or _of_computer(event)


def _of_flight(event: Event) -> Notice | None:
    match event:
        case schema.SafeEnd(action=action, why=why):
            return _alarm("safe end", f"the flight cannot go on, {SAFE_ENDS[action]}: {why}", _BE_READY)
        case schema.SafeEndFailed(action=action, why=why):
            return _alarm("disobeys", f"the vehicle does not obey ({SAFE_ENDS[action]}): {why}", _TAKE_OVER)
        case schema.Foreseen(finish_by_s=float(finish_by_s), lightest_s=float(lightest_s)) if not event.fits:
            ends, wanted = clock(lightest_s), clock(finish_by_s)
            late = f"the mission is expected to end at {ends}, later than the {wanted} of finish_by_s"
            return Notice("late", late)
        case schema.ControlChanged(owner=Owner.PROGRAM):
            return Notice("control")
        case schema.ControlChanged(owner=owner, why=why):
            level = Level.CAUTION if owner is Owner.PILOT else Level.ALARM  # who has taken it over knows
            cause = f"{who_has_it(owner)} has the vehicle: {why}"
            return Notice("control", cause, "Nothing is sent to it any more.", level)
    return None


def _of_vehicle(event: Event) -> Notice | None:
    match event:
        case schema.PositionDoubted(unsure=True):
            return _alarm("position", f"the vehicle is not sure of its position: {_NO_ARRIVAL}", _LOOK)
        case schema.PositionDoubted(jumped_m=jumped_m) if jumped_m:
            jumped = f"jumped {jumped_m:.0f} m, farther than it can fly: {_NO_ARRIVAL}"
            return _alarm("position", f"the vehicle's reported position {jumped}", _LOOK)
        case schema.PositionDoubted():
            return Notice("position")
        case schema.HomeMoved(east_m=east_m, north_m=north_m, altitude_m=altitude_m):
            up = f"{abs(altitude_m):.0f} m {'higher' if altitude_m >= 0 else 'lower'}"
            there = f"{east_m:.0f} m east, {north_m:.0f} m north, {up}"
            return Notice("home", f"the vehicle's home was moved to {there}: the vehicle returns there")
        case schema.ArmingDelayed(reasons=reasons):
            said = "; ".join(reasons) or "it does not say why"
            return Notice("arming", f"the vehicle cannot be armed yet: {said}")
        case schema.VehicleSetting(name=name, value=value, advice=advice):
            return Notice("setting", f"the vehicle's {name} is {known(value)}: {advice}", of=name)
        case schema.VehicleFound(firmware=firmware, version=version):
            unknown = "" if version else f"the vehicle does not tell the version of its {firmware}"
            return Notice("version", unknown, "Check that the version is new enough." if unknown else "")
    return None


def _of_computer(event: Event) -> Notice | None:
    """Notices of the drone's computer, its clock and log, the camera, and where findings are handed over."""
    match event:
        case schema.SupplyChanged(supply=supply, left=left, scarce=scarce):
            cause = f"the drone's computer has {left_of(supply, left)}: {_SPARED[supply]}" if scarce else ""
            return Notice("supply", cause, "End what takes it, or land." if scarce else "", of=supply)
        case schema.CameraClockDiffers(camera=camera, clock=own):
            said = clocks_apart("the camera's clock", camera, own)
            return Notice(
                "clock", f"{said}; its photos count as taken when they come: set its clock", of="camera"
            )
        case schema.Shortened(of=of, why=why):
            return Notice(
                "shortened", f"the log has a part of an event alone ({of.replace('_', ' ')}): {why}"
            )
        case schema.HandoverTrouble(to=to, why=why):
            return Notice("handover", f"findings do not arrive at {to}: {why}" if why else "", of=to)
        case schema.HandoverFailed(to=to, count=count, why=why):
            failed = f"not handed over to {to}: {counted(count, 'finding')}, {why}"
            return Notice(
                "handover", failed, "The files of `upwash report LOG --findings FILE` have them.", of=to
            )
    return None
