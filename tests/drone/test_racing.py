"""Which answer of a call counts, the server's or the drone's own, on virtual time."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from typing import Any

import pytest

from upwash.core.geo import Position
from upwash.core.operation import Operation
from upwash.core.policies.policy import Local, Remote
from upwash.core.selection import events
from upwash.core.selection.deadlines import Deadline, Deadlines
from upwash.core.selection.hedging import Hedge
from upwash.core.selection.lanes import Lanes
from upwash.drone.calling import Attempt, CallAnswer, Calling, Invocation
from upwash.errors import InstanceError
from upwash.eventlog import schema
from upwash.sim.loop import run_virtually

ANY: Any = None
CALL = Invocation(Operation("detector", "look"), ANY, b"")
OTHER = Invocation(Operation("counter", "count"), ANY, b"")
ELSEWHERE = Remote("s1", 2.0, "server ready")
RACED = Remote("s1", 2.0, "on trial", raced=True)


@dataclass
class Field(Calling):
    """A server and the drone's own service, in place of all that a race needs; "" is no answer."""

    server_s: float = 1.0
    server: str = "s1's"
    drone_s: float = 10.0
    drone: str = "own"
    hedge: Hedge | None = None
    overtakes_s: float | None = None  # when a server becomes of use
    overtakes: bool = True
    ran: list[str] = field(default_factory=list)
    told: list[Any] = field(default_factory=list)
    tested: list[str] = field(default_factory=list)
    overtaken_s: list[float] = field(default_factory=list)
    busy: list[bool] = field(default_factory=list)
    began_s: list[float] = field(default_factory=list)  # the drone, as the decision to overtake it is told

    def __post_init__(self) -> None:
        this: Any = self
        self.selection = self.estimates = this
        self.lanes = Lanes()
        super().__init__(this, this, this, this, this)

    # --- the lanes

    def hold(self, computing: asyncio.Task[Any], place: str, takes_s: float | None) -> None:
        self.lanes.hold(computing, place, 0.0)
        computing.add_done_callback(self.lanes.release)

    def remote_s(self, server: str, operation: Operation) -> float | None:
        return None

    def local_s(self, operation: Operation) -> float | None:
        return None

    # --- the decisions and the journal

    def fall_back(self, operation: Operation) -> None:
        return None

    def tell(self, event: object) -> None:
        self.told.append(event)

    def record(self, event: object) -> None:
        self.told.append(event)

    def wake(self) -> None:
        self.told.append("wake")

    def overtake(
        self, operation: Operation, *, began_s: float, waypoint: int | None
    ) -> tuple[Remote | None, float]:
        self.began_s.append(began_s)
        due_s = self.overtakes_s
        if due_s is not None and now_s() >= due_s:
            self.overtakes_s = None
            return ELSEWHERE, 0.0
        return None, 1e9 if due_s is None else due_s

    async def until_told(self, unless: asyncio.Task[object], *, until_s: float) -> None:
        await asyncio.wait([unless], timeout=until_s - now_s())

    # --- calls

    def attempt(self, call: Invocation, decision: Remote) -> Attempt:
        return Attempt(call, decision.server, ANY, ANY, 1, decision.deadline_s, Position(0.0, 0.0))

    async def at_server(self, attempt: Attempt) -> str | None:
        return await self._computed(attempt.server, self.server_s, self.server) or None

    async def onboard(self, call: Invocation) -> str:
        answer = await self._computed("drone", self.drone_s, self.drone)
        if not answer:
            raise InstanceError("the drone's own service failed")
        return answer

    async def _computed(self, where: str, took_s: float, answer: str) -> str:
        self.ran.append(f"{where} from {now_s():g}")
        try:
            await asyncio.sleep(took_s)
        except asyncio.CancelledError:
            self.ran.append(f"{where} cancelled at {now_s():g}")
            raise
        return answer

    def test(self, attempt: Attempt, onboard: str) -> None:
        self.tested.append(onboard)

    # --- hedging

    def called(self, operation: Operation) -> None:
        pass

    def plan(
        self, decision: Remote, operation: Operation, *, is_busy: bool, within_s: float | None
    ) -> Hedge | None:
        self.busy.append(is_busy)
        return None if is_busy else self.hedge

    def overtaken(self, hedge: Hedge, decision: Remote, operation: Operation, *, onboard_s: float) -> None:
        self.overtaken_s.append(onboard_s)


