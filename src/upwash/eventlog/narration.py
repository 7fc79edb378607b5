"""What the events of a flight say to a person, a sentence each, while it lasts or afterwards."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from upwash.core.knowledge.servers import State
from upwash.core.vehicle.control import Owner
from upwash.core.vehicle.energy import in_words
from upwash.eventlog import schema
from upwash.eventlog.beginning import Beginning
from upwash.eventlog.schema import SEVERITIES, Event
from upwash.eventlog.whereabouts import Whereabouts
from upwash.support.text import printable

SAFE_ENDS = {
    "return": "returning to land",
    "land": "landing where it is",
    "hold": "stopping to hover",
    "disarm": "disarming on the ground",
}
WARNING = 4
_FAILURES = (
    schema.LocalFailed,
    schema.RemoteFailed,
    schema.LeaveFailed,
    schema.SafeEndFailed,
    schema.DeadManFailed,
    schema.BatteryWatchFailed,
    schema.BorderWatchFailed,
    schema.CoverageNotKept,
    schema.OffloadingFailed,
)
# Most events of a long log are of few kinds: each case of a match takes time.
_NEVER_TOLD = frozenset({schema.Photo, schema.Decided, schema.CallStarted})
_OWNERS = {
    Owner.NOBODY: "nobody",
    Owner.PROGRAM: "the program",
    Owner.PILOT: "the pilot",
    Owner.GROUND_STATION: "a ground station or another program",
    Owner.FAILSAFE: "a fail-safe",
    Owner.UNKNOWN: "nobody known",
}
LEFT_HOVERING = "The vehicle hovers where it is, and nobody flies it now: take over with the remote control."
WAS_LEFT_HOVERING = "The vehicle hovered where it was, and nobody flew it: a pilot had to take over."


def spans(indices: Sequence[int]) -> str:
    """Ascending numbers as a person writes them: "0-4, 7"."""
    stretches = []
    for _, stretch in itertools.groupby(enumerate(indices), key=lambda each: each[1] - each[0]):
        members = [index for _, index in stretch]
        stretches.append(str(members[0]) if len(members) == 1 else f"{members[0]}-{members[-1]}")
    return ", ".join(stretches)


def ran_on(server: str | None) -> str:
    """Where a call ran, as a sentence says it: on that server, or on the drone."""
    return "on the drone" if server is None else f"on {server}"


def counted(number: int, noun: str) -> str:
    """A number with its noun: 1 call, 2 calls."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


class Tone(StrEnum):
    """How a sentence is meant."""

    PLAIN = "plain"
    ASIDE = "aside"  # what changes nothing for the mission
    CHECKING = "checking"
    READY = "ready"
    REMOTE = "remote"  # a call that ran on a server
    FOUND = "found"  # what the mission tells its user
    TROUBLE = "trouble"  # a failure after which the flight goes on
    ALARM = "alarm"  # a person should look


MEANINGS = {  # CHECK-R means what CHECK does
    State.AVL: "available",
    State.AVL_R: "available, its services running",
    State.CHECK: "being checked",
    State.READY: "ready for calls",
    State.BLACKLISTED: "blacklisted",
}
_STATE_TONES: dict[str, Tone] = {
    State.READY: Tone.READY,
    State.CHECK: Tone.CHECKING,
    State.CHECK_R: Tone.CHECKING,
    State.BLACKLISTED: Tone.TROUBLE,
}


def tone_of(state: str) -> Tone:
    """How it is meant that a server is in that state."""
    return _STATE_TONES.get(state, Tone.ASIDE)


@dataclass(frozen=True, slots=True)
class Said:
    """One sentence."""

    text: str
    tone: Tone = Tone.PLAIN


