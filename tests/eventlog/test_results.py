"""Reading a run's result from its events."""

from __future__ import annotations

import pytest
from tests.events import event as made
from tests.scenarios import fault, scenario, server

from upwash.eventlog.ending import left_undone
from upwash.eventlog.results import CallResult, as_json, read_result
from upwash.eventlog.schema import Event
from upwash.lab.run import simulate


def event(t: float, name: str, **facts: object) -> Event:
    return made(name, t, **facts)


def call(
    t: float, place: str, delay_s: float, *, wait: str = "", waited_s: float = 0.0, **more: object
) -> Event:
    facts = {"operation": "detector.process_photo[heavy]", "decision": "as estimated", "fell_back": False}
    return event(t, "call", place=place, delay_s=delay_s, wait=wait, waited_s=waited_s, **(facts | more))


RUN = [
    event(0.0, "log_opened"),
    event(2.0, "mission_started", policy="location-aware", waypoints=5),
    event(10.0, "arrived", waypoint=0),
    call(13.0, "local", 3.0),
    event(14.0, "selected", server="s1"),
    event(20.0, "arrived", waypoint=1),
    call(26.0, "s2", 1.0, wait="paid off", waited_s=0.7),
    call(27.0, "s1", 1.0),
    event(28.0, "selected", server="s2"),
    call(34.0, "local", 7.0, wait="failed", waited_s=2.0, fell_back=True),
    event(40.0, "mission_completed"),
    event(41.0, "position"),
]


def test_calls_are_told_with_their_waypoint_and_the_missions_time() -> None:
    result = read_result(RUN)
    assert (result.policy, result.completed, result.mission_time_s) == ("location-aware", True, 38.0)
    assert [(each.waypoint, each.place, each.at_s) for each in result.calls] == [
        (0, "local", 8.0),
        (1, "s2", 23.0),
        (1, "s1", 24.0),
        (1, "local", 25.0),
    ]


def test_totals_are_counted_over_all_calls() -> None:
    totals = read_result(RUN).totals
    assert (totals.calls, totals.local, totals.remote) == (4, 2, {"s1": 1, "s2": 1})
    assert (totals.waits, totals.waits_failed, totals.switches, totals.fallbacks) == (2, 1, 2, 1)
    assert totals.service_delay_s == pytest.approx(12.0)


def test_the_time_with_local_calls_alone_uses_their_measured_mean_without_waiting() -> None:
    # local calls took 3 s and 7 - 2 s, 4 s on average: 16 s for the four calls, which took 12 s
    assert read_result(RUN).local_only_time_s() == pytest.approx(38.0 + 16.0 - 12.0)


def test_without_a_measured_local_call_nothing_is_claimed() -> None:
    assert read_result([*RUN[:2], call(9.0, "s1", 1.0)]).local_only_time_s() is None


def test_a_run_that_broke_off_lasts_to_its_last_event() -> None:
    result = read_result(RUN[:5])
    assert (result.completed, result.mission_time_s, len(result.calls)) == (False, 12.0, 1)


def test_a_call_before_the_first_waypoint_belongs_to_none() -> None:
    result = read_result([RUN[1], call(4.0, "local", 1.0)])
    assert result.calls == [
        CallResult(None, "detector.process_photo[heavy]", "local", "as estimated", 1.0, 0.0, 1.0)
    ]


def test_a_log_without_a_mission_has_no_calls() -> None:
    for events in ([], RUN[:1]):
        result = read_result(events)
        assert (result.completed, result.calls, result.mission_time_s) == (False, [], 0.0)


def test_the_waypoints_that_were_not_reached_are_left_undone() -> None:
    result = read_result(RUN)
    assert (result.waypoints, result.undone, result.left_hovering) == (5, [2, 3, 4], False)
    assert read_result([*RUN[:-2], event(39.0, "left_hovering")]).left_hovering


