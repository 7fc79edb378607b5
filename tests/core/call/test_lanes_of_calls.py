"""Whose lanes calls hold, and until when; which call is decided next, and which gets a server's better answer."""

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
    value,
)

from upwash.core.call import steps
from upwash.core.call.call import Call
from upwash.core.policies.policy import Inputs, Lightened, PolicyDefect, Wait
from upwash.core.selection import events
from upwash.core.selection.deadlines import AnswerDeadline, Deadlines
from upwash.core.selection.hedging import Hedge
from upwash.core.selection.settings import TwoAnswers
from upwash.eventlog import schema

SAID = "builtins.LookupError: nothing"
TWO = TwoAnswers(LIGHT, 20.0)
PATIENT = steps.Asked(OPERATION, size_bytes=lambda _: 100, on_servers=True)


def line(*replies: Reply, **facts: Any) -> Field:
    told: dict[str, Any] = {"first": "oldest"} | facts
    return Field(replies={"s1": list(replies) or [value(30.0)]}, **told)


def rests_s(field: Field) -> tuple[float, float]:
    """How long the lanes of the drone and the server are expected to be held."""
    return tuple(round(field.lanes.rest_s(place, field.now_s), 9) for place in ("local", "s1"))  # type: ignore[return-value]


def of(told: list[Any], kind: type[Any]) -> list[Any]:
    return [event for event in told if isinstance(event, kind)]


# --- lanes --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("expected_s", "rest_s"), [(10.0, 10.0), (None, 0.0)])
def test_the_drones_lane_is_held_for_as_long_as_it_is_expected_to_compute(
    expected_s: float | None, rest_s: float
) -> None:
    for field in (Field(expected_s=expected_s), line(expected_s=expected_s)):
        field.make()
        assert rests_s(field) == (rest_s, 0.0)
        assert not field.lanes.is_free("local") and field.calls.is_busy
        field.runs()
        assert field.lanes.are_free and not field.calls.is_busy


@pytest.mark.parametrize(("known_s", "rest_s"), [(0.5, 3.5), (None, 3.0)])
def test_a_servers_lane_is_held_for_the_calls_of_others_and_the_call_itself(
    known_s: float | None, rest_s: float
) -> None:
    for field in (Field(), line()):
        field.remote_known_s, field.decisions = known_s, [REMOTE]
        field.lanes.queue("s1", 3.0, 100.0)
        field.make()
        assert rests_s(field) == (0.0, rest_s)


@pytest.mark.parametrize(
    ("decision", "held", "rest_s"),
    [(REMOTE, {"s1", "local"}, 0.3), (RACED, {"local"}, 0.0), (LOCAL, {"local"}, 0.0)],
)
def test_a_call_keeps_the_lane_of_its_place_wherever_it_is_computed(
    decision: Any, held: set[str], rest_s: float
) -> None:
    field = line(silent(0.2), decisions=[decision])
    field.make()
    field.runs(100.2)
    assert {place for place in ("local", "s1") if not field.lanes.is_free(place)} == held
    assert rests_s(field)[1] == rest_s
    field.runs()
    assert field.lanes.are_free


def test_a_place_of_unknown_delay_is_held_until_now() -> None:
    field = line(silent(0.2), decisions=[REMOTE], remote_known_s=None)
    field.make()
    assert rests_s(field) == (0.0, 0.0)
    assert not field.lanes.is_free("s1")


def test_a_call_that_a_server_did_not_begin_leaves_the_servers_lane_and_takes_the_drones() -> None:
    field = line(not_begun(2.0), decisions=[LOCAL, REMOTE, LOCAL])
    for number in range(3):
        field.make(steps.Asked(OPERATION, waypoint=number))
        field.runs(field.now_s + 0.25)
    field.lane = None
    field.runs(103.0)
    assert field.lanes.is_free("s1")
    assert [place.on_drone for place in field.lanes.line] == [True, False]
    field.runs(109.0)
    field.lane = "either"
    field.runs()
    assert field.ran == ["drone from 0", "s1 from 0.25", "drone from 10", "drone from 20"]
    assert of(field.told, schema.Call)[1].queued_s == 7.75
    assert field.asked == [(False, False), (False, True), (False, True)]


