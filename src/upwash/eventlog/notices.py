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
from upwash.core.vehicle.control import Owner
from upwash.eventlog import schema
from upwash.eventlog.narration import SAFE_ENDS, WARNING, known, left_of, who_has_it
from upwash.eventlog.progress import clock
from upwash.eventlog.schema import SEVERITIES, Event
from upwash.support.text import counted

_TAKE_OVER = "Take over with the remote control."
_BE_READY = "Be ready to take over."
_TAKES_OVER = frozenset({_TAKE_OVER, _BE_READY})
_SAID_AT_ONCE = 3  # of the vehicle's texts, the newest
_SAID_FOR_S = 60.0  # a text that is not repeated
_CRITICAL = 2
_TEXTS = ("critical", "said", "prearm")
_PEOPLE = frozenset({Owner.PILOT, Owner.GROUND_STATION})  # who fly it themselves
_COUNTED = ("link", "server", *_TEXTS)  # how often it began, in this flight
_URGENT_FIRST = (
    "hovering", "disobeys", "left", "link", "position", "control", "critical", "reserve", "return", "safe end",
    "stopping", "home",
    "arming", "prearm", "waiting", "dead man", "battery", "said", "supply", "offloading", "server", "border",
    "trouble", "late", "site", "setting", "version", "unsigned", "ended", "fallbacks", "coverage", "demands",
    "handover", "log", "shortened", "events",
)  # fmt: skip
_RANKS = {about: rank for rank, about in enumerate(_URGENT_FIRST)}
# Most events of a long log are of few kinds: each case of a match takes time.
_NEVER_NOTICED = frozenset(
    {schema.PositionReport, schema.Arrived, schema.PhotoTaken, schema.AutopilotPhoto, schema.Decided}
)


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
    def rank(self) -> int:
        """Its place in the order of urgency, the most urgent at 0."""
        return _RANKS[self.about]


class Notices:
    """Follows the events of one flight in their order."""

    def __init__(self) -> None:
        self._held: dict[str, Notice] = {}
        self._times = Counter[str]()
        self._fell_back = 0
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
        if notice.about in _COUNTED and (held is None or notice.about in _TEXTS):
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
        if (notice := _BEGUN.get(type(event))) is not None:
            yield _filled_in(notice, event)
        yield from _by_content(event)
        match event:
            case schema.ServerStep(server=server, after=after, why=why):
                failed = f"{server} is not used: {why or 'it failed'}"
                is_news = after is State.BLACKLISTED and self._works
                yield Notice("server", failed if is_news else "", of=server)
            case schema.LeftToPilot(why=why) if self._owner in {
                Owner.PROGRAM,
                Owner.NOBODY,
            }:  # or "control" tells it
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
_OF_WORK = ("server", "late", "waiting")  # of the program's
_OF_FLIGHTS = (*_OF_COMMANDS, "link", "position", "home", "control", "trouble", *_TEXTS)
_OVER: Mapping[type[Event], Sequence[str]] = {  # what the notices are about that an event ends
    schema.LeftHovering: ("safe end", "disobeys"),
    schema.MissionEnded: ("stopping", *_OF_WORK),
    schema.MissionCompleted: ("stopping", *_OF_WORK),
    schema.LogResumed: ("ended", "stopping", "handover", *_OF_FLIGHTS),
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
        "hovering", "The vehicle hovers where it is, and nobody flies it", _TAKE_OVER
    ),
    schema.ReturnHovers: Notice("return", "{event.why}; the program lands it there"),
    schema.NoNearer: _alarm(
        "return",
        "The return comes no nearer: {event.away_m:.0f} m from {event.to} for {event.for_s:.0f} s",
        _TAKE_OVER,
    ),
    schema.ReserveOnTheWayDown: _alarm(
        "reserve", "The reserve is used up on the way down: {event.why}", _BE_READY
    ),
    schema.SafeEndFailed: _alarm(
        "disobeys", "The vehicle did not do as told ({event.action}): {event.why}", _TAKE_OVER
    ),
    schema.Stopping: _alarm("stopping", "The mission is being ended: {event.why}"),
    schema.HomeMoved: Notice("home", "The vehicle's home was moved in flight: it returns to the new home"),
    schema.WaitingForVehicle: Notice("waiting", "The vehicle is waited for: {event.why}"),
    schema.LinkLost: _alarm("link", "The vehicle is not heard any more", _BE_READY),
    schema.LinkTrouble: Notice("trouble", "{event.why}", of="{event.about}"),
    schema.OffloadingFailed: Notice(
        "offloading", "Every call runs on the drone from now on, after a defect: {event.why}"
    ),
    schema.UnsignedPort: Notice("unsigned", "{event.why}"),
    schema.SiteDoubt: Notice("site", "{event.why}", of="{event.why}"),
    schema.DeadManFailed: Notice(
        "dead man", "The autopilot will not notice a silence of this program: {event.why}"
    ),
    schema.BatteryWatchFailed: Notice("battery", "The battery is not watched: {event.why}"),
    schema.BorderWatchFailed: Notice("border", "Borders of ranges are noticed late: {event.why}"),
    schema.CoverageNotKept: Notice(
        "coverage", "The coverage map is as it was before the flight: {event.why}"
    ),
    schema.DemandsNotKept: Notice(
        "demands", "The map of demands is as it was before the flight: {event.why}"
    ),
}


