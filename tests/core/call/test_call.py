"""Which answer of a call counts, and what the core, the log and the mission hear of it: without I/O, by scripts."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest
from tests.core.call.field import (
    CHECK,
    HERE,
    LESS,
    LIGHT,
    LOCAL,
    OPERATION,
    RACED,
    REMOTE,
    Field,
    Reply,
    not_begun,
    silent,
    slot_lost,
    value,
)

from upwash.core.call import steps
from upwash.core.call.attempts import Attempt
from upwash.core.policies.policy import Lightened, PolicyDefect, Wait
from upwash.core.selection import events
from upwash.core.selection.deadlines import AnswerDeadline, Deadlines
from upwash.core.selection.hedging import Hedge
from upwash.core.selection.settings import TwoAnswers
from upwash.eventlog import schema

COMPUTED = events.LocalCallEnded(OPERATION, 10.0)
SAID = "builtins.LookupError: nothing"
FAULT = value(raised=SAID)
DENIED = f"it says that gripper.look raised {SAID}, which did not raise on the drone"
TWO = TwoAnswers(LIGHT, 20.0)
ON_SERVERS = steps.Asked(OPERATION, size_bytes=lambda _: 100, on_servers=True, within_s=30.0)


def at(server: str, *said: Reply) -> dict[str, list[Reply]]:
    return {server: list(said)}


def both(first: Reply, second: Reply) -> dict[str, list[Reply]]:
    return at("s1", first) | at("s2", second)


def reached(answered: bool, size_bytes: int = 107) -> events.Reached:
    return events.Reached("s1", HERE, answered, OPERATION, 0.5, size_bytes)


def failed(why: str = "silent", *, late: bool = False) -> list[Any]:
    return [
        schema.RemoteFailed(server="s1", check=CHECK, why=why),
        events.RemoteCallFailed("s1", CHECK, why, late),
    ]


def source(end: Any) -> str:
    """Where the answer came from."""
    if isinstance(end, steps.LeftUnanswered):
        return end.why
    return end.source.server if isinstance(end.source, Attempt) else "drone"


def of(told: list[Any], kind: type[Any]) -> list[Any]:
    return [event for event in told if isinstance(event, kind)]


# --- one server, and the drone where it fails -----------------------------------------------------------------


def test_a_value_in_time_is_told_to_the_core_with_its_delay_and_place() -> None:
    field = Field(is_there=True)
    _, took_s, end = field.answer(REMOTE)
    assert (source(end), took_s, field.ran, field.known_s) == ("s1", 0.5, ["s1 from 0"], [0.5])
    assert field.heard == [events.RemoteCallEnded("s1", OPERATION, 0.5), reached(answered=True)]
    call = field.logged
    assert (call.place, call.check, call.fell_back, call.hedged_s) == ("s1", CHECK, False, None)
    assert (call.delay_s, call.onboard_s, call.queued_s, call.decision) == (0.5, 0.0, None, "server ready")


@pytest.mark.parametrize(
    ("how", "is_reached", "is_cut"),
    [({}, False, False), ({"unreached": True}, True, False), ({"cut": True, "unreached": True}, True, True)],
)
def test_a_failure_is_told_with_what_it_shows_of_the_path_and_of_the_servers_speed(
    how: dict[str, bool], is_reached: bool, is_cut: bool
) -> None:
    field = Field(replies=at("s1", silent(**how)), is_there=True)
    _, took_s, end = field.answer(REMOTE)
    assert (source(end), took_s, field.known_s) == ("drone", 10.5, [])
    unreached = events.Reached("s1", HERE, False, OPERATION, 0.5, 100)
    assert field.heard == [*failed(), *([unreached] if is_reached else []), COMPUTED]
    cuts = of(field.done, steps.Cut)
    assert [each.event for each in cuts] == ([events.RemoteCallCut("s1", OPERATION, 0.5)] if is_cut else [])
    assert (field.logged.fell_back, field.logged.onboard_s) == (True, 10.0)
    assert field.logged.decision == "server ready; no usable answer, so on the drone"


def test_a_call_without_an_answer_counts_as_late_in_what_a_deadline_promises() -> None:
    known = Deadlines({OPERATION: AnswerDeadline(1.0, 0.9, 0.1)}, {("s1", OPERATION): [0.5] * 100})
    before = known.prospect(OPERATION, "s1", None)
    Field(replies=at("s1", silent()), deadlines=known).answer(REMOTE)
    after = known.prospect(OPERATION, "s1", None)
    assert before is not None and after is not None
    assert after.probability < before.probability


def test_a_slot_that_was_taken_in_a_call_is_no_failure_of_the_server() -> None:
    field = Field(replies=at("s1", slot_lost()))
    _, _, end = field.answer(REMOTE)
    assert (source(end), field.logged.fell_back) == ("drone", True)
    assert field.heard == [events.SlotTaken(CHECK, "another drone has it", in_call=True), COMPUTED]


def test_a_call_that_the_server_did_not_begin_is_no_failure_and_the_drone_answers_it() -> None:
    field = Field(replies=at("s1", not_begun()))
    _, _, end = field.answer(REMOTE)
    assert (source(end), field.logged.fell_back, field.known_s) == ("drone", True, [])
    assert field.heard == [
        schema.RemoteQueued(server="s1", check=CHECK, waited_s=0.5, queue_s=6.0, why="in line"),
        events.RemoteCallQueued("s1", "in line", 0.5, 6.0),
        COMPUTED,
    ]


@pytest.mark.parametrize(("stated_s", "queued_s"), [(0.25, 0.25), (99.0, 0.5)])
def test_a_call_waited_no_longer_for_others_than_it_took(stated_s: float, queued_s: float) -> None:
    field = Field(replies=at("s1", value(queued_s=stated_s, queue_s=3.0)))
    field.answer(REMOTE)
    assert field.heard == [events.RemoteCallEnded("s1", OPERATION, 0.5, queued_s=queued_s, queue_s=3.0)]


def test_after_a_failure_the_drone_may_compute_less() -> None:
    lighter = Lightened(LIGHT, OPERATION, 900.0, 800.0)
    field = Field(replies=at("s1", silent()), lighter=lighter)
    field.answer(REMOTE)
    call = field.logged
    assert (call.operation, call.asked, call.forecast_s) == (str(LIGHT), str(OPERATION), 900.0)
    field = Field(replies=at("s1", FAULT), lighter=lighter)
    field.answer(REMOTE)
    assert field.logged.operation == str(OPERATION), "the same call, which tests the exception"


@pytest.mark.parametrize(
    ("expected_s", "timeout_s"), [(None, 30.0), (2.0, 30.0), (3.0, 30.0), (3.1, 31.0), (10.0, 100.0)]
)
def test_the_drones_own_service_has_ten_times_what_it_is_expected_to_take(
    expected_s: float | None, timeout_s: float
) -> None:
    field = Field(expected_s=expected_s)
    field.answer(LOCAL)
    assert field.timeouts_s == [timeout_s]


def test_a_call_on_the_drone_did_not_fall_back() -> None:
    field = Field()
    _, took_s, end = field.answer(LOCAL)
    assert (source(end), took_s, field.ran) == ("drone", 10.0, ["drone from 0"])
    call = field.logged
    assert (call.fell_back, call.queued_s, call.place, call.onboard_s) == (False, None, "local", 10.0)
    assert call.decision == "no server selected"


def test_a_call_that_runs_once_is_decided_by_nobody_and_teaches_nothing() -> None:
    field = Field(overtakes_s=[1.0])
    _, took_s, end = field.answer(asked=replace_asked(once=True))
    assert (source(end), took_s, field.heard, field.ran) == ("drone", 10.0, [], ["drone from 0"])
    assert field.logged.decision == "it runs once, and on the drone"
    assert of(field.told, schema.Decided) == []


def replace_asked(**facts: Any) -> steps.Asked:
    return steps.Asked(OPERATION, size_bytes=lambda _: 100, **facts)


# --- a wait for a check -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("ends_s", "after", "waited_s", "wait", "why"),
    [
        (102.0, replace(REMOTE, why="server became ready"), 2.0, "paid off", "soon: server became ready"),
        (math.inf, LOCAL, 4.0, "failed", "soon: no server selected"),
    ],
)
def test_a_call_waits_for_a_check_until_it_is_over_and_no_longer_than_was_decided(
    ends_s: float, after: Any, waited_s: float, wait: str, why: str
) -> None:
    field = Field(check_ends_s=ends_s, after_wait=after, decisions=[Wait("s1", 4.0, "soon")])
    call = field.make()
    field.runs(101.0)
    assert field.ran == []
    if ends_s < math.inf:
        field.runs(ends_s)
        field.happens(steps.Recheck())
    field.runs()
    record = field.logged
    assert (record.waited_s, record.wait, record.decision) == (waited_s, wait, why)
    assert call in field.ends and len(of(field.told, schema.Decided)) == 2


# --- exceptions that servers report -----------------------------------------------------------------------------


@pytest.mark.parametrize("is_true", [True, False])
def test_an_exception_that_a_server_reports_is_tested_on_the_drone(is_true: bool) -> None:
    field = Field(replies=at("s1", FAULT), drone_raises=SAID if is_true else "")
    field.answer(REMOTE)
    assert field.logged.remote_fault == ("confirmed" if is_true else "denied")
    assert field.logged.decision.endswith(f"which was {field.logged.remote_fault} on the drone")
    assert field.known_s == ([0.5] if is_true else [])
    assert len(of(field.done, steps.Deny)) == (0 if is_true else 1)
    assert field.heard == [
        schema.RemoteRaised(server="s1", check=CHECK, operation="gripper.look", raised=SAID),
        events.RemoteCallRaised("s1", f"s1 says that gripper.look raised {SAID}"),
        *([] if is_true else [schema.RemoteFailed(server="s1", check=CHECK, why=f"s1: {DENIED}")]),
        events.RemoteFaultTested("s1", CHECK, OPERATION, 0.5, DENIED, is_true),
        COMPUTED,
    ]


def test_in_a_race_an_exception_of_the_server_waits_for_the_drones_own_answer() -> None:
    field = Field(replies=at("s1", FAULT))
    _, took_s, end = field.answer(RACED)
    assert (source(end), took_s, field.logged.remote_fault, field.logged.onboard_s) == (
        "drone",
        10.0,
        "denied",
        10.0,
    )
    assert [type(event) for event in field.heard] == [
        schema.RemoteRaised,
        events.RemoteCallRaised,
        schema.RemoteFailed,
        events.RemoteFaultTested,
        events.LocalCallEnded,
    ]


# --- races ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("reply", "drone_fails", "where", "took_s"),
    [
        (value(3.0), False, "s1", 3.0),
        (value(30.0), False, "drone", 10.0),
        (silent(3.0), False, "drone", 10.0),
        (value(30.0), True, "s1", 30.0),
    ],
)
def test_the_first_answer_of_a_race_counts(
    reply: Reply, drone_fails: bool, where: str, took_s: float
) -> None:
    field = Field(replies=at("s1", reply), drone_fails=drone_fails)
    _, after_s, end = field.answer(RACED)
    assert (source(end), after_s) == (where, took_s)
    assert field.ran == ["s1 from 0", "drone from 0"]
    assert field.logged.fell_back is (reply.kind is steps.Failed)


@pytest.mark.parametrize("late_s", [3.0, 30.0])
def test_where_neither_answers_the_drones_failure_ends_the_call(late_s: float) -> None:
    field = Field(replies=at("s1", silent(late_s)), drone_fails=True)
    call, took_s, end = field.answer(RACED)
    assert (end.source is call.own, took_s) == (True, max(late_s, 10.0))
    assert of(field.told, schema.Call) == []


@pytest.mark.parametrize(
    ("reply", "told"),
    [
        (
            value(30.0),
            [
                schema.Dropped(operation="gripper.look", place="s1"),
                events.RemoteCallEnded("s1", OPERATION, 30.0, late=True),
            ],
        ),
        (silent(30.0), failed(late=True)),
        (
            value(30.0, raised=SAID),
            [
                schema.RemoteRaised(server="s1", check=CHECK, operation="gripper.look", raised=SAID),
                schema.RemoteFailed(server="s1", check=CHECK, why=f"s1: {DENIED}"),
                events.RemoteFaultTested("s1", CHECK, OPERATION, 30.0, DENIED, confirmed=False),
            ],
        ),
    ],
)
def test_a_server_that_is_later_than_the_drone_is_told_to_be_late(reply: Reply, told: list[Any]) -> None:
    field = Field(replies=at("s1", reply))
    _, _, end = field.answer(RACED)
    field.runs()
    call = field.logged
    assert (source(end), call.fell_back, call.remote_fault) == ("drone", False, "")
    assert call.decision == "on trial; late, and sooner on the drone"
    assert field.heard == [COMPUTED, *told]


def test_a_server_is_not_late_where_the_drone_has_no_answer() -> None:
    field = Field(replies=at("s1", value(30.0)), drone_fails=True)
    field.answer(RACED)
    assert events.RemoteCallEnded("s1", OPERATION, 30.0, late=False) in field.heard


def test_a_hedge_starts_the_drone_late_and_costs_nothing_before() -> None:
    def hedged(reply: Reply) -> tuple[Field, str, float]:
        field = Field(replies=at("s1", reply), hedge=Hedge(2.0, 20.0))
        _, took_s, end = field.answer(REMOTE)
        return field, source(end), took_s

    field, where, took_s = hedged(value(1.0))
    assert (where, took_s, field.ran, field.logged.hedged_s) == ("s1", 1.0, ["s1 from 0"], None)
    field, where, took_s = hedged(value(5.0))
    assert (where, took_s, field.ran) == ("s1", 5.0, ["s1 from 0", "drone from 2"])
    assert (field.logged.hedged_s, field.logged.onboard_s, field.hedges_s) == (2.0, 3.0, [3.0])
    (begun,) = of(field.told, schema.Hedged)
    assert (begun.after_s, begun.deadline_s, begun.server, begun.check) == (2.0, 20.0, "s1", CHECK)
    field, where, took_s = hedged(value(15.0))
    assert (where, took_s, field.logged.hedged_s) == ("drone", 12.0, 2.0)
    assert (field.logged.fell_back, field.hedges_s) == (False, [])
    field, where, took_s = hedged(silent(1.0))
    assert (where, took_s, field.logged.fell_back, field.logged.hedged_s) == ("drone", 11.0, True, None)


def test_a_hedge_waits_for_the_drones_lane() -> None:
    field = Field(replies=at("s1", value(30.0)), hedge=Hedge(2.0, 40.0), decisions=[REMOTE])
    field.make()
    field.lanes.hold("another call", "local", 0.0)
    field.runs(104.0)
    assert field.ran == ["s1 from 0"]
    field.lanes.release("another call")
    field.calls.wake()
    field.happens(steps.Recheck())
    assert field.ran == ["s1 from 0", "drone from 4"]


def test_a_server_that_becomes_of_use_overtakes_the_drone() -> None:
    field = Field(overtakes_s=[4.0], replies=at("s1", value(1.0)))
    _, took_s, end = field.answer(LOCAL)
    assert (source(end), took_s) == ("s1", 5.0)
    assert field.ran == ["drone from 0", "s1 from 4"]
    assert field.logged.decision == "no server selected; s1 became of use, and was sooner"
    assert set(field.began_s) == {0.0}
    field = Field(overtakes_s=[4.0], replies=at("s1", silent(1.0)))
    _, took_s, end = field.answer(LOCAL)
    assert (source(end), took_s, field.logged.fell_back) == ("drone", 10.0, True)
    field = Field(overtakes_s=[4.0, 6.0], replies=at("s1", silent(1.0), value(1.0)))
    assert field.answer(LOCAL)[1] == 7.0, "and again, after a failure"
    field = Field(overtakes_s=[4.0, 6.0], replies=at("s1", value(1.0, raised=SAID), value(1.0)))
    assert field.answer(LOCAL)[1] == 10.0, "an exception is tested, and not asked for again"


@pytest.mark.parametrize(
    ("decision", "facts"),
    [
        (RACED, {}),
        (REMOTE, {"hedge": Hedge(1.0, 40.0)}),
        (REMOTE, {"hedge": Hedge(5.0, 40.0)}),
        (LOCAL, {"overtakes_s": [1.0]}),
        (replace(REMOTE, inputs=LESS.inputs), {"reduced": (9.0, 60, "")}),
    ],
)
def test_a_call_that_is_given_up_leaves_nothing_that_runs(decision: Any, facts: dict[str, Any]) -> None:
    field = Field(replies=at("s1", value(30.0)), decisions=[decision], **facts)
    call = field.make()
    field.runs(102.0)
    field.happens(steps.Abandoned(call))
    assert len(field.stopped) == max(1, len(field.ran))
    assert field.lanes.are_free and call not in field.ends
    told = len(field.told)
    field.runs()
    assert len(field.told) == told and field.calls.due_s == math.inf


# --- the drone's own computer -------------------------------------------------------------------------------------


def test_the_next_call_of_a_service_waits_for_a_loser_and_no_call_is_hedged_meanwhile() -> None:
    field = Field(hedge=Hedge(0.6, 20.0))
    field.answer(RACED)
    assert field.answer(REMOTE)[1] == 0.5
    assert field.busy == [True]
    _, took_s, _ = field.answer(LOCAL)
    assert (took_s, field.logged.queued_s, field.logged.onboard_s) == (19.0, 9.0, 10.0)
    assert [(each.operation, each.place) for each in of(field.told, schema.Dropped)] == [
        ("gripper.look", "local")
    ]
    field.answer(REMOTE)
    assert field.busy == [True, False]


def test_a_call_in_line_on_the_drone_that_a_server_answers_is_not_computed() -> None:
    field = Field()
    field.answer(RACED)
    field.answer(RACED)
    assert (field.logged.onboard_s, field.logged.queued_s, field.now_s) == (0.0, 0.5, 101.0)
    field.runs()
    assert sum("drone" in each for each in field.ran) == 1


def test_a_call_in_line_on_the_drone_begins_no_sooner_than_now_for_the_decision_to_overtake_it() -> None:
    field = Field()
    field.answer(RACED)
    field.overtakes_s = [4.0]
    assert source(field.answer(LOCAL)[2]) == "s1"
    assert field.began_s[0] == 0.5 and field.began_s[-1] == 4.0


# --- less to send -------------------------------------------------------------------------------------------------


def test_a_request_is_made_smaller_before_it_is_sent() -> None:
    field = Field(is_there=True)
    field.answer(LESS)
    call = field.logged
    assert (call.whole_bytes, call.sent_bytes, call.part_s, call.delay_s) == (100, 60, 0.25, 0.75)
    assert field.heard[0] == events.RemoteCallEnded("s1", OPERATION, 0.75, less=True)
    assert field.heard[1] == events.Reached("s1", HERE, True, OPERATION, 0.75, 67, True)
    assert "made smaller before sending: 0.80 s expected with less to send, 1.00 s whole" in call.decision


def test_a_part_that_fails_has_the_request_sent_whole_and_its_time_is_no_fault_of_the_server() -> None:
    field = Field(reduced=(0.25, 100, "it broke"))
    field.answer(LESS)
    assert field.heard == [
        events.PartFailed("gripper"),
        schema.SentWhole(operation="gripper.look", why="it broke"),
        events.RemoteCallEnded("s1", OPERATION, 0.5),
    ]
    assert (field.logged.sent_bytes, field.logged.delay_s) == (None, 0.75)
    assert "sent whole, as it was not made smaller" in field.logged.decision


@pytest.mark.parametrize("part", [(0.25, 60, ""), (1.6, 100, "it broke")])
def test_what_a_part_has_left_is_sent_only_where_an_answer_can_still_come(part: Any) -> None:
    field = Field(reduced=part, is_left=not part[2])
    _, _, end = field.answer(LESS)
    assert (source(end), field.ran) == ("drone", [f"drone from {part[0]:g}"])


def test_a_part_that_ends_after_the_call_has_nothing_sent() -> None:
    field = Field(drone_s=1.0, reduced=(1.5, 60, ""))
    _, took_s, end = field.answer(replace(RACED, inputs=LESS.inputs))
    field.runs()
    assert (source(end), took_s, field.ran) == ("drone", 1.0, ["drone from 0"])
    assert field.lanes.are_free and not field.calls.is_busy


def test_an_exception_to_a_smaller_request_may_be_the_parts_fault() -> None:
    field = Field(replies=at("s1", FAULT))
    field.answer(LESS)
    assert field.logged.remote_fault == "denied"
    (whole,) = of(field.told, schema.SentWhole)
    assert whole.why == f"s1 says that it raised {SAID} then"
    assert of(field.told, events.RemoteFaultTested) == [] and of(field.done, steps.Deny) == []


# --- a second server, by a deadline -------------------------------------------------------------------------------


def by_a_deadline(first: Reply, second: Reply, **facts: Any) -> tuple[Field, float, Any]:
    """A call that a second server gets after 1.5 s, and all that comes of it."""
    known = Deadlines(
        {OPERATION: AnswerDeadline(2.05, 0.999, 1.0)},
        {("s1", OPERATION): [0.5] * 200, ("s2", OPERATION): [0.5] * 200},
    )
    field = Field(replies=both(first, second), second_server="s2", deadlines=known, **facts)
    _, took_s, end = field.answer(REMOTE)
    field.runs()
    return field, took_s, end


def test_a_late_server_is_joined_by_a_second_one_whose_answer_may_come_first() -> None:
    field, took_s, end = by_a_deadline(value(9.0), value(1.0))
    assert (source(end), took_s, field.ran) == ("s2", 2.5, ["s1 from 0", "s2 from 1.5"])
    assert field.logged.second_s == pytest.approx(1.5)
    (seconded,) = of(field.told, schema.Seconded)
    assert (seconded.server, seconded.second, seconded.check) == ("s1", "s2", CHECK)
    assert seconded.after_s == pytest.approx(1.5) and seconded.deadline_s == pytest.approx(0.5)
    assert field.heard[-2:] == [
        schema.Dropped(operation="gripper.look", place="s1"),
        events.RemoteCallEnded("s1", OPERATION, 9.0, late=True),
    ]


def test_the_first_server_may_still_answer_first() -> None:
    field, took_s, end = by_a_deadline(value(1.8), value(0.4))
    assert (source(end), took_s) == ("s1", 1.8)
    assert of(field.told, schema.Dropped) == [schema.Dropped(operation="gripper.look", place="s2")]
    field, took_s, end = by_a_deadline(value(1.0), value(1.0))
    assert (source(end), took_s, field.ran) == ("s1", 1.0, ["s1 from 0"])


def test_a_server_that_fails_at_once_is_followed_by_the_second_one_at_once() -> None:
    _, took_s, end = by_a_deadline(silent(0.2), value(1.0))
    assert (source(end), took_s) == ("s2", 1.2)


def test_where_both_servers_fail_the_drone_computes() -> None:
    field, took_s, end = by_a_deadline(silent(1.0), silent(1.0))
    assert (source(end), took_s, field.logged.fell_back) == ("drone", 12.0, True)


@pytest.mark.parametrize(
    ("first", "second", "began_s"),
    [(value(1.0, raised=SAID), value(1.0), 1.0), (value(9.0), value(1.0, raised=SAID), 2.5)],
)
def test_an_exception_of_either_server_is_tested_on_the_drone(
    first: Reply, second: Reply, began_s: float
) -> None:
    field, took_s, end = by_a_deadline(first, second)
    assert (source(end), took_s, field.logged.remote_fault) == ("drone", began_s + 10.0, "denied")


def test_an_exception_of_the_slower_server_blames_it() -> None:
    field, _, end = by_a_deadline(value(9.0, raised=SAID), value(1.0))
    assert source(end) == "s2"
    assert field.heard[-1] == events.RemoteCallFailed(
        "s1", CHECK, f"s1 says that gripper.look raised {SAID}", late=True
    )


def test_where_the_drone_fails_to_test_an_exception_the_other_server_may_still_answer() -> None:
    told: dict[str, Any] = {"drone_s": 0.1, "drone_fails": True}
    for first, second in ((FAULT, value(3.0)), (value(3.0), value(0.2, raised=SAID))):
        field, _, end = by_a_deadline(replace(first, after_s=1.7 if first is FAULT else 3.0), second, **told)
        assert isinstance(end.source, Attempt) and end.source.state == "answered"
        assert of(field.told, events.RemoteCallEnded)[0].late is False
    field, took_s, end = by_a_deadline(value(1.7, raised=SAID), silent(1.0), **told)
    assert (source(end), took_s) == ("drone", 2.5)
    field, took_s, end = by_a_deadline(value(2.0, raised=SAID), value(1.0), hedge=Hedge(1.6, 9.0), **told)
    assert source(end) == "s2", "nor does an exception end the call that the drone could not test"


def test_a_lighter_call_on_the_drone_that_a_server_overtakes_has_no_deadline() -> None:
    lighter = Lightened(LIGHT, OPERATION, 900.0, 800.0)
    field, _, end = by_a_deadline(silent(1.0), silent(0.5), lighter=lighter, overtakes_s=[4.0])
    assert source(end) == "drone" and field.ran[-1] == "s1 from 4"


def test_the_drone_joins_in_time_for_a_deadline_that_it_can_keep() -> None:
    field, took_s, end = by_a_deadline(value(9.0), value(9.0), hedge=Hedge(0.5, 20.0), drone_s=0.7)
    assert (source(end), took_s) == ("drone", 1.2)
    assert field.ran == ["s1 from 0", "drone from 0.5"], "and no second server once it has answered"


def test_no_more_second_servers_are_asked_than_the_share_allows() -> None:
    known = Deadlines(
        {OPERATION: AnswerDeadline(2.05, 0.999, 0.2)},
        {("s1", OPERATION): [0.5] * 3000, ("s2", OPERATION): [0.5] * 3000},
    )
    field = Field(replies=both(value(1.9), value(0.1)), second_server="s2", deadlines=known)
    for _ in range(20):
        field.answer(REMOTE)
        field.runs()
    assert len(of(field.told, schema.Seconded)) == 5  # one, and then 0.2 of 20


# --- two answers --------------------------------------------------------------------------------------------------


def twice(decision: Any, *replies: Reply, **facts: Any) -> Field:
    told: dict[str, Any] = {"two": TWO, "drone_s": 1.0} | facts
    return Field(replies=at("s1", *replies), decisions=[decision], **told)


def test_the_first_answer_is_heard_at_once_and_the_better_one_counts() -> None:
    field = twice(RACED, value(5.0))
    call, took_s, end = field.answer()
    (hear,) = of(field.done, steps.Hear)
    assert (hear.computing is call.own, hear.delay_s) == (True, 1.0)
    assert (source(end), took_s) == ("s1", 5.0)
    record = field.logged
    assert (record.first_s, record.onboard_s, record.operation) == (1.0, 1.0, "gripper.look")
    assert record.decision == "on trial; the better answer, of s1"
    assert field.heard == [
        events.LocalCallEnded(LIGHT, 1.0, OPERATION),
        events.RemoteCallEnded("s1", OPERATION, 5.0, late=True),
    ]


def test_a_better_answer_that_comes_first_is_the_only_one() -> None:
    field = twice(REMOTE, value(0.5))
    _, took_s, end = field.answer()
    assert (source(end), took_s, field.ran, field.logged.first_s) == ("s1", 0.5, ["s1 from 0"], None)
    field = twice(RACED, value(0.5))
    _, took_s, end = field.answer()
    assert (source(end), took_s, field.logged.onboard_s) == ("s1", 0.5, 0.5)
    field.runs()
    assert field.heard[-1] == schema.Dropped(operation=str(LIGHT), place="local")


def test_where_no_better_answer_comes_by_the_deadline_the_first_one_counts() -> None:
    field = twice(LOCAL, betters=[(None, True)])
    _, took_s, end = field.answer()
    record = field.logged
    assert (source(end), took_s, record.operation, record.asked) == (
        "drone",
        20.0,
        str(LIGHT),
        str(OPERATION),
    )
    assert (record.fell_back, record.first_s, record.onboard_s) == (False, 1.0, 1.0)
    assert record.decision == "no server selected; the first answer counts, as no better one came"


def test_a_mission_at_rest_does_not_wait_for_a_better_answer_that_cannot_come() -> None:
    field = twice(LOCAL)
    call = field.make()
    field.runs(103.0)
    assert call not in field.ends
    field.happens(steps.Waited(call))
    assert field.ends[call][0] == 103.0


def test_a_mission_that_needs_no_better_answer_has_the_first_and_the_late_one_is_dropped() -> None:
    field = twice(RACED, value(5.0))
    call = field.make()
    field.runs(102.0)
    field.happens(steps.Enough(call))
    assert field.ends[call][0] == 102.0
    field.runs()
    assert schema.Dropped(operation="gripper.look", place="s1") in field.heard
    assert field.lanes.are_free
    field = twice(RACED, value(5.0))
    call = field.make()
    field.happens(steps.Enough(call))
    field.runs()
    assert (field.ends[call][0], source(field.ends[call][1])) == (101.0, "drone"), "not before it is there"


def test_a_server_that_fails_is_followed_by_the_next_that_is_of_use() -> None:
    field = twice(RACED, silent(2.0), value(2.0), betters=[(REMOTE, True)])
    _, took_s, end = field.answer()
    assert (source(end), took_s, field.logged.fell_back) == ("s1", 4.0, False)
    assert field.ran == ["s1 from 0", "drone from 0", "s1 from 2"]


def test_no_server_is_asked_again_for_a_better_answer_after_an_exception() -> None:
    field = twice(RACED, value(2.0, raised=SAID), betters=[(REMOTE, True)])
    _, took_s, end = field.answer()
    assert (source(end), took_s, field.logged.fell_back) == ("drone", 2.0, True)
    assert (
        events.RemoteCallFailed("s1", CHECK, f"s1 says that gripper.look raised {SAID}", True) in field.heard
    )


@pytest.mark.parametrize(("server_s", "first_from_s"), [(3.0, 1.5), (1.0, 1.0)])
def test_the_first_answer_is_computed_where_the_expected_server_is_late_or_fails(
    server_s: float, first_from_s: float
) -> None:
    field = twice(REMOTE, silent(server_s), hedge=Hedge(1.5, 9.0))
    field.answer()
    assert field.ran == ["s1 from 0", f"drone from {first_from_s:g}"]


def test_a_better_answer_ends_the_call_where_the_drone_has_none() -> None:
    field = twice(RACED, value(5.0), drone_fails=True)
    _, took_s, end = field.answer()
    assert (source(end), took_s, of(field.done, steps.Hear)) == ("s1", 5.0, [])
    assert (field.logged.onboard_s, field.logged.first_s) == (0.0, None)
    field = twice(RACED, silent(5.0), drone_fails=True, betters=[(None, False)])
    call = field.make()
    field.happens(steps.Waited(call))
    field.runs()
    assert field.ends[call][1].source is call.own


def test_a_first_answer_that_raised_is_not_heard() -> None:
    field = twice(RACED, value(5.0), drone_raises=SAID)
    assert source(field.answer()[2]) == "s1"
    assert of(field.done, steps.Hear) == []
    assert events.RemoteCallEnded("s1", OPERATION, 5.0, late=False) in field.heard


def test_a_better_answer_has_no_longer_than_its_deadline() -> None:
    field = twice(replace(RACED, deadline_s=60.0), value(5.0))
    field.answer()
    assert field.sent_s == [20.0]


# --- only on servers ----------------------------------------------------------------------------------------------


def on_servers(*replies: Reply, **facts: Any) -> Field:
    told: dict[str, Any] = {"first": "oldest", "on_servers": True, "decisions": [REMOTE]} | facts
    return Field(replies=at("s1", *replies), **told)


def test_a_call_on_servers_alone_is_tried_again_until_a_server_answers() -> None:
    field = on_servers(silent(2.0), slot_lost(1.0), not_begun(1.0), value(1.0))
    _, took_s, end = field.answer(asked=ON_SERVERS)
    assert (source(end), took_s) == ("s1", 6.0), "one second after a server did not begin it"
    again = events.CallWaits(OPERATION, again=True)
    assert field.heard.count(again) == 3
    assert (field.heard[0], field.heard[-1]) == (events.CallWaits(OPERATION), events.CallOver(OPERATION))
    assert (field.logged.queued_s, field.logged.onboard_s, field.logged.fell_back) == (5.0, 0.0, False)


def test_a_call_that_no_server_answers_in_time_ends_without_an_answer() -> None:
    field = on_servers(value(99.0))
    call, took_s, end = field.answer(asked=ON_SERVERS)
    assert (source(end), took_s) == ("no server answered within 30 s", 30.0)
    (unanswered,) = of(field.told, schema.Unanswered)
    assert (unanswered.waited_s, unanswered.within_s, unanswered.at_s) == (30.0, 30.0, 100.0)
    assert field.stopped == set(call.tries) and field.lanes.are_free


def test_a_second_exception_blames_the_call() -> None:
    field = on_servers(FAULT)
    _, took_s, end = field.answer(asked=ON_SERVERS)
    why = f"s1 says that gripper.look raised {SAID}"
    assert (source(end), took_s) == (f"{why}, as at the attempt before", 1.0)
    tested = of(field.told, events.RemoteFaultTested)
    assert [each.confirmed for each in tested] == [False, True]


def test_an_exception_to_a_smaller_request_has_the_whole_one_sent() -> None:
    field = on_servers(FAULT, value(1.0), decisions=[LESS])
    _, took_s, end = field.answer(asked=ON_SERVERS)
    assert (source(end), took_s) == ("s1", 1.75)
    assert of(field.told, events.RemoteFaultTested) == [] and field.logged.sent_bytes is None
    field = on_servers(FAULT, decisions=[LESS])
    field.reduced = (0.25, 60, "")
    call = field.make(ON_SERVERS)
    field.runs(100.3)
    field.is_left = True
    field.runs(100.8)
    assert call not in field.ends and field.heard[-1] == events.CallWaits(OPERATION, again=True)


def test_a_call_that_is_not_sent_waits_for_news() -> None:
    field = on_servers(value(1.0), decisions=[LOCAL, LOCAL, REMOTE])
    call = field.make(ON_SERVERS)
    field.runs(105.0)
    decided = len(of(field.told, schema.Decided))
    assert (decided, field.ran) == (1, [])
    field.happens(events.Tick())
    field.happens(events.Tick())
    field.runs(110.0)
    assert field.ends[call][0] == 106.0


def test_calls_that_are_not_sent_are_no_news_for_each_other() -> None:
    field = on_servers(decisions=[LOCAL])
    for _ in range(2):
        field.make(ON_SERVERS)
    assert len(of(field.told, schema.Decided)) == 3, "the first once more, as another was made"
    field.happens(events.Tick())
    assert len(of(field.told, schema.Decided)) == 5


def test_a_call_is_looked_at_though_something_else_happens_first_at_that_time() -> None:
    field = on_servers(lane=None)
    call = field.make(ON_SERVERS)
    field.now_s = 130.0
    field.happens(steps.EndWaiting("the flight is over"))
    assert field.calls.due_s == 130.0
    field.runs(130.0)
    assert call in field.ends and field.calls.due_s == math.inf


def test_the_mission_may_drop_a_call_and_at_rest_it_waits_only_for_a_server_in_range() -> None:
    field = on_servers(value(99.0))
    patient = replace_asked(on_servers=True)
    call = field.make(patient)
    field.happens(steps.Enough(call))
    assert source(field.ends[call][1]) == "the mission dropped it"
    call = field.make(patient)
    field.happens(steps.Waited(call))
    assert source(field.ends[call][1]) == "no server in range can answer, and the mission waits"
    field.reaches_s = 5.0
    call = field.make(patient)
    field.happens(steps.Waited(call))
    began_s = field.now_s
    field.runs()
    ended_s, end = field.ends[call]
    assert (ended_s - began_s, source(end)) == (15.0, "no server in range answered within 15 s")
    call = field.make(patient)
    field.happens(steps.EndWaiting("the flight is over"))
    assert source(field.ends[call][1]) == "the flight is over"


def test_the_oldest_calls_end_where_requests_need_more_memory_than_they_may() -> None:
    field = on_servers(value(99.0), waiting_bytes=250, lane=None)
    calls = [field.make(ON_SERVERS) for _ in range(4)]
    assert [call in field.ends for call in calls] == [True, True, False, False]
    assert source(field.ends[calls[0]][1]).endswith("keep more than service.waiting_bytes = 250")


# --- several calls ------------------------------------------------------------------------------------------------


def test_calls_in_line_are_decided_one_after_the_other() -> None:
    field = Field(first="oldest", decisions=[LOCAL, REMOTE, LOCAL])
    calls = [field.make(steps.Asked(OPERATION, waypoint=number)) for number in range(3)]
    assert field.ran == ["drone from 0", "s1 from 0"]
    field.runs()
    assert [field.ends[call][0] for call in calls] == [110.0, 100.5, 120.0]
    assert [each.waypoint for each in of(field.told, schema.Decided)] == [0, 1, 2]


def test_a_call_that_a_server_did_not_begin_takes_its_turn_on_the_drone() -> None:
    field = Field(first="oldest", replies=at("s1", not_begun(2.0)), decisions=[LOCAL, REMOTE])
    field.make()
    call = field.make()
    field.runs()
    assert field.ends[call][0] == 120.0
    assert (field.logged.queued_s, field.logged.fell_back) == (8.0, True)


def test_a_wait_for_a_check_holds_up_the_decisions_behind_it() -> None:
    field = Field(first="oldest", decisions=[Wait("s1", 4.0, "soon"), LOCAL], after_wait=LOCAL)
    calls = [field.make(), field.make()]
    field.runs(103.0)
    assert field.ran == []
    field.happens(steps.Abandoned(calls[0]))
    assert field.ran == ["drone from 3"]


def test_a_policy_that_uses_no_lane_for_a_minute_has_a_defect() -> None:
    field = Field(first="oldest", lane=None)
    field.make()
    with pytest.raises(PolicyDefect, match="policy mine: place_in_line used no lane for 60 s"):
        field.runs(160.0)
    field = on_servers(value(), lane=None)
    field.make(replace_asked(on_servers=True))
    field.runs(1000.0)


def test_the_better_answers_of_a_server_come_in_the_order_of_the_line() -> None:
    for order, numbers in (("oldest", [0, 1, 2]), ("newest", [0, 2, 1])):
        field = Field(
            first=order,
            two=TWO,
            drone_s=0.1,
            decisions=[LOCAL],
            betters=[(REMOTE, True)],
            replies=at("s1", value(3.0)),
        )
        for number in range(3):
            field.make(steps.Asked(OPERATION, waypoint=number))
            field.runs(field.now_s + 0.01)
        field.runs()
        places = [each.waypoint for each in of(field.told, schema.Call)]
        assert places == numbers, order


def test_a_call_that_needs_no_better_answer_holds_up_no_other() -> None:
    field = Field(first="oldest", two=TWO, drone_s=5.0, decisions=[LOCAL], betters=[(None, True)])
    calls = [field.make(steps.Asked(OPERATION, waypoint=number)) for number in range(2)]
    field.runs(102.0)
    field.betters = [(REMOTE, True)]
    field.happens(steps.Enough(calls[0]))
    field.happens(events.Tick())
    assert [call.tries != [] for call in calls] == [False, True]


def test_a_call_whose_turn_comes_at_its_deadline_has_the_first_answer_computed_at_once() -> None:
    field = Field(first="oldest", lane=None, two=TWO, hedge=Hedge(2.0, 20.0), decisions=[REMOTE])
    field.make()
    field.now_s, field.lane = 120.0, "either"
    field.happens(events.Tick())
    assert field.ran == ["drone from 20"]


def test_a_decision_that_leaves_a_server_has_servers_looked_at_again() -> None:
    left = schema.NoSlot(server="s1", check=1, waiting=1)
    field = Field(effects=[left])
    field.make()
    assert field.told[0] == left and isinstance(field.told[1], schema.Decided)
    assert of(field.done, steps.LookAgain) == [steps.LookAgain()]