def now_s() -> float:
    return asyncio.get_running_loop().time()


def run(place: Callable[[], Field], story: Callable[[Field], Awaitable[Any]]) -> Any:
    async def told() -> Any:
        return await story(place())

    return run_virtually(told())


def answered(decision: Any, **facts: Any) -> tuple[Field, CallAnswer, float]:
    """The field, the answer, and after how many seconds it came."""

    async def story(field: Field) -> tuple[Field, CallAnswer, float]:
        return field, await field.answer(decision, CALL), now_s()

    found: tuple[Field, CallAnswer, float] = run(lambda: Field(**facts), story)
    return found


def test_a_server_alone_is_asked_and_the_drone_where_it_fails() -> None:
    field, answer, took_s = answered(ELSEWHERE)
    assert (answer.reply, answer.server, took_s, field.ran) == ("s1's", "s1", 1.0, ["s1 from 0"])
    assert (answer.fell_back, answer.hedged_s, answer.onboard_s) == (False, None, 0.0)
    field, answer, took_s = answered(ELSEWHERE, server="", overtakes=False)
    assert (answer.reply, answer.server, took_s) == ("own", None, 11.0)
    assert (answer.fell_back, answer.onboard_s, field.tested) == (True, 10.0, ["own"])
    assert field.told == [events.LocalCallEnded(CALL.operation, 10.0)]


def test_a_call_on_the_drone_did_not_fall_back() -> None:
    field, answer, took_s = answered(Local("no server"))
    assert (answer.reply, answer.server, took_s, field.ran) == ("own", None, 10.0, ["drone from 0"])
    assert (answer.fell_back, answer.queued_s, answer.overtook, field.tested) == (False, 0.0, False, [])


@pytest.mark.parametrize(
    ("facts", "reply", "took_s"),
    [
        ({"server_s": 3.0}, "s1's", 3.0),
        ({"server_s": 30.0}, "own", 10.0),
        ({"server_s": 3.0, "server": ""}, "own", 10.0),
        ({"server_s": 30.0, "drone": ""}, "s1's", 30.0),
    ],
)
def test_the_first_answer_of_a_race_counts(facts: dict[str, Any], reply: str, took_s: float) -> None:
    field, answer, after_s = answered(RACED, **facts)
    assert (answer.reply, after_s, answer.overtook) == (reply, took_s, False)
    assert field.ran[:2] == ["drone from 0", "s1 from 0"] or field.ran[:2] == ["s1 from 0", "drone from 0"]
    assert answer.fell_back is (facts["server_s"] == 3.0 and reply == "own")


def test_where_neither_answers_the_drones_failure_is_raised() -> None:
    with pytest.raises(InstanceError, match="the drone's own service failed"):
        answered(RACED, server="", drone="")


def test_a_hedge_starts_the_drone_late_and_costs_nothing_before() -> None:
    field, answer, took_s = answered(ELSEWHERE, hedge=Hedge(2.0, 20.0))
    assert (answer.reply, answer.hedged_s, took_s, field.ran) == ("s1's", None, 1.0, ["s1 from 0"])
    field, answer, took_s = answered(ELSEWHERE, hedge=Hedge(2.0, 20.0), server_s=5.0)
    assert (answer.reply, answer.hedged_s, answer.onboard_s, took_s) == ("s1's", 2.0, 3.0, 5.0)
    assert (field.ran[:2], field.overtaken_s) == (["s1 from 0", "drone from 2"], [3.0])
    (hedged,) = (event for event in field.told if isinstance(event, schema.Hedged))
    assert (hedged.after_s, hedged.deadline_s) == (2.0, 20.0)
    field, answer, took_s = answered(ELSEWHERE, hedge=Hedge(2.0, 20.0), server_s=15.0)
    assert (answer.reply, answer.server, answer.hedged_s, took_s) == ("own", None, 2.0, 12.0)
    assert (answer.fell_back, field.overtaken_s) == (False, [])
    field, answer, took_s = answered(ELSEWHERE, hedge=Hedge(2.0, 20.0), server="")
    assert (answer.reply, answer.fell_back, answer.hedged_s, took_s) == ("own", True, None, 11.0)