class Narrator:
    """Follows the events of one flight in their order, and knows what the drone is doing."""

    def __init__(self) -> None:
        self.doing = "starting the services of the drone"
        self.where = ""
        self._reached: set[int] = set()
        self._whereabouts = Whereabouts()
        self._knows_servers = True  # until the plan says otherwise
        self.began = Beginning()
        self.started = False  # whether the mission has begun
        self.waits_since_s: float | None = None  # until the vehicle can be armed; None while it does not
        self.waits_for = ""  # the reasons that the vehicle gives
        self.down_s: float | None = None  # until it is on the ground, while the program brings it down
        self.control = ""  # who has the vehicle, since when and why; empty while the program has

    @property
    def reached(self) -> int:
        """How many waypoints."""
        return len(self._reached)

    def tell(self, event: Event) -> Said | None:
        """What the event says; None for an event without a sentence."""
        self._whereabouts.take(event)
        self.began.take(event)
        if isinstance(event, schema.Planned):
            self._knows_servers = event.has_servers
        if type(event) in _NEVER_TOLD:
            return None
        match event:
            case schema.PositionReport(east_m=east_m, north_m=north_m, altitude_m=altitude_m):
                self.down_s = event.down_s
                self.where = f"{east_m:.0f} m east, {north_m:.0f} m north, {altitude_m:.0f} m up"
                return None
            case schema.Call():
                return self._call(event)
            case schema.Step(server=server, before=before, after=after, why=why):
                because = f" ({why})" if why else ""
                return Said(f"{server}: {before} → {after}{because}", tone_of(after))
            case schema.Leg(waypoint=waypoint, back=back):
                self.doing = f"flying {'back ' * back}to {named(waypoint)}"
                return None
            case schema.Arrived(waypoint=waypoint, hold_s=hold_s):
                self.doing = f"at {named(waypoint)}" + (f", for {hold_s:g} s as planned" if hold_s else "")
                if waypoint is not None:
                    self._reached.add(waypoint)
                return None
            case schema.Notified(message=message):
                return Said(f"told the user: {in_one_line(message)}", Tone.FOUND)
            case _:
                said = (
                    self._course(event) or self._vehicle(event) or self._link(event) or _vehicle_told(event)
                )
                return said or _ending(event) or _failure(event) or _clock(event)

    def _course(self, event: Event) -> Said | None:
        match event:
            case schema.LocalReady(service=service):
                return Said(f"{service} is ready on the drone")
            case schema.Planned(order_why=str(why)) if why:
                return Said(f"order of the waypoints: {why}")
            case schema.MissionStarted(policy=policy, done=done):
                self.started = True
                self.doing = "before take-off"
                self._reached = set(done)
                before = f"taken up again, {len(done)} waypoints done before" if done else "started"
                under = f", policy {policy}" if self._knows_servers else ""
                return Said(f"mission {before}{under}")
            case schema.Demanded(waypoint=waypoint, failed=failed):
                if failed:
                    return Said(f"the call at {named(waypoint)} failed: {failed}", Tone.TROUBLE)
                return Said(f"the answer at {named(waypoint)} demands something", Tone.FOUND)
            case schema.TurnedBack(waypoint=waypoint):
                return Said(f"turning back to {named(waypoint)}, for its answer", Tone.FOUND)
            case schema.Foreseen():
                return _foreseen(event)
            case schema.Returning():
                self.doing = "returning"
                return Said("returning home to land")
            case schema.LeftToPilot(why=why) if self.control:  # which was said
                return Said(why.rpartition("; ")[2], Tone.ALARM)
            case schema.Landed():
                self.doing = "landed"
                return Said("landed")
            case schema.SafeEnd(action=action, why=why):
                self.doing = SAFE_ENDS[action]
                return Said(f"{self.doing}: {why}", Tone.ALARM)
            case schema.LeftHovering():
                self.doing = "hovering"
                return Said(LEFT_HOVERING, Tone.ALARM)
        return None

    def _call(self, call: schema.Call) -> Said:
        waited = f" after waiting {call.waited_s:.1f} s" if call.wait else ""
        why = f" ({call.decision})" if self._knows_servers else ""
        asked_at = self._whereabouts.of_call
        where = self.doing if asked_at == self._whereabouts.here else f"{self.doing}, for {named(asked_at)}"
        return Said(
            f"{where}: {call.operation} {ran_on(call.server)}, {call.delay_s:.2f} s{waited}{why}",
            Tone.PLAIN if call.server is None else Tone.REMOTE,
        )

    def _vehicle(self, event: Event) -> Said | None:
        """Who has the vehicle, and how it gets into the air and down again."""
        match event:
            case schema.Control(owner=owner, why=why):
                taken = f"{who_has_it(owner)} has the vehicle since {self.began.told(event.t)}: {why}"
                self.control = "" if owner == Owner.PROGRAM else taken
                self.waits_since_s = None
                return _control(owner, why)
            case schema.ArmingDelayed(reasons=reasons):
                if self.waits_since_s is None:
                    self.waits_since_s = event.t
                self.doing = "waiting until the vehicle can be armed"
                self.waits_for = "; ".join(reasons) or "the vehicle does not say why yet"
                return Said(f"{self.doing}: {self.waits_for}", Tone.TROUBLE)
            case schema.Arming():
                self.waits_since_s = None
                self.doing = "arming"
                return Said("arming")
            case schema.Armed():
                self.waits_since_s = None
                self.doing = "armed"
                return Said("armed")
            case schema.Turned(heading_deg=heading_deg):
                return Said(f"turned to {heading_deg:g}°")
            case schema.PayloadCommanded(name=name):
                return Said(f"the payload did {name}")
            case schema.TextSent(text=text):
                return Said(f"told the ground station: {text}")
            case schema.TakingOff(altitude_m=altitude_m):
                self.doing = f"climbing to {altitude_m:g} m"
                return Said(self.doing)
            case schema.TookOff(altitude_m=altitude_m):
                self.doing = "in the air"
                return Said(f"took off to {altitude_m:g} m")
            case schema.Stood():
                self.doing = "on the ground"
                return Said("the vehicle stands on the ground")
        return None

    def _link(self, event: Event) -> Said | None:
        """Which vehicle is heard, and how well."""
        match event:
            case schema.UnsignedPort(why=why) | schema.SiteDoubt(why=why) | schema.LinkTrouble(why=why):
                return Said(why, Tone.TROUBLE)
            case schema.WaitingForVehicle(why=why, waited_s=waited_s, within_s=within_s):
                self.doing = "waiting for the vehicle"
                return Said(f"{self.doing} for {waited_s:.0f} of {within_s:g} s: {why}", Tone.TROUBLE)
            case schema.VehicleFound(system=system, component=component, firmware=firmware):
                self.doing = "starting the services of the drone"
                version = event.version or "of an unknown version"
                return Said(
                    f"the vehicle is system {system}, component {component} ({firmware} {version}, {event.type})",
                    Tone.ASIDE if event.version else Tone.TROUBLE,
                )
            case schema.LinkLost(silent_s=silent_s):
                return Said(f"the vehicle is not heard any more, for {silent_s:.1f} s", Tone.TROUBLE)
            case schema.LinkRestored(silent_s=silent_s):
                return Said(f"the vehicle is heard again, after {silent_s:.1f} s")
        return None


