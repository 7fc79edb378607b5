"""The promises of docs/promises.md, tested over what one simulated flight left behind.

A promise's check yields what breaks it, the first breach first. It goes by the drone's event log, by what a
witness saw of drones and servers (`witness.py`), and by the same mission flown without servers.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import msgspec

from upwash.config import (
    DroneConfig,
    FaultConfig,
    ProbeConfig,
    ServerConfig,
    server_area,
    server_truth,
    waypoints,
)
from upwash.core.control import Owner
from upwash.core.geo import Position
from upwash.core.instances import HostSettings
from upwash.core.recovery import REST_S
from upwash.core.servers import SELECTED, TRANSITIONS, Event, State
from upwash.lab import probing
from upwash.lab.field import daemon_address
from upwash.lab.run import Run
from upwash.protocol import AVAILABILITY, HEALTH_CHECK, LEAVE

Fact = Mapping[str, Any]  # an event of a log
Breach = tuple[Fact | None, str]  # the bad event, where one can be named, and what is bad about it

_CHANGES = frozenset(event.value for event in Event)
_SERVICE_PATH = "/upwash.service."
_SLACK_S = 0.1
_ROUNDING_S = 2e-6  # of the times in a log
_FAREWELL_S = 0.5  # a drone says goodbye to its last server
_LOOK_S = 1.0  # a daemon looks no more often at what has come to its end
_LEASE_S, _HOLD_S = HostSettings().lease_s, HostSettings().hold_s
_MOST_ASKED = 10  # in a second, by a drone that renews a lease of 2 s and checks again and again
_ANSWER_S = 5.0  # for which a daemon's word is waited for
_CHECK_LEAST_S, _CHECK_FACTOR = 10.0, 3.0  # of how long joining may take, by what is believed of it
_WELL_S = 60.0  # without failures, until those before are forgotten
_JOINING_S = 30.0  # for a network that was off the air when joining it began
_LONGEST_TEXT = 3000  # of a log, where reasons are put together
_DONE = {"return": "landed", "land": "landed", "hold": "left_hovering", "disarm": "disarmed"}
_KEEP_TRYING_S = 600.0  # a safe end is given up no earlier
_REMOTE_LEAST_S, _REMOTE_FACTOR = 1.0, 4.0  # of the deadline of a remote call


class Promise(IntEnum):
    """The promises that a simulated flight can break, by their numbers."""

    AUTONOMY = 1
    BOUNDED_CALLS = 2
    ONE_ANSWER = 3
    TRUTHFUL_ERRORS = 4
    ONE_SELECTION = 5
    RANGE = 6
    RESPECT = 7
    NO_HARM = 8
    REPRODUCIBLE = 9
    ADMISSION = 11
    VEHICLE_FIRST = 13
    PILOT_WINS = 14
    LIARS = 15
    RECOVERY = 17

    def __str__(self) -> str:
        return f"promise {self.value} ({self.name.lower().replace('_', ' ')})"


@dataclass(frozen=True, slots=True)
class Broken:
    """A promise that a flight broke, in the world of that seed; `event` is the first bad one, if one can be named."""

    promise: Promise
    seed: int
    event: Fact | None
    why: str


@dataclass(frozen=True, slots=True)
class History:
    """What is known of one flight when it is over.

    `seen` are the events of a witness, of other drones' flights in the same world too; `alone` is the same mission
    by the same chance without any server, where that can be compared.
    """

    config: DroneConfig
    run: Run
    seen: Sequence[Fact] = ()
    alone: Run | None = None

    def own(self, *names: str) -> Iterator[Fact]:
        """What the witness saw of this drone, of those names."""
        return (
            fact for fact in self.seen if fact["event"] in names and fact.get("drone") == self.config.name
        )


def broken_promises(history: History, *, seed: int) -> list[Broken]:
    """The promises that the flight in the world of that seed broke, each by its first breach."""
    found = []
    for promise, check in CHECKS.items():
        for event, why in check(history):
            found.append(Broken(promise, seed, event, why))
            break
    return found


@dataclass(frozen=True, slots=True)
class Call:
    """One call of the mission with the decisions that were made for it, and its hedge, if it had one."""

    decisions: tuple[Fact, ...]
    ended: Fact
    hedged: Fact | None = None

    @property
    def allowed_s(self) -> float:
        """What the rules allowed it to wait and to try: what was not allowed counts 0.

        A hedged call was tried alone until the drone's own service started; what comes then is that one's time, as
        in a call that is raced.
        """
        waits_s = sum((each.get("at_most_s", 0.0) for each in self.decisions), self.queued_s)
        if self.hedged is not None:
            return waits_s + float(self.hedged["after_s"])
        return waits_s + (self.sent["deadline_s"] if self.sent is not None else 0.0)

    @property
    def tried(self) -> list[Fact]:
        """The decisions for servers."""
        return [each for each in self.decisions if each["decision"] == "remote"]

    @property
    def sent(self) -> Fact | None:
        """The decision for a server alone, if there was one, with the drone's own service not at the call too."""
        return next((each for each in self.tried if not each.get("raced")), None)

    @property
    def queued_s(self) -> float:
        """How long the drone's own service was busy with an earlier call that was hedged."""
        return float(self.ended.get("queued_s", 0.0))

    @property
    def computed(self) -> bool:
        """Whether the drone's own service was at it."""
        raced = any(each.get("raced") for each in self.tried) and self.ended["onboard_s"] > 0
        return self.hedged is not None or self.ended["place"] == "local" or raced

    @property
    def bound_s(self) -> float:
        """The longest that it may have taken."""
        onboard_s: float = self.ended["onboard_s"]
        return self.allowed_s + onboard_s + _SLACK_S


