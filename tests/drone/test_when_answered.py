"""Missions that tell late answers without flying for them, on virtual time."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any
from unittest.mock import patch

import pytest
from tests.drone.test_pending import in_the_air, of
from tests.drone.test_resume import fly, scenario
from tests.drone.test_rows import PLAN, ROWS, rows
from tests.drone.test_stay_or_go import going

from upwash import Drone, Waypoint
from upwash.drone.pending import Pending
from upwash.errors import UsageError
from upwash.eventlog import schema
from upwash.rpc.service import Method
from upwash.services import Detection, Detector

# On rows 12 photos, 20 m and 5 s apart, on two rows; at stops legs of 9 s. A call on the drone takes 3 or 10 s.
Found = list[Detection]
Later = Callable[[Drone, Waypoint, Pending[Found]], object]
SHOWN = [PLAN[2], PLAN[3], PLAN[8]]


def on_rows(later: Later, *, shows: Any = SHOWN, mode: Any = "heavy") -> list[Any]:
    def program(drone: Drone, detector: Detector) -> None:
        for waypoint in drone.plan:
            drone.autopilot.goto(waypoint)
            later(drone, waypoint, drone.start(detector.process_photo, drone.camera.take_photo(), mode=mode))

    part = fly(rows(), mission=in_the_air(program), shows=shows)
    assert part.error is None, part.error
    return part.events


def tells(drone: Drone, waypoint: Waypoint, pending: Pending[Found]) -> None:
    drone.when_answered(pending, lambda found: drone.user.notify([waypoint.index, len(found)], at=waypoint))


def test_on_rows_answers_are_told_in_their_order_and_the_drone_flies_on() -> None:
    events, quiet = on_rows(tells), on_rows(tells, shows=())
    assert [event.message for event in of(events, schema.Notified)] == [
        [index, int(index in (2, 3, 8))] for index in range(12)
    ]
    assert not of(events, schema.TurnedBack) and not of(events, schema.Acted)
    assert events[-1].t == quiet[-1].t
    assert [event.t for event in of(events, schema.Arrived)] == [
        event.t for event in of(quiet, schema.Arrived)
    ]


def test_on_rows_an_answer_is_told_when_it_comes_and_all_before_the_way_down() -> None:
    events = on_rows(tells)
    answered_s = [event.t for event in of(events, schema.Call)]
    assert [event.t for event in of(events, schema.Notified)] == pytest.approx(
        answered_s, abs=1.1
    )  # a photo takes 1 s
    assert answered_s[-1] <= of(events, schema.Returning)[0].t


def test_other_answers_turn_the_drone_back_beside_those_that_only_tell() -> None:
    def later(drone: Drone, waypoint: Waypoint, pending: Pending[Found]) -> None:
        if waypoint.index == 3:
            drone.stay_or_go(pending, lambda _: None)
        else:
            tells(drone, waypoint, pending)

    assert [event.waypoint for event in of(on_rows(later, mode="light"), schema.Acted)] == [3]


def test_a_failed_call_turns_nothing_back_and_failed_hears_of_it() -> None:
    heard: list[str] = []

    def later(drone: Drone, _: Waypoint, pending: Pending[Found]) -> None:
        drone.when_answered(
            pending, lambda _: heard.append("an answer"), failed=lambda error: heard.append(str(error))
        )

    with patch.object(Method, "result", side_effect=ValueError("no photo")):
        events = on_rows(later)
    assert heard == ["no photo"] * 12
    assert not of(events, schema.TurnedBack) and not of(events, schema.Demanded)


def test_without_failed_the_verb_that_hears_of_a_failed_call_raises_it() -> None:
    def program(drone: Drone, detector: Detector) -> None:
        drone.autopilot.goto(drone.plan[0])
        drone.when_answered(drone.start(detector.process_photo, b"photo", mode="light"), lambda _: None)
        with patch.object(Method, "result", side_effect=ValueError("no photo")), pytest.raises(ValueError):
            drone.autopilot.goto(drone.plan[1])
        drone.autopilot.goto(drone.plan[1])

    for config in (rows(), scenario()):
        part = fly(config, mission=in_the_air(program))
        assert part.error is None, part.error


def test_what_tells_may_not_fly() -> None:
    def later(drone: Drone, _: Waypoint, pending: Pending[Found]) -> None:
        def tell(_: Found) -> None:
            for verb in (
                partial(drone.autopilot.hover, 1.0),
                partial(drone.autopilot.goto, drone.plan[0]),
                drone.autopilot.land,
                drone.camera.take_photo,
                lambda: drone.start(detector.process_photo, b"photo", mode="light"),
            ):
                with pytest.raises(UsageError, match=r"only drone\.user\.notify"):
                    verb()

        detector = drone.service(Detector)
        drone.when_answered(pending, tell)

    assert len(of(on_rows(later), schema.Arrived)) == len(of(on_rows(tells), schema.Arrived))


def test_an_exception_of_what_tells_ends_the_mission() -> None:
    def later(drone: Drone, _: Waypoint, pending: Pending[Found]) -> None:
        drone.when_answered(pending, lambda found: 1 / len(found))

    with pytest.raises(AssertionError, match="ZeroDivisionError"):
        on_rows(later)


@pytest.mark.parametrize("manner", ["stay", "go", "learn"])
def test_at_stops_the_drone_flies_on_until_the_next_call(manner: str) -> None:
    told_m: list[float] = []

    def program(drone: Drone, detector: Detector) -> None:
        def tell(_: Found) -> None:
            told_m.append(drone.autopilot.position.east_m)

        drone.autopilot.goto(drone.plan[0])
        drone.when_answered(drone.start(detector.process_photo, b"photo", mode="heavy"), tell)
        drone.autopilot.goto(drone.plan[1])
        drone.autopilot.goto(drone.plan[2])
        drone.when_answered(drone.start(detector.process_photo, b"photo", mode="heavy"), tell)
        detector.process_photo(b"photo", mode="light")
        drone.when_answered(drone.start(detector.process_photo, b"photo", mode="heavy"), tell)

    part = fly(going(scenario(), manner), mission=in_the_air(program), shows=())
    assert part.error is None, part.error
    assert 20.0 < told_m[0] < 30.0, "on the second leg, 1 s after it began"
    assert told_m[1:] == pytest.approx([40.0, 40.0])
    legs = [event.t for event in of(part.events, schema.Arrived)]
    assert legs[2] - legs[1] == pytest.approx(9.0)
    assert [event.waited_s for event in of(part.events, schema.AnswerTaken)] == pytest.approx(
        [0.0, 10.0, 10.0]
    )


# --- the bundled survey ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(("action_s", "acted"), [(0.0, []), (5.0, [2, 3, 8])])
def test_the_survey_turns_back_on_rows_only_for_an_act(action_s: float, acted: list[int]) -> None:
    config = scenario(waypoints_m=ROWS, photos={"every_m": 20.0}, action_s=action_s)
    part = fly(config, shows=SHOWN)
    assert part.error is None
    assert sorted(event.waypoint for event in of(part.events, schema.Acted)) == acted
    assert bool(of(part.events, schema.TurnedBack)) == bool(acted)
    assert len(of(part.events, schema.Notified)) == 3


def test_a_survey_on_rows_that_tells_takes_as_long_as_one_that_finds_nothing() -> None:
    config = scenario(waypoints_m=ROWS, photos={"every_m": 20.0})
    assert fly(config, shows=SHOWN).result.mission_time_s == fly(config).result.mission_time_s


def test_the_survey_at_stops_acts_where_it_is() -> None:
    part = fly(scenario(), shows=[PLAN[2]])
    assert [event.waypoint for event in of(part.events, schema.Acted)] == [2]