def _vehicle_told(event: Event) -> Said | None:
    """The vehicle's own words, without its reasons not to arm: `arming_delayed` has them."""
    match event:
        case schema.VehicleSaid(severity=severity, text=text) if severity <= WARNING:
            if text.startswith(("PreArm: ", "Arm: ")):
                return None
            return Said(f"the vehicle says: {text} ({SEVERITIES[severity]})", Tone.TROUBLE)
        case schema.VehicleSetting(name=name, value=value, advice=advice):
            return Said(f"the vehicle's {name} is {known(value)}: {advice}", Tone.TROUBLE)
        case schema.PositionDoubted(jumped_m=jumped_m):
            return _doubt(jumped_m)
        case schema.HomeMoved(east_m=east_m, north_m=north_m, altitude_m=altitude_m):
            there = f"{east_m:.0f} m east, {north_m:.0f} m north, {abs(altitude_m):.0f} m "
            there += "higher" if altitude_m >= 0 else "lower"
            return Said(f"the vehicle's home was moved to {there}: the vehicle returns there", Tone.TROUBLE)
        case schema.DeadManSet(silence_s=silence_s, action=action):
            doing = "returns" if action == "return" else "lands"
            said = f"the autopilot {doing} if it does not hear this program for {silence_s:g} s"
            return Said(said, Tone.ASIDE)
        case schema.Energy(left_percent=left, home_s=home_s, margin_percent=spare, guessed=guessed):
            said = f"battery {left:.0f} %, {home_s:.0f} s to the landing, {spare:.0f} % to spare"
            return Said(f"{said} ({in_words(guessed)})" if guessed else said, Tone.ASIDE)
    return None