def calls_of(events: Sequence[Fact]) -> Iterator[Call]:
    """The calls of an event log, in order."""
    decisions: list[Fact] = []
    hedged: Fact | None = None
    for event in events:
        if event["event"] == "decided":
            decisions.append(event)
        elif event["event"] == "hedged":
            hedged = event
        elif event["event"] == "call":
            yield Call(tuple(decisions), event, hedged)
            decisions, hedged = [], None


# --- 1: autonomy --------------------------------------------------------------------------------------------


def autonomy(history: History) -> Iterator[Breach]:
    """Every waypoint in order, its calls answered; an autopilot that failed may cut that short."""
    events, run = history.run.events, history.run
    for event in events:
        if event["event"] == "offloading_failed":
            yield event, f"offloading ended for the rest of the flight: {event['why']}"
    arrived = [event["waypoint"] for event in events if event["event"] == "arrived"]
    planned = [waypoint.index for waypoint in waypoints(history.config.mission)]
    if arrived != planned[: len(arrived)]:
        yield None, f"arrived at waypoints {arrived} instead of {planned}"
    if may_be_cut_short(history.config):
        return
    if run.failure or not run.result.completed:
        yield (events[-1] if events else None), f"the mission was not completed: {run.failure}"
    elif len(arrived) < len(planned):
        yield None, f"arrived at {len(arrived)} of {len(planned)} waypoints"
    if history.alone is not None:
        made, wanted = (
            [(call.waypoint, call.operation) for call in each.result.calls] for each in (run, history.alone)
        )
        if made != wanted:
            yield None, f"{len(made)} calls had a result, the drone alone has {len(wanted)}: {made}"


def may_be_cut_short(config: DroneConfig) -> bool:
    """Whether the autopilot fails in this world, so that the mission may end early, in its safe action."""
    return any(fault.target == "autopilot" and fault.kind != "slow" for fault in config.faults)


# --- 2 to 4: calls ------------------------------------------------------------------------------------------


def bounded_calls(history: History) -> Iterator[Breach]:
    """The longest worthwhile wait, the remote deadline and one local call, each as the rules say."""
    policy, first = history.config.policy, set(map(id, _first_calls(history.run.events)))
    computed: dict[str, deque[Fact]] = {}  # by service, as a hedged call may outlast one of another
    for fact in history.own("computed"):
        computed.setdefault(_service(fact), deque()).append(fact)
    before_s: dict[str, float] = {}  # of the last hedged call, by service
    for call in calls_of(history.run.events):
        ended = call.ended
        if ended["delay_s"] > call.bound_s:
            yield ended, f"took {ended['delay_s']:.3f} s of at most {call.bound_s:.3f} s"
        for decided in call.decisions:
            patient = policy.patient_first_call and id(decided) in first
            yield from _allowed_too_much(decided, policy.gain_wait, patient=patient)
        yield from _hedged_too_late(call)
        service = _service(ended)
        if call.queued_s > (most_s := before_s.get(service, 0.0)) + _SLACK_S:
            yield ended, f"waited {call.queued_s:.3f} s for a service that needed {most_s:.3f} s"
        if computed.get(service) and call.computed:
            before_s[service] = took_s = computed[service].popleft()["took_s"]
            if ended["onboard_s"] > took_s + _SLACK_S:
                yield (
                    ended,
                    f"spent {ended['onboard_s']:.3f} s on the drone, whose service took {took_s:.3f} s",
                )