@pytest.mark.parametrize("is_by_a_deadline", [False, True])
def test_a_call_whose_server_fails_or_is_the_second_of_two_keeps_its_place_on_the_way_to_the_drone(
    is_by_a_deadline: bool,
) -> None:
    deadlines = Deadlines(
        {OPERATION: AnswerDeadline(2.05, 0.999, 1.0)},
        {(name, OPERATION): [0.5] * 200 for name in ("s1", "s2")},
    )
    said = not_begun(0.2) if is_by_a_deadline else silent(0.2)
    field = line(said, decisions=[REMOTE])
    if is_by_a_deadline:
        field.calls.deadlines, field.second_server, field.replies["s2"] = deadlines, "s2", [not_begun(0.2)]
    field.make()
    field.runs(101.0)
    assert not field.lanes.is_free("s1") and field.ran[-1].startswith("drone")


def test_without_a_line_a_call_that_a_server_did_not_begin_is_computed_at_once() -> None:
    field = Field(replies={"s1": [not_begun()]})
    field.answer(REMOTE)
    assert field.ran == ["s1 from 0", "drone from 0.5"] and field.asked == [(False, False)]


def test_a_call_once_takes_the_drone_and_the_next_is_decided_beside_it() -> None:
    field = line(value(1.0), decisions=[REMOTE])
    field.make(steps.Asked(OPERATION, once=True))
    assert rests_s(field)[0] == math.inf
    field.make()
    assert field.ran == ["drone from 0", "s1 from 0"] and field.asked == [(False, True)]


def test_the_first_in_line_is_decided_for_the_drone_where_the_policy_says_so() -> None:
    field = line(lane="drone")
    field.make()
    assert field.asked == [(True, False)]
    assert not any(place.on_drone for place in field.lanes.line)


def test_the_end_of_a_part_before_sending_frees_the_servers_lane_for_the_next_call() -> None:
    field = line(value(1.0), decisions=[replace(RACED, inputs=LESS.inputs), REMOTE], drone_s=1.0)
    field.reduced = (5.0, 60, "")
    field.make()
    field.runs(101.0)
    field.lanes.hold("another", "local", 0.0)
    field.make()
    field.runs()
    assert field.ran == ["drone from 0", "s1 from 5"]


def test_a_call_that_leaves_the_line_to_wait_for_a_check_is_news_for_the_others() -> None:
    field = line(decisions=[LOCAL, Wait("s1", 4.0, "soon")])
    field.make()
    asked = len(field.began_s)
    field.make()
    assert len(field.began_s) > asked, "whether a server overtakes the drone"


def test_a_call_that_is_given_up_in_line_is_never_decided() -> None:
    field = line(lane=None)
    call = field.make()
    field.happens(steps.Abandoned(call))
    assert call.is_over and not field.lanes.line


def test_a_policy_may_leave_lanes_free_beside_a_line_for_less_than_a_minute() -> None:
    field = line(lane=None)
    field.make()
    field.runs(159.0)
    field.calls.wake()
    field.happens(steps.Recheck())
    field.runs(159.9)
    with pytest.raises(PolicyDefect):
        field.runs(160.0)


def test_the_selection_knows_where_each_event_happens() -> None:
    field = Field()
    field.answer(LOCAL)
    assert field.located_s[0] == 100.0 and field.located_s[-1] == 110.0
    assert field.begun == [OPERATION]


# --- better answers -----------------------------------------------------------------------------------------------


