"""Missions that go on before an answer, and come back where it demands it, on virtual time."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Literal

import msgspec
import pytest
from tests.drone.test_pending import in_the_air, of
from tests.drone.test_resume import at_once, fly, scenario
from tests.drone.test_safe_ends import cut_the_wire
from tests.drone.test_safe_ends import fly as fly_far
from tests.drone.test_safe_ends import scenario as far
from tests.events import written

from upwash import Drone, Position
from upwash.config.drone import DroneConfig
from upwash.errors import InstanceError
from upwash.eventlog import schema
from upwash.eventlog.schema import Event
from upwash.services import Detector

# A leg of 20 m takes 9 s; a light call 3 s, so that the drone is 9 m further if it brakes then; a heavy call 10 s.
STEPS = {
    "call_started",
    "stay_or_go",
    "leg",
    "arrived",
    "demanded",
    "turned_back",
    "answer_taken",
    "acted",
}
Act = Callable[[Any], object]


def going(config: DroneConfig, manner: str = "go") -> DroneConfig:
    policy = msgspec.structs.replace(config.policy, stay_or_go=manner)
    return msgspec.structs.replace(config, policy=policy)


def flown(program: Callable[[Drone, Detector], None], manner: str = "go") -> list[Any]:
    part = fly(at_once(going(scenario(), manner)), mission=in_the_air(program))
    assert part.error is None, part.error
    return part.events


def steps(events: Iterable[Event]) -> list[str]:
    """What is done about the answer, each step with its waypoint."""
    return [
        f"{event['event']} {'back ' if event.get('back') else ''}{event.get('waypoint')}"
        for event in written(events)
        if event["event"] in STEPS
    ]


def ask(
    drone: Drone,
    detector: Detector,
    act: Act = lambda _: None,
    *,
    mode: Literal["light", "heavy"] = "light",
    demands: bool = True,
) -> None:
    pending = drone.start(detector.process_photo, b"photo", mode=mode)
    drone.stay_or_go(pending, act, demands=lambda _: demands)


BEGUN = ["leg 0", "arrived 0", "call_started 0", "stay_or_go 0", "leg 1"]


def test_a_demand_on_the_way_brings_the_drone_back_and_then_to_its_target() -> None:
    at_m: list[float] = []

    def program(drone: Drone, detector: Detector) -> None:
        drone.autopilot.goto(drone.plan[0])
        ask(drone, detector, lambda _: at_m.append(drone.autopilot.position.east_m))
        assert drone.autopilot.goto(drone.plan[1])
        at_m.append(drone.autopilot.position.east_m)

    events = flown(program)
    back = ["demanded 0", "turned_back 0", "leg back 0", "arrived 0", "answer_taken 0", "acted 0"]
    assert steps(events) == [*BEGUN, *back, "leg 1", "arrived 1"]
    assert at_m == [pytest.approx(0.0), pytest.approx(20.0)]
    (turned,), (taken,) = of(events, schema.TurnedBack), of(events, schema.AnswerTaken)
    assert turned.position.east_m == pytest.approx(9.0)
    assert (taken.waited_s, taken.demanded) == (0.0, True)


def test_an_answer_on_the_way_without_a_demand_is_taken_at_the_next_waypoint() -> None:
    acted: list[Any] = []

    def program(drone: Drone, detector: Detector) -> None:
        drone.autopilot.goto(drone.plan[0])
        ask(drone, detector, acted.append, demands=False)
        drone.autopilot.goto(drone.plan[1])
        drone.autopilot.hover(1.0)

    events = flown(program)
    assert steps(events) == [*BEGUN, "arrived 1", "answer_taken 0"]
    (arrived, taken) = of(events, schema.Arrived)[-1], of(events, schema.AnswerTaken)[0]
    assert (taken.t, taken.waited_s, taken.demanded, acted) == (arrived.t, 0.0, False, [])


@pytest.mark.parametrize("demands", [True, False])
@pytest.mark.parametrize("then", ["another leg", "another call"])
def test_an_answer_after_the_next_waypoint_is_awaited_there(then: str, demands: bool) -> None:
    def program(drone: Drone, detector: Detector) -> None:
        drone.autopilot.goto(drone.plan[0])
        ask(drone, detector, mode="heavy", demands=demands)
        drone.autopilot.goto(drone.plan[1])
        if then == "another call":
            detector.process_photo(b"photo", mode="light")
        drone.autopilot.goto(drone.plan[2])

    events = flown(program)
    back = ["demanded 0", "turned_back 0", "leg back 0", "arrived 0", "answer_taken 0", "acted 0"]
    done = [*back, "leg 1", "arrived 1"] if demands else ["answer_taken 0"]
    assert steps(events) == [*BEGUN, "arrived 1", *done, "leg 2", "arrived 2"]
    (taken,) = of(events, schema.AnswerTaken)
    assert taken.waited_s == pytest.approx(1.0)


def test_a_drone_that_stays_acts_at_once_and_nothing_is_decided() -> None:
    acted_s: list[float] = []

    def program(drone: Drone, detector: Detector) -> None:
        drone.autopilot.goto(drone.plan[0])
        ask(drone, detector)
        drone.autopilot.goto(drone.plan[1])

    events = flown(program, "stay")
    assert steps(events) == [*BEGUN[:3], "answer_taken 0", "acted 0", "leg 1", "arrived 1"]
    assert of(events, schema.AnswerTaken)[0].waited_s == pytest.approx(3.0)
    assert acted_s == []


def test_an_answer_that_is_there_already_is_taken_without_a_decision() -> None:
    def program(drone: Drone, detector: Detector) -> None:
        drone.autopilot.goto(drone.plan[0])
        pending = drone.start(detector.process_photo, b"photo", mode="light")
        drone.autopilot.hover(5.0)
        drone.stay_or_go(pending, lambda _: None, demands=lambda _: True)
        drone.autopilot.goto(drone.plan[1])

    assert steps(flown(program))[3:] == ["answer_taken 0", "acted 0", "leg 1", "arrived 1"]


def test_a_place_off_the_plan_is_come_back_to_as_well() -> None:
    at_m: list[float] = []

    def program(drone: Drone, detector: Detector) -> None:
        drone.autopilot.goto(drone.plan[0])
        ask(drone, detector, lambda _: at_m.append(drone.autopilot.position.east_m))
        drone.autopilot.goto(Position(0.0, 50.0, 20.0))
        at_m.append(drone.autopilot.position.north_m)

    events = flown(program)
    assert steps(events)[4:] == [
        "leg None",
        *["demanded 0", "turned_back 0", "leg back 0", "arrived 0", "answer_taken 0", "acted 0"],
        *["leg None", "arrived None"],
    ]
    assert at_m == [pytest.approx(0.0), pytest.approx(50.0)]


@pytest.mark.parametrize(("demands", "chance"), [(True, 0.4), (False, 0.2)])
def test_the_drone_learns_from_each_answer(demands: bool, chance: float) -> None:
    def program(drone: Drone, detector: Detector) -> None:
        for waypoint in drone.plan[:2]:
            drone.autopilot.goto(waypoint)
            ask(drone, detector, demands=demands)

    judged = of(flown(program, "learn"), schema.StayOrGo)
    assert [event.chance for event in judged] == [0.25, chance]


@pytest.mark.parametrize("hears", [True, False])
def test_a_call_that_fails_is_come_back_for_and_raised_there(hears: bool) -> None:
    heard: list[tuple[str, float]] = []

    def mission(drone: Drone) -> None:
        def failed(error: Exception) -> None:
            heard.append((type(error).__name__, drone.autopilot.position.east_m))

        drone.autopilot.arm()
        drone.autopilot.takeoff(10)
        drone.autopilot.goto(drone.plan[0])
        pending = drone.start(drone.service(Detector).process_photo, b"photo", mode="heavy")
        drone.stay_or_go(pending, lambda _: None, failed=failed if hears else None)
        drone.autopilot.goto(drone.plan[1])
        drone.end_flight()

    scene, error = fly_far(going(far()), mission, happens=cut_the_wire, at_s=12.0)
    (demanded,), (taken,) = scene.events("demanded"), scene.events("answer_taken")
    assert "failed on the drone" in demanded["failed"] == taken["failed"]
    assert steps(scene.journal.events)[5:8] == ["demanded 0", "turned_back 0", "leg back 0"]
    if hears:
        ((what, east_m),) = heard
        assert (what, round(east_m, 6), error) == ("InstanceError", 0.0, None)
        assert [event["waypoint"] for event in scene.events("acted")] == [0]
    else:
        assert isinstance(error, InstanceError) and not scene.events("acted")