def test_a_log_of_two_runs_tells_of_the_last() -> None:
    latest = [
        event(0.0, "log_opened"),
        event(1.0, "mission_started", policy="local-only"),
        call(5.0, "local", 2.0),
    ]
    result = read_result([*RUN, *latest])
    assert (result.policy, result.completed, result.mission_time_s) == ("local-only", False, 4.0)
    assert [each.at_s for each in result.calls] == [2.0]
    assert result.totals.switches == 0


# --- answers that come later ----------------------------------------------------------------------------------

STARTED = event(0.0, "mission_started", policy="look-ahead", waypoints=3)


def started(t: float, waypoint: int) -> Event:
    return event(t, "call_started", operation="detector.process_photo[heavy]", waypoint=waypoint)


def taken(t: float, waypoint: int, waited_s: float, **more: object) -> Event:
    return event(t, "answer_taken", waypoint=waypoint, waited_s=waited_s, **more)


def test_a_call_that_ends_elsewhere_belongs_to_the_waypoint_where_it_was_made() -> None:
    result = read_result(
        [
            STARTED,
            event(1.0, "arrived", waypoint=0),
            started(2.0, 0),
            event(2.0, "stay_or_go", waypoint=0, goes=True, why="it always goes", chance=0.25),
            event(11.0, "arrived", waypoint=1),
            call(12.0, "local", 10.0),
            event(12.0, "turned_back", waypoint=0),
            event(21.0, "arrived", waypoint=0),
            taken(21.0, 0, 0.5, demanded=True),
            event(30.0, "arrived", waypoint=1),
            started(31.0, 1),
            call(34.0, "local", 3.0),
            taken(34.0, 1, 3.0),
        ]
    )
    assert [(each.waypoint, each.hidden_s) for each in result.calls] == [(0, 9.5), (1, 0.0)]
    assert (result.totals.went_on, result.totals.turns_back, result.totals.hidden_s) == (1, 1, 9.5)
    assert result.local_only_time_s() is None  # what going lost and saved is not measured


def test_a_call_that_was_dropped_does_not_take_the_place_of_the_next_one() -> None:
    result = read_result(
        [
            STARTED,
            event(1.0, "arrived", waypoint=0),
            started(2.0, 0),
            event(5.0, "arrived", waypoint=1),
            started(6.0, 1),  # begins once the first is over, which nobody waits for
            call(12.0, "local", 10.0),
            call(15.0, "s1", 3.0),
            taken(15.0, 1, 2.0),
        ]
    )
    assert [(each.waypoint, each.place, each.hidden_s) for each in result.calls] == [
        (0, "local", 0.0),
        (1, "s1", 1.0),
    ]


def test_a_call_that_failed_does_not_give_its_waypoint_to_the_next_one() -> None:
    result = read_result(
        [
            STARTED,
            event(1.0, "arrived", waypoint=0),
            started(2.0, 0),
            taken(8.0, 0, 6.0, failed="no memory"),
            event(9.0, "arrived", waypoint=1),
            call(12.0, "local", 3.0),
        ]
    )
    assert [each.waypoint for each in result.calls] == [1]
    assert result.local_only_time_s() == 12.0


def test_what_is_rounded_away_was_not_hidden() -> None:
    result = read_result([STARTED, started(1.0, 0), call(4.0, "local", 3.0), taken(4.0, 0, 2.999)])
    assert result.totals.hidden_s == 0.0


def test_what_offloading_saved_is_known_where_the_mission_waited_for_each_answer_in_the_end() -> None:
    calls = [started(1.0, 0), call(4.0, "local", 3.0), started(5.0, 1), call(6.0, "s1", 1.0)]
    waited = read_result([STARTED, *calls[:2], taken(4.0, 0, 2.5), *calls[2:], taken(6.0, 1, 0.4)])
    assert waited.totals.hidden_s == pytest.approx(1.1)
    assert waited.local_only_time_s() == pytest.approx(6.0 + 3.0 - 1.0)
    too_late = read_result([STARTED, *calls[:2], taken(4.0, 0, 2.5), *calls[2:], taken(6.5, 1, 0.0)])
    assert too_late.local_only_time_s() is None, "how much longer it could have done without is not known"


