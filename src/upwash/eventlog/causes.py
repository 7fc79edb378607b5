"""Why a call ran at its place, as one plain sentence with its cause, from what the log told until the decision."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from upwash.core.geo import Circle, Measured, Position, Reach, ground_distance_m
from upwash.core.knowledge.servers import CHECKING, State
from upwash.eventlog import schema
from upwash.eventlog.schema import Event
from upwash.support.text import clock, counted

_REMEMBERED_S = 60.0  # how long the drone believes a server without a free slot
_NO_ANSWER = "no answer"
_ALONE = "computing on the drone"
_OUT_OF_RANGE = "out of range"
SHORTEST_S = 0.005  # less is printed as 0.00 s
_WITHOUT_FIGURES = (_OUT_OF_RANGE, "failed or was slow")  # of a decision: its estimates decided nothing
_RAISED = {
    "": "",
    "confirmed": ", and it was raised on the drone too",
    "denied": ", which the drone did not raise",
}


@dataclass(slots=True, eq=False)
class StateSpell:
    """The time of a server in one state, in seconds of the log, and why it began.

    `until_s` is None while it lasts.
    """

    server: str
    state: State
    from_s: float
    why: str = ""
    until_s: float | None = None


@dataclass(frozen=True, slots=True)
class Standing:
    """What was known of a server at a decision: its state, and how far beyond its range the drone was.

    `mean_s` and `local_s` are the mean delays of calls there and on the drone, as last compared; `waiting` drones
    queued for a slot. None where nothing is known.
    """

    stay: StateSpell
    beyond_m: float
    mean_s: float | None = None
    local_s: float | None = None
    waiting: int | None = None


@dataclass(frozen=True, slots=True)
class Considered:
    """A decision, and the servers that explain it: the one in use, else those in range, else the nearest.

    `policy` is the mission's; nothing is known of its servers unless it `is_planned`. Times are seconds of the log,
    and the mission began at `began_s`.
    """

    decided: schema.Decided
    servers: Sequence[Standing]
    policy: str
    is_planned: bool
    began_s: float

    @property
    def in_use(self) -> Standing | None:
        """The server in use."""
        return self.servers[0] if self.decided.selected is not None else None

    @property
    def left_alone(self) -> Iterator[StateSpell]:
        """The stays of the blacklisted servers."""
        return (server.stay for server in self.servers if server.stay.state is State.BLACKLISTED)

    @property
    def at_s(self) -> float:
        """When it was decided, in seconds of the mission."""
        return self.decided.t - self.began_s

    @property
    def wait_s(self) -> float:
        """The expected time until the server in use is ready."""
        decided = self.decided
        if decided.state not in CHECKING or decided.check_s is None:
            return 0.0
        return max(0.0, decided.check_s - (decided.check_elapsed_s or 0.0))

    @property
    def expected_s(self) -> Mapping[str, float]:
        """The expected time of the call with its wait, by place: a server, or "local"."""
        decided = self.decided
        expected_s = {} if decided.local_s is None else {"local": decided.local_s}
        if decided.selected is not None and decided.remote_s is not None:
            expected_s[decided.selected] = self.wait_s + decided.remote_s
        return expected_s


class Standings:
    """Follows what a log tells of the servers."""

    def __init__(self) -> None:
        self._policy = ""
        self._planned = False
        self._areas: dict[str, Reach] = {}
        self._stays: dict[str, StateSpell] = {}
        self._means_s: dict[str, tuple[float | None, float | None]] = {}  # there, and on the drone
        self._full: dict[str, schema.NoSlot] = {}

    def take(self, event: Event) -> None:
        """Takes in the next event."""
        match event:
            case schema.Planned(ranges=ranges, measured=measured):
                self._planned = True
                self._areas = {**dict.fromkeys(measured, Measured()), **ranges}
                self._stays = {server: StateSpell(server, State.AVL, event.t) for server in self._areas}
            case schema.MissionStarted(policy=policy):
                self._policy = policy
            case schema.LogResumed():  # a program that starts again knows no server's state
                for server in self._stays:
                    self._enter(StateSpell(server, State.AVL, event.t, "taken up again"))
            case schema.ServerStep(server=server, after=after, why=why):
                local_s = event.local_mean_call_s
                self._means_s |= {name: (mean_s, local_s) for name, mean_s in event.mean_call_s.items()}
                self._enter(StateSpell(server, after, event.t, why))
            case schema.NoSlot(server=server):
                self._full[server] = event

    def _enter(self, stay: StateSpell) -> None:
        if (before := self._stays.get(stay.server)) is not None:
            before.until_s = stay.from_s
        self._stays[stay.server] = stay

    def considered(self, decided: schema.Decided, began_s: float) -> Considered:
        """The decision with what explains it."""
        if decided.selected is not None:
            names = [decided.selected]
        else:
            names = sorted(self._areas, key=lambda name: self._beyond_m(name, decided.position))
            in_range = [name for name in names if self._beyond_m(name, decided.position) <= 0]
            names = in_range or names[:1]
        standings = [self._standing(name, decided) for name in names]
        return Considered(decided, standings, self._policy, self._planned, began_s)

    def _standing(self, server: str, decided: schema.Decided) -> Standing:
        stay = self._stays.setdefault(server, StateSpell(server, decided.state or State.AVL, decided.t))
        full = self._full.get(server)
        waiting = full.waiting if full is not None and decided.t - full.t < _REMEMBERED_S else None
        mean_s, local_s = self._means_s.get(server, (None, None))
        return Standing(stay, self._beyond_m(server, decided.position), mean_s, local_s, waiting)

    def _beyond_m(self, server: str, position: Position) -> float:
        area = self._areas.get(server)
        return ground_distance_m(area.centre, position) - area.radius_m if isinstance(area, Circle) else 0.0


# --- a call that is under way -----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Course:
    """Where a call is now, as what is `doing`, and why, in a sentence; it began at `began_s` of the log.

    It is at a `server`, or on the drone without one. From `asked_s` on the server has `at_most_s`, and may only have
    to become ready if the call `waits`. The drone computes it since `alone_from_s`; None if it does not.
    """

    doing: str
    sentence: str
    began_s: float
    server: str | None = None
    asked_s: float = 0.0
    at_most_s: float | None = None
    waits: bool = False
    alone_from_s: float | None = None

    @property
    def from_s(self) -> float:
        """Since when it is where it is."""
        if self.server is None and self.alone_from_s is not None:
            return self.alone_from_s
        return self.asked_s

    def may_become(self, decided: schema.Decided) -> bool:
        """Whether the decision is about this call. Otherwise this call has failed without an event."""
        return self.waits or (self.server is None and decided.raced)


def course_after(event: Event, decision: Considered, before: Course | None) -> Course | None:
    """Where the open call is from the event on, after that decision; the same as `before` if that changes nothing."""
    decided, now_s = decision.decided, event.t
    if isinstance(event, schema.Decided):
        return _decided(decision, before if before is not None and before.may_become(decided) else None)
    if before is None or decided.decision != "remote":
        return before
    match event:
        case schema.Hedged(server=before.server as name, after_s=after_s):
            words = f"Runs on {name} and on the drone, as {name} had not answered after {after_s:.2f} s"
            return replace(before, sentence=words, at_most_s=event.deadline_s, alone_from_s=now_s)
        case schema.Seconded(server=before.server as name, second=second, after_s=after_s):
            words = f"Runs on {name} and {second}, as {name} had not answered after {after_s:.2f} s"
            return replace(before, sentence=words)
        case schema.RemoteFailed(server=before.server) | schema.RemoteRaised(server=before.server):
            return _left(before, event, f"{before.server} failed, {_ALONE}")
        case schema.TurnOver(server=before.server):
            return _left(before, event, _ALONE)
    return before


def _decided(decision: Considered, before: Course | None) -> Course:
    decided, now_s = decision.decided, decision.decided.t
    began_s = now_s if before is None else before.began_s
    match decided:
        case schema.Decided(decision="wait", server=server, at_most_s=at_most_s):
            words = f"Waits for {server}, {_checked(decision)}: {_against(decision)}"
            return Course(f"waiting for {server}", words, began_s, server, now_s, at_most_s, waits=True)
        case schema.Decided(decision="remote", server=server, deadline_s=deadline_s, raced=raced):
            words = f"Runs on {server}, {_readiness(decision)}" + (", and on the drone" if raced else "")
            began_alone_s = None if before is None else before.alone_from_s
            alone_from_s = (now_s if began_alone_s is None else began_alone_s) if raced else None
            return Course(
                f"calling {server}", words, began_s, server, now_s, deadline_s, alone_from_s=alone_from_s
            )
    words = f"Runs on the drone{_because(_drone_cause(decision))}"
    return Course(_ALONE, words, began_s, alone_from_s=now_s)


def _left(before: Course, event: Event, doing: str) -> Course:
    """The call without the server that had it."""
    words = f"Runs on the drone because {_failure(before.server, '', [event])}"
    alone_from_s = event.t if before.alone_from_s is None else before.alone_from_s
    return Course(doing, words, before.began_s, alone_from_s=alone_from_s)


def ran_on(server: str | None) -> str:
    """The place of a call as text: "on s1", "on the drone"."""
    return "on the drone" if server is None else f"on {server}"


# --- a call that is over ----------------------------------------------------------------------------------------


def ran(outcome: schema.Call, decisions: Sequence[Considered], events: Sequence[Event]) -> str:
    """Where the call ran and why; `events` are what the log told of servers from its first decision on."""
    took = f"in {outcome.delay_s:.2f} s"
    if (
        outcome.waypoint is not None and (outcome.queued_s or 0.0) >= SHORTEST_S
    ):  # one of several that were open
        queued_s = outcome.queued_s or 0.0
        took = f"in {outcome.delay_s - queued_s:.2f} s after {queued_s:.2f} s in line"
    if outcome.server is not None:
        return f"Ran on {outcome.server}{_server_cause(outcome, decisions)} {took}"
    if not decisions:
        return f"Ran on the drone {took}" + (f": {outcome.decision}" if outcome.decision else "")
    return f"Ran on the drone {took}{_because(cause_of(outcome, decisions, events))}"


def _because(cause: str) -> str:
    return f" because {cause}" if cause else ""


def _server_cause(outcome: schema.Call, decisions: Sequence[Considered]) -> str:
    its = [each for each in decisions if each.decided.server == outcome.server]
    if not its:
        return ""
    if outcome.wait == "paid off":
        return f", ready after a wait of {outcome.waited_s:.2f} s,"
    if outcome.wait:
        return f", {_readiness(its[-1])}, after a vain wait of {outcome.waited_s:.2f} s,"
    return f", {_readiness(its[-1])},"


def _readiness(considered: Considered) -> str:
    ready, in_use = "ready", considered.in_use
    if in_use is not None and in_use.stay.state is State.READY:
        ready += f" since {clock(in_use.stay.from_s - considered.began_s)}"
    if not considered.decided.raced:
        return ready
    return (
        f"{ready}, on trial" if considered.decided.why == "on trial" else f"{ready} and sooner than the drone"
    )


def cause_of(outcome: schema.Call, decisions: Sequence[Considered], events: Sequence[Event]) -> str:
    """Why a call that is over ran on the drone; empty if there is nothing to say, and for a call at a server."""
    if outcome.server is not None or not decisions:
        return ""
    last = decisions[-1]
    asked = next(
        (each.decided.server for each in reversed(decisions) if each.decided.decision == "remote"), None
    )
    if outcome.fell_back:
        return _failure(asked, outcome.remote_fault, events)
    if asked is not None and outcome.hedged_s is not None:
        late = f"{asked} had not answered after {outcome.hedged_s:.2f} s"
        return f"{late}, and the drone, which then began too, was sooner"
    if asked is not None:
        return f"it was sooner there than on {asked}"
    waited_for = next((each.decided.server for each in decisions if each.decided.decision == "wait"), None)
    if waited_for is not None and (last.decided.selected is None or last.decided.state in CHECKING):
        return f"{waited_for} was not ready after a wait of {outcome.waited_s:.2f} s{_given_up(waited_for, events)}"
    return _drone_cause(last)


def _failure(server: str | None, fault: str, events: Sequence[Event]) -> str:
    """Why the server gave no usable answer, by the first event about it."""
    for event in events:
        match event:
            case schema.RemoteRaised(server=name, raised=raised) if name == server:
                return f"{server} said that it raised {raised}{_RAISED[fault]}"
            case schema.RemoteFailed(server=name, why=why) if name == server:
                said = _after(name, why)
                return (
                    f"{name} gave {said}"
                    if said.startswith(_NO_ANSWER)
                    else f"{name} failed: {_plain(name, why)}"
                )
            case schema.TurnOver(server=name, why=why) if name == server:
                return f"{name} had given its slot to another drone ({_plain(name, why)})"
    return f"{server or 'the server'} gave no usable answer"


def _given_up(server: str, events: Sequence[Event]) -> str:
    steps = [event for event in events if isinstance(event, schema.ServerStep) and event.server == server]
    if not steps or steps[-1].after in (*CHECKING, State.READY):
        return ""
    return f" ({_plain(server, steps[-1].why)})" if steps[-1].why else ""


def _drone_cause(considered: Considered) -> str:
    """Why a decision was for the drone; empty if there is nothing to say."""
    decided = considered.decided
    server, there_s = decided.selected, decided.remote_s
    if server is None:
        return _none_cause(considered)
    if "no free slot" in decided.why:
        return f"{server} had no free slot{_queue(considered.servers[0])}"
    if there_s is None or decided.local_s is None or any(words in decided.why for words in _WITHOUT_FIGURES):
        return _in_the_past(decided.why)
    if decided.state in CHECKING:
        return f"{server}, {_checked(considered)}, was not worth the wait: {_against(considered)}"
    if decided.state is State.READY and there_s >= decided.local_s:
        return f"{server} was worth less than the drone: {_against(considered)}"
    return _in_the_past(decided.why)


def _in_the_past(why: str) -> str:
    return why.replace("no estimate of", "nothing was known of", 1).replace(" is ", " was ", 1)


def _checked(considered: Considered) -> str:
    elapsed_s = considered.decided.check_elapsed_s or 0.0
    return f"joining since {clock(considered.at_s - elapsed_s)} and not ready yet"


def _against(considered: Considered) -> str:
    """The figures of the server in use against those of the drone."""
    decided, wait_s = considered.decided, considered.wait_s
    if decided.remote_s is None or decided.local_s is None:
        return "it is not known how long the call takes"
    there = f"{decided.remote_s:.2f} s"
    if wait_s:
        there = f"{wait_s:.2f} s of wait and {there}"
    return f"{there} expected there, {decided.local_s:.2f} s on the drone"


def _none_cause(considered: Considered) -> str:
    """Why no server was in use."""
    servers = considered.servers
    if not servers:
        return "the flight has no server" if considered.is_planned else ""
    if considered.policy == "local-only":
        return "the policy local-only uses no server"
    if servers[0].beyond_m > 0:
        return f"no server was in range: {servers[0].stay.server} ends {servers[0].beyond_m:.0f} m away"
    return " and ".join(_unused(server, considered) for server in servers)


def _unused(server: Standing, considered: Considered) -> str:
    """Why the drone did not use a server in range."""
    stay, name = server.stay, f"{server.stay.server}, in range,"
    since = clock(stay.from_s - considered.began_s)
    if stay.state is State.BLACKLISTED:
        lasted = (
            f"until {clock(stay.until_s - considered.began_s)}"
            if stay.until_s is not None
            else f"since {since}"
        )
        return f"{name} was left alone {lasted} after {_after(stay.server, stay.why)}"
    if server.waiting is not None:
        return f"{name} had no free slot{_queue(server)}"
    if server.mean_s is not None and server.local_s is not None and server.mean_s >= server.local_s:
        return (
            f"{name} was worth less than the drone: {server.mean_s:.2f} s a call there, {server.local_s:.2f} s on "
            "the drone"
        )
    if stay.why and _OUT_OF_RANGE not in stay.why and stay.state in (State.AVL, State.AVL_R):
        return f"{name} was left at {since}: {stay.why}"
    return f"{name} was not worth its check for the calls to come, by the policy {considered.policy}"


def _queue(server: Standing) -> str:
    return f", and {counted(server.waiting, 'drone')} waited for one" if server.waiting else ""


# --- what servers and links say, in a sentence ------------------------------------------------------------------


def _after(server: str, why: str) -> str:
    """The failure of a server as a noun: "no answer within 2.8 s", "a failure (its network was lost)"."""
    said = _plain(server, why).replace("does not answer", _NO_ANSWER)
    return said if said.startswith(_NO_ANSWER) else f"a failure ({said})" if said else "a failure"


def _plain(server: str, why: str) -> str:
    """The words without the server's name and address in front."""
    return re.sub(rf"^(?:{re.escape(server)}(?: at [^\s,;]+)?(?::\s+|\s+))+", "", why)