def _first_calls(events: Iterable[Fact]) -> Iterator[Fact]:
    """The decisions for a server whose service has answered no call since services were last started there."""
    warm: dict[str, set[str]] = {}  # services by server
    asked = ""  # the server that a call was last sent to
    for event in events:
        match event:
            case {"event": "call", "remote_fault": "confirmed"}:
                warm.setdefault(asked, set()).add(_service(event))
            case {"event": "started" | "prepared", "server": server}:
                warm[server] = set()
            case {"event": "call", "place": place}:
                warm.setdefault(place, set()).add(_service(event))
            case {"event": "decided", "decision": "remote", "server": server}:
                asked = server
                if _service(event) not in warm.get(server, set()):
                    yield event


def _allowed_too_much(decided: Fact, gain_wait: float, *, patient: bool) -> Iterator[Breach]:
    if decided["decision"] == "wait":
        longest_s = decided["local_s"] * (1 - gain_wait) - decided["remote_s"]
        if decided["at_most_s"] > longest_s + _ROUNDING_S:
            yield decided, f"may wait {decided['at_most_s']:.3f} s, worthwhile are {longest_s:.3f} s"
    elif decided["decision"] == "remote":
        if decided.get("raced"):  # which costs no time
            return
        expected_s = math.inf if patient else _REMOTE_FACTOR * decided["remote_s"]
        longest_s = max(_REMOTE_LEAST_S, min(expected_s, decided["local_s"]))
        if decided["deadline_s"] > longest_s + _ROUNDING_S:
            yield decided, f"has a deadline of {decided['deadline_s']:.3f} s, allowed are {longest_s:.3f} s"


def _service(fact: Fact) -> str:
    name: str = fact["operation"]
    return name.partition(".")[0]


def _hedged_too_late(call: Call) -> Iterator[Breach]:
    """The drone's own service starts within the server's deadline, which grows by a local call at most."""
    hedged, decided = call.hedged, call.sent
    if hedged is None or decided is None:
        return
    if hedged["after_s"] > decided["deadline_s"] + _ROUNDING_S:
        yield (
            hedged,
            f"starts {hedged['after_s']:.3f} s into a call whose deadline is {decided['deadline_s']:.3f} s",
        )
    longest_s = max(decided["deadline_s"], hedged["after_s"] + decided["local_s"])
    if hedged["deadline_s"] > longest_s + _ROUNDING_S:
        yield hedged, f"has a deadline of {hedged['deadline_s']:.3f} s, allowed are {longest_s:.3f} s"


def one_answer(history: History) -> Iterator[Breach]:
    """One result a call, its own; a server's within the deadline."""
    for call in calls_of(history.run.events):
        yield from _unbelievable(call)
    told = _told(history)
    for number, (event, heard) in enumerate(told):
        if heard.asked != number:
            yield event, f"this is about call {heard.asked}, but number {number} was to come"
        elif not heard.raised and heard != _expected(history.config, heard.asked):
            yield event, f"call {heard.asked} was answered by {heard.answer}, which is another call's answer"
    if _is_probing(history.config) and len(told) != (calls := len(history.run.result.calls)):
        yield None, f"{calls} calls ended, and {len(told)} answers reached the mission"


def _unbelievable(call: Call) -> Iterator[Breach]:
    ended, alone = call.ended, [each for each in call.tried if not each.get("raced")]
    if len(alone) > 1 or (alone and alone[0] is not call.tried[0]):
        yield alone[-1], "a second server was tried for one call, and the drone's own service was not at it"
    if ended["place"] == "local":
        return
    answering = [each for each in call.tried if each["server"] == ended["place"]]
    if not answering:
        yield ended, f"was answered by {ended['place']}, where it was not sent"
        return
    late_s = [
        ended["t"] - each["t"] - (call.hedged or each if each is call.sent else each)["deadline_s"]
        for each in answering
    ]
    if min(late_s) > _SLACK_S:
        yield ended, f"was answered {min(late_s):.3f} s after the deadline"