def _filled_in(notice: Notice, event: Event) -> Notice:
    cause = notice.cause.format(event=event)
    return replace(notice, of=notice.of.format(event=event), cause=cause[:1].upper() + cause[1:])


def _by_content(event: Event) -> Iterator[Notice]:
    """Notices whose words, or begin or end, depend on more than the kind of the event."""
    match event:
        case schema.SafeEnd(action=action, why=why):
            cause = f"The flight cannot go on, {SAFE_ENDS[action]}: {why}"
            yield _alarm("safe end", cause, _BE_READY)
        case schema.Foreseen(finish_by_s=float(finish_by_s), lightest_s=float(lightest_s)) if not event.fits:
            ends, wanted = clock(lightest_s), clock(finish_by_s)
            late = f"The mission is expected to end at {ends}, later than the {wanted} of finish_by_s"
            yield Notice("late", late)
        case schema.ControlChanged(owner=Owner.PROGRAM):
            yield Notice("control")
        case schema.ControlChanged(owner=owner, why=why):
            cause = f"{who_has_it(owner)} has the vehicle: {why}"
            level = Level.CAUTION if owner is Owner.PILOT else Level.ALARM  # who has taken it over knows
            yield Notice("control", cause[:1].upper() + cause[1:], "Nothing is sent to it any more.", level)
        case schema.PositionDoubted(jumped_m=jumped_m, unsure=unsure):
            doubt = f"The vehicle's reported position jumped {jumped_m:.0f} m, farther than it can fly"
            doubt = "The vehicle is not sure of its position" if unsure else doubt
            doubts = jumped_m or unsure
            yield _alarm("position", doubt, "Look where it is.") if doubts else Notice("position")
        case schema.ArmingDelayed(reasons=reasons):
            said = "; ".join(reasons) or "it does not say why"
            yield Notice("arming", f"The vehicle cannot be armed yet: {said}")
        case schema.VehicleSetting(name=name, value=value, advice=advice):
            yield Notice("setting", f"The vehicle's {name} is {known(value)}: {advice}", of=name)
        case schema.VehicleFound(firmware=firmware, version=version):
            unknown = "" if version else f"The vehicle does not tell the version of its {firmware}"
            yield Notice("version", unknown, "Check that the version is new enough." if unknown else "")
    yield from _of_computer(event)


def _of_computer(event: Event) -> Iterator[Notice]:
    """Notices of the drone's computer, its log, and where findings are handed over."""
    match event:
        case schema.SupplyChanged(supply=supply, left=left, scarce=scarce):
            cause = f"The drone's computer has {left_of(supply, left)}" if scarce else ""
            yield Notice("supply", cause, "End what takes it, or land." if scarce else "", of=supply)
        case schema.Shortened(of=of, why=why):
            yield Notice("shortened", f"The log has a part of an event alone ({of.replace('_', ' ')}): {why}")
        case schema.HandoverTrouble(to=to, why=why):
            yield Notice("handover", f"Findings do not arrive at {to}: {why}" if why else "", of=to)
        case schema.HandoverFailed(to=to, count=count, why=why):
            failed = f"Not handed over to {to}: {counted(count, 'finding')}, {why}"
            yield Notice(
                "handover", failed, "The files of `upwash report LOG --findings FILE` have them.", of=to
            )
        case schema.EventsLost(count=count):
            yield Notice("events", f"{counted(count, 'event')} of the log could not be kept")
