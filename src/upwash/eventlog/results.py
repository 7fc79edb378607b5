"""The result of a run, read from its events."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field, fields, replace
from sys import intern
from typing import Any

import msgspec

from upwash.core.knowledge.servers import State
from upwash.core.operation import server_of
from upwash.eventlog import schema
from upwash.eventlog.progress import DEMAND_EVENTS, TIME_EVENTS, CallPlaces, MissionTime, OpenDemands
from upwash.eventlog.schema import Event
from upwash.support.text import by_name

# Most events of a long log are positions: a set lookup skips them faster than a match statement.
_COUNTED = (
    TIME_EVENTS
    | DEMAND_EVENTS
    | {
        schema.StayOrGo,
        schema.TurnedBack,
        schema.DeadlinePromised,
        schema.Decided,
        schema.Seconded,
        schema.MissionCompleted,
        schema.Arrived,
        schema.EnergyUsed,
        schema.LeftHovering,
        schema.OffloadingFailed,
        schema.Unanswered,
        *schema.STEPS.values(),
    }
)
_RARE = (
    "in_time", "late", "second_servers", "wait", "fell_back",
    "hidden_s", "first_s", "first_answers", "first_alone", "went_on", "turns_back", "never_ready", "not_acted_on",
    "not_looked_at", "failed_calls", "offloading_failed", "unanswered",
)  # fmt: skip
_LEAST_HIDDEN_S = 0.01  # less is the time between the end of a call and the mission's next step


@dataclass(frozen=True, slots=True)
class CallResult:
    """One service call, as the mission experienced it; `waypoint` is None before the first arrival.

    `place` is where the call ran in the end: "local" for the drone, or a server's name. `delay_s` is the delay of the
    answer, `waited_s` the part spent waiting for a server. The mission made the call at `at_s` of its time. `asked`
    is the operation that the mission asked for, if a lighter one ran. During `hidden_s` of the delay the mission did
    other things. Of a call with two answers the first was there after `first_s`. `wait` says how a wait for a server
    ended; the drone computed a call that `fell_back` after a server had it.
    """

    waypoint: int | None
    operation: str
    place: str
    decision: str
    delay_s: float
    waited_s: float
    at_s: float
    asked: str = ""
    hidden_s: float = 0.0
    first_s: float | None = None
    wait: str = ""
    fell_back: bool = False

    @property
    def key(self) -> str:
        """The profile key of the operation; "" without one."""
        return self.operation.partition("[")[2].removesuffix("]")

    @property
    def server(self) -> str | None:
        """The server that ran the call; None for the drone."""
        return server_of(self.place)


@dataclass(frozen=True, slots=True)
class Totals:
    """Sums over all calls; `remote` counts by server, `fallbacks` remote calls that ended on the drone.

    `waits` counts the calls that waited for a server, `waits_failed` the waits for a server that was not ready in
    time, and `switches` the selections of a server. `lighter` counts the calls that ran lighter than the mission
    asked for. `went_on` counts the answers that the drone did not wait for, and `turns_back` its ways back for
    answers. `service_delay_s` is the sum of all delays; during `hidden_s` of it the mission did other things.
    `first_answers` counts the calls with two answers whose first one was there before a better one, and
    `first_alone` those of them that got no better one by the deadline. Of calls with a deadline `in_time` counts
    those that kept it, and `late` the others; `second_servers` counts the calls that a second server got too.
    """

    calls: int
    local: int
    remote: dict[str, int]
    waits: int
    waits_failed: int
    switches: int
    fallbacks: int
    service_delay_s: float
    lighter: int = 0
    went_on: int = 0
    turns_back: int = 0
    hidden_s: float = 0.0
    first_answers: int = 0
    first_alone: int = 0
    in_time: int = 0
    late: int = 0
    second_servers: int = 0


@dataclass(frozen=True, slots=True)
class EnergyTotals:
    """The energy that a simulated flight drew: rotors in motion, rotors in hover, computing, radio.

    `battery_wh` is the capacity of the battery; None for an endless one.
    """

    total_wh: float
    flight_wh: float
    hover_wh: float
    computing_wh: float
    radio_wh: float
    battery_wh: float | None


@dataclass(frozen=True, slots=True)
class RunResult:
    """One run; `undone` are the waypoints that were not reached, `left_hovering` whether the pilot has to land.

    `not_acted_on` are waypoints whose answers demand what was not done, and `failed_calls` those whose call failed,
    which the mission did nothing about. Where it was not completed, `not_looked_at` are those whose answers it did
    not look at. None stands for a place beside the plan.

    The mission's time is counted from arming; `arming_s` is how long it had waited for that. `energy` is None
    in real flights: only simulations meter it. `never_ready` says of servers that failed, and never were of use,
    why they did at last. `offloading_failed` is the defect after which every call ran on the drone, "" for none.
    `unanswered` has the waypoints of calls that no server answered, of services that only servers run, by the reason.
    """

    policy: str
    mission_time_s: float
    completed: bool
    calls: list[CallResult] = field(repr=False)
    totals: Totals
    waypoints: int
    undone: list[int]
    left_hovering: bool
    arming_s: float = 0.0
    energy: EnergyTotals | None = None
    never_ready: dict[str, str] = field(default_factory=dict)
    not_acted_on: list[int | None] = field(default_factory=list)
    failed_calls: list[int | None] = field(default_factory=list)
    not_looked_at: list[int | None] = field(default_factory=list)
    offloading_failed: str = ""
    unanswered: dict[str, list[int | None]] = field(default_factory=dict)

    def made_the_calls_of(self, other: RunResult) -> bool:
        """Whether the two runs asked for the same calls at the same waypoints, in the same order."""
        mine, its = (
            [(call.waypoint, call.asked or call.operation) for call in run.calls] for run in (self, other)
        )
        return mine == its

    def local_only_time_s(self) -> float | None:
        """How long the mission would have taken with every call at the mean measured local delay.

        None where nothing measured says: an operation never ran on the drone, or the mission went on before answers.
        Where it did other things during a part of a call and then waited, it would have waited on the drone too.
        """
        if (
            self.totals.went_on
            or self.totals.first_answers
            or any(call.hidden_s >= call.delay_s for call in self.calls if call.hidden_s)
        ):
            return None
        local = mean_local_delay_s(self.calls)
        if any(call.operation not in local for call in self.calls):
            return None
        return self.mission_time_s + sum(local[call.operation] - call.delay_s for call in self.calls)

    def saved_s(self) -> float | None:
        """What offloading saved against the measured local delays, in seconds; None where nothing measured says."""
        local_only_s = self.local_only_time_s()
        return None if local_only_s is None or not self.completed else local_only_s - self.mission_time_s


def read_result(events: Iterable[Event]) -> RunResult:
    """The result of the run that left these events, the last of several, whether it was completed or not.

    All parts of a run that was broken off and taken up again count, and the time between them too.
    """
    tally = Tally()
    for event in events:
        if isinstance(event, schema.LogOpened):
            tally = Tally()
        if not tally.completed:
            tally.take(event)
    return tally.result()


class Tally:
    """The result of one run, gathered event by event; it keeps no event. `whereabouts` has the waypoints of calls."""

    def __init__(self) -> None:
        self.completed = False
        self._policy, self._ended_s = "", 0.0
        self._began = MissionTime()
        self.whereabouts = CallPlaces()
        self._calls: list[CallResult] = []
        self._waypoints, self._reached, self._left_hovering = 0, set[int | None](), False
        self._waits: list[str] = []
        self._switches = self._fallbacks = self._went_on = self._turned_back = 0
        self._offloading_failed = ""
        self._unanswered: dict[str, list[int | None]] = {}
        self._deadlines_s: dict[str, float] = {}  # of operations
        self._second_servers = 0
        self._energy: EnergyTotals | None = None
        self._open = OpenDemands()
        self._calling: set[int | None] = set()  # where the call was made that is not over
        self._ready, self._failed = set[str](), dict[str, str]()  # servers; why each failed last

    def take(self, event: Event) -> None:  # noqa: PLR0912 - a case for each kind
        """Takes in the next event."""
        self._ended_s = max(self._ended_s, event.t)  # in a stranger's log times may go back
        if type(event) not in _COUNTED:
            return
        self._began.take(event)
        self.whereabouts.take(event)
        self._open.take(event)
        match event:
            case schema.MissionStarted():
                self._policy, self._waypoints = event.policy, event.waypoints
                self._left_hovering = False
            case schema.MissionCompleted():
                self.completed = True
            case schema.Arrived():
                self._reached.add(event.waypoint)
                self._went_on += event.passing
            case schema.LeftHovering():
                self._left_hovering = True
            case schema.OffloadingFailed():
                self._offloading_failed = event.why
            case schema.ServerStep():
                self._take_step(event)
            case schema.EnergyUsed():
                parts = {part.name: getattr(event, part.name) for part in fields(EnergyTotals)}
                self._energy = EnergyTotals(**parts)
            case schema.DeadlinePromised():
                self._deadlines_s[event.operation] = event.within_s
            case schema.Seconded():
                self._second_servers += 1
            case schema.Decided():
                self._calling = {self.whereabouts.of_call_under_way}
            case schema.Unanswered(why=why):
                self._unanswered.setdefault(why, []).append(event.waypoint)
            case schema.Call():
                self._calling = set()
                self._calls.append(_call(event, self.whereabouts.of_call, self._began.at_s or 0.0))
                self._waits += [event.wait] if event.wait else []
                self._fallbacks += event.fell_back
            case schema.AnswerTaken() if (number := self.whereabouts.answered) is not None:
                call = self._calls[number]
                hidden_s = call.delay_s - event.waited_s  # which the mission did not wait
                if hidden_s >= _LEAST_HIDDEN_S:
                    self._calls[number] = replace(call, hidden_s=hidden_s)
            case schema.StayOrGo() | schema.TurnedBack():
                self._went_on += isinstance(event, schema.StayOrGo) and event.goes
                self._turned_back += isinstance(event, schema.TurnedBack)

    def _take_step(self, step: schema.ServerStep) -> None:
        self._switches += isinstance(step, schema.Selected)
        if step.after is State.READY:
            self._ready.add(step.server)
        elif step.after is State.BLACKLISTED:
            self._failed[step.server] = step.why.removeprefix(f"{step.server}: ")

    @property
    def _not_looked_at(self) -> set[int | None]:
        return (self._calling | self._open.answers) - self._open.demands - self._open.failures

    @property
    def began_s(self) -> float | None:
        """The mission's beginning, in seconds of the log; None before."""
        return self._began.at_s

    def result(self) -> RunResult:
        """The result of the events taken until now."""
        with_deadline = [call for call in self._calls if call.operation in self._deadlines_s]
        late = sum(call.delay_s > self._deadlines_s[call.operation] for call in with_deadline)
        remote = Counter(call.server for call in self._calls if call.server is not None)
        return RunResult(
            policy=self._policy,
            mission_time_s=self._ended_s - (self._began.at_s or 0.0),
            completed=self.completed,
            calls=self._calls,
            totals=Totals(
                calls=len(self._calls),
                local=len(self._calls) - remote.total(),
                remote={server: remote[server] for server in sorted(remote, key=by_name)},
                waits=len(self._waits),
                waits_failed=self._waits.count("failed"),
                switches=self._switches,
                fallbacks=self._fallbacks,
                service_delay_s=sum(call.delay_s for call in self._calls),
                lighter=sum(bool(call.asked) and call.first_s is None for call in self._calls),
                went_on=self._went_on,
                turns_back=self._turned_back,
                hidden_s=sum((call.hidden_s for call in self._calls), 0.0),
                first_answers=sum(call.first_s is not None for call in self._calls),
                first_alone=sum(bool(call.asked) and call.first_s is not None for call in self._calls),
                in_time=len(with_deadline) - late,
                late=late,
                second_servers=self._second_servers,
            ),
            waypoints=self._waypoints,
            undone=[index for index in range(self._waypoints) if index not in self._reached],
            left_hovering=self._left_hovering,
            arming_s=self._began.arming_s,
            energy=self._energy,
            never_ready={
                server: self._failed[server]
                for server in sorted(self._failed, key=by_name)
                if server not in self._ready
            },
            not_acted_on=_in_order(self._open.demands),
            failed_calls=_in_order(self._open.failures),
            not_looked_at=[] if self.completed else _in_order(self._not_looked_at),
            offloading_failed=self._offloading_failed,
            unanswered={why: _in_order(places) for why, places in self._unanswered.items()},
        )