def truthful_errors(history: History) -> Iterator[Breach]:
    """The service's own exception for the calls that raise it, and no other; each was raised on the drone."""
    if _is_probing(history.config):
        yield from _raised_afar(history.run.events)
    for event, heard in _told(history):
        wanted = _expected(history.config, heard.asked)
        if heard.raised != wanted.raised:
            yield (
                event,
                f"call {heard.asked} raised {heard.raised or 'nothing'} instead of {wanted.raised or 'nothing'}",
            )
    if not may_be_cut_short(history.config) and history.run.failure:
        yield None, f"the mission met an error: {history.run.failure}"


def _raised_afar(events: Iterable[Fact]) -> Iterator[Breach]:
    """Exceptions that the mission heard of calls that were answered by a server."""
    place = ""  # of the last call
    for event in events:
        if event["event"] == "call":
            place = event["place"]
        elif event["event"] == "notified" and event["message"]["raised"] and place != "local":
            yield (
                event,
                f"the mission heard what {place} said was raised; the drone's own service was not asked",
            )


def _told(history: History) -> list[tuple[Fact, probing.Heard]]:
    if not _is_probing(history.config):
        return []
    return [
        (event, msgspec.convert(event["message"], probing.Heard))
        for event in history.run.events
        if event["event"] == "notified"
    ]


def _is_probing(config: DroneConfig) -> bool:
    return config.mission.program.startswith(f"{probing.__name__}:")


def _expected(config: DroneConfig, number: int) -> probing.Heard:
    mode: probing.Mode = "light" if config.mission.mode == "light" else "heavy"
    return probing.expected(config.mission.program, mode, number)


# --- 5 to 7: servers ----------------------------------------------------------------------------------------


def one_selection(history: History) -> Iterator[Breach]:
    """Each change starts where the last one ended and is the table's; one server and one network for each radio.

    Of two servers that are selected the one in use was there first: calls go there.
    """
    radios = history.config.network.radios
    states: dict[str, State] = {}
    for event in history.run.events:
        if event["event"] not in _CHANGES:
            continue
        name, before, after = event["server"], State(event["before"]), State(event["after"])
        if states.get(name, State.AVL) is not before:
            yield event, f"{name} was {states.get(name, State.AVL)} before"
        if TRANSITIONS.get((before, Event(event["event"]))) is not after:
            yield event, f"{event['event']} does not lead from {before} to {after}"
        states[name] = after
        selected = [each for each, state in states.items() if state in SELECTED]
        if len(selected) > radios:
            yield event, f"{' and '.join(selected)} are selected at the same time"
    yield from _used_out_of_turn(history)
    joined: dict[int, str] = {}  # by radio
    for fact in history.own("joined", "left"):
        if fact["event"] == "joined" and joined.get(fact["radio"]):
            yield fact, f"{joined[fact['radio']]} is still joined"
        joined[fact["radio"]] = fact["network"] if fact["event"] == "joined" else ""


def _used_out_of_turn(history: History) -> Iterator[Breach]:
    """A call goes to the server that was selected first of those that are."""
    selected: list[str] = []
    for event in history.run.events:
        if event["event"] in _CHANGES:
            if event["server"] in selected and event["after"] not in SELECTED:
                selected.remove(event["server"])
            elif event["server"] not in selected and event["after"] in SELECTED:
                selected.append(event["server"])
        elif (
            event["event"] == "decided" and event["decision"] != "local" and [event["server"]] != selected[:1]
        ):
            yield event, f"{event['server']} is not the one in use of {' and '.join(selected)}"


def in_range(history: History) -> Iterator[Breach]:
    """No call is sent from outside the server's range."""
    areas = {
        server.name: server_area(server, history.config.mission.home) for server in history.config.servers
    }
    remote = (each for each in history.run.events if each.get("decision") == "remote")
    sent = (each for each in history.own("sent") if each["path"].startswith(_SERVICE_PATH))
    for call in (*remote, *sent):
        if not areas[call["server"]].contains(Position(**call["position"])):
            yield call, f"a call was sent to {call['server']}, which is out of range"


def respect(history: History) -> Iterator[Breach]:
    """A blacklisted server is left alone, but for the farewell and probes; a call goes to a server that is READY."""
    for event in history.run.events:
        if event.get("decision") == "remote" and event["state"] != State.READY:
            yield event, f"{event['selected']} is {event['state']}"
    if history.config.policy.probing is not None:
        yield from _probed_too_much(history)
    else:
        yield from _contacted_too_soon(history)


