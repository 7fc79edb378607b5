"""What a person has to act on, or should know, of a flight: each notice from its event until its cause is over."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

from upwash.core.knowledge.servers import State
from upwash.core.vehicle.control import Owner
from upwash.eventlog import schema
from upwash.eventlog.narration import SAFE_ENDS, WARNING, counted, known, who_has_it
from upwash.eventlog.schema import SEVERITIES, Event

_TAKE_OVER = "Take over with the remote control."
_SAID_AT_ONCE = 3  # of the vehicle's warnings, the newest
# Most events of a long log are of few kinds: each case of a match takes time.
_NEVER_NOTICED = frozenset(
    {schema.PositionReport, schema.SetOff, schema.Arrived, schema.PhotoTaken, schema.Decided}
)


class Level(StrEnum):
    """How urgent it is: a person has to act now, or should know."""

    ALARM = "alarm"
    CAUTION = "caution"


@dataclass(frozen=True, slots=True)
class Notice:
    """What holds from now on under a key; without a `cause` what held under it is over.

    `action` says what a person can do, empty where there is nothing.
    """

    key: str
    cause: str = ""
    action: str = ""
    level: Level = Level.CAUTION


class Notices:
    """Follows the events of one flight in their order."""

    def __init__(self) -> None:
        self._held: set[str] = set()
        self._fell_back = 0
        self._said = 0

    def take(self, event: Event) -> Iterator[Notice]:
        """What the next event begins, changes or ends."""
        if type(event) in _NEVER_NOTICED:
            return
        for notice in self._of(event):
            if notice.cause:
                self._held.add(notice.key)
                yield notice
            elif notice.key in self._held:
                self._held.discard(notice.key)
                yield notice

    def _of(self, event: Event) -> Iterator[Notice]:
        for key in _OVER.get(type(event), ()):
            yield Notice(key)
        if (notice := _BEGUN.get(type(event))) is not None:
            yield _filled_in(notice, event)
        yield from _by_content(event)
        match event:
            case schema.Call(fell_back=True):
                self._fell_back += 1
                fell = counted(self._fell_back, "call")
                yield Notice("fallbacks", f"{fell} fell back to the drone, as a server gave no usable answer")
            case schema.VehicleSaid(severity=severity, text=text) if severity <= WARNING:
                key = f"vehicle {self._said % _SAID_AT_ONCE}"
                self._said += 1
                yield Notice(key, f"The vehicle says: {text} ({SEVERITIES[severity]})")


def _alarm(key: str, cause: str, action: str = "") -> Notice:
    return Notice(key, cause, action, Level.ALARM)


_OF_FLIGHTS = ("hovering", "safe end", "left", "link", "position", "home")
_OVER: Mapping[type[Event], Sequence[str]] = {  # the keys whose notices an event ends
    schema.LeftHovering: ("safe end",),
    schema.MissionEnded: ("stopping",),
    schema.MissionCompleted: ("stopping",),
    schema.LogResumed: ("ended", "safe end", "stopping", "hovering", "left"),
    schema.Armed: ("arming",),
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
    schema.SafeEndFailed: _alarm(
        "safe end", "The vehicle did not do as told ({event.action}): {event.why}", _TAKE_OVER
    ),
    schema.Stopping: _alarm("stopping", "The mission is being ended: {event.why}"),
    schema.MissionEnded: _alarm("ended", "The mission ended early: {event.why}"),
    schema.LeftToPilot: _alarm("left", "Nothing is sent to the vehicle any more: {event.why}", _TAKE_OVER),
    schema.HomeMoved: Notice("home", "The vehicle's home was moved in flight: it returns to the new home"),
    schema.WaitingForVehicle: Notice("waiting", "The vehicle is waited for: {event.why}"),
    schema.LinkLost: _alarm(
        "link", "The vehicle has not been heard for {event.silent_s:.1f} s", "Be ready to take over."
    ),
    schema.LinkTrouble: Notice("link {event.about}", "{event.why}"),
    schema.OffloadingFailed: Notice(
        "offloading", "Every call runs on the drone from now on, after a defect: {event.why}"
    ),
    schema.UnsignedPort: Notice("unsigned", "{event.why}"),
    schema.SiteDoubt: Notice("site {event.why}", "{event.why}"),
    schema.DeadManFailed: Notice(
        "dead man", "The autopilot will not notice a silence of this program: {event.why}"
    ),
    schema.BatteryWatchFailed: Notice("battery", "The battery is not watched: {event.why}"),
    schema.BorderWatchFailed: Notice("border", "Borders of ranges are noticed late: {event.why}"),
    schema.CoverageNotKept: Notice(
        "coverage", "The coverage map is as it was before the flight: {event.why}"
    ),
}


def _filled_in(notice: Notice, event: Event) -> Notice:
    cause = notice.cause.format(event=event)
    return replace(notice, key=notice.key.format(event=event), cause=cause[:1].upper() + cause[1:])


def _by_content(event: Event) -> Iterator[Notice]:
    """Notices whose words, or begin or end, depend on more than the kind of the event."""
    match event:
        case schema.ServerStep(server=server, after=after, why=why):
            failed = f"{server} is not used: {why or 'it failed'}" if after is State.BLACKLISTED else ""
            yield Notice(f"server {server}", failed)
        case schema.SafeEnd(action=action, why=why):
            cause = f"The flight cannot go on, {SAFE_ENDS[action]}: {why}"
            yield _alarm("safe end", cause, "Be ready to take over.")
        case schema.Foreseen(finish_by_s=float(finish_by_s), lightest_s=float(lightest_s)) if not event.fits:
            late = f"The mission is expected to end after {lightest_s:.0f} s, later than {finish_by_s:g} s"
            yield Notice("late", late)
        case schema.ControlChanged(owner=Owner.PROGRAM):
            yield Notice("control")
        case schema.ControlChanged(owner=owner, why=why):
            cause = f"{who_has_it(owner)} has the vehicle: {why}"
            yield Notice("hovering")
            yield _alarm("control", cause[:1].upper() + cause[1:], "Nothing is sent to it any more.")
        case schema.PositionDoubted(jumped_m=jumped_m):
            doubt = f"The vehicle's reported position jumped {jumped_m:.0f} m, farther than it can fly"
            yield _alarm("position", doubt, "Look where it is.") if jumped_m else Notice("position")
        case schema.ArmingDelayed(reasons=reasons):
            said = "; ".join(reasons) or "it does not say why"
            yield Notice("arming", f"The vehicle cannot be armed yet: {said}")
        case schema.VehicleSetting(name=name, value=value, advice=advice):
            yield Notice(f"setting {name}", f"The vehicle's {name} is {known(value)}: {advice}")
        case schema.VehicleFound(firmware=firmware, version=version):
            unknown = "" if version else f"The vehicle does not tell the version of its {firmware}"
            yield Notice("version", unknown, "Check that the version is new enough." if unknown else "")
        case schema.Shortened(of=of, why=why):
            yield Notice("shortened", f"The log has a part of an event alone ({of.replace('_', ' ')}): {why}")
        case schema.EventsLost(count=count):
            yield Notice("events", f"{counted(count, 'event')} of the log could not be kept")
