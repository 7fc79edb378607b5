"""Which answers count, and that each call ends, under random calls, answers, failures and times.

Beside the machine under test runs a model of its surroundings: servers and a drone that end their work as drawn, and
a program that looks at the calls when there is news or their time has come.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule
from msgspec import structs
from tests.core.call.field import HERE, LIGHT, LOCAL, OPERATION, RACED, REMOTE
from tests.core.call.world import BY_A_DEADLINE, ON_SERVERS, TWICE, TWO, Story, World

from upwash.core.call import steps
from upwash.core.call.attempts import Attempt, Computing
from upwash.core.call.call import Call
from upwash.core.operation import ON_DRONE, Operation
from upwash.core.policies.policy import Inputs, Lightened, Wait
from upwash.core.selection import events
from upwash.core.selection.hedging import Hedge
from upwash.eventlog import schema
from upwash.eventlog.schema import Event

OF_ANOTHER_SERVICE = Operation("counter", "count")
LIGHTER = Lightened(LIGHT, OPERATION, 900.0, 800.0)
LESS = replace(REMOTE, inputs=Inputs(whole_s=1.0, less_s=0.8))
LESS_RACED = replace(RACED, inputs=LESS.inputs)
LONG = replace(RACED, deadline_s=60.0)
WAIT = Wait("s1", 4.0, "soon")
SAID = "builtins.LookupError: nothing"
MOST_OPEN = 5  # calls
MOST_LOOKS = 100  # in a row
MOST_ENDS = 500  # of work, until all calls are over
AT_ONCE_S = 0.001  # before its deadline the search for a better answer ends

kinds = st.sampled_from(
    [
        *[steps.Asked(operation) for operation in (OPERATION, BY_A_DEADLINE, TWICE) for _ in range(3)],
        *[steps.Asked(OPERATION, once=True), steps.Asked(OF_ANOTHER_SERVICE)],
        *[steps.Asked(ON_SERVERS, on_servers=True, within_s=within_s) for within_s in (None, 30.0)],
    ]
)
decisions = st.sampled_from([LOCAL, REMOTE, RACED, LONG, LESS, LESS_RACED, WAIT])
changes = st.sampled_from(  # of `World`
    [
        *(("decision", each) for each in (LOCAL, REMOTE, LESS)),
        *(("hedge", each) for each in (None, Hedge(0.5, 20.0), Hedge(2.0, 20.0))),
        *(("lighter", each) for each in (None, LIGHTER)),
        *(("reaches_s", each) for each in (None, 2.0)),
        *(
            (name, each)
            for name in ("is_left", "has_better", "may_come", "has_second")
            for each in (False, True)
        ),
        *[("is_of_use", True), ("is_checked", True)] * 3,
    ]
)
attempt_ends = st.sampled_from(["value", "value", "raised", "silent", "unreached", "not begun", "slot lost"])
drone_ends = st.sampled_from(["value", "value", "raised", "failed"])
numbers = st.integers(0, 5)


class RandomCalls(RuleBasedStateMachine):
    """A mission that makes calls, while all that can go wrong does."""

    @initialize(first=st.sampled_from([None, "oldest", "newest"]), is_slow=st.booleans())
    def begin(self, first: str | None, *, is_slow: bool) -> None:
        self.world = World(first)
        self.calls = self.world.calls
        self.first = first
        self.is_slow = is_slow  # the program: it looks when time passes, and not at once
        self.looked_at = 0
        self.alarm_s = math.inf
        self.stories: dict[Call, Story] = {}
        self.under_way: dict[Attempt | Computing, tuple[str, float]] = {}  # what is done, until when at most
        self.latest_s: dict[str, float] = {}  # when the latest computation of a service was asked for
        self.latest_value: Attempt | None = None
        self.records: Counter[tuple[str, int | None]] = Counter()

    # --- what happens ---------------------------------------------------------------------------------------

    @precondition(lambda self: self.open)
    @rule(change=changes)
    def selection_changes(self, change: tuple[str, Any]) -> None:
        setattr(self.world, *change)
        self.tell(events.Tick())

    @precondition(lambda self: len(self.open) < (1 if self.first is None else MOST_OPEN))
    @rule(kind=kinds, decision=decisions, urgent=st.booleans(), waits=st.booleans())
    def mission_calls(self, kind: steps.Asked, decision: Any, *, urgent: bool, waits: bool) -> None:
        self.world.decision, self.world.is_checked, number = decision, False, len(self.stories)
        asked = structs.replace(kind, waypoint=number, urgent=urgent, size_bytes=lambda _: 100)
        waits &= not kind.on_servers or number % 3 == 0
        call = Call(asked, is_waited_for=waits)
        self.stories[call] = Story(asked, self.world.now_s, waits=waits)
        self.tell(steps.Made(call))

    @precondition(lambda self: self.open)
    @rule(number=numbers, what=st.sampled_from(["waits", "waits", "needs no more", "ends", "has no server"]))
    def mission_goes_on(self, number: int, what: str) -> None:
        call = pick(self.open, number)
        story = self.stories[call]
        match what:
            case "waits":
                story.waits = True
                self.tell(steps.Waited(call))
            case "needs no more":
                story.is_enough = True
                self.tell(steps.Enough(call))
            case "ends":
                story.is_abandoned = True
                self.tell(steps.Abandoned(call))
                assert all(work.call is not call for work in self.under_way), "it goes on for no mission"
            case _ if self.calls.waiting:
                self.tell(steps.EndWaiting("the flight is over"))
                self.time_passes(0.0, looks=True)
                assert not self.calls.waiting

    @precondition(lambda self: self.open or self.under_way)
    @rule(step_s=st.sampled_from([0.0, *[0.5, 1.5] * 3, 5.0, 20.0]), looks=st.booleans())
    def time_passes(self, step_s: float, *, looks: bool) -> None:
        """The clock goes to that time; what is due at the end of it may come after the next event."""
        self.look()
        until_s = self.world.now_s + step_s
        while (due_s := min([self.alarm_s, *(end_s for _, end_s in self.under_way.values())])) <= until_s:
            due_s = self.world.now_s = max(due_s, self.world.now_s)
            if due_s == until_s and not looks:
                return
            late = next((work for work, (_, end_s) in self.under_way.items() if end_s <= due_s), None)
            if late is None or self.alarm_s <= due_s:
                self.looked_at = self.calls.news
                self.handle(steps.Recheck())
            else:
                self.ends(late, "cut" if isinstance(late, Attempt) else "failed")
            self.look()
        self.world.now_s = until_s

    @precondition(lambda self: self.doing("send"))
    @rule(number=numbers, how=attempt_ends)
    def attempt_ends(self, number: int, how: str) -> None:
        self.ends(pick(self.doing("send"), number), how)

    @precondition(lambda self: self.doing("reduce"))
    @rule(number=numbers, how=st.sampled_from(["less", "whole", "failed"]))
    def part_before_sending_ends(self, number: int, how: str) -> None:
        self.ends(pick(self.doing("reduce"), number), how)

    @precondition(lambda self: self.doing("compute"))
    @rule(number=numbers, how=drone_ends)
    def drone_ends(self, number: int, how: str) -> None:
        self.ends(pick(self.doing("compute"), number), how)

    def ends(self, work: Attempt | Computing, how: str) -> None:
        """The work of a server, of the drone or of a part before sending ends so."""
        doing, _ = self.under_way.pop(work)
        story, raised = self.stories[work.call], SAID if how == "raised" else ""
        event: Any
        before = replace(story)
        if isinstance(work, Computing):
            event, story.own = steps.Computed(work, raised, failed=how == "failed"), how
        elif doing == "reduce":
            why = "it broke" if how in ("failed", "cut") else ""
            event = steps.RequestReduced(work, 60 if how == "less" else 100, is_less=how == "less", why=why)
        elif how in ("value", "raised"):
            event = steps.Replied(work, 7, raised)
            story.has_raised |= how == "raised"
            self.latest_value = work if how == "value" else None
        elif how == "not begun":
            event, story.place = steps.TurnedAway(work, "in line", 6.0), ""
        elif how == "slot lost":
            event = steps.SlotLost(work, "another drone has it")
        else:
            event = steps.Failed(work, how, cut=how == "cut", unreached=how != "silent")
        self.judge(self.handle(event), work, how, before)
        self.look_at_once()

    # --- the program ----------------------------------------------------------------------------------------

    def tell(self, event: Any) -> None:
        self.handle(event)
        self.look_at_once()

    def look_at_once(self) -> None:
        if not self.is_slow:
            self.look()

    def look(self) -> None:
        """Look at the calls until there is no news that they wait for."""
        for _ in range(MOST_LOOKS):
            is_awaited = self.calls.news != self.looked_at and self.calls.await_news
            self.looked_at = self.calls.news
            if not is_awaited:
                return
            self.handle(steps.Recheck())
        raise AssertionError("calls are looked at again and again")

    def handle(self, event: Any) -> list[Any]:
        told = self.calls.handle(event, now_s=self.world.now_s, position=HERE)
        for step in told:
            self.carry_out(step)
        self.alarm_s = self.calls.due_s
        for call in self.open:
            self.stories[call].is_hopeless |= self.stories[call].waits and not self.world.may_come
        return told

    def carry_out(self, step: Any) -> None:
        match step:
            case Event():
                self.note(step)
            case steps.Reduce(attempt):
                self.begins(attempt, "reduce", self.world.now_s + attempt.deadline_s)
            case steps.Send(attempt, deadline_s, may_queue_s):
                assert 0 <= may_queue_s <= deadline_s
                self.begins(attempt, "send", self.world.now_s + deadline_s)
            case steps.Compute(computing, timeout_s):
                service = computing.operation.service
                assert not any(each.operation.service == service for each in self.doing("compute")), (
                    "two at once"
                )
                assert computing.asked_s >= self.latest_s.get(service, 0.0), "not in the order asked"
                self.latest_s[service] = computing.asked_s
                self.begins(computing, "compute", self.world.now_s + timeout_s)
            case steps.Stop(work):
                del self.under_way[work]
            case steps.Hear(computing):
                story = self.stories[computing.call]
                assert story.is_twice and not story.has_heard and not story.is_over
                story.has_heard = True
            case steps.Answer(call, source):
                assert source.call is call
                self.over(call, step)
            case steps.LeftUnanswered(call, why):
                story = self.stories[call]
                assert story.asked.on_servers
                if why == "no server answered within 30 s":
                    assert self.world.now_s >= story.made_s + 30.0
                self.over(call, step)
                assert all(work.call is not call for work in self.under_way)

    def begins(self, work: Attempt | Computing, doing: str, until_s: float) -> None:
        story = self.stories[work.call]
        assert not story.is_over, "begins for a call that is over"
        assert work not in self.under_way
        assert isinstance(work, Computing) or not story.asked.once
        self.under_way[work] = doing, until_s

    def over(self, call: Call, end: steps.Answer | steps.LeftUnanswered) -> None:
        story, now_s = self.stories[call], self.world.now_s
        assert not story.is_over, "ends twice"
        story.end = end
        if isinstance(end, steps.LeftUnanswered):
            return
        if isinstance(end.source, Attempt):
            assert end.source is self.latest_value, "no server has answered so"
            assert not story.is_twice or now_s <= story.made_s + TWO.within_s
            return
        assert story.own and end.source is call.own, "the drone has not computed it"
        assert story.own != "failed" or story.is_enough or not self.attempts_at(call)
        if story.is_twice and not story.is_enough:
            is_late = now_s >= story.made_s + TWO.within_s - AT_ONCE_S
            assert not self.attempts_at(call), "a better answer may come"
            assert is_late or story.is_hopeless or story.has_raised

    def note(self, event: Any) -> None:
        number = getattr(event, "waypoint", None)
        call = next((call for call in self.stories if call.asked.waypoint == number), None)
        match event:
            case schema.Decided() if call is not None:
                self.decided(self.stories[call], event)
            case schema.Seconded() if call is not None:
                story = self.stories[call]
                assert story.asked.operation == BY_A_DEADLINE and not story.is_over and not story.is_seconded
                story.is_seconded = True
            case schema.Hedged() if call is not None:
                story = self.stories[call]
                assert story.is_one and not story.is_hedged
                story.is_hedged = True
            case schema.Call() | schema.Unanswered():
                self.records[event.kind, event.waypoint] += 1

    def decided(self, story: Story, event: schema.Decided) -> None:
        """In line a call is decided while its place is free, and while no decision is open."""
        assert not story.is_over
        was_waiting, story.is_waiting, story.is_seconded = story.is_waiting, False, False
        if self.first is None:
            story.is_waiting = event.decision == "wait" and story.is_one
            return
        busy = {place_of(work) for work in self.under_way}
        busy |= {each.place for each in self.stories.values() if each.is_one and not each.is_over}
        if event.decision == "remote":
            assert event.server not in busy - {story.place}, "its server is not free"
        if not story.is_one or story.is_decided:
            return
        is_open = any(each.is_waiting and not each.is_over for each in self.stories.values())
        assert not is_open, "another one is being decided"
        story.is_waiting = event.decision == "wait"
        if story.is_waiting:
            return
        story.place = ON_DRONE if event.server is None or event.raced else event.server
        story.is_decided = True
        assert was_waiting or story.place not in busy, "its place is not free"

    def judge(self, told: list[Any], work: Attempt | Computing, how: str, before: Story) -> None:
        """An end of work has the effect that it must have, and no other."""
        story = self.stories[work.call]
        dropped = [step.place for step in told if isinstance(step, schema.Dropped)]
        has_ended = story.end is not None and before.end is None
        source = story.end.source if has_ended and isinstance(story.end, steps.Answer) else None
        if isinstance(work, Computing):
            assert any(isinstance(step, steps.Hear) for step in told) == (
                story.is_twice and not before.is_over and how == "value"
            )
            if before.is_over:
                assert dropped == [ON_DRONE]
            elif story.is_one:
                assert source is (work if how != "failed" or not self.attempts_at(work.call) else None)
        elif how == "value":
            is_tested = story.is_one and before.has_raised and before.own != "failed"
            assert source is (None if before.is_over or is_tested else work), "the first answer counts"
            assert (work.server in dropped) == (before.is_over or is_tested)
            (ended,) = [step for step in told if isinstance(step, events.RemoteCallEnded)]
            assert ended.late == (before.is_over or is_tested or before.has_heard)
        elif story.is_one and not before.is_over:
            is_last = before.own == "failed" and not self.attempts_at(work.call)
            assert source is (work.call.own if is_last else None)
        assert len(dropped) <= 1

    # --- what is known --------------------------------------------------------------------------------------

    @property
    def open(self) -> list[Call]:
        return [call for call, story in self.stories.items() if not story.is_over]

    def doing(self, what: str) -> list[Any]:
        return [work for work, (doing, _) in self.under_way.items() if doing == what]

    def attempts_at(self, call: Call) -> list[Attempt]:
        return [work for work in self.under_way if isinstance(work, Attempt) and work.call is call]

    def is_at_work(self, call: Call) -> bool:
        """Whether a server or the drone works on the call, or on one before it."""
        own = call.own
        is_behind = own is not None and any(
            each.operation.service == own.operation.service for each in self.doing("compute")
        )
        return bool(self.attempts_at(call)) or (is_behind and not self.stories[call].own)

    # --- what always holds ----------------------------------------------------------------------------------

    @invariant()
    def lanes_are_held_by_what_is_under_way(self) -> None:
        lanes = self.world.lanes
        assert not any(lanes.is_free(place_of(work)) for work in self.under_way)
        assert self.under_way or self.open or (lanes.are_free and self.calls.due_s == math.inf)

    @invariant()
    def no_server_has_a_call_twice(self) -> None:
        for call in self.open:
            servers = [attempt.server for attempt in self.attempts_at(call)]
            most = 2 if self.stories[call].asked.operation == BY_A_DEADLINE else 1
            assert len(set(servers)) == len(servers) <= most

    @invariant()
    def an_open_call_goes_on(self) -> None:
        if self.calls.news != self.looked_at or self.alarm_s <= self.world.now_s:
            return  # the program has not looked yet
        line = [place.call for place in self.world.lanes.line]  # type: ignore[attr-defined]
        is_deciding = any(self.stories[call].is_waiting for call in self.open)
        assert is_deciding or self.world.next_in_line() is None, "a free place takes the first in line"
        for call in self.open:
            story = self.stories[call]
            by_s = story.made_s + (TWO.within_s if story.is_twice else story.asked.within_s or math.inf)
            if story.is_waiting:
                assert not self.world.is_checked and self.alarm_s <= self.world.now_s + WAIT.at_most_s
            elif call in line or self.is_at_work(call):
                continue
            else:
                assert not story.is_one, "nothing will answer it"
                assert not story.is_enough and self.alarm_s <= by_s
                assert story.own or not story.is_twice

    def teardown(self) -> None:
        """Servers and the drone end all that is under way, and time passes: then each call has ended."""
        if not hasattr(self, "world"):
            return
        self.world.decision, self.world.is_checked, self.world.is_left = REMOTE, True, False
        self.tell(events.Tick())
        for number in range(MOST_ENDS):
            if self.under_way:
                work, (doing, _) = next(iter(self.under_way.items()))
                self.ends(work, "less" if doing == "reduce" else "value" if number % 3 else "failed")
            elif self.open:
                self.time_passes(5.0, looks=True)
        assert not self.open, "some calls never end"
        self.lanes_are_held_by_what_is_under_way()
        for call, story in self.stories.items():
            is_answer = isinstance(story.end, steps.Answer) and story.end.source.state == "answered"
            assert self.records["call", call.asked.waypoint] == is_answer
            assert self.records["unanswered", call.asked.waypoint] == isinstance(
                story.end, steps.LeftUnanswered
            )


def pick(of: list[Any], number: int) -> Any:
    return of[number % len(of)]


def place_of(work: Attempt | Computing) -> str:
    return work.server if isinstance(work, Attempt) else ON_DRONE


class ManyRandomCalls(RandomCalls):
    """The same, with enough calls to meet what is rare."""


TestRandomCalls = RandomCalls.TestCase
TestRandomCalls.settings = settings(max_examples=250, stateful_step_count=50)
TestManyRandomCalls = pytest.mark.nightly(ManyRandomCalls.TestCase)
TestManyRandomCalls.settings = settings(max_examples=1000, stateful_step_count=50)