def _contacted_too_soon(history: History) -> Iterator[Breach]:
    """A server that is not probed is left alone for the time that was set."""
    blacklisted: dict[str, list[tuple[float, float]]] = {}
    for event in history.run.events:
        if event["event"] in _CHANGES and event["after"] == State.BLACKLISTED:
            until_s = event["t"] + history.config.policy.left_alone_s
            blacklisted.setdefault(event["server"], []).append((event["t"], until_s))
        elif event["event"] == Event.SELECTED:
            spells = blacklisted.get(event["server"], [])
            if spells and event["t"] < spells[-1][1] - _ROUNDING_S:
                yield event, f"{event['server']} is blacklisted until {spells[-1][1]:.3f} s"
    for fact in history.own("sent"):
        for from_s, until_s in blacklisted.get(fact["server"], []):
            if fact["path"] != LEAVE and from_s + _ROUNDING_S < fact["t"] < until_s - _ROUNDING_S:
                yield fact, f"{fact['server']} is blacklisted until {until_s:.3f} s"


@dataclass(slots=True)
class _Spell:
    """For how long a server was blacklisted, and from when on it could be probed."""

    from_s: float
    probed_s: float
    until_s: float = math.inf


def _spells(history: History) -> dict[str, list[_Spell]]:
    """The spells of each server, by what it had failed before."""
    probing = history.config.policy.probing or ProbeConfig()
    spells: dict[str, list[_Spell]] = {}
    failures: dict[str, tuple[int, float]] = {}  # how many in a row, and when the last one was
    for event in history.run.events:
        if event["event"] not in _CHANGES:
            continue
        server, now_s = event["server"], event["t"]
        if event["after"] == State.BLACKLISTED:
            count, last_s = failures.get(server, (0, -math.inf))
            if event["event"] != Event.NETWORK_LOST:
                forgotten = now_s - last_s > _WELL_S + _alone_s(count)
                count, last_s = failures[server] = (1 if forgotten else count + 1, now_s)
            alone_s = max(last_s + _alone_s(count) - now_s, probing.first_s)
            spells.setdefault(server, []).append(_Spell(now_s, now_s + alone_s))
        elif event["before"] == State.BLACKLISTED:
            spells[server][-1].until_s = now_s
    return spells


def _alone_s(failures: int) -> float:
    """How long a server is left alone after so many failures in a row."""
    return min(10.0, 2.0 ** (failures - 2)) if failures > 1 else 0.0


def _probed_too_much(history: History) -> Iterator[Breach]:
    """Failed servers are asked for a sign of life alone, at the pace that was set, and by how often they failed."""
    probing, spells = history.config.policy.probing or ProbeConfig(), _spells(history)
    last_s: dict[str, float] = {}
    for fact in history.own("sent"):
        server, now_s = fact["server"], fact["t"]
        spell = next(
            (each for each in spells.get(server, []) if each.from_s + _ROUNDING_S < now_s < each.until_s),
            None,
        )
        if spell is None or fact["path"] == LEAVE:
            continue
        if fact["path"] not in (AVAILABILITY, HEALTH_CHECK):
            yield fact, f"{server} is blacklisted until {spell.until_s:.3f} s"
        elif fact["path"] == AVAILABILITY:
            if now_s < spell.probed_s - _ROUNDING_S:
                yield fact, f"{server} is to be left alone until {spell.probed_s:.3f} s"
            if now_s - last_s.get(server, -math.inf) < probing.first_s - _ROUNDING_S:
                yield fact, f"{server} was asked {now_s - last_s[server]:.3f} s before"
            last_s[server] = now_s


# --- 17: recovery -------------------------------------------------------------------------------------------


def recovered(history: History) -> Iterator[Breach]:
    """A server that failed costs no time again until it has answered a call; once well it is back within bounds."""
    if history.config.policy.probing is None:
        return
    yield from _trusted_too_soon(history.run.events)
    yield from _left_unused(history)


def _trusted_too_soon(events: Iterable[Fact]) -> Iterator[Breach]:
    """Until an operation is answered there, calls of it that go there are raced, and nobody waits for the server."""
    doubted: dict[
        str, set[str]
    ] = {}  # operations that were answered since the last failure, by server that failed
    for event in events:
        match event:
            case {"event": "decided", "server": server, "operation": operation} if server in doubted:
                if operation not in doubted[server] and not event.get("raced"):
                    yield event, f"{server} has answered no call of {operation} since it failed"
            case {"event": name, "after": State.BLACKLISTED, "server": server} if name in _CHANGES:
                doubted[server] = set()
            case {"event": "call", "place": place, "operation": operation}:
                if event.get("remote_fault") == "confirmed":
                    for answered in doubted.values():
                        answered.add(operation)
                elif place in doubted:
                    doubted[place].add(operation)
            case {"event": "dropped", "place": place, "operation": operation} if place in doubted:
                doubted[place].add(operation)
            case {"event": "remote_raised", "server": server, "operation": operation} if server in doubted:
                doubted[server].add(operation)  # where the drone's own service confirms it