def known(value: float | None) -> str:
    """A value, or that it is not known."""
    return "not known" if value is None else f"{value:g}"


def who_has_it(owner: str) -> str:
    """An owner of the vehicle, as a sentence names it."""
    return _OWNERS[Owner(owner)]


def _doubt(jumped_m: float) -> Said:
    if not jumped_m:
        return Said("the vehicle's position can be true again")
    said = (
        f"the vehicle's reported position jumped {jumped_m:.0f} m, farther than it can fly: no arrival counts"
    )
    return Said(said, Tone.TROUBLE)


def _control(owner: str, why: str) -> Said:
    if owner == Owner.PROGRAM:
        return Said(f"the program has the vehicle: {why}", Tone.ASIDE)
    return Said(f"{who_has_it(owner)} has the vehicle: {why}; nothing is sent to it any more", Tone.ALARM)


def _ending(event: Event) -> Said | None:
    match event:
        case schema.Stopping(why=why):
            return Said(
                f"stopping: {why} (Ctrl-C from now on ends the program at once, and leaves the vehicle to itself)",
                Tone.ALARM,
            )
        case schema.LeftToPilot(why=why):
            return Said(f"nothing more is sent to the vehicle: {why}", Tone.ALARM)
        case schema.MissionEnded(why=why):
            return Said(f"mission ended: {why.removeprefix('mission: ')}", Tone.ALARM)
        case schema.FollowingEnded(why=why):
            return Said(f"{event.kind.replace('_', ' ')}: {why}", Tone.ALARM)
    return None


def _clock(event: Event) -> Said | None:
    match event:
        case schema.WaitingForTheTime(why=why):
            return Said(f"waiting for the vehicle's GPS to tell the time: {why}", Tone.TROUBLE)
        case schema.ClockSet(before=before, after=after):
            return Said(
                f"this computer's clock said {before.isoformat()}: set to {after.isoformat()}, as the vehicle's GPS "
                "has it"
            )
        case schema.ClockDiffers(clock=clock, gps=gps, why=why):
            return Said(
                f"this computer's clock says {clock}, the vehicle's GPS {gps}: left as it is, {why}",
                Tone.TROUBLE,
            )
    return None


def _failure(event: Event) -> Said | None:
    if isinstance(event, _FAILURES):
        return Said(f"{event.kind.replace('_', ' ')}: {event.why}", Tone.TROUBLE)
    match event:
        case schema.Shortened(of=of, why=why):
            said = f"the log has no more than a part of what it was told ({of.replace('_', ' ')}): {why}"
            return Said(said, Tone.TROUBLE)
        case schema.RemoteRaised(server=server, operation=operation, raised=raised):
            said = f"{server} says that {operation} raised {raised}; making the call on the drone"
            return Said(said, Tone.TROUBLE)
        case schema.LocalEnded(service=service, how=how):
            return Said(f"{service} on the drone ended ({how}); starting it again", Tone.TROUBLE)
    return None


def _foreseen(event: schema.Foreseen) -> Said:
    expected = f"expected to be over after {event.as_asked_s:.0f} s"
    if event.finish_by_s is None or event.lightest_s is None:
        return Said(expected, Tone.ASIDE)
    expected += f", and with every call lighter after {event.lightest_s:.0f} s"
    if not event.fits:
        return Said(f"{expected}: too late for finish_by_s = {event.finish_by_s:g}", Tone.ALARM)
    return Said(f"{expected}; to be over by {event.finish_by_s:g} s", Tone.ASIDE)


def named(waypoint: int | None) -> str:
    """A waypoint, as a sentence names it."""
    return "a place beside the plan" if waypoint is None else f"waypoint {waypoint}"


def in_one_line(message: object) -> str:
    """A message to the user: detections by their number and labels, other messages unchanged."""
    if isinstance(message, list) and all(isinstance(item, dict) and "label" in item for item in message):
        labels = Counter(str(item["label"]) for item in message)
        message = ", ".join(f"{count} x {label}" for label, count in labels.items())
    return printable(str(message))
