"""The events of a flight as sentences for a person, during the flight or afterwards."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum

from upwash.core.knowledge.servers import State
from upwash.core.vehicle.control import Owner
from upwash.core.vehicle.way_home import in_words
from upwash.eventlog import schema
from upwash.eventlog.progress import CallPlaces, MissionTime
from upwash.eventlog.results import RunResult
from upwash.eventlog.schema import SEVERITIES, Event
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
# Most events of a long log are of these kinds: a set lookup is faster than a match statement.
_WITHOUT_SENTENCE = frozenset({schema.PhotoTaken, schema.Decided, schema.CallStarted})
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
    """Ascending numbers as text: "0-4, 7"."""
    stretches = []
    for _, stretch in itertools.groupby(enumerate(indices), key=lambda pair: pair[1] - pair[0]):
        members = [index for _, index in stretch]
        stretches.append(str(members[0]) if len(members) == 1 else f"{members[0]}-{members[-1]}")
    return ", ".join(stretches)


def ran_on(server: str | None) -> str:
    """The place of a call as text: "on s1", "on the drone"."""
    return "on the drone" if server is None else f"on {server}"


def counted(number: int, noun: str) -> str:
    """A number with its noun: "1 call", "2 calls"."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


class Tone(StrEnum):
    """The importance of a sentence, which decides its colour."""

    PLAIN = "plain"
    ASIDE = "aside"  # changes nothing for the mission
    CHECKING = "checking"
    READY = "ready"
    REMOTE = "remote"  # a remote call
    FOUND = "found"  # a message of the mission to its user
    TROUBLE = "trouble"  # a failure that does not end the flight
    ALARM = "alarm"  # a person must act