def _left_unused(history: History) -> Iterator[Breach]:
    """A failed server that is well again, and in range all the time, does not stay blacklisted."""
    events, spells = history.run.events, _spells(history)
    ends = (each["t"] for each in events if each["event"] in ("mission_ended", "mission_completed"))
    end_s = next(ends, events[-1]["t"])
    for server in _joinable(history):
        area = server_area(server, history.config.mission.home)
        outside_s = [
            each["t"]
            for each in events
            if each["event"] == "position"
            and not area.contains(Position(each["east_m"], each["north_m"], each["altitude_m"]))
        ]
        for spell in spells.get(server.name, []):
            since_s = max(
                spell.probed_s,
                *(t for t in outside_s if t < spell.until_s),
                *(each.to_s for each in _faults_of(history, server.name) if each.from_s < spell.until_s),
                0.0,
            )
            unused_s = min(spell.until_s, end_s) - since_s
            if unused_s > REST_S + _JOINING_S + 2 * _ANSWER_S:
                yield None, f"{server.name} was well and in range for {unused_s:.3f} s, and still blacklisted"


def _joinable(history: History) -> Iterator[ServerConfig]:
    """The servers that can serve the drone whenever they are well: all that it wants, soon enough, and alone."""
    config = history.config
    wanted = {service.name for service in config.services}
    for server in config.servers:
        truth = server_truth(server, config.services)
        shared = any(
            fact["event"] == "asked" and fact.get("server") == server.name and fact["drone"] != config.name
            for fact in history.seen
        )
        longest_s = max(_CHECK_LEAST_S, _CHECK_FACTOR * server.check_running_s)
        if not shared and wanted <= set(truth.images) and truth.join_s <= longest_s:
            yield server


def _faults_of(history: History, server: str) -> Iterator[FaultConfig]:
    return (each for each in history.config.faults if each.target in (server, f"link:{server}"))


# --- 8: no harm ---------------------------------------------------------------------------------------------


def no_harm(history: History) -> Iterator[Breach]:
    """No later than the drone alone, but for the waits and deadlines that the rules allowed.

    Chance and heat make two local calls differ that would be alike: each counts here as long as it took alone.
    """
    yield from _hedged_too_much(history)
    if history.alone is None or history.run.failure or history.alone.failure:
        return
    calls, alone = list(calls_of(history.run.events)), list(calls_of(history.alone.events))
    luck_s = sum(
        ours.ended["onboard_s"] - theirs.ended["onboard_s"]
        for ours, theirs in zip(calls, alone, strict=False)
        if ours.ended["onboard_s"]
    )
    allowed_s = sum(call.allowed_s for call in calls)
    latest_s = history.alone.result.mission_time_s + luck_s + allowed_s + _FAREWELL_S + _SLACK_S
    if (took_s := history.run.result.mission_time_s) > latest_s:
        yield (
            None,
            f"the mission took {took_s:.3f} s; alone, with what the rules allowed, at most {latest_s:.3f} s",
        )


def _hedged_too_much(history: History) -> Iterator[Breach]:
    """A hedge starts only while what was computed for nothing is within the share of what all calls would take."""
    hedge = history.config.policy.hedging
    calls_s = extra_s = 0.0
    for call in calls_of(history.run.events):
        if not call.decisions:  # it runs once, and on the drone
            continue
        decided = call.sent or call.decisions[-1]
        calls_s += decided["local_s"] or 0.0
        if call.hedged is None:
            continue
        if hedge is None or extra_s > hedge.budget * calls_s + _ROUNDING_S:
            yield call.hedged, f"{extra_s:.3f} s were computed for nothing, of {calls_s:.3f} s in all calls"
        remote_s = call.ended["t"] - decided["t"]
        if call.ended["place"] == decided.get("server") and remote_s <= decided["deadline_s"] - _ROUNDING_S:
            extra_s += decided["local_s"]


# --- 11: admission ------------------------------------------------------------------------------------------


