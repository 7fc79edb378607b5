"""A machine of calls with scripted servers, a scripted drone and no I/O: what it does next stands in a heap."""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

from upwash.core.call import steps
from upwash.core.call.call import Call
from upwash.core.call.calls import Calls
from upwash.core.geo import Position
from upwash.core.operation import Operation
from upwash.core.policies.policy import Inputs, Lightened, Local, Remote
from upwash.core.selection.deadlines import Deadlines
from upwash.core.selection.events import SelectionEvent
from upwash.core.selection.hedging import Hedge
from upwash.core.selection.lanes import InLine, Lanes
from upwash.core.selection.settings import TwoAnswers
from upwash.eventlog import schema
from upwash.eventlog.schema import Event

OPERATION = Operation("gripper", "look")
LIGHT = Operation("gripper", "look", "light")
ASKED = steps.Asked(OPERATION, size_bytes=lambda _: 100)
CHECK = 4
HERE = Position(30.0, 40.0)
REMOTE = Remote("s1", 2.0, "server ready")
RACED = Remote("s1", 2.0, "on trial", raced=True)
LOCAL = Local("no server selected")
LESS = replace(REMOTE, inputs=Inputs(whole_s=1.0, less_s=0.8))


@dataclass
class Reply:
    """What a server says of a call after some time: an event of the machine, without its attempt."""

    after_s: float = 0.5
    kind: type[Any] = steps.Replied
    facts: Mapping[str, Any] = field(default_factory=lambda: {"size_bytes": 7})


def value(after_s: float = 0.5, **facts: Any) -> Reply:
    return Reply(after_s, facts={"size_bytes": 7} | facts)


def silent(after_s: float = 0.5, **facts: Any) -> Reply:
    return Reply(after_s, steps.Failed, {"why": "silent"} | facts)


def not_begun(after_s: float = 0.5) -> Reply:
    return Reply(after_s, steps.TurnedAway, {"why": "in line", "queue_s": 6.0})


def slot_lost(after_s: float = 0.5) -> Reply:
    return Reply(after_s, steps.SlotLost, {"why": "another drone has it"})


