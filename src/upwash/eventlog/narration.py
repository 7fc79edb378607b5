"""The events of a flight as sentences for a person, during the flight or afterwards."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

from upwash.core.knowledge.servers import CHECKING, SELECTED, State
from upwash.core.operation import title_of
from upwash.core.vehicle.control import Owner
from upwash.core.vehicle.way_home import in_words
from upwash.eventlog import schema
from upwash.eventlog.causes import ran_on
from upwash.eventlog.notices import SAFE_ENDS, WARNING, Level, left_of, notice_of, who_has_it
from upwash.eventlog.objects import count_of_kind, found_objects, noun_of
from upwash.eventlog.progress import MissionEnd
from upwash.eventlog.reasons import ExplainedCall, Reasons
from upwash.eventlog.schema import SEVERITIES, Event
from upwash.support.text import clock, counted, printable

_SHORTEST_S = 0.05  # the shortest time in line that a sentence has
# Most events of a long log are of these kinds: a set lookup is faster than a match statement.
_WITHOUT_SENTENCE = frozenset(
    {schema.PhotoTaken, schema.AutopilotPhoto, schema.Decided, schema.CallStarted, schema.FirstAnswer}
)


def spans(indices: Sequence[int]) -> str:
    """Ascending numbers as text: "0-4, 7"."""
    stretches = []
    for _, stretch in itertools.groupby(enumerate(indices), key=lambda pair: pair[1] - pair[0]):
        members = [index for _, index in stretch]
        stretches.append(str(members[0]) if len(members) == 1 else f"{members[0]}-{members[-1]}")
    return ", ".join(stretches)


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


STATE_WORDS: Mapping[str, str] = {  # what people read; the codes stand in logs and in reference alone
    State.AVL: "not joined",
    State.AVL_R: "running, not joined",
    State.CHECK: "joining",
    State.CHECK_R: "joining",
    State.READY: "ready",
    State.BLACKLISTED: "left alone",
}
_STATE_TONES: dict[str, Tone] = {
    State.READY: Tone.READY,
    State.CHECK: Tone.CHECKING,
    State.CHECK_R: Tone.CHECKING,
    State.BLACKLISTED: Tone.TROUBLE,
}


def _stands_after(event: Event) -> bool:
    """Whether the drone stays at a place from the event on."""
    if isinstance(event, schema.Arrived):
        return not event.passing
    return isinstance(event, schema.PhotosWait | schema.SoughtAnswers)


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
        self.stands = False  # at a place, for a photo or a call
        self.where = ""
        self._reached: set[int] = set()
        self._reasons = Reasons()
        self._knows_servers = True  # until the plan says otherwise
        self.began = self._reasons.began
        self._end = MissionEnd()
        self.started = False  # whether the mission has begun
        self.waits_since_s: float | None = None  # the begin of the wait for arming; None without a wait
        self.waits_for = ""  # the vehicle's reasons
        self.down_s: float | None = None  # to the ground, while the program brings the vehicle down
        self.control = ""  # who controls the vehicle, since when and why; empty for the program

    @property
    def reached(self) -> int:
        """The number of waypoints reached."""
        return len(self._reached)

    @property
    def open_answers(self) -> int:
        """The number of answers that the mission does not have yet."""
        return self._reasons.whereabouts.open_calls

    def left_s(self, t: float) -> float | None:
        """The time to the mission's end at that second of the log, by the forecast and the last arrival."""
        return None if self.began.at_s is None else self._end.left_s(t - self.began.at_s)

    def tell(self, event: Event) -> Sentence | None:
        """The sentence of an event; None for an event without one."""
        explained = self._reasons.take(event)
        self._end.take(event, self.began.at_s or 0.0)
        if type(event) in _WITHOUT_SENTENCE:
            return None
        before = self.doing
        self._follow(event)
        if self.doing != before:
            self.stands = _stands_after(event)
        if isinstance(explained, ExplainedCall):
            return self._call(explained)
        if isinstance(event, schema.LeftToPilot) and self.control:  # which was said
            return Sentence(event.why.rpartition("; ")[2], Tone.ALARM)
        if isinstance(event, schema.MissionStarted):
            before = (
                f"taken up again, {counted(len(event.done), 'waypoint')} done before"
                if event.done
                else "started"
            )
            return Sentence(f"mission {before}" + (f", policy {event.policy}" if self._knows_servers else ""))
        if (line := _LINE_OF.get(type(event))) is None:
            return _sentence(event) or self._of_notice(event)
        words, tone = line
        return Sentence(words.format(event=event, now=self), tone)

    def _of_notice(self, event: Event) -> Sentence | None:
        """What a person has to act on or should know; who has the vehicle already is not asked to take over."""
        notice = notice_of(event)
        if notice is None or not notice.cause:
            return None
        words = notice.cause if self.control else notice.words
        return Sentence(words, Tone.ALARM if notice.level is Level.ALARM else Tone.TROUBLE)

    def _follow(self, event: Event) -> None:
        """Take in what the drone does from the event on."""
        match event:
            case schema.PositionReport(east_m=east_m, north_m=north_m, altitude_m=altitude_m):
                self.down_s = event.down_s
                self.where = f"{east_m:.0f} m east, {north_m:.0f} m north, {altitude_m:.0f} m up"
            case schema.Planned():
                self._knows_servers = event.has_servers
            case schema.SetOff(waypoint=waypoint, back=back):
                self.doing = f"flying {'back ' * back}to {named(waypoint)}"
            case schema.Arrived(waypoint=waypoint, hold_s=hold_s):
                self.doing = f"at {named(waypoint)}" + (f", for {hold_s:g} s as planned" if hold_s else "")
                if waypoint is not None:
                    self._reached.add(waypoint)
            case schema.MissionStarted(done=done):
                self.started = True
                self._reached = set(done)
            case schema.ControlChanged(owner=owner, why=why):
                taken = f"{who_has_it(owner)} has the vehicle since {self.began.text(event.t)}: {why}"
                self.control = "" if owner == Owner.PROGRAM else taken
                self.waits_since_s = None
            case schema.ArmingDelayed(reasons=reasons):
                if self.waits_since_s is None:
                    self.waits_since_s = event.t
                self.waits_for = "; ".join(reasons) or "the vehicle does not say why yet"
            case schema.Arming() | schema.Armed():
                self.waits_since_s = None
            case schema.TakingOff(altitude_m=altitude_m):
                self.doing = f"climbing to {altitude_m:g} m"
            case schema.SafeEnd(action=action):
                self.doing = SAFE_ENDS[action]
        self.doing = _DOING.get(type(event), self.doing)

    def _call(self, explained: ExplainedCall) -> Sentence:
        call = explained.outcome
        waited = f" after waiting {call.waited_s:.1f} s" if call.wait else ""
        if call.queued_s and call.queued_s >= _SHORTEST_S:
            waited += f", {call.queued_s:.1f} s of that in line"
        why = f", as {explained.cause}" if explained.cause and self._knows_servers else ""
        where = self.doing if explained.waypoint is None else named(explained.waypoint)
        return Sentence(
            f"{where}: {title_of(call.operation)} {ran_on(call.server)}, {call.delay_s:.2f} s{waited}{why}",
            Tone.PLAIN if call.server is None else Tone.REMOTE,
        )