def admission(history: History) -> Iterator[Breach]:
    """Of each server: one instance of a service, no more drones than slots, leases and held slots that end."""
    yield from _holds(history)
    for server in history.config.servers:
        facts = [fact for fact in history.seen if fact.get("server") == server.name]
        yield from _instances(facts)
        yield from _slots(facts, server.truth.slots)
        yield from _leases(facts, end_s=history.seen[-1]["t"] if history.seen else 0.0)


def _instances(facts: Sequence[Fact]) -> Iterator[Breach]:
    running: set[str] = set()
    for fact in facts:
        if fact["event"] == "instance_started":
            if fact["service"] in running:
                yield fact, f"a second instance of {fact['service']} on {fact['server']}"
            running.add(fact["service"])
        elif fact["event"] == "instance_ended":
            running.discard(fact["service"])


def _slots(facts: Sequence[Fact], slots: int) -> Iterator[Breach]:
    for fact in facts:
        if fact["event"] == "admitted" and len(fact["drones"]) > slots:
            yield fact, f"{fact['server']} serves {', '.join(fact['drones'])}, and has {slots} slots"


def _holds(history: History) -> Iterator[Breach]:
    """Slots are held for servers that are peers, and for a drone one at a time by each server that it visits."""
    peers = {server.name: server.truth.peers for server in history.config.servers}
    holding: dict[tuple[str, str], tuple[str, float]] = {}  # by peer and drone: where, and until when
    for fact in history.seen:
        if fact["event"] != "held":
            continue
        by, drone, server = fact["by"], fact["drone"], fact["server"]
        if by not in peers[server]:
            yield fact, f"{server} holds a slot for {by}, which is no peer of it"
        where, until_s = holding.get((by, drone), (server, 0.0))
        if where != server and until_s > fact["t"] + _ROUNDING_S:
            yield fact, f"{drone} has slots of {where} and of {server} held at the same time"
        holding[by, drone] = (server, fact["t"] + min(fact["for_s"], _HOLD_S))


def _leases(facts: Sequence[Fact], *, end_s: float) -> Iterator[Breach]:
    """A drone that asks nothing, and for which nothing is held, is no longer admitted once its lease is over."""
    asked_s: dict[str, float] = {}
    held_until_s: dict[str, float] = {}
    admitted: dict[str, Fact] = {}  # by service, as last told to its instance
    over: Fact = {"event": "over", "t": end_s}
    for fact in (*facts, over):
        for told in admitted.values():
            for drone in told["drones"]:
                last_s: float = asked_s[drone] if drone in asked_s else told["t"]
                ends_s = max(last_s + _LEASE_S, held_until_s.get(drone, 0.0)) + _LOOK_S + _SLACK_S
                if fact["t"] > max(
                    ends_s, told["t"]
                ):  # what it was told for may come after it, at one moment
                    yield (
                        told,
                        f"{drone} still has its lease at {fact['t']:.3f} s; it was over at {ends_s:.3f} s",
                    )
        match fact["event"]:
            case "asked" | "answered" | "served":
                asked_s[fact["drone"]] = fact["t"]
            case "held":
                held_until_s[fact["drone"]] = fact["t"] + min(fact["for_s"], _HOLD_S)
            case "admitted":
                admitted[fact["service"]] = fact
            case "instance_ended":
                admitted.pop(fact["service"], None)


# --- 13: the vehicle first ----------------------------------------------------------------------------------


def vehicle_first(history: History) -> Iterator[Breach]:
    """A mission that ends early in the air ends in the configured action, or has tried for long enough.

    One that ends on the ground disarms the vehicle. A vehicle that somebody else has taken is theirs to end with.
    """
    events = {event["event"]: event for event in history.run.events}  # the last of each kind
    for over in history.own("flight_over"):
        if "landed" in events and over["altitude_m"] > 0:
            yield events["landed"], f"the vehicle is {over['altitude_m']:.1f} m up"
    if not history.run.failure or "armed" not in events or ("landed" in events and "safe_end" not in events):
        return
    last = history.run.events[-1]
    if last["event"] != "mission_ended":
        yield last, "the mission failed, and its end is not in the log"
    if events["control"]["owner"] != Owner.PROGRAM:
        return
    wanted = history.config.autopilot.on_failure
    begun = next((event for event in history.run.events if event["event"] == "safe_end"), None)
    if begun is None or begun["action"] not in (wanted, "disarm"):
        yield begun or last, f"the mission failed in the air without {wanted}"
    elif given_up := events.get("left_to_pilot"):
        if given_up["t"] - begun["t"] < _KEEP_TRYING_S:
            yield given_up, f"the vehicle was given up after {given_up['t'] - begun['t']:.0f} s"
    elif _DONE[events["safe_end"]["action"]] not in events:
        yield last, f"{begun['action']} neither succeeded nor was given up"