@dataclass
class Field:
    """All around calls. What a server says is taken from the left, the last of it again and again."""

    replies: dict[str, list[Reply]] = field(default_factory=lambda: {"s1": [value()]})  # by server
    drone_s: float = 10.0
    drone_raises: str = ""
    drone_fails: bool = False
    decisions: list[Any] = field(default_factory=lambda: [LOCAL])
    reduced: tuple[float, int, str] = (0.25, 60, "")  # seconds, bytes, why the part gave none
    effects: list[Any] = field(default_factory=list)  # of decisions
    hedge: Hedge | None = None
    overtakes_s: list[float] = field(default_factory=list)  # when a server becomes of use, once each
    second_server: str | None = None
    two: TwoAnswers | None = None
    betters: list[tuple[Remote | None, bool]] = field(default_factory=lambda: [(None, False)])
    lighter: Lightened | None = None  # where the drone computes after a failure
    check_ends_s: float = math.inf
    after_wait: Any = REMOTE
    is_left: bool = False  # the server, while a part made the request smaller
    is_there: bool = False  # a range of the server is not known
    expected_s: float | None = 10.0  # of the drone
    remote_known_s: float | None = 0.5  # of each server
    reaches_s: float | None = None
    lane: str | None = "either"  # which one the policy gives the first in line
    deadlines: Deadlines = field(default_factory=Deadlines)
    first: Any = None
    has_current: bool = True  # server in use
    on_servers: bool = False
    waiting_bytes: int = 1000
    told: list[Any] = field(default_factory=list)  # to the core or the log
    known_s: list[float] = field(default_factory=list)  # delays of servers for later hedges
    hedges_s: list[float] = field(default_factory=list)  # of the drone in calls that servers answered
    begun: list[Operation] = field(default_factory=list)  # calls, as hedging knows them
    located_s: list[float] = field(default_factory=list)
    asked: list[tuple[bool, bool]] = field(
        default_factory=list
    )  # decisions: on the drone, while that is busy
    seconds: list[bool] = field(default_factory=list)  # whether a second server begins that was asked for
    busy: list[bool] = field(default_factory=list)
    began_s: list[float] = field(default_factory=list)  # the drone, as the decision to overtake it is told
    ran: list[str] = field(default_factory=list)
    sent_s: list[float] = field(default_factory=list)  # the deadlines of what was sent
    timeouts_s: list[float] = field(default_factory=list)  # of the drone
    done: list[Any] = field(default_factory=list)  # instructions that need no answer
    ends: dict[Call, tuple[float, Any]] = field(default_factory=dict)
    now_s: float = 100.0

    def __post_init__(self) -> None:
        this: Any = self
        self.lanes = Lanes()
        self.estimates = self.policy = self.placement = self.planning = this
        self.two_answers = {} if self.two is None else {OPERATION: self.two}
        self.name = "mine"
        self.servers = {name: SimpleNamespace(name=name, check=CHECK) for name in ("s1", "s2", "s3")}
        self.current: Any = self.servers["s1"] if self.has_current else None
        self.counter = itertools.count()
        self.coming: list[tuple[float, int, Any]] = []
        self.stopped: set[Any] = set()
        self.calls = Calls(
            this, this, self.deadlines, first=self.first, waiting_bytes={"gripper": self.waiting_bytes}
        )

    # --- the story ------------------------------------------------------------------------------------------

    def make(self, asked: steps.Asked = ASKED) -> Call:
        """The mission makes a call."""
        call = Call(asked)
        self.happens(steps.Made(call))
        return call

    def happens(self, event: Any) -> None:
        """Tell the machine, and do what it says; look at the calls while they wait for the news."""
        news = self.calls.news
        for step in self.calls.handle(event, now_s=self.now_s, position=HERE):
            self._do(step)
        if self.calls.news > news and self.calls.await_news:
            self.happens(steps.Recheck())

    def runs(self, until_s: float = math.inf) -> None:
        """Let time pass until then, or until nothing comes any more."""
        while True:
            due_s = min(self.calls.due_s, self.coming[0][0] if self.coming else math.inf)
            if due_s > until_s or due_s == math.inf:
                break
            self.now_s = due_s
            if self.coming and self.coming[0][0] <= due_s:
                event = heapq.heappop(self.coming)[2]
                if not {getattr(event, "attempt", None), getattr(event, "computing", None)} & self.stopped:
                    self.happens(event)
            else:
                self.happens(steps.Recheck())
        self.now_s = max(self.now_s, until_s) if until_s < math.inf else self.now_s

    def answer(self, *decisions: Any, asked: steps.Asked = ASKED) -> tuple[Call, float, Any]:
        """A call that is decided so, after how many seconds it ended, and how."""
        self.decisions, made_s = list(decisions) or self.decisions, self.now_s
        call = self.make(asked)
        while call not in self.ends:
            due_s = min([self.calls.due_s, *(each[0] for each in self.coming)])
            assert due_s < math.inf, "nothing comes any more"
            self.runs(due_s)
        ended_s, end = self.ends[call]
        return call, round(ended_s - made_s, 9), end

    @property
    def logged(self) -> schema.Call:
        """The record of the latest call."""
        return [event for event in self.told if isinstance(event, schema.Call)][-1]

    @property
    def heard(self) -> list[Any]:
        """What the core and the log were told, without decisions and records of calls."""
        return [event for event in self.told if not isinstance(event, (schema.Call, schema.Decided))]

    def _do(self, step: Any) -> None:
        match step:
            case Event() | SelectionEvent():
                self.told.append(step)
            case steps.Reduce(attempt):
                after_s, size_bytes, why = self.reduced
                self._comes(after_s, steps.RequestReduced(attempt, size_bytes, is_less=not why, why=why))
            case steps.Send(attempt, deadline_s):
                self.sent_s.append(deadline_s)
                self.ran.append(f"{attempt.server} from {self.now_s - 100:g}")
                script = self.replies[attempt.server]
                said = script.pop(0) if len(script) > 1 else script[0]
                self._comes(said.after_s, said.kind(attempt, **said.facts))
            case steps.Compute(computing, timeout_s):
                self.timeouts_s.append(timeout_s)
                self.ran.append(f"drone from {self.now_s - 100:g}")
                self._comes(
                    self.drone_s, steps.Computed(computing, self.drone_raises, failed=self.drone_fails)
                )
            case steps.Stop(work):
                self.stopped.add(work)
            case steps.Answer(call) | steps.LeftUnanswered(call):
                assert call not in self.ends, "it has ended before"
                self.ends[call] = self.now_s, step
            case _:
                self.done.append(step)

    def _comes(self, after_s: float, event: Any) -> None:
        heapq.heappush(self.coming, (self.now_s + after_s, next(self.counter), event))

    # --- what the machine asks of the selection -------------------------------------------------------------

    def handle(self, event: Any, *, now_s: float, position: Position) -> list[Any]:
        assert (now_s, position) == (self.now_s, HERE)
        return [event]

    def decide(
        self, operation: Operation, *, on_drone: bool, drone_is_busy: bool, **_: Any
    ) -> tuple[Any, list[Any]]:
        self.asked.append((on_drone, drone_is_busy))
        decision = self.decisions.pop(0) if len(self.decisions) > 1 else self.decisions[0]
        return decision, self.effects

    def decide_after_wait(self, operation: Operation, check: int, **_: Any) -> tuple[Any, list[Any]]:
        assert check == CHECK
        return self.after_wait, []

    def is_awaited(self, check: int) -> bool:
        return self.now_s < self.check_ends_s

    def locate(self, position: Position, now_s: float) -> None:
        assert (now_s, position) == (self.now_s, HERE)
        self.located_s.append(now_s)

    def overtake(self, operation: Operation, *, began_s: float, **_: Any) -> tuple[Remote | None, float]:
        self.began_s.append(began_s - 100)
        if self.overtakes_s and self.now_s - 100 >= self.overtakes_s[0]:
            del self.overtakes_s[0]
            return REMOTE, math.inf
        return None, 100 + self.overtakes_s[0] if self.overtakes_s else math.inf

    def better(self, operation: Operation, by_s: float, *, is_next: bool) -> tuple[Remote | None, bool]:
        found = self.betters.pop(0) if len(self.betters) > 1 else self.betters[0]
        return found if is_next else (None, True)

    def second(self, operation: Operation, beside: str, *, begins: bool) -> Any:
        self.seconds.append(begins)
        return None if self.second_server is None else self.servers[self.second_server]

    def fall_back(self, operation: Operation, **_: Any) -> Lightened | None:
        return self.lighter

    def may_send(self, server: str, check: int) -> bool:
        return not self.is_left

    def may_queue_s(self, server: str, operation: Operation, deadline_s: float) -> float:
        return deadline_s / 2

    def reach_s(self, operation: Operation) -> float | None:
        return self.reaches_s

    def next_in_line(self) -> tuple[InLine, str] | None:
        line = self.lanes.line
        if not line or self.lane is None or not (self.lanes.is_free("local") or self.lanes.is_free("s1")):
            return None
        return line[0], "drone" if line[0].on_drone else self.lane

    # --- of estimates ---------------------------------------------------------------------------------------

    def needs_server(self, operation: Operation) -> bool:
        return self.on_servers

    def is_measured(self, server: str) -> bool:
        return self.is_there

    def local_s(self, operation: Operation) -> float | None:
        return self.expected_s

    def remote_s(self, server: str, operation: Operation) -> float | None:
        return self.remote_known_s

    def tries_part(self, service: str) -> bool:
        return True

    # --- of hedging -----------------------------------------------------------------------------------------

    def called(self, operation: Operation) -> None:
        self.begun.append(operation)

    def plan(self, decision: Remote, operation: Operation, *, is_busy: bool, **_: Any) -> Hedge | None:
        self.busy.append(is_busy)
        return None if is_busy else self.hedge

    def answered(self, server: str, operation: Operation, delay_s: float, *, less: bool) -> None:
        self.known_s.append(delay_s)

    def overtaken(self, hedge: Hedge, decision: Remote, operation: Operation, *, onboard_s: float) -> None:
        self.hedges_s.append(onboard_s)