def wanting(*replies: Reply, **facts: Any) -> tuple[Field, Call, Call]:
    """Two calls for a better answer, made at 100 and 110 s, while another call holds the server."""
    told: dict[str, Any] = {"two": TWO, "drone_s": 0.1, "decisions": [LOCAL], "betters": [(REMOTE, True)]}
    field = line(*replies, **told | facts)
    field.lanes.hold("another", "s1", 0.0)
    older = field.make(steps.Asked(OPERATION, waypoint=0))
    field.runs(110.0)
    return field, older, field.make(steps.Asked(OPERATION, waypoint=1))


def frees(field: Field, at_s: float) -> None:
    field.runs(at_s)
    field.lanes.release("another")
    field.calls.wake()
    field.happens(steps.Recheck())


@pytest.mark.parametrize(
    ("at_s", "known_s", "is_older"),
    [(119.4, 0.5, True), (119.5, 0.5, True), (119.6, 0.5, False), (119.6, None, True)],
)
def test_a_call_whose_better_answer_would_be_late_is_passed_over(
    at_s: float, known_s: float | None, is_older: bool
) -> None:
    field, older, newer = wanting(value(1.0), remote_known_s=known_s)
    frees(field, at_s)
    assert (bool(older.tries), bool(newer.tries)) == (is_older, not is_older)


def test_a_call_that_is_over_or_had_its_attempt_keeps_no_other_from_its_better_answer() -> None:
    field, older, newer = wanting(value(1.0))
    field.happens(steps.Abandoned(older))
    frees(field, 111.0)
    assert newer.tries
    field, older, newer = wanting(value(1.0, raised=SAID), drone_s=0.1)
    frees(field, 111.0)
    field.runs(112.0)
    assert older in field.ends and newer.tries


def test_no_better_answer_is_sought_while_a_decision_is_open() -> None:
    field, older, newer = wanting(value(1.0))
    field.decisions, field.after_wait = [Wait("s1", 4.0, "soon")], LOCAL
    field.make(steps.Asked(LIGHT))
    frees(field, 111.0)
    field.runs(113.0)
    assert not older.tries and not newer.tries
    field.runs(114.5)
    assert older.tries


def test_a_call_that_has_raised_keeps_no_other_from_its_better_answer_while_the_drone_computes() -> None:
    field = line(value(1.0, raised=SAID), value(1.0), two=TWO, drone_s=9.0, decisions=[LOCAL])
    field.betters = [(REMOTE, True)]
    field.lane = "drone"
    field.make(steps.Asked(OPERATION, waypoint=0))
    newer = field.make(steps.Asked(OPERATION, waypoint=1))
    field.runs(101.5)
    assert newer.tries and field.ran == ["s1 from 0", "drone from 0", "s1 from 1"]


def test_without_a_server_in_use_no_better_answer_is_next() -> None:
    field = line(two=TWO, drone_s=1.0, decisions=[LOCAL], betters=[(REMOTE, True)], has_current=False)
    call = field.make()
    field.runs(110.0)
    assert call not in field.ends and field.ran == ["drone from 0"]


@pytest.mark.parametrize(("fails_s", "tries"), [(19.5, 2), (19.9995, 1)])
def test_a_better_answer_is_sought_until_a_moment_before_its_deadline(fails_s: float, tries: int) -> None:
    field = Field(
        replies={"s1": [silent(fails_s), value(0.25)]},
        two=TWO,
        drone_s=1.0,
        decisions=[replace(RACED, deadline_s=20.0)],
        betters=[(REMOTE, True)],
    )
    field.make()
    field.runs()
    assert len(field.sent_s) == tries


def test_a_call_at_the_server_for_its_better_answer_holds_its_lane_until_that_is_over() -> None:
    field = line(silent(2.0), two=TWO, drone_s=5.0, decisions=[REMOTE], hedge=Hedge(1.0, 9.0))
    call = field.make()
    field.runs(101.5)
    assert rests_s(field) == (9.5, 0.0) and not field.lanes.is_free("s1")
    field.runs(103.0)
    assert field.lanes.is_free("s1") and not field.lanes.is_free("local") and call not in field.ends
    field.runs(106.5)
    assert field.lanes.are_free and call not in field.ends


