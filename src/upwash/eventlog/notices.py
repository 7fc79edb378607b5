"""What a person has to act on, or should know, of a flight: each notice from its event until its cause is over."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
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
_ON_GROUND = (schema.Landed, schema.Disarmed, schema.Stood)


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
        yield from _course(event)
        yield from _vehicle(event)
        yield from _link(event)
        yield from _defects(event)
        match event:
            case schema.ServerStep(server=server, after=State.BLACKLISTED, why=why):
                yield Notice(f"server {server}", f"{server} is not used: {why or 'it failed'}")
            case schema.ServerStep(server=server):
                yield Notice(f"server {server}")
            case schema.Call(fell_back=True):
                self._fell_back += 1
                fell = counted(self._fell_back, "call")
                yield Notice("fallbacks", f"{fell} fell back to the drone, as a server gave no usable answer")
            case schema.VehicleSaid(severity=severity, text=text) if severity <= WARNING:
                key = f"vehicle {self._said % _SAID_AT_ONCE}"
                self._said += 1
                yield Notice(key, f"The vehicle says: {text} ({SEVERITIES[severity]})")


def _course(event: Event) -> Iterator[Notice]:
    """How the flight goes, and ends."""
    match event:
        case schema.LeftHovering():
            yield Notice("safe end")
            yield _alarm("hovering", "The vehicle hovers where it is, and nobody flies it", _TAKE_OVER)
        case schema.SafeEnd(action=action, why=why):
            yield _alarm(
                "safe end", f"The flight cannot go on, {SAFE_ENDS[action]}: {why}", "Be ready to take over."
            )
        case schema.SafeEndFailed(action=action, why=why):
            yield _alarm("safe end", f"The vehicle did not do as told ({action}): {why}", _TAKE_OVER)
        case schema.Stopping(why=why):
            yield _alarm("stopping", f"The mission is being ended: {why}")
        case schema.MissionEnded(why=why):
            yield Notice("stopping")
            yield _alarm("ended", f"The mission ended early: {why}")
        case schema.MissionCompleted():
            yield Notice("stopping")
        case schema.LogResumed():
            for key in ("ended", "safe end", "stopping", "hovering", "left"):
                yield Notice(key)
        case schema.Foreseen(finish_by_s=float(finish_by_s), lightest_s=float(lightest_s)) if not event.fits:
            yield Notice(
                "late",
                f"The mission is expected to end after {lightest_s:.0f} s, later than {finish_by_s:g} s",
            )


def _vehicle(event: Event) -> Iterator[Notice]:
    """Who has the vehicle, and what it waits for."""
    match event:
        case schema.ControlChanged(owner=Owner.PROGRAM):
            yield Notice("control")
        case schema.ControlChanged(owner=owner, why=why):
            cause = _sentence(f"{who_has_it(owner)} has the vehicle: {why}")
            yield Notice("hovering")
            yield _alarm("control", cause, "Nothing is sent to it any more.")
        case schema.LeftToPilot(why=why):
            yield _alarm("left", f"Nothing is sent to the vehicle any more: {why}", _TAKE_OVER)
        case schema.PositionDoubted(jumped_m=jumped_m):
            doubt = f"The vehicle's reported position jumped {jumped_m:.0f} m, farther than it can fly"
            yield _alarm("position", doubt, "Look where it is.") if jumped_m else Notice("position")
        case schema.HomeMoved():
            yield Notice("home", "The vehicle's home was moved in flight: it returns to the new home")
        case schema.ArmingDelayed(reasons=reasons):
            said = "; ".join(reasons) or "it does not say why"
            yield Notice("arming", f"The vehicle cannot be armed yet: {said}")
        case schema.Armed():
            yield Notice("arming")
        case schema.VehicleSetting(name=name, value=value, advice=advice):
            yield Notice(f"setting {name}", f"The vehicle's {name} is {known(value)}: {advice}")
    if isinstance(event, _ON_GROUND):
        for key in ("hovering", "safe end", "left", "link", "position", "home"):
            yield Notice(key)


def _link(event: Event) -> Iterator[Notice]:
    """The link to the vehicle."""
    match event:
        case schema.WaitingForVehicle(why=why):
            yield Notice("waiting", f"The vehicle is waited for: {why}")
        case schema.VehicleFound(firmware=firmware, version=version):
            yield Notice("waiting")
            unknown = "" if version else f"The vehicle does not tell the version of its {firmware}"
            yield Notice("version", unknown, "Check that the version is new enough." if unknown else "")
        case schema.LinkLost(silent_s=silent_s):
            yield _alarm(
                "link", f"The vehicle has not been heard for {silent_s:.1f} s", "Be ready to take over."
            )
        case schema.LinkRestored():
            yield Notice("link")
        case schema.LinkTrouble(about=about, why=why):
            yield Notice(f"link {about}", _sentence(why))


def _defects(event: Event) -> Iterator[Notice]:
    """What does not work from now on, or is in doubt."""
    match event:
        case schema.OffloadingFailed(why=why):
            yield Notice("offloading", f"Every call runs on the drone from now on, after a defect: {why}")
        case schema.UnsignedPort(why=why):
            yield Notice("unsigned", _sentence(why))
        case schema.SiteDoubt(why=why):
            yield Notice(f"site {why}", _sentence(why))
        case schema.DeadManFailed(why=why):
            yield Notice("dead man", f"The autopilot will not notice a silence of this program: {why}")
        case schema.BatteryWatchFailed(why=why):
            yield Notice("battery", f"The battery is not watched: {why}")
        case schema.BorderWatchFailed(why=why):
            yield Notice("border", f"Borders of ranges are noticed late: {why}")
        case schema.CoverageNotKept(why=why):
            yield Notice("coverage", f"The coverage map is as it was before the flight: {why}")
        case schema.Shortened(of=of, why=why):
            yield Notice("shortened", f"The log has a part of an event alone ({of.replace('_', ' ')}): {why}")
        case schema.EventsLost(count=count):
            yield Notice("events", f"{counted(count, 'event')} of the log could not be kept")


def _sentence(words: str) -> str:
    return words[:1].upper() + words[1:]


def _alarm(key: str, cause: str, action: str = "") -> Notice:
    return Notice(key, cause, action, Level.ALARM)