def test_a_server_that_becomes_of_use_overtakes_the_drone() -> None:
    field, answer, took_s = answered(Local("no server"), overtakes_s=4.0)
    assert (answer.reply, answer.overtook, took_s) == ("s1's", True, 5.0)
    assert field.ran[:2] == ["drone from 0", "s1 from 4"]
    assert field.began_s == [0.0, 0.0]
    field, answer, took_s = answered(Local("no server"), overtakes_s=4.0, server="")
    assert (answer.reply, answer.overtook, answer.fell_back, took_s) == ("own", False, True, 10.0)
    field, answer, took_s = answered(Local("no server"), overtakes_s=4.0, overtakes=False)
    assert (answer.reply, field.ran) == ("own", ["drone from 0"])


@pytest.mark.parametrize(
    ("decision", "facts"),
    [
        (RACED, {"server_s": 30.0}),
        (ELSEWHERE, {"server_s": 30.0, "hedge": Hedge(1.0, 40.0)}),
        (ELSEWHERE, {"server_s": 30.0, "hedge": Hedge(5.0, 40.0)}),
        (Local("no server"), {"server_s": 30.0, "overtakes_s": 1.0}),
    ],
)
def test_a_call_that_is_given_up_leaves_nothing_that_runs(decision: Any, facts: dict[str, Any]) -> None:
    async def story(field: Field) -> None:
        call = asyncio.create_task(field.answer(decision, CALL))
        await asyncio.sleep(2.0)
        call.cancel()
        await asyncio.gather(call, return_exceptions=True)
        begun = sum("from" in each for each in field.ran)
        assert sum("cancelled at 2" in each for each in field.ran) == begun

    run(lambda: Field(**facts), story)


def test_the_next_call_of_that_service_waits_for_a_loser_and_no_call_is_hedged_meanwhile() -> None:
    async def story(field: Field) -> None:
        await field.answer(RACED, CALL)
        assert (now_s(), await field.queue("counter")) == (1.0, 0.0)
        field.hedge = Hedge(0.5, 20.0)
        answer = await field.answer(ELSEWHERE, OTHER)
        assert (now_s(), answer.hedged_s, field.busy) == (2.0, None, [True])
        answer = await field.answer(Local("no server"), CALL)
        assert (now_s(), answer.queued_s, answer.onboard_s) == (20.0, 8.0, 10.0)
        dropped = [event for event in field.told if isinstance(event, schema.Dropped)]
        assert [(each.operation, each.place) for each in dropped] == [(str(CALL.operation), "local")]
        await field.answer(ELSEWHERE, OTHER)
        assert field.busy == [True, False]

    run(Field, story)


def test_a_call_in_line_that_a_server_answers_is_not_computed() -> None:
    async def story(field: Field) -> None:
        await field.answer(RACED, CALL)
        answer = await field.answer(RACED, CALL)
        assert (answer.reply, answer.onboard_s, answer.queued_s, now_s()) == ("s1's", 0.0, 1.0, 2.0)
        await asyncio.sleep(30.0)
        assert sum("drone from" in each for each in field.ran) == 1

    run(Field, story)


def test_a_call_in_line_begins_no_sooner_than_now_for_the_decision_to_overtake_it() -> None:
    async def story(field: Field) -> None:
        await field.answer(RACED, CALL)
        field.overtakes_s = 4.0
        assert (await field.answer(Local("no server"), CALL)).reply == "s1's"
        assert field.began_s == [1.0, 4.0]

    run(Field, story)


@pytest.mark.parametrize(("server_s", "loser"), [(1.0, "drone"), (30.0, "s1")])
def test_losers_end_with_the_flight(server_s: float, loser: str) -> None:
    async def story(field: Field) -> None:
        await field.answer(RACED, CALL)
        await asyncio.sleep(1.0)
        await field.stop_losers()
        await asyncio.sleep(0.5)
        assert field.ran[-1] == f"{loser} cancelled at {now_s() - 0.5:g}"

    run(lambda: Field(server_s=server_s), story)