_DOING: Mapping[type[Event], str] = {  # from the event on
    schema.VehicleFound: "starting the services of the drone",
    schema.WaitingForVehicle: "waiting for the vehicle",
    schema.MissionStarted: "before take-off",
    schema.ArmingDelayed: "waiting until the vehicle can be armed",
    schema.Arming: "arming",
    schema.Armed: "armed",
    schema.TookOff: "in the air",
    schema.PhotosWait: "waiting for answers",
    schema.SoughtAnswers: "waiting for answers",
    schema.Returning: "returning",
    schema.LeftHovering: "hovering",
    schema.Landed: "landed",
    schema.Stood: "on the ground",
}
# The sentence of an event, from its fields (`event`) and the state of the narrator (`now`), by tone.
_LINES: Mapping[Tone, Mapping[type[Event], str]] = {
    Tone.PLAIN: {
        schema.SpeedChosen: "ground speed: {event.why}",
        schema.LocalReady: "{event.service} is ready on the drone",
        schema.Returning: "returning home to land",
        schema.Arming: "arming",
        schema.Armed: "armed",
        schema.Turned: "turned to {event.heading_deg:g}°",
        schema.PayloadCommanded: "the payload did {event.name}",
        schema.TextSent: "told the ground station: {event.text}",
        schema.TakingOff: "{now.doing}",
        schema.TookOff: "took off to {event.altitude_m:g} m",
        schema.Stood: "the vehicle stands on the ground",
        schema.LinkRestored: "the vehicle is heard again, after {event.silent_s:.1f} s",
    },
    Tone.TROUBLE: {
        schema.ArmingDelayed: "{now.doing}: {now.waits_for}",
        schema.Preferred: "calls go to {event.server} now: {event.why}",
        schema.Seconded: "{event.server} has not answered after {event.after_s:.2f} s; asking {event.second} too",
        schema.WaitingForVehicle: "{now.doing} for {event.waited_s:.0f} of {event.within_s:g} s: {event.why}",
        schema.RemoteRaised: "{event.server} says that {event.operation} raised {event.raised}; making the "
        "call on the drone",
        schema.RemoteFailed: "remote failed: {event.why}",
        schema.RemoteQueued: "not begun: {event.why}",
        schema.WaitingForTheTime: "waiting for the vehicle's GPS to tell the time: {event.why}",
    },
    Tone.ALARM: {
        schema.Stopping: "stopping: {event.why} (Ctrl-C from now on ends the program at once, and leaves "
        "the vehicle to itself)",
        schema.LeftToPilot: "nothing is sent to the vehicle any more: {event.why}",
    },
}
_LINE_OF = {kind: (words, tone) for tone, lines in _LINES.items() for kind, words in lines.items()}