MEANINGS = {  # CHECK-R means the same as CHECK
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
    """The tone of a server state."""
    return _STATE_TONES.get(state, Tone.ASIDE)


@dataclass(frozen=True, slots=True)
class Sentence:
    """One sentence."""

    text: str
    tone: Tone = Tone.PLAIN


class Narrator:
    """Turns the events of one flight, in their order, into sentences, and knows what the drone is doing."""

    def __init__(self) -> None:
        self.doing = "starting the services of the drone"
        self.where = ""
        self._reached: set[int] = set()
        self._whereabouts = CallPlaces()
        self._knows_servers = True  # until the plan says otherwise
        self.began = MissionTime()
        self.started = False  # whether the mission has begun
        self.waits_since_s: float | None = None  # the begin of the wait for arming; None without a wait
        self.waits_for = ""  # the vehicle's reasons
        self.down_s: float | None = None  # to the ground, while the program brings the vehicle down
        self.control = ""  # who controls the vehicle, since when and why; empty for the program

    @property
    def reached(self) -> int:
        """The number of waypoints reached."""
        return len(self._reached)

    def tell(self, event: Event) -> Sentence | None:
        """The sentence of an event; None for an event without one."""
        self._whereabouts.take(event)
        self.began.take(event)
        if isinstance(event, schema.Planned):
            self._knows_servers = event.has_servers
        if type(event) in _WITHOUT_SENTENCE:
            return None
        match event:
            case schema.PositionReport(east_m=east_m, north_m=north_m, altitude_m=altitude_m):
                self.down_s = event.down_s
                self.where = f"{east_m:.0f} m east, {north_m:.0f} m north, {altitude_m:.0f} m up"
                return None
            case schema.Call():
                return self._call(event)
            case schema.ServerStep(server=server, before=before, after=after, why=why):
                because = f" ({why})" if why else ""
                return Sentence(f"{server}: {before} → {after}{because}", tone_of(after))
            case schema.SetOff(waypoint=waypoint, back=back):
                self.doing = f"flying {'back ' * back}to {named(waypoint)}"
                return None
            case schema.Arrived(waypoint=waypoint, hold_s=hold_s):
                self.doing = f"at {named(waypoint)}" + (f", for {hold_s:g} s as planned" if hold_s else "")
                if waypoint is not None:
                    self._reached.add(waypoint)
                return None
            case schema.Notified(message=message):
                return Sentence(f"told the user: {in_one_line(message)}", Tone.FOUND)
            case _:
                said = (
                    self._course(event) or self._vehicle(event) or self._link(event) or _vehicle_report(event)
                )
                return said or _ending(event) or _failure(event) or _clock(event)

    def _course(self, event: Event) -> Sentence | None:
        match event:
            case schema.LocalReady(service=service):
                return Sentence(f"{service} is ready on the drone")
            case schema.Planned(order_why=str(why)) if why:
                return Sentence(f"order of the waypoints: {why}")
            case schema.MissionStarted(policy=policy, done=done):
                self.started = True
                self.doing = "before take-off"
                self._reached = set(done)
                before = f"taken up again, {len(done)} waypoints done before" if done else "started"
                under = f", policy {policy}" if self._knows_servers else ""
                return Sentence(f"mission {before}{under}")
            case schema.Demanded(waypoint=waypoint, failed=failed):
                if failed:
                    return Sentence(f"the call at {named(waypoint)} failed: {failed}", Tone.TROUBLE)
                return Sentence(f"the answer at {named(waypoint)} demands something", Tone.FOUND)
            case schema.TurnedBack(waypoint=waypoint):
                return Sentence(f"turning back to {named(waypoint)}, for its answer", Tone.FOUND)
            case schema.Foreseen():
                return _foreseen(event)
            case schema.Returning():
                self.doing = "returning"
                return Sentence("returning home to land")
            case schema.LeftToPilot(why=why) if self.control:  # which was said
                return Sentence(why.rpartition("; ")[2], Tone.ALARM)
            case schema.Landed():
                self.doing = "landed"
                return Sentence("landed")
            case schema.SafeEnd(action=action, why=why):
                self.doing = SAFE_ENDS[action]
                return Sentence(f"{self.doing}: {why}", Tone.ALARM)
            case schema.LeftHovering():
                self.doing = "hovering"
                return Sentence(LEFT_HOVERING, Tone.ALARM)
        return None

    def _call(self, call: schema.Call) -> Sentence:
        waited = f" after waiting {call.waited_s:.1f} s" if call.wait else ""
        why = f" ({call.decision})" if self._knows_servers else ""
        asked_at = self._whereabouts.of_call
        where = self.doing if asked_at == self._whereabouts.here else f"{self.doing}, for {named(asked_at)}"
        return Sentence(
            f"{where}: {call.operation} {ran_on(call.server)}, {call.delay_s:.2f} s{waited}{why}",
            Tone.PLAIN if call.server is None else Tone.REMOTE,
        )

    def _vehicle(self, event: Event) -> Sentence | None:
        """Control of the vehicle, take-off and landing."""
        match event:
            case schema.ControlChanged(owner=owner, why=why):
                taken = f"{who_has_it(owner)} has the vehicle since {self.began.text(event.t)}: {why}"
                self.control = "" if owner == Owner.PROGRAM else taken
                self.waits_since_s = None
                return _control(owner, why)
            case schema.ArmingDelayed(reasons=reasons):
                if self.waits_since_s is None:
                    self.waits_since_s = event.t
                self.doing = "waiting until the vehicle can be armed"
                self.waits_for = "; ".join(reasons) or "the vehicle does not say why yet"
                return Sentence(f"{self.doing}: {self.waits_for}", Tone.TROUBLE)
            case schema.Arming():
                self.waits_since_s = None
                self.doing = "arming"
                return Sentence("arming")
            case schema.Armed():
                self.waits_since_s = None
                self.doing = "armed"
                return Sentence("armed")
            case schema.Turned(heading_deg=heading_deg):
                return Sentence(f"turned to {heading_deg:g}°")
            case schema.PayloadCommanded(name=name):
                return Sentence(f"the payload did {name}")
            case schema.TextSent(text=text):
                return Sentence(f"told the ground station: {text}")
            case schema.TakingOff(altitude_m=altitude_m):
                self.doing = f"climbing to {altitude_m:g} m"
                return Sentence(self.doing)
            case schema.TookOff(altitude_m=altitude_m):
                self.doing = "in the air"
                return Sentence(f"took off to {altitude_m:g} m")
            case schema.Stood():
                self.doing = "on the ground"
                return Sentence("the vehicle stands on the ground")
        return None

    def _link(self, event: Event) -> Sentence | None:
        """The link to the vehicle."""
        match event:
            case schema.UnsignedPort(why=why) | schema.SiteDoubt(why=why) | schema.LinkTrouble(why=why):
                return Sentence(why, Tone.TROUBLE)
            case schema.WaitingForVehicle(why=why, waited_s=waited_s, within_s=within_s):
                self.doing = "waiting for the vehicle"
                return Sentence(f"{self.doing} for {waited_s:.0f} of {within_s:g} s: {why}", Tone.TROUBLE)
            case schema.VehicleFound(system=system, component=component, firmware=firmware):
                self.doing = "starting the services of the drone"
                version = event.version or "of an unknown version"
                return Sentence(
                    f"the vehicle is system {system}, component {component} ({firmware} {version}, {event.type})",
                    Tone.ASIDE if event.version else Tone.TROUBLE,
                )
            case schema.LinkLost(silent_s=silent_s):
                return Sentence(f"the vehicle is not heard any more, for {silent_s:.1f} s", Tone.TROUBLE)
            case schema.LinkRestored(silent_s=silent_s):
                return Sentence(f"the vehicle is heard again, after {silent_s:.1f} s")
        return None


def _vehicle_report(event: Event) -> Sentence | None:
    """Texts and settings of the vehicle. Its reasons not to arm are left to `arming_delayed`."""
    match event:
        case schema.VehicleSaid(severity=severity, text=text) if severity <= WARNING:
            if text.startswith(("PreArm: ", "Arm: ")):
                return None
            return Sentence(f"the vehicle says: {text} ({SEVERITIES[severity]})", Tone.TROUBLE)
        case schema.VehicleSetting(name=name, value=value, advice=advice):
            return Sentence(f"the vehicle's {name} is {known(value)}: {advice}", Tone.TROUBLE)
        case schema.PositionDoubted(jumped_m=jumped_m):
            return _doubt(jumped_m)
        case schema.HomeMoved(east_m=east_m, north_m=north_m, altitude_m=altitude_m):
            there = f"{east_m:.0f} m east, {north_m:.0f} m north, {abs(altitude_m):.0f} m "
            there += "higher" if altitude_m >= 0 else "lower"
            return Sentence(
                f"the vehicle's home was moved to {there}: the vehicle returns there", Tone.TROUBLE
            )
        case schema.DeadManSet(silence_s=silence_s, action=action):
            doing = "returns" if action == "return" else "lands"
            said = f"the autopilot {doing} if it does not hear this program for {silence_s:g} s"
            return Sentence(said, Tone.ASIDE)
        case schema.Energy(left_percent=left, home_s=home_s, margin_percent=spare, guessed=guessed):
            said = f"battery {left:.0f} %, {home_s:.0f} s to the landing, {spare:.0f} % to spare"
            return Sentence(f"{said} ({in_words(guessed)})" if guessed else said, Tone.ASIDE)
    return None


def known(value: float | None) -> str:
    """A value as text, or "not known"."""
    return "not known" if value is None else f"{value:g}"


def who_has_it(owner: str) -> str:
    """The owner of the vehicle as text."""
    return _OWNERS[Owner(owner)]


def _doubt(jumped_m: float) -> Sentence:
    if not jumped_m:
        return Sentence("the vehicle's position can be true again")
    said = (
        f"the vehicle's reported position jumped {jumped_m:.0f} m, farther than it can fly: no arrival counts"
    )
    return Sentence(said, Tone.TROUBLE)


def _control(owner: str, why: str) -> Sentence:
    if owner == Owner.PROGRAM:
        return Sentence(f"the program has the vehicle: {why}", Tone.ASIDE)
    return Sentence(f"{who_has_it(owner)} has the vehicle: {why}; nothing is sent to it any more", Tone.ALARM)


def _ending(event: Event) -> Sentence | None:
    match event:
        case schema.Stopping(why=why):
            return Sentence(
                f"stopping: {why} (Ctrl-C from now on ends the program at once, and leaves the vehicle to itself)",
                Tone.ALARM,
            )
        case schema.LeftToPilot(why=why):
            return Sentence(f"nothing more is sent to the vehicle: {why}", Tone.ALARM)
        case schema.MissionEnded(why=why):
            return Sentence(f"mission ended: {why.removeprefix('mission: ')}", Tone.ALARM)
        case schema.FollowingEnded(why=why):
            return Sentence(f"{event.kind.replace('_', ' ')}: {why}", Tone.ALARM)
    return None


def _clock(event: Event) -> Sentence | None:
    match event:
        case schema.WaitingForTheTime(why=why):
            return Sentence(f"waiting for the vehicle's GPS to tell the time: {why}", Tone.TROUBLE)
        case schema.ClockSet(before=before, after=after):
            return Sentence(
                f"this computer's clock said {before.isoformat()}: set to {after.isoformat()}, as the vehicle's GPS "
                "has it"
            )
        case schema.ClockDiffers(clock=clock, gps=gps, why=why):
            return Sentence(
                f"this computer's clock says {clock}, the vehicle's GPS {gps}: left as it is, {why}",
                Tone.TROUBLE,
            )
    return None


def _failure(event: Event) -> Sentence | None:
    if isinstance(event, _FAILURES):
        return Sentence(f"{event.kind.replace('_', ' ')}: {event.why}", Tone.TROUBLE)
    match event:
        case schema.Shortened(of=of, why=why):
            said = f"the log has no more than a part of what it was told ({of.replace('_', ' ')}): {why}"
            return Sentence(said, Tone.TROUBLE)
        case schema.RemoteRaised(server=server, operation=operation, raised=raised):
            said = f"{server} says that {operation} raised {raised}; making the call on the drone"
            return Sentence(said, Tone.TROUBLE)
        case schema.LocalEnded(service=service, how=how):
            return Sentence(f"{service} on the drone ended ({how}); starting it again", Tone.TROUBLE)
    return None


def _foreseen(event: schema.Foreseen) -> Sentence:
    expected = f"expected to be over after {event.as_asked_s:.0f} s"
    if event.finish_by_s is None or event.lightest_s is None:
        return Sentence(expected, Tone.ASIDE)
    expected += f", and with every call lighter after {event.lightest_s:.0f} s"
    if not event.fits:
        return Sentence(f"{expected}: too late for finish_by_s = {event.finish_by_s:g}", Tone.ALARM)
    return Sentence(f"{expected}; to be over by {event.finish_by_s:g} s", Tone.ASIDE)


def named(waypoint: int | None) -> str:
    """A waypoint, as a sentence names it."""
    return "a place beside the plan" if waypoint is None else f"waypoint {waypoint}"


def in_one_line(message: object) -> str:
    """A message to the user: detections by their number and labels, other messages unchanged."""
    if isinstance(message, list) and all(isinstance(item, dict) and "label" in item for item in message):
        labels = Counter(str(item["label"]) for item in message)
        message = ", ".join(f"{count} x {label}" for label, count in labels.items())
    return printable(str(message))


def left_undone(result: RunResult) -> Iterator[str]:
    """What a mission left undone at waypoints: demands, failed calls, and answers that it did not take."""
    if result.not_acted_on:
        one = len(result.not_acted_on) == 1
        answers = "the answer at" if one else "the answers at"
        yield f"not done: what {answers} {_places(result.not_acted_on)} {'demands' if one else 'demand'}"
    if result.failed_calls:
        calls = "the call" if len(result.failed_calls) == 1 else "the calls"
        yield f"{calls} at {_places(result.failed_calls)} failed, and the mission did nothing about it"
    if result.not_looked_at:
        answers = "the answer" if len(result.not_looked_at) == 1 else "the answers"
        yield f"not looked at: {answers} at {_places(result.not_looked_at)}"


def _places(waypoints: Sequence[int | None]) -> str:
    planned = [waypoint for waypoint in waypoints if waypoint is not None]
    beside = ["a place beside the plan"] if len(planned) < len(waypoints) else []
    noun = "waypoint" if len(planned) == 1 else "waypoints"
    return " and ".join([*([f"{noun} {spans(planned)}"] if planned else []), *beside])
