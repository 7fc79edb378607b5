"""Surveys that go on before their answers are there."""

from __future__ import annotations

from collections import Counter
from typing import Any

import pytest
from tests.scenarios import fault, scenario, server

from upwash.config.drone import DroneConfig
from upwash.eventlog import schema
from upwash.lab.run import Run, simulate


def survey(
    *servers: dict[str, Any], manner: str, ground_speed_m_s: float = 4.0, **tables: Any
) -> DroneConfig:
    return scenario(
        *servers,
        mission={"action_s": 5.0, "ground_speed_m_s": ground_speed_m_s},
        policy={"name": "location-aware", "stay_or_go": manner},
        **tables,
    )


def of(run: Run, kind: type[schema.Event]) -> list[Any]:
    return [event for event in run.events if isinstance(event, kind)]


@pytest.mark.parametrize("manner", ["stay", "go", "learn"])
def test_what_is_demanded_is_done_at_its_waypoint_once(manner: str) -> None:
    run = simulate(survey(manner=manner, event={"every": 4, "offset": 1}))
    eventful = [1, 5, 9, 13, 17]
    assert run.result.completed
    acted = [event.waypoint for event in of(run, schema.Acted)]
    assert Counter(acted) == Counter(eventful)
    at = [(event.at.east_m, event.at.north_m) for event in of(run, schema.Notified)]
    places = of(run, schema.Planned)[0].waypoints_m
    assert at == [tuple(places[number]) for number in acted]
    assert [call.waypoint for call in run.result.calls] == list(range(18)), "each call at its own waypoint"


def test_the_last_waypoint_waits() -> None:
    run = simulate(survey(manner="go"))
    assert [event.goes for event in of(run, schema.StayOrGo)] == [True] * 17 + [False]


def test_going_hides_calls_on_the_drone_and_turning_back_costs_a_leg_at_most() -> None:
    stay, go = (simulate(survey(manner=manner)).result.mission_time_s for manner in ("stay", "go"))
    assert go == pytest.approx(stay - 17 * 10.0), "but for the last"
    for event in of(simulate(survey(manner="go", event={"probability": 0.5})), schema.TurnedBack):
        assert event.waypoint is not None


def test_a_call_that_would_lose_its_server_stays() -> None:
    near = server("s1", 0.0, 40.0, range_m=3.0)  # about the first waypoint alone
    run = simulate(survey(near, manner="learn", event={"probability": 0.0}))
    first = of(run, schema.StayOrGo)[0]
    call = run.result.calls[0]
    assert call.server is None or not first.goes


def test_events_of_a_probability_hang_on_the_seed_and_the_waypoint_alone() -> None:
    one, other = (
        Counter(
            event.waypoint
            for event in of(simulate(survey(manner=manner, event={"probability": 0.3})), schema.Acted)
        )
        for manner in ("stay", "go")
    )
    assert one == other and one


def test_a_survey_that_stays_takes_no_longer_than_one_that_calls_and_waits() -> None:
    run = simulate(survey(server("s1", 40.0, 20.0), manner="stay"))
    assert not of(run, schema.StayOrGo)
    assert all(
        event.waited_s == pytest.approx(call.delay_s)
        for event, call in zip(of(run, schema.AnswerTaken), run.result.calls, strict=True)
    )


@pytest.mark.parametrize("after_s", [0.1, 3.0, 12.0])
def test_a_demand_that_a_pilot_keeps_it_from_doing_is_left_undone(after_s: float) -> None:
    slow: dict[str, Any] = {
        "manner": "go",
        "ground_speed_m_s": 1.0,
        "event": {"every": 4, "offset": 1},
    }  # answers come on the way
    demanded = of(simulate(survey(**slow)), schema.Demanded)
    assert [event.waypoint for event in demanded] == [1, 5, 9, 13], "at the last waypoint it stays"
    takes_s = demanded[1].t + after_s  # while it brakes, as it flies back, as it acts
    run = simulate(survey(**slow, faults=[fault("autopilot", "pilot", from_s=takes_s, to_s=takes_s + 1e4)]))
    assert not run.result.completed
    assert run.result.not_acted_on == [5]
