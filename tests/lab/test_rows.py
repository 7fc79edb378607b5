"""Surveys that photograph their rows without stopping."""

from __future__ import annotations

import math
from typing import Any

import pytest
from tests.programs import ROOT

from upwash.errors import ConfigError
from upwash.eventlog import schema
from upwash.eventlog.reasons import explained_calls, worst_of
from upwash.eventlog.results import as_json
from upwash.lab.simulation import Simulation, simulate

SCENARIO = ROOT / "scenarios" / "on-the-move.toml"


def survey(**overrides: Any) -> Simulation:
    return simulate(SCENARIO, overrides={key.replace("__", "."): value for key, value in overrides.items()})


def of(run: Simulation, kind: type[schema.Event]) -> list[Any]:
    return [event for event in run.events if isinstance(event, kind)]


@pytest.mark.parametrize(
    ("changed", "model_s"),
    [
        ({"event__every": 1000, "event__offset": 999}, 718.0),
        ({"event__every": 1000, "event__offset": 999, "mission__ground_speed_m_s": 6.0}, 557.0),
        ({}, 972.0),
    ],
)
def test_it_takes_no_longer_than_a_model_of_it(changed: dict[str, Any], model_s: float) -> None:
    run = survey(**changed)
    assert run.completed and run.mission_time_s < 1.03 * model_s
    assert {call.waypoint for call in run.calls} == set(range(121)), "every photo has its answer"


def test_photos_are_taken_in_flight_at_their_spots_and_only_row_ends_are_stops() -> None:
    run = survey()
    places = of(run, schema.Planned)[0].waypoints_m
    photos = of(run, schema.PhotoTaken)
    assert len(photos) == 121
    for photo, place in zip(photos, places, strict=True):
        assert math.dist((photo.position.east_m, photo.position.north_m), place) < 0.1
    stops = {
        event.waypoint
        for event in of(run, schema.Arrived)
        if not event.passing and event.waypoint is not None
    }
    demanding = set(range(5, 121, 10))
    assert stops - demanding == {row + column for row in range(0, 121, 11) for column in (0, 10)} - demanding


def test_a_time_between_photos_is_a_distance_at_the_speed_of_the_rows() -> None:
    timed, spaced = (survey(mission__photos=photos) for photos in ({"every_s": 5.0}, {"every_m": 20.0}))
    assert timed.mission_time_s == spaced.mission_time_s
    assert [call.at_s for call in timed.calls] == [call.at_s for call in spaced.calls]


def test_its_totals_have_the_turns_back_also_if_there_was_none() -> None:
    for every, turns in ((10, 12), (1000, 0)):
        run = survey(event={"every": every, "offset": 5 if every == 10 else 999})
        assert as_json(run.totals)["turns_back"] == run.totals.turns_back == turns
    assert "turns_back" not in as_json(simulate(ROOT / "scenarios/demonstration.toml").totals)


def test_the_time_in_line_is_no_loss_of_a_call() -> None:
    run = survey(policy__name="local-only")
    texts = list(explained_calls(run.events))
    assert len(texts) == 121 and max(call.delay_s for call in run.calls) > 60.0
    assert worst_of(texts, 3) == []


def test_every_demand_is_met_at_its_place_once() -> None:
    run = survey()
    assert sorted(event.waypoint for event in of(run, schema.Acted)) == list(range(5, 121, 10))
    places = of(run, schema.Planned)[0].waypoints_m
    notified = sorted((event.at.east_m, event.at.north_m) for event in of(run, schema.Notified))
    assert notified == sorted(places[waypoint] for waypoint in range(5, 121, 10))


def test_demands_that_come_together_are_one_detour() -> None:
    run = survey(
        policy__name="local-only", event__every=1, event__offset=0
    )  # answers are 60 m late, and each has a demand
    letters = {schema.SetOff: "l", schema.TurnedBack: "t", schema.Acted: "a"}
    way = "".join(letters.get(type(event), "") for event in run.events)
    assert way.count("a") == 121
    assert "atla" in way, "from one place to the next, and not back in between"


def test_the_newest_photo_is_computed_first_where_only_now_counts() -> None:
    run = survey(**{"policy__name": "local-only", "mission__photos": {"every_m": 20.0, "order": "newest"}})
    order = [call.waypoint for call in run.calls]
    assert order[:4] == [0, 1, 3, 5]


def test_too_many_photos_without_an_answer_stop_the_drone() -> None:
    run = survey(
        **{
            "policy__name": "local-only",
            "mission__photos": {"every_m": 20.0, "at_most": 5},
            "event__every": 1000,
        }
    )
    assert run.completed and len(run.calls) == 121
    waiting = open_photos = 0
    for event in run.events:
        open_photos += isinstance(event, schema.CallStarted)
        open_photos -= isinstance(event, schema.AnswerTaken)
        waiting = max(waiting, open_photos)
    assert waiting == 5
    assert len(of(run, schema.PhotosWait)) > 10


def test_a_slow_photo_is_refused_with_the_speed_that_it_allows() -> None:
    for photos, problem in (
        ({"every_s": 0.5}, r"every_s.*0.5 s, and a photo takes camera.photo_s = 1 s: make it larger"),
        ({"every_s": 2.0, "every_m": 20.0}, r"every_m and every_s both say when"),
        ({"every_s": 1e-5}, r"every_s.*more than 100,000 photos of"),
    ):
        with pytest.raises(ConfigError, match=problem):
            survey(mission__photos=photos, camera__photo_s=0.0 if "100" in problem else 1.0)
    with pytest.raises(Exception, match=r"at most 10 m/s: fly slower, or make photos.every_m larger"):
        survey(**{"camera__photo_s": 2.0, "mission__ground_speed_m_s": 12.0})


def test_where_most_answers_demand_something_it_stops_if_it_may_learn() -> None:
    often = {"event": {"probability": 0.5}, "seed": 1}
    on, learnt = (survey(**often, policy__stay_or_go=manner).mission_time_s for manner in ("go", "learn"))
    assert learnt < 0.95 * on
    rarely = {"event": {"probability": 0.05}, "seed": 1}
    on, learnt = (survey(**rarely, policy__stay_or_go=manner).mission_time_s for manner in ("go", "learn"))
    assert learnt < 1.01 * on


def test_the_expected_times_are_those_of_a_drone_that_flies_on() -> None:
    run = survey(event__every=1000, event__offset=999)
    (foreseen,) = of(run, schema.Foreseen)
    reached_s = [event.t for event in of(run, schema.Arrived) if event.waypoint is not None]
    assert foreseen.reached_s == pytest.approx(reached_s, abs=1.0)
    assert foreseen.as_asked_s == pytest.approx(run.mission_time_s, rel=0.02)


def test_the_bound_flies_the_rows_without_waits_and_ways_back() -> None:
    run = survey()
    assert run.bound is not None
    demands, action_s = 12, 5.0
    rows_s = 11 * (200 / 4 + 4 / 1.02) + 10 * (20 / 4 + 4 / 1.02) + 26
    assert run.bound.free_s == pytest.approx(rows_s + demands * action_s, abs=2.0)
    assert run.bound.free_s < run.mission_time_s