def _of_act(event: schema.Demanded | schema.PutOff | schema.TurnedBack | schema.NotActed) -> Sentence:
    """The sentence about an act, at a waypoint or at an object."""
    waypoint = named(event.waypoint)
    match event:
        case schema.Demanded(failed=failed) if failed:
            return Sentence(f"the call at {waypoint} failed: {failed}", Tone.TROUBLE)
        case schema.Demanded(object=schema.FoundRecord(number=number, label=label)):
            found = f"object {number} ({noun_of(label)})"
            return Sentence(f"{found} is on the photo of {waypoint}: the drone will go there", Tone.FOUND)
        case schema.Demanded():
            return Sentence(f"the answer at {waypoint} asks for an act", Tone.FOUND)
        case schema.PutOff(object=number, extra_s=extra_s, at_once_s=at_once_s):
            where = waypoint if number is None else f"object {number}"
            costs = f"{extra_s:.0f} s longer then, {at_once_s:.0f} s at once"
            return Sentence(f"acting at {where} later: the way gets {costs}")
        case schema.TurnedBack(object=number):
            to = f"turning back to {waypoint}, for its answer"
            return Sentence(to if number is None else f"flying to object {number}", Tone.FOUND)
        case schema.NotActed(object=number, why=why):
            return Sentence(f"not acting at object {number}: {why}")


def _sentence(event: Event) -> Sentence | None:
    """The sentence of an event whose words depend on its content."""
    match event:
        case schema.Prepared(server=server, why=why):
            return Sentence(f"{server} is running, not joined: prepared {why}", Tone.ASIDE)
        case schema.ServerStep(server=server, before=before, after=after, why=why):
            return Sentence(f"{_step(server, before, after)}{f' ({why})' if why else ''}", tone_of(after))
        case schema.Notified(message=message):
            return Sentence(f"told the user: {in_one_line(message)}", Tone.FOUND)
        case schema.Planned(order_why=str(why)) if why:
            return Sentence(f"order of the waypoints: {why}")
        case schema.Demanded() | schema.PutOff() | schema.TurnedBack() | schema.NotActed():
            return _of_act(event)
        case schema.PhotosWait(waiting=waiting):
            return Sentence(f"stopping on the row: {counted(waiting, 'photo')} without an answer")
        case schema.Foreseen():
            return _foreseen(event)
        case schema.MissionEnded(why=why):
            return Sentence(f"mission ended: {why.removeprefix('mission: ')}", Tone.ALARM)
        case schema.ClockSet(before=before, after=after):
            said = f"this computer's clock said {before.isoformat()}: set to {after.isoformat()}"
            return Sentence(f"{said}, as the vehicle's GPS has it")
    return _waiting_sentence(event) or _computer_sentence(event) or _vehicle_sentence(event)


def _step(server: str, before: State, after: State) -> str:
    """The step of a server in words."""
    if after in CHECKING:
        return f"joining {server}"
    if before in SELECTED and after in (State.AVL, State.AVL_R):
        return f"leaving {server}"
    if before is State.BLACKLISTED:
        return f"{server} may be joined again"
    return f"{server} is {STATE_WORDS[after]}"


def _waiting_sentence(event: Event) -> Sentence | None:
    match event:
        case schema.Unanswered(waypoint=waypoint, operation=operation, why=why):
            return Sentence(f"{named(waypoint)}: no answer of {title_of(operation)}: {why}", Tone.TROUBLE)
        case schema.SoughtAnswers(waiting=waiting, extra_s=extra_s):
            beside = f", {extra_s:.0f} s beside its way" if extra_s >= 1 else ""
            return Sentence(f"stopping for {counted(waiting, 'call')} that a server here can answer{beside}")
    return None


