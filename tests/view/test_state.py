"""What stands in the bar of a page: who has the vehicle, what it does, and the call under way."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from tests.events import event

from upwash.eventlog.schema import Event
from upwash.view import facts
from upwash.view.facts import Fact
from upwash.view.news import News

FLIES = [
    event("mission_started", 2.0, policy="location-aware", waypoints=2),
    event("armed", 3.0),
    event("leg", 4.0, waypoint=0, east_m=30.0, north_m=0.0),
]
LOITER = event(
    "control",
    6.0,
    owner="pilot",
    why="the vehicle is in mode LOITER (the remote control moved), GUIDED was commanded",
)


def told(events: Sequence[Event]) -> list[Fact]:
    story = News(lambda _: False)
    return [fact for event in events for fact in story.take(event)]


def bar(*events: Event) -> tuple[str, str, str]:
    """Who has it, the tone, and what the drone does after these events."""
    *_, last = (fact for fact in told(events) if isinstance(fact, facts.DoingFact))
    return last.who, last.tone, last.words


def calling(*events: Event) -> facts.DecisionFact | None:
    """The call under way after these events."""
    known = told(events)
    *_, last = (fact for fact in known if isinstance(fact, facts.DecisionFact))
    is_over = not last.words or last.number < sum(isinstance(fact, facts.CallFact) for fact in known)
    return None if is_over else last


def at(t: float, east_m: float, altitude_m: float, **more: object) -> Event:
    return event("position", t, east_m=east_m, north_m=0.0, altitude_m=altitude_m, **more)


@pytest.mark.parametrize(
    ("events", "who", "tone", "words"),
    [
        ([event("waiting_for_vehicle", 1.0)], "WAITING", "ground", "waiting for the vehicle"),
        ([*FLIES[:1], event("arming_delayed", 2.0)], "PROGRAM", "program", "waiting until the vehicle can be armed"),
        (FLIES, "PROGRAM", "program", "flying to waypoint 0"),
        ([*FLIES, LOITER], "PILOT", "person", ""),
        ([*FLIES, event("control", 6.0, owner="ground station", why="x")], "GROUND STATION", "person", ""),
        ([*FLIES, event("control", 6.0, owner="fail-safe", why="x")], "FAIL-SAFE", "alarm", ""),
        ([*FLIES, event("control", 6.0, owner="unknown", why="x")], "NOBODY KNOWN", "alarm", ""),
        ([*FLIES, event("left_hovering", 6.0)], "NOBODY", "alarm", "hovering"),
        ([*FLIES, event("link_lost", 6.0)], "NOT HEARD", "alarm", ""),
        ([*FLIES, event("link_lost", 6.0), event("link_restored", 9.0)],
         "PROGRAM", "program", "flying to waypoint 0"),
        ([*FLIES, event("safe_end", 6.0, action="return"), event("safe_end_failed", 7.0)],
         "NOBODY", "alarm", "does not obey"),
        ([*FLIES, event("safe_end", 6.0, action="return", why="x")], "RETURNING", "landing", ""),
        ([*FLIES, event("safe_end", 6.0, action="land", why="x")], "LANDING", "landing", ""),
        ([*FLIES, event("returning", 6.0), LOITER], "PILOT", "person", ""),
        ([*FLIES, LOITER, event("stood", 9.0, position={"east_m": 0, "north_m": 0})], "LANDED", "ground", ""),
        ([*FLIES, event("landed", 6.0), event("disarmed", 7.0)], "LANDED", "ground", ""),
        ([*FLIES, event("landed", 6.0), event("log_resumed", 9.0), event("waiting_for_vehicle", 9.5)],
         "WAITING", "ground", "waiting for the vehicle"),
    ],
)  # fmt: skip
def test_who_has_the_vehicle_is_said_in_a_word(events: list[Event], who: str, tone: str, words: str) -> None:
    assert bar(*events) == (who, tone, words)


def test_a_return_becomes_a_landing_above_home_as_it_comes_down() -> None:
    events = [*FLIES, event("returning", 5.0), at(6.0, 30.0, 10.0), at(7.0, 30.0, 15.0), at(8.0, 20.0, 13.0)]
    assert bar(*events)[0] == "RETURNING", "it descends on its way"
    assert bar(*events, at(9.0, 0.0, 14.5))[0] == "RETURNING", "it is above home, and settles there"
    assert bar(*events, at(9.0, 0.0, 13.0))[0] == "LANDING"
    moved = event("home_moved", 5.5, east_m=30.0, north_m=0.0, altitude_m=0.0)
    assert bar(*events[:4], moved, *events[4:6], at(9.0, 30.0, 13.0))[0] == "LANDING", (
        "it returns to the new home"
    )


def test_the_mode_is_the_last_that_is_told_and_the_gps_what_the_vehicle_reports() -> None:
    reports = [at(5.0, 0.0, 9.0, mode="GUIDED", armed=True, gps="3d", satellites=9), at(5.5, 0.0, 9.0)]
    lands = event(
        "control", 7.0, owner="pilot", why="the vehicle is in mode AUTO RTL (the remote control did not move)"
    )
    stands = event("stood", 9.0, position={"east_m": 0, "north_m": 0})
    events = [*FLIES, *reports, LOITER, lands, stands]
    states = [fact for fact in told(events) if isinstance(fact, facts.VehicleFact)]
    assert [(state.at_s, state.mode) for state in states] == [
        (3.0, ""),
        (5.0, "GUIDED"),
        (6.0, "LOITER"),
        (7.0, "AUTO RTL"),
        (9.0, "AUTO RTL"),
    ]
    assert (states[-2].armed, states[-2].gps, states[-2].satellites) == (True, "3d", 9)
    assert states[-1].armed is False


REMOTE = event("decided", 10.0, decision="remote", server="s1", deadline_s=3.9, local_s=10.7)
HEDGED = event("hedged", 12.0, server="s1", after_s=2.0, deadline_s=5.0)
FAILED = event("remote_failed", 13.0, server="s1")
WAIT = event("decided", 10.0, decision="wait", server="s1", at_most_s=4.0)
AFTERWARDS = event("decided", 12.0, decision="local", local_s=10.7)
DRONE = event("decided", 10.0, decision="local", local_s=10.7)


@pytest.mark.parametrize(
    ("events", "doing", "from_s", "limit", "also_local"),
    [
        ([REMOTE], "calling s1", 10.0, ("at most", 3.9), False),
        ([DRONE], "computing on the drone", 10.0, ("about", 10.7), False),
        ([event("decided", 10.0, decision="local")], "computing on the drone", 10.0, ("", None), False),
        ([WAIT], "waiting for s1", 10.0, ("at most", 4.0), False),
        ([WAIT, AFTERWARDS],
         "computing on the drone", 12.0, ("about", 10.7), False),
        ([REMOTE, HEDGED],
         "calling s1", 10.0, ("at most", 5.0), True),
        ([REMOTE, FAILED], "s1 failed, computing on the drone", 13.0, ("about", 10.7), False),
        ([REMOTE, HEDGED, FAILED],
         "s1 failed, computing on the drone", 12.0, ("about", 10.7), False),
        ([DRONE, event("decided", 14.0, decision="remote", server="s1", deadline_s=2.0, local_s=10.7, raced=True)],
         "calling s1", 14.0, ("at most", 2.0), True),
        ([REMOTE, event("remote_failed", 13.0, server="s2")], "calling s1", 10.0, ("at most", 3.9), False),
        ([REMOTE, event("answer_taken", 12.0)], "calling s1", 10.0, ("at most", 3.9), False),
        ([WAIT, FAILED], "waiting for s1", 10.0, ("at most", 4.0), False),
        ([DRONE, event("decided", 30.0, decision="local", local_s=10.7)],
         "computing on the drone", 30.0, ("about", 10.7), False),
    ],
)  # fmt: skip
def test_the_call_under_way_is_told_with_its_bound(
    events: list[Event], doing: str, from_s: float, limit: tuple[str, float | None], also_local: bool
) -> None:
    now = calling(*FLIES, *events)
    assert now is not None
    assert (now.doing, now.from_s, (now.bound, now.limit_s), now.also_local) == (
        doing,
        from_s,
        limit,
        also_local,
    )


@pytest.mark.parametrize(
    "events",
    [
        [event("call", 12.0), FAILED],
        [event("answer_taken", 12.0, failed="it raised")],
        [event("control", 12.0, owner="pilot")],
        [event("mission_ended", 12.0)],
        [event("log_resumed", 12.0)],
    ],
)
def test_no_call_is_under_way_once_it_has_ended(events: list[Event]) -> None:
    assert calling(*FLIES, REMOTE, *events) is None


def test_the_battery_has_the_vehicles_own_stages() -> None:
    limits = event("vehicle_limits", 2.5, low_percent=25.0, critical_percent=12.0)
    (stages,) = (
        fact for fact in told([limits, event("vehicle_limits", 2.6)]) if isinstance(fact, facts.StagesFact)
    )
    assert (stages.low_percent, stages.critical_percent) == (25.0, 12.0)