# --- servers ------------------------------------------------------------------------------------------------------


def by_a_deadline(*replies: Reply, **facts: Any) -> Field:
    known = Deadlines(
        {OPERATION: AnswerDeadline(2.05, 0.999, 1.0)},
        {(name, OPERATION): [0.5] * 200 for name in ("s1", "s2")},
    )
    told: dict[str, Any] = {"second_server": "s2", "deadlines": known, "decisions": [REMOTE]} | facts
    return Field(replies={"s1": [replies[0]], "s2": [replies[-1]]}, **told)


def test_a_second_server_joins_beside_the_drone_too() -> None:
    field = by_a_deadline(value(9.0), value(0.25), hedge=Hedge(0.5, 20.0))
    field.make()
    assert field.seconds == [False], "only what it would be"
    field.runs()
    assert field.ran == ["s1 from 0", "drone from 0.5", "s2 from 1.5"]
    assert field.seconds[-1] is True


def test_a_second_server_needs_time() -> None:
    field = by_a_deadline(silent(1.0), value(0.25), decisions=[replace(REMOTE, deadline_s=1.0)])
    field.make()
    field.runs()
    assert field.ran == ["s1 from 0", "drone from 1"]


def test_an_answer_teaches_how_surely_the_next_is_in_time() -> None:
    field = by_a_deadline(value(0.5))
    known = field.calls.deadlines
    before = known.prospect(OPERATION, "s1", None)
    field.answer(REMOTE)
    after = known.prospect(OPERATION, "s1", None)
    assert before is not None and after is not None and after.probability > before.probability


def test_what_a_server_overtakes_or_betters_is_decided_once_more() -> None:
    field = Field(overtakes_s=[1.0])
    field.answer(LOCAL)
    assert [each.decision for each in of(field.told, schema.Decided)] == ["local", "remote"]
    field = Field(two=TWO, drone_s=1.0, betters=[(REMOTE, True)])
    field.answer(LOCAL)
    assert [each.decision for each in of(field.told, schema.Decided)] == ["local", "remote"]


def test_a_lighter_call_that_a_server_overtakes_is_the_lighter_one_there() -> None:
    lighter = Lightened(LIGHT, OPERATION, 900.0, 800.0)
    field = Field(replies={"s1": [silent(), value()]}, lighter=lighter, overtakes_s=[2.0])
    call, _, end = field.answer(REMOTE)
    assert (end.source.operation, end.source.lightened) == (LIGHT, lighter)
    assert call.operation == OPERATION
    field = Field(two=TWO, drone_s=1.0, betters=[(REMOTE, True)])
    assert field.answer(LOCAL)[2].source.operation == OPERATION, "the better answer is not the light one"


def test_the_speed_of_an_exception_and_of_a_drone_that_failed_is_told() -> None:
    field = Field(replies={"s1": [value(raised=SAID)]}, is_there=True)
    field.answer(REMOTE)
    assert of(field.told, events.Reached) == [events.Reached("s1", HERE, True, OPERATION, 0.5, 107)]
    field = Field(replies={"s1": [value(30.0)]}, drone_fails=True)
    field.answer(RACED)
    assert of(field.told, schema.Dropped) == [schema.Dropped(operation=str(OPERATION), place="local")]


def test_an_exception_to_a_smaller_request_for_a_better_answer_is_the_parts_fault() -> None:
    field = Field(two=TWO, replies={"s1": [value(raised=SAID)]}, drone_s=1.0)
    field.answer(replace(RACED, inputs=LESS.inputs))
    assert of(field.told, events.PartFailed) and not of(field.told, events.RemoteCallFailed)