def as_json(value: object) -> Any:
    """A result, or a value made of results, for JSON; fields that are empty in most runs are left out when empty."""
    match msgspec.to_builtins(value):
        case dict() as members:
            fields = {name: as_json(field) for name, field in members.items()}
            rare = [name for name in _RARE if name != "turns_back" or not fields.get("went_on")]
            return {name: field for name, field in fields.items() if field or name not in rare}
        case list() as items:
            return [as_json(item) for item in items]
        case plain:
            return plain


def _in_order(waypoints: Iterable[int | None]) -> list[int | None]:
    """Places beside the plan first."""
    return sorted(waypoints, key=lambda waypoint: -1 if waypoint is None else waypoint)


def _call(event: schema.Call, waypoint: int | None, began_s: float) -> CallResult:
    return CallResult(
        waypoint=waypoint,
        operation=intern(event.operation),  # calls have few of these, and a long run has many calls
        place=intern(event.place),
        decision=intern(event.decision),
        delay_s=event.delay_s,
        waited_s=event.waited_s,
        at_s=event.t - event.delay_s - began_s,
        asked=event.asked,
        first_s=event.first_s,
        wait=event.wait,
        fell_back=event.fell_back,
    )


def mean_local_delay_s(calls: Iterable[CallResult]) -> dict[str, float]:
    """By operation, what its calls on the drone took on average, without what was waited for servers."""
    delays: dict[str, list[float]] = {}
    for call in calls:
        if call.server is None:
            delays.setdefault(call.operation, []).append(call.delay_s - call.waited_s)
    return {operation: sum(values) / len(values) for operation, values in delays.items()}