@dataclass
class TwoServers(Field):
    """A field with a second server, for calls that the first has not answered after 1.5 s."""

    second_s: float = 1.0
    second_answer: str = "s2's"
    raises: str = ""  # the server whose answer is an exception

    def __post_init__(self) -> None:
        super().__post_init__()
        known_s = {("s1", CALL.operation): [0.5] * 200, ("s2", CALL.operation): [0.5] * 200}
        self._deadlines = Deadlines({CALL.operation: Deadline(2.05, 0.999, 1.0)}, known_s)

    def second(self, operation: Operation, *, beside: str, begins: bool = False) -> str | None:
        return "s2"

    async def at_server(self, attempt: Attempt) -> str | None:
        if attempt.server == "s2":
            answer = await self._computed("s2", self.second_s, self.second_answer)
        else:
            answer = await super().at_server(attempt) or ""
        if attempt.server == self.raises:
            attempt.raised, answer = "an exception", ""
        if answer and attempt.late:
            self.told.append(f"dropped {answer}")
        return answer or None


def asked_twice(**facts: Any) -> tuple[TwoServers, CallAnswer, float]:
    """The field after all of its calls, the answer, and after how many seconds it came."""

    async def story(field: Field) -> tuple[Field, CallAnswer, float]:
        answer = await field.answer(ELSEWHERE, CALL)
        took_s = now_s()
        await asyncio.sleep(100.0)
        return field, answer, took_s

    found: tuple[TwoServers, CallAnswer, float] = run(lambda: TwoServers(**facts), story)
    return found


def test_a_late_server_is_joined_by_a_second_one_whose_answer_may_come_first() -> None:
    field, answer, took_s = asked_twice(server_s=9.0)
    assert (answer.reply, answer.server, took_s) == ("s2's", "s2", 2.5)
    assert answer.attempt is not None and answer.attempt.second_s == pytest.approx(1.5)
    (seconded,) = (event for event in field.told if isinstance(event, schema.Seconded))
    assert (seconded.server, seconded.second) == ("s1", "s2")
    assert seconded.after_s == pytest.approx(1.5) and seconded.deadline_s == pytest.approx(0.5)
    assert field.ran == ["s1 from 0", "s2 from 1.5"] and field.told[-1] == "dropped s1's"


def test_the_first_server_may_still_answer_first() -> None:
    field, answer, took_s = asked_twice(server_s=1.8, second_s=0.4)
    assert (answer.reply, answer.server, took_s) == ("s1's", "s1", 1.8)
    assert field.told[-1] == "dropped s2's"
    field, answer, took_s = asked_twice(server_s=1.0)
    assert (answer.server, took_s, field.ran) == ("s1", 1.0, ["s1 from 0"])


def test_a_server_that_fails_at_once_is_followed_by_the_second_one_at_once() -> None:
    _, answer, took_s = asked_twice(server="", server_s=0.2)
    assert (answer.reply, answer.server, took_s) == ("s2's", "s2", 1.2)


def test_where_both_servers_fail_the_drone_computes() -> None:
    _, answer, took_s = asked_twice(server="", second_answer="")
    assert (answer.reply, answer.server, answer.fell_back, took_s) == ("own", None, True, 12.0)


@pytest.mark.parametrize(("raises", "began_s"), [("s1", 1.0), ("s2", 2.5)])
def test_an_exception_of_either_server_is_tested_on_the_drone(raises: str, began_s: float) -> None:
    field, answer, took_s = asked_twice(raises=raises, server_s=1.0 if raises == "s1" else 9.0)
    assert (answer.reply, answer.server, took_s) == ("own", None, began_s + 10.0)
    assert field.tested == ["own"]


def test_the_drone_joins_in_time_for_a_deadline_that_it_can_keep() -> None:
    field, answer, took_s = asked_twice(hedge=Hedge(0.5, 20.0), server_s=9.0, second_s=9.0, drone_s=0.7)
    assert (answer.reply, answer.server, took_s) == ("own", None, 1.2)
    assert field.ran == ["s1 from 0", "drone from 0.5"]  # and no second server once it has answered
