"""Why a call ran at its place, in a sentence with the cause and its figures."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from tests.events import event

from upwash.eventlog.reasons import CallText, explained_calls, worst_of
from upwash.eventlog.schema import Event
from upwash.support.text import clock

OPERATION = "detector.count"
HERE, FAR = (
    {"east_m": 0.0, "north_m": 0.0, "altitude_m": 9.0},
    {"east_m": 75.0, "north_m": 0.0, "altitude_m": 9.0},
)
RANGE = {"centre": {"east_m": 0.0, "north_m": 0.0, "altitude_m": 0.0}, "radius_m": 50.0}


def planned(*servers: str) -> list[Event]:
    """A mission that began at second 10 of the log, by a policy that compares."""
    return [
        event("planned", 1.0, waypoints_m=[(0, 0)], ranges=dict.fromkeys(servers, RANGE), home=None),
        event("mission_started", 10.0, policy="location-aware", waypoints=1),
    ]


def step(kind: str, t: float, after: str, server: str = "s1", why: str = "", **facts: object) -> Event:
    return event(kind, t, server=server, before="AVL", after=after, why=why, **facts)


def decided(t: float, **facts: object) -> Event:
    known: dict[str, object] = {
        "local_s": 10.0,
        "selected": None,
        "state": None,
        "remote_s": None,
        "check_s": None,
        "check_elapsed_s": None,
    }
    known |= {"decision": "local", "why": "no server selected", "position": HERE}
    return event("decided", t, operation=OPERATION, **{**known, **facts})


def at_s1(t: float, state: str = "READY", **facts: object) -> Event:
    known = {"decision": "remote", "server": "s1", "why": "server ready", "selected": "s1", "remote_s": 0.7}
    return decided(t, **{**known, "state": state, "check_s": 11.5, "check_elapsed_s": 6.0, **facts})


def ended(t: float, delay_s: float, place: str = "local", **facts: object) -> Event:
    known = {"waited_s": 0.0, "wait": "", "fell_back": False, "remote_fault": ""}
    return event("call", t, operation=OPERATION, place=place, delay_s=delay_s, **{**known, **facts})


def texts(*events: Event, servers: Sequence[str] = ("s1",)) -> list[CallText]:
    return explained_calls([*planned(*servers), *events])


def test_of_several_open_calls_the_line_is_told_where_there_was_one_and_what_the_answer_demanded() -> None:
    begun = [event("call_started", 20.0, operation=OPERATION, waypoint=number) for number in (0, 1)]
    first, second = texts(
        *begun,
        decided(20.0, waypoint=0),
        ended(30.0, 10.0, waypoint=0, queued_s=0.001),
        event("answer_taken", 30.0, waypoint=0, demanded=True),
        decided(30.0, waypoint=1),
        ended(40.0, 20.0, waypoint=1, queued_s=10.0),
        event("answer_taken", 41.0, waypoint=1),
    )
    assert first.reasons[0].startswith("Ran on the drone in 10.00 s because")
    assert first.reasons[-1] == "the answer was taken at 0:20, and demanded something"
    assert second.reasons[0].startswith("Ran on the drone in 10.00 s after 10.00 s in line because")
    assert second.reasons[-1] == "the answer was taken at 0:31, and demanded nothing"


def sentence(*events: Event, servers: Sequence[str] = ("s1",)) -> str:
    """Of the last call."""
    return texts(*events, servers=servers)[-1].reasons[0]


READY = step("started", 73.0, "READY")
FAILED = step("call_failed_in_range", 80.0, "BLACKLISTED", why="s1 at 10.0.0.1:50: no answer within 2.8 s")


@pytest.mark.parametrize(
    ("events", "said"),
    [
        ([READY, at_s1(100.0), ended(100.4, 0.39, "s1")], "Ran on s1, ready since 1:03, in 0.39 s."),
        (
            [
                at_s1(100.0, "CHECK", decision="wait", why=""),
                ended(106.0, 5.8, "s1", wait="paid off", waited_s=5.1),
            ],
            "Ran on s1, ready after a wait of 5.10 s, in 5.80 s.",
        ),
        (
            [READY, at_s1(100.0, raced=True, why="on trial"), ended(101.0, 0.9, "s1")],
            "Ran on s1, ready since 1:03, on trial, in 0.90 s.",
        ),
        (
            [
                decided(100.0),
                READY,
                at_s1(103.0, raced=True, why="s1 is ready, and sooner"),
                ended(104.0, 4.0, "s1"),
            ],
            "Ran on s1, ready since 1:03 and sooner than the drone, in 4.00 s.",
        ),
        (
            [decided(100.0, position=FAR), ended(110.0, 10.0)],
            "Ran on the drone in 10.00 s because no server was in range: s1 ends 25 m away.",
        ),
        (
            [FAILED, decided(100.0), ended(110.0, 10.0)],
            "Ran on the drone in 10.00 s because "
            "s1, in range, was left alone since 1:10 after no answer within 2.8 s.",
        ),
        (
            [FAILED, decided(100.0), ended(110.0, 10.0), step("blacklist_expired", 382.0, "AVL")],
            "Ran on the drone in 10.00 s because "
            "s1, in range, was left alone until 6:12 after no answer within 2.8 s.",
        ),
        (
            [
                step("selected", 20.0, "CHECK", local_mean_call_s=9.0, mean_call_s={"s1": 9.5}),
                step("deselected", 21.0, "AVL", why="not faster than local"),
                decided(100.0),
                ended(110.0, 10.0),
            ],
            "Ran on the drone in 10.00 s because s1, in range, was worth less than the drone: 9.50 s a call there, "
            "9.00 s on the drone.",
        ),
        (
            [event("no_slot", 90.0, server="s1", check=1, waiting=2), decided(100.0), ended(110.0, 10.0)],
            "Ran on the drone in 10.00 s because s1, in range, had no free slot, and 2 drones waited for one.",
        ),
        (
            [
                at_s1(100.0, "CHECK", decision="local", server=None, why="too late to pay off"),
                ended(110.0, 10.0),
            ],
            "Ran on the drone in 10.00 s because s1, joining since 1:24 and not ready yet, was not worth the wait: "
            "5.50 s of wait and 0.70 s expected there, 10.00 s on the drone.",
        ),
        (
            [READY, at_s1(100.0, decision="local", server=None, why="", remote_s=12.0), ended(110.0, 10.0)],
            "Ran on the drone in 10.00 s because s1 was worth less than the drone: 12.00 s expected there, "
            "10.00 s on the drone.",
        ),
        (
            [
                READY,
                at_s1(100.0, decision="local", server=None, why="s1 is out of range"),
                ended(110.0, 10.0),
            ],
            "Ran on the drone in 10.00 s because s1 was out of range.",
        ),
        (
            [
                at_s1(100.0, "CHECK", decision="wait", why=""),
                step("check_failed", 103.0, "BLACKLISTED", why="s1 does not answer"),
                decided(103.0, why="the check failed or was given up"),
                ended(113.0, 13.0, wait="failed", waited_s=3.0),
            ],
            "Ran on the drone in 13.00 s because s1 was not ready after a wait of 3.00 s (does not answer).",
        ),
        (
            [
                READY,
                at_s1(100.0),
                event(
                    "remote_failed",
                    102.8,
                    server="s1",
                    check=1,
                    why="s1 at 10.0.0.1:50: no answer within 2.8 s",
                ),
                ended(112.8, 12.8, fell_back=True),
            ],
            "Ran on the drone in 12.80 s because s1 gave no answer within 2.8 s.",
        ),
        (
            [
                READY,
                at_s1(100.0),
                event(
                    "remote_raised", 101.0, server="s1", check=1, operation=OPERATION, raised="KeyError: a"
                ),
                ended(111.0, 11.0, fell_back=True, remote_fault="confirmed"),
            ],
            "Ran on the drone in 11.00 s because "
            "s1 said that it raised KeyError: a, and it was raised on the drone too.",
        ),
        (
            [READY, at_s1(100.0), ended(103.5, 3.5, hedged_s=0.6)],
            "Ran on the drone in 3.50 s because s1 had not answered after 0.60 s, and the drone, which then "
            "began too, was sooner.",
        ),
    ],
)
def test_the_sentence_of_a_call_has_its_cause_with_figures(events: list[Event], said: str) -> None:
    assert sentence(*events) == said


def test_of_servers_in_range_each_is_told_why_it_was_not_used() -> None:
    other = step("check_failed", 60.0, "BLACKLISTED", "s2", "network s2 is off the air")
    assert sentence(FAILED, other, decided(100.0), ended(110.0, 10.0), servers=("s1", "s2")) == (
        "Ran on the drone in 10.00 s because s1, in range, was left alone since 1:10 after no answer within 2.8 s "
        "and s2, in range, was left alone since 0:50 after a failure (network s2 is off the air)."
    )


def test_a_flight_without_servers_says_so() -> None:
    assert sentence(decided(100.0), ended(110.0, 10.0), servers=()) == (
        "Ran on the drone in 10.00 s because the flight has no server."
    )


def test_a_selection_after_the_decision_is_no_reason_of_it_and_one_of_the_next_call() -> None:
    selected = step("selected", 103.0, "CHECK", why="fastest in range")
    first, second = texts(decided(100.0), selected, ended(110.0, 10.0), decided(120.0), ended(130.0, 10.0))
    told = "at 1:33 s1 was selected: fastest in range"
    assert told not in first.reasons
    assert told in second.reasons


def test_the_worst_calls_lost_most_against_the_best_place_and_equals_are_left_out() -> None:
    calls = texts(
        decided(100.0),  # as long as it was expected to
        ended(110.2, 10.2),
        READY,
        at_s1(120.0),  # long for s1, and sooner than the drone
        ended(125.0, 5.0, "s1"),
        at_s1(130.0, "CHECK", decision="wait", why=""),  # by the wait that was expected
        ended(136.2, 6.2, "s1", wait="paid off", waited_s=5.5),
        decided(140.0),
        ended(151.5, 11.5),
    )
    assert [(text.call.number, round(text.call.loss_s, 1)) for text in worst_of(calls, 5)] == [
        (1, 4.3),
        (3, 1.5),
    ]
    assert [text.call.number for text in worst_of(calls, 1)] == [1]


@pytest.mark.parametrize(
    ("seconds", "text"), [(-3.0, "0:00"), (7.9, "0:07"), (372.0, "6:12"), (3972.0, "1:06:12")]
)
def test_times_are_told_as_on_the_flight_page(seconds: float, text: str) -> None:
    assert clock(seconds) == text