def _computer_sentence(event: Event) -> Sentence | None:
    match event:
        case schema.SupplyChanged(supply=supply, left=left, scarce=False):
            return Sentence(f"the drone's computer has {left_of(supply, left)} again")
        case schema.HandoverTrouble(to=to, why=""):
            return Sentence(f"{to} takes findings again")
    return None


def _vehicle_sentence(event: Event) -> Sentence | None:
    """The sentence of a report of the vehicle. Its reasons not to arm are left to `arming_delayed`."""
    match event:
        case schema.ControlChanged(owner=Owner.PROGRAM, why=why):
            return Sentence(f"the program has the vehicle: {why}", Tone.ASIDE)
        case schema.ControlChanged(owner=owner, why=why):
            said = f"{who_has_it(owner)} has the vehicle: {why}; nothing is sent to it any more"
            return Sentence(said, Tone.ALARM)
        case schema.VehicleFound(system=system, component=component, firmware=firmware):
            version = event.version or "of an unknown version"
            return Sentence(
                f"the vehicle is system {system}, component {component} ({firmware} {version}, {event.type})",
                Tone.ASIDE if event.version else Tone.TROUBLE,
            )
        case schema.VehicleSaid(severity=severity, text=text) if severity <= WARNING:
            if not text.startswith(("PreArm: ", "Arm: ")):
                return Sentence(f"the vehicle says: {text} ({SEVERITIES[severity]})", Tone.TROUBLE)
        case schema.PositionDoubted(unsure=False, jumped_m=jumped_m) if not jumped_m:
            return Sentence("the vehicle's position can be true again")
        case schema.DeadManSet(silence_s=silence_s, action=action):
            doing = "returns" if action == "return" else "lands"
            said = f"the autopilot {doing} if it does not hear this program for {silence_s:g} s"
            return Sentence(said, Tone.ASIDE)
        case schema.Landed(at=at, from_home_m=from_home_m):
            return Sentence(landed(at, from_home_m))
        case schema.Energy(left_percent=left, home_s=home_s, margin_percent=spare, guessed=guessed):
            which = "" if event.battery is None else f" {event.battery}"
            said = f"battery{which} {left:.0f} %, {clock(home_s)} to the landing, {spare:.0f} % to spare"
            return Sentence(f"{said} ({in_words(guessed)})" if guessed else said, Tone.ASIDE)
    return None


def landed(at: str, from_home_m: float | None) -> str:
    """A landing as text, with its place as far as known."""
    where = f"landed at {at}" if at else "landed"
    away = "" if from_home_m is None else f"{from_home_m:.0f} m from home"
    if not away or at == "home":
        return where
    return f"{where}, {away}" if at else f"{where} {away}"


def _foreseen(event: schema.Foreseen) -> Sentence:
    expected = f"expected to be over at {clock(event.as_asked_s)}"
    if event.finish_by_s is None or event.lightest_s is None:
        return Sentence(expected, Tone.ASIDE)
    expected += f", and with every call lighter at {clock(event.lightest_s)}"
    if not event.fits:
        return Sentence(f"{expected}: too late for finish_by_s = {event.finish_by_s:g}", Tone.ALARM)
    return Sentence(f"{expected}; to be over by {clock(event.finish_by_s)}", Tone.ASIDE)


def named(waypoint: int | None) -> str:
    """A waypoint, as a sentence names it."""
    return "a place beside the plan" if waypoint is None else f"waypoint {waypoint}"


def in_one_line(message: object) -> str:
    """A message to the user: objects by their number and labels, fields by their names, other messages unchanged."""
    if (objects := found_objects(message)) is not None:
        labels = Counter(found.label for found in objects)
        message = ", ".join(count_of_kind(label, count) for label, count in labels.items())
    elif isinstance(message, dict):
        message = ", ".join(_field(str(name), value) for name, value in message.items())
    return printable(str(message))


def _field(name: str, value: object) -> str:
    """Such as "2 bright spots", "brightness 67.5", "counted" or "not counted"."""
    noun = name.removesuffix("_px").replace("_", " ")
    if isinstance(value, bool):
        return noun if value else f"not {noun}"
    if not isinstance(value, int):
        return f"{noun} {value}"
    return counted(value, noun[:-1]) if noun.endswith("s") and not noun.endswith("ss") else f"{value} {noun}"


def at_places(waypoints: Sequence[int | None]) -> str:
    """Waypoints as text: "waypoint 4", "waypoints 0-3, 7 and a place beside the plan"."""
    planned = [waypoint for waypoint in waypoints if waypoint is not None]
    beside = ["a place beside the plan"] if len(planned) < len(waypoints) else []
    noun = "waypoint" if len(planned) == 1 else "waypoints"
    return " and ".join([*([f"{noun} {spans(planned)}"] if planned else []), *beside])