@pytest.mark.parametrize(
    ("part", "known_s", "is_sent"),
    [
        ((1.5, 60, ""), 0.5, True),
        ((1.5, 100, "it broke"), 0.5, True),
        ((1.5, 100, "it broke"), None, True),
        ((1.75, 100, "it broke"), 0.5, False),
        ((1.75, 60, ""), 0.5, True),
    ],
)
def test_after_a_part_a_request_is_sent_where_the_expected_answer_is_in_time(
    part: Any, known_s: float | None, is_sent: bool
) -> None:
    field = Field(reduced=part, remote_known_s=known_s, decisions=[LESS])
    field.make()
    field.runs(102.0)
    assert bool(field.sent_s) is is_sent


# --- only on servers ----------------------------------------------------------------------------------------------


def patient(*replies: Reply, **facts: Any) -> Field:
    return line(*replies, **{"on_servers": True, "decisions": [REMOTE]} | facts)


def test_a_call_that_the_mission_waits_for_from_the_beginning_ends_at_once_without_a_server() -> None:
    field = patient()
    call = Call(PATIENT, is_waited_for=True)
    field.happens(steps.Made(call))
    assert field.ends[call][1].why == "no server in range can answer, and the mission waits"


@pytest.mark.parametrize(("reach_s", "within_s"), [(5.0, 30.0), (1.5, 10.0)])
def test_a_mission_at_rest_waits_longer_beside_other_calls(reach_s: float, within_s: float) -> None:
    field = patient(value(99.0), reaches_s=reach_s)
    field.make(PATIENT)
    call = field.make(PATIENT)
    field.happens(steps.Waited(call))
    field.runs(100.0 + within_s)
    assert field.ends[call] == (
        100.0 + within_s,
        steps.LeftUnanswered(call, f"no server in range answered within {within_s:.0f} s"),
    )
    assert call.is_over


def test_the_first_of_two_reasons_to_end_at_the_same_time_counts() -> None:
    field = patient(value(99.0))
    call = field.make(PATIENT)
    field.calls.handle(steps.Enough(call), now_s=field.now_s, position=HERE)
    field.happens(steps.EndWaiting("the flight is over"))
    field.happens(steps.Recheck())
    assert field.ends[call][1].why == "the mission dropped it"


@pytest.mark.parametrize(("most_bytes", "ended"), [(200, 0), (199, 1)])
def test_waiting_requests_may_need_all_of_their_memory(most_bytes: int, ended: int) -> None:
    field = patient(value(99.0), waiting_bytes=most_bytes)
    for _ in range(2):
        field.make(PATIENT)
    assert len(field.ends) == ended


def test_a_call_on_servers_alone_is_sent_to_one_at_a_time() -> None:
    known = {(name, OPERATION): [0.5] * 200 for name in ("s1", "s2")}
    field = patient(
        value(9.0), second_server="s2", deadlines=Deadlines({OPERATION: AnswerDeadline(2.05, 0.999)}, known)
    )
    field.make(PATIENT)
    field.runs(105.0)
    assert field.ran == ["s1 from 0"] and field.seconds == []


def test_an_exception_is_logged_as_a_failure_where_the_drone_cannot_test_it() -> None:
    field = patient(value(raised=SAID), value())
    field.answer(REMOTE, asked=PATIENT)
    why = f"s1 says that gripper.look raised {SAID}"
    assert of(field.told, schema.RemoteFailed) == [schema.RemoteFailed(server="s1", check=CHECK, why=why)]
    assert len(of(field.told, schema.Decided)) == 2
    assert field.asked == [(False, False)] * 2, "not for the drone"


@pytest.mark.parametrize(("whole_s", "less_s", "longer"), [(1.0, 0.8, 1.25), (2.0, 0.5, 4.0)])
def test_a_request_that_is_sent_whole_after_all_has_longer(
    whole_s: float, less_s: float, longer: float
) -> None:
    inputs = Inputs(whole_s=whole_s, less_s=less_s)
    field = patient(value(0.5, raised=SAID), value(0.5), decisions=[replace(REMOTE, inputs=inputs)])
    field.answer(asked=PATIENT)
    assert field.sent_s == [1.75, pytest.approx(2.0 * longer)]
    assert of(field.told, events.PartFailed) == [events.PartFailed("gripper")]