def test_a_mission_begins_with_a_call_that_it_starts_before_it_is_armed() -> None:
    armed = [STARTED, started(1.0, 0), event(3.0, "armed"), event(10.0, "mission_completed")]
    assert read_result(armed).mission_time_s == 10.0


def test_servers_that_failed_and_were_never_of_use_are_named_with_the_last_reason() -> None:
    down = fault("s1", "off", to_s=1e6)
    late = fault("s2", "off", to_s=60.0)
    run = simulate(
        scenario(
            server("s1", 40.0, 20.0),
            server("s2", 60.0, 20.0),
            faults=[down, late],
            policy={"name": "location-aware", "blacklist_s": 10.0},
        )
    )
    assert run.result.never_ready == {"s1": "s1 does not answer"}, "s2 came back"
    assert "never_ready" not in as_json(simulate(scenario()).result)


# --- what was left undone ---------------------------------------------------------------------------------------


def went_on(*events: Event) -> list[Event]:
    """A drone that has left waypoint 0 with its answer open, and what happened then."""
    return [
        STARTED,
        event(1.0, "arrived", waypoint=0),
        started(2.0, 0),
        event(2.0, "stay_or_go", waypoint=0, goes=True, why="it always goes", chance=0.25),
        *events,
    ]


ENDED = event(30.0, "mission_ended", why="the pilot has the vehicle")
ANSWERED = call(6.0, "local", 4.0)
DEMANDED = event(6.0, "demanded", waypoint=0)
BACK = [
    event(7.0, "turned_back", waypoint=0),
    event(9.0, "arrived", waypoint=0),
    taken(9.0, 0, 0.0, demanded=True),
]


@pytest.mark.parametrize(
    ("events", "said"),
    [
        ([ANSWERED, DEMANDED, ENDED], ["not done: what the answer at waypoint 0 demands"]),
        ([ANSWERED, DEMANDED, *BACK, ENDED], ["not done: what the answer at waypoint 0 demands"]),
        ([ANSWERED, DEMANDED, *BACK, event(10.0, "acted", waypoint=0), ENDED], []),
        ([ENDED], ["not looked at: the answer at waypoint 0"]),
        ([ANSWERED, ENDED], ["not looked at: the answer at waypoint 0"]),
        ([ANSWERED, taken(6.0, 0, 0.0), ENDED], []),
        ([event(20.0, "mission_completed")], []),  # it dropped the answer, and went on
        (
            [event(6.0, "demanded", waypoint=0, failed="it crashed"), ENDED],
            ["the call at waypoint 0 failed, and the mission did nothing about it"],
        ),
        (
            [taken(6.0, 0, 0.0, demanded=True, failed="it crashed"), event(6.0, "acted", waypoint=0), ENDED],
            [],
        ),
        (
            [ANSWERED, DEMANDED, started(7.0, 1), event(8.0, "demanded", waypoint=None), ENDED],
            ["not done: what the answers at waypoint 0 and a place beside the plan demand",
             "not looked at: the answer at waypoint 1"],
        ),
    ],
)  # fmt: skip
def test_what_answers_ask_for_and_nobody_did_is_left_undone(events: list[Event], said: list[str]) -> None:
    assert list(left_undone(read_result(went_on(*events)))) == said


def test_a_call_that_was_not_over_at_the_end_was_not_looked_at() -> None:
    decided = event(
        2.0, "decided", operation="detector.process_photo", decision="local", why="", local_s=None, selected=None,
        state=None, remote_s=None, check_s=None, check_elapsed_s=None, position={"east_m": 0.0, "north_m": 0.0},
    )  # fmt: skip
    result = read_result([STARTED, event(1.0, "arrived", waypoint=2), decided, ENDED])
    assert result.not_looked_at == [2]
    assert (
        read_result([STARTED, event(1.0, "arrived", waypoint=2), decided, ANSWERED, ENDED]).not_looked_at
        == []
    )