# --- 14: the pilot wins -------------------------------------------------------------------------------------


def pilot_wins(history: History) -> Iterator[Breach]:
    """From the moment that a pilot or a fail-safe has the vehicle, no command reaches it, and it is not taken back.

    While its link is silent the program cannot know, but it sends nothing then either. A pilot who takes it and gives
    it back within one silence leaves nothing that the program could hear of: that turn does not count.
    """
    taken: Fact | None = None
    for fact in history.own("taken", "given_back_unheard", "commanded"):
        if fact["event"] == "taken":
            taken = taken or fact
        elif fact["event"] == "given_back_unheard":
            taken = None
        elif taken is not None:
            yield (
                fact,
                f"{fact['command']} was commanded {fact['t'] - taken['t']:.3f} s after a {taken['by']} took over",
            )
    owners = [event["owner"] for event in history.run.events if event["event"] == "control"]
    if Owner.PROGRAM in owners[1:]:
        yield None, f"the vehicle was the {' then the '.join(owners)}'s: it was taken back"


# --- 15: liars ----------------------------------------------------------------------------------------------


def unswayed(history: History) -> Iterator[Breach]:
    """Whom the drone calls, how often it asks, and what its log can hold is not for a server to choose."""
    yield from _dialled_elsewhere(history)
    yield from _asked_too_often(history)
    for event in history.run.events:
        if event["event"] != "notified":  # which is the mission's own
            yield from _unfit_texts(event)


def _dialled_elsewhere(history: History) -> Iterator[Breach]:
    """At each visit, or probe, the daemon, and a port of its host for each service that is wanted."""
    services = len(history.config.services)
    dialled: Counter[str] = Counter()  # of a server, since its daemon was
    allowed: Counter[str] = Counter()
    last_s: dict[str, float] = {}
    for fact in history.own("dialled"):
        server, address = fact["server"], fact["address"]
        if address == daemon_address(server):
            if (
                fact["t"] - last_s.get(server, -math.inf) > _ANSWER_S
            ):  # else an earlier probe may be under way
                dialled[server] = allowed[server] = 0
            last_s[server] = fact["t"]
            allowed[server] += services
            continue
        host, _, port = address.rpartition(":")
        if host != daemon_address(server).rpartition(":")[0] or not port.isdecimal():
            yield fact, f"{server} had the drone call {address!r:.100}"
        dialled[server] += 1
        if dialled[server] > allowed[server]:
            yield (
                fact,
                f"{server} had the drone call {dialled[server]} addresses instead of {allowed[server]}",
            )


def _asked_too_often(history: History) -> Iterator[Breach]:
    asked: dict[str, deque[float]] = {}  # the last times, by server
    for fact in history.own("sent"):
        if fact["path"] != AVAILABILITY:
            continue
        times = asked.setdefault(fact["server"], deque(maxlen=_MOST_ASKED))
        times.append(fact["t"])
        if len(times) == _MOST_ASKED and times[-1] - times[0] < 1.0:
            yield fact, f"{fact['server']} was asked {_MOST_ASKED} times within a second"


def _unfit_texts(event: Fact) -> Iterator[Breach]:
    for name, fact in event.items():
        if (
            name != "trace"
            and isinstance(fact, str)
            and not (fact.isprintable() and len(fact) <= _LONGEST_TEXT)
        ):
            yield (
                {"t": event["t"], "event": event["event"]},
                f"its {name} is {len(fact)} characters: {fact!r:.100}",
            )


CHECKS: Mapping[Promise, Callable[[History], Iterator[Breach]]] = {
    Promise.AUTONOMY: autonomy,
    Promise.BOUNDED_CALLS: bounded_calls,
    Promise.ONE_ANSWER: one_answer,
    Promise.TRUTHFUL_ERRORS: truthful_errors,
    Promise.ONE_SELECTION: one_selection,
    Promise.RANGE: in_range,
    Promise.RESPECT: respect,
    Promise.NO_HARM: no_harm,
    Promise.ADMISSION: admission,
    Promise.VEHICLE_FIRST: vehicle_first,
    Promise.PILOT_WINS: pilot_wins,
    Promise.LIARS: unswayed,
    Promise.RECOVERY: recovered,
}
