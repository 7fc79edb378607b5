"""What a mission may do on a row that it flies without stopping, on virtual time."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest
from msgspec.structs import replace
from tests.drone.test_pending import in_the_air, of
from tests.drone.test_resume import Part, at_once, fly, scenario
from tests.surveys import END, at, begin, transects, written

from upwash import Drone, Position, Waypoint
from upwash.config.drone_file import read_drone_config
from upwash.config.places import waypoints
from upwash.config.world import FaultConfig
from upwash.core.geo import ground_distance_m
from upwash.core.selection.selection import Selection
from upwash.errors import AutopilotOverruled, CameraError, MissionStopped, ReserveReached
from upwash.eventlog import schema
from upwash.ports import Photo
from upwash.rpc.service import Method
from upwash.services import Detector
from upwash.sim.autopilot import ModelAutopilot
from upwash.sim.camera import ModelCamera

# Two rows of 100 m, 20 m apart, a photo each 20 m at 4 m/s: 12 spots, from 0 to 5 and from 6 to 11. A call on the
# drone takes 3 or 10 s, a photo 1 s.
ROWS = [[0, 0], [100, 0], [100, 20], [0, 20]]


def rows(**photos: Any) -> Any:
    return scenario(waypoints_m=ROWS, photos={"every_m": 20.0, **photos})


def flown(program: Callable[[Drone, Detector], None], **photos: Any) -> list[Any]:
    part = fly(at_once(rows(**photos)), mission=in_the_air(program))
    assert part.error is None, part.error
    return part.events


def offs_m(events: list[Any], drone_plan: dict[int, Position]) -> list[float]:
    """How far from the last spot that was reached each photo was taken."""
    here: int | None = None
    found = []
    for event in events:
        if isinstance(event, schema.Arrived):
            here = event.waypoint
        elif isinstance(event, schema.PhotoTaken) and here is not None:
            found.append(ground_distance_m(event.position, drone_plan[here]))
    return found


PLAN = {
    **{index: Position(20.0 * index, 0.0, 20.0) for index in range(6)},
    **{6 + index: Position(100.0 - 20.0 * index, 20.0, 20.0) for index in range(6)},
}


def photograph_each(drone: Drone, do: Callable[[Waypoint, bytes], object]) -> None:
    for waypoint in drone.plan:
        drone.autopilot.goto(waypoint)
        do(waypoint, drone.camera.take_photo())


def test_a_spot_that_was_passed_during_a_call_is_flown_back_to() -> None:
    """A call of 10 s flies the drone 40 m on."""

    def program(drone: Drone, detector: Detector) -> None:
        photograph_each(drone, lambda _, photo: detector.process_photo(photo, mode="heavy"))

    events = flown(program)
    assert len(of(events, schema.Call)) == 12
    assert max(offs_m(events, PLAN)) < 2.0


def test_a_spot_just_before_a_rows_end_is_flown_back_to() -> None:
    """A call flies the drone on to the end, 2 m beyond the last spot."""

    def program(drone: Drone, detector: Detector) -> None:
        photograph_each(drone, lambda _, photo: detector.process_photo(photo, mode="heavy"))

    config = scenario(waypoints_m=[[0, 0], [42, 0]], photos={"every_m": 20.0}, ground_speed_m_s=3.0)
    part = fly(config, mission=in_the_air(program))
    assert part.error is None
    assert max(offs_m(part.events, PLAN)) < 0.5


def test_a_row_that_begins_beside_another_begins_at_rest() -> None:
    """The second row begins 1.7 m beside the first, behind its last spot."""
    config = scenario(waypoints_m=[[0, 0], [99, 0], [92, 1.7], [92, 60]], photos={"every_m": 90.0})
    part = fly(config)
    assert part.error is None
    assert max(offs_m(part.events, {0: PLAN[0], 1: Position(90.0, 0.0), 2: Position(92.0, 1.7)})) < 0.5


def test_rows_that_end_at_one_place_are_two_rows() -> None:
    config = scenario(waypoints_m=[[0, 0], [100, 0], [100, 60], [100, 0]], photos={"every_m": 20.0})
    part = fly(config)
    assert part.error is None
    plan = {6 + index: Position(100.0, 60.0 - 20.0 * index, 20.0) for index in range(4)}
    assert max(offs_m(part.events, {**PLAN, **plan})) < 1.0


def test_the_mission_does_else_what_it_likes_on_a_row() -> None:
    """Each is done at rest, and each spot after it has its photo."""
    verbs: dict[int, Callable[[Drone], object]] = {
        1: lambda drone: drone.autopilot.hover(2.0),
        3: lambda drone: drone.autopilot.turn_to(90.0),
        7: lambda drone: drone.autopilot.goto(Position(50.0, 50.0, 20.0)),
        9: lambda drone: drone.autopilot.hold(),
    }
    stood: dict[int, float] = {}

    def program(drone: Drone, detector: Detector) -> None:
        def at_spot(waypoint: Waypoint, photo: bytes) -> None:
            drone.stay_or_go(drone.start(detector.process_photo, photo, mode="heavy"), lambda _: None)
            if waypoint.index in verbs:
                verbs[waypoint.index](drone)
                velocity = drone.autopilot.telemetry.velocity
                stood[waypoint.index] = velocity.speed_m_s if velocity else 0.0

        photograph_each(drone, at_spot)

    events = flown(program)
    assert stood == pytest.approx(dict.fromkeys(verbs, 0.0))
    assert max(offs_m(events, PLAN)) < 1.0
    assert len(of(events, schema.AnswerTaken)) == 12


def test_an_action_may_fly_photograph_and_call() -> None:
    heard: list[object] = []

    def program(drone: Drone, detector: Detector) -> None:
        def act(waypoint: Waypoint, _: object) -> None:
            drone.autopilot.goto(Position(waypoint.position.east_m, 10.0, 20.0))
            photo = drone.camera.take_photo()
            heard.append(detector.process_photo(photo, mode="light"))
            heard.append(drone.start(detector.process_photo, photo, mode="light").result())

        def at_spot(waypoint: Waypoint, photo: bytes) -> None:
            pending = drone.start(detector.process_photo, photo, mode="light")
            drone.stay_or_go(pending, partial(act, waypoint), demands=lambda _: waypoint.index in (2, 3, 8))

        photograph_each(drone, at_spot)

    events = flown(program)
    assert len(heard) == 6
    assert sorted(event.waypoint for event in of(events, schema.Acted)) == [2, 3, 8]
    assert sorted(event.waypoint for event in of(events, schema.Demanded)) == [2, 3, 8], "each is logged once"
    assert [
        event.waypoint for event in of(events, schema.Arrived) if event.passing or event.waypoint in (0, 5)
    ]


def test_an_action_may_leave_an_answer_open() -> None:
    """With two open answers it must wait for one in its own action."""
    acted: list[str] = []

    def program(drone: Drone, detector: Detector) -> None:
        def later(waypoint: Waypoint, _: object) -> None:
            acted.append(f"again {waypoint.index}")

        def act(waypoint: Waypoint, _: object) -> None:
            acted.append(f"{waypoint.index}")
            again = drone.start(detector.process_photo, b"photo", mode="light")
            drone.stay_or_go(again, partial(later, waypoint), demands=lambda _: True)
            drone.autopilot.goto(Position(waypoint.position.east_m, 10.0, 20.0))

        def at_spot(waypoint: Waypoint, photo: bytes) -> None:
            pending = drone.start(detector.process_photo, photo, mode="light")
            drone.stay_or_go(pending, partial(act, waypoint), demands=lambda _: waypoint.index in (2, 3, 8))

        photograph_each(drone, at_spot)

    flown(program, at_most=2)
    assert sorted(acted) == ["2", "3", "8", "again 2", "again 3", "again 8"]


def test_without_failed_the_exception_of_a_call_comes_at_its_place() -> None:
    raised: list[tuple[float, float]] = []

    def program(drone: Drone, detector: Detector) -> None:
        for waypoint in drone.plan:
            try:
                drone.autopilot.goto(waypoint)
            except ValueError:
                raised.append((drone.autopilot.position.east_m, drone.autopilot.position.north_m))
                drone.autopilot.goto(waypoint)
            photo = drone.camera.take_photo()
            pending = drone.start(detector.process_photo, photo, mode="light")
            drone.stay_or_go(pending, _raise, demands=partial(_is_of_spot_2, waypoint.index))

    events = flown(program)
    assert raised == [(40.0, 0.0)]
    assert max(offs_m(events, PLAN)) < 1.0


def _raise(_: object) -> None:
    raise ValueError("it cannot be done")


def _is_of_spot_2(index: int, _: object) -> bool:
    return index == 2


def test_with_unless_a_leg_begins_at_rest() -> None:
    def program(drone: Drone, detector: Detector) -> None:
        drone.autopilot.goto(drone.plan[0])
        pending = drone.start(detector.process_photo, drone.camera.take_photo(), mode="light")
        assert not drone.autopilot.goto(drone.plan[5], unless=pending.demands(lambda _: True))
        assert drone.autopilot.position.east_m < 40.0
        drone.autopilot.goto(drone.plan[1])
        assert ground_distance_m(drone.autopilot.position, PLAN[1]) < 0.1

    flown(program)


@pytest.mark.parametrize("killed_at_s", [14.0, 21.0, 26.0, 27.5, 30.0, 33.0, 41.0, 48.0, 60.0, 75.0])
def test_killed_on_a_row_it_takes_again_the_photos_without_an_answer(killed_at_s: float) -> None:
    """Answers are 10 s late, and those of spots 2 and 8 have a demand."""
    config, shows = scenario(waypoints_m=ROWS, photos={"every_m": 20.0}, action_s=0.1), [PLAN[2], PLAN[8]]
    first = fly(config, killed_at_s=killed_at_s, shows=shows)
    taken = {event.waypoint for event in of(first.events, schema.AnswerTaken) if not event.demanded}
    acted = {event.waypoint for event in of(first.events, schema.Acted)}
    assert "mission_completed" not in first.names()
    both = fly(config, after=first, shows=shows)
    assert both.error is None
    again = after_resumption(both, first)
    photos = [event.waypoint for event in again if isinstance(event, schema.CallStarted)]
    assert photos == sorted(set(range(12)) - taken - acted), "exactly the photos without a finished answer"
    assert sorted({event.waypoint for event in of(both.events, schema.Acted)}) == [2, 8]
    assert max(offs_m(again, PLAN)) < 1.0
    assert both.result.undone == []


@pytest.mark.parametrize("killed_at_s", [12.0, 30.0, 44.0, 52.0, 57.0, 63.0, 75.0, 100.0, 130.0, 150.0])
def test_killed_in_a_survey_it_takes_again_the_photos_without_an_answer(
    tmp_path: Path, killed_at_s: float
) -> None:
    """On transects and in turn-arounds; answers are late, and that of spot 8 has a demand."""
    config = read_drone_config(written(tmp_path, transects(), heavy_s=4.0))
    plan = {waypoint.index: waypoint.position for waypoint in waypoints(config.mission)}
    first = fly(config, killed_at_s=killed_at_s, shows=[plan[8]])
    taken = {event.waypoint for event in of(first.events, schema.AnswerTaken) if not event.demanded}
    acted = {event.waypoint for event in of(first.events, schema.Acted)}
    both = fly(config, after=first, shows=[plan[8]])
    assert both.error is None
    again = after_resumption(both, first)
    photos = [event.waypoint for event in again if isinstance(event, schema.CallStarted)]
    assert photos == sorted(plan.keys() - taken - acted)
    assert [event.waypoint for event in of(both.events, schema.Acted)] == [8]
    assert max(offs_m(again, plan), default=0.0) < 1.0
    assert both.result.completed and both.result.undone == []


def test_a_survey_with_a_gap_is_taken_up_along_the_planned_way(tmp_path: Path) -> None:
    """Two rows with an obstacle between; the photos at the middle of the way are done."""
    items = [at(0, 10), begin(), at(0, 110), at(60, 110), at(60, 10), END]
    config = read_drone_config(
        written(tmp_path, items, fence=[(20, 0), (40, 0), (40, 90), (20, 90)], heavy_s=4.0)
    )
    first = fly(config, killed_at_s=75.0)
    assert "mission_completed" not in first.names()
    answered = {event.waypoint for event in of(first.events, schema.AnswerTaken)}
    first.events = [
        event for event in first.events if not (isinstance(event, schema.AnswerTaken) and event.waypoint == 1)
    ]
    both = fly(config, after=first)
    assert both.error is None and both.result.completed
    photos = [
        event.waypoint for event in after_resumption(both, first) if isinstance(event, schema.CallStarted)
    ]
    assert photos == sorted((set(range(14)) - answered) | {1})


def after_resumption(both: Part, first: Part) -> list[Any]:
    return both.events[len(first.events) :]


@dataclass(frozen=True)
class Ending:
    """A moment after an event, and the waypoints whose answers are open then, and whose demands are not met."""

    kind: type[schema.Event]
    waypoint: int | None
    later_s: float
    open: list[int]
    demanding: list[int]
    at_most: int = 100


# Answers are 10 s late, and those of spots 2 and 8 have a demand, met in 5 s.
ENDINGS = {
    "on a row": Ending(schema.Arrived, 3, 2.0, [1, 2, 3], []),
    "on a detour": Ending(schema.TurnedBack, 2, 2.0, [3, 4, 5], [2]),
    "at an action": Ending(schema.Notified, None, 2.0, [3, 4, 5], [2]),
    "at a wait": Ending(schema.PhotosWait, None, 3.0, [0, 1], [], at_most=2),
    "at the last answers": Ending(schema.Acted, 8, 1.0, [11], []),
}


@pytest.mark.parametrize("moment", ENDINGS)
@pytest.mark.parametrize("by", ["Ctrl-C", "the reserve", "the pilot"])
def test_a_flight_ended_on_a_row_names_what_is_open_and_is_taken_up_again(moment: str, by: str) -> None:
    shows = [PLAN[2], PLAN[8]]
    ending = ENDINGS[moment]
    photos = {"every_m": 20.0, "at_most": ending.at_most}
    config = at_once(scenario(waypoints_m=ROWS, photos=photos, action_s=5.0))
    whole = of(fly(config, shows=shows).events, ending.kind)
    began = [event for event in whole if ending.waypoint in (None, getattr(event, "waypoint", None))]
    at_s = began[0].t + ending.later_s
    first = ended(config, by, at_s, shows)
    assert not first.result.completed
    assert (first.result.not_looked_at, first.result.not_acted_on) == (ending.open, ending.demanding)
    assert first.result.failed_calls == []
    ended_s = max(at_s, max((event.t for event in of(first.events, schema.Stopping)), default=0.0))
    after = [event for event in first.events if event.t > ended_s]
    assert not [
        event for event in after if isinstance(event, schema.Call | schema.AnswerTaken | schema.PhotoTaken)
    ]
    assert of(after, schema.SetOff) == []
    assert first.position is not None and first.position.altitude_m == 0.0
    both = fly(config, after=first, shows=shows)
    assert both.error is None and both.result.completed and both.result.undone == []
    assert sorted(event.waypoint for event in of(both.events, schema.Acted)) == [2, 8]


def test_an_action_that_goes_on_after_the_stop_is_not_noted_as_done() -> None:
    def program(drone: Drone, detector: Detector) -> None:
        def act(_: object) -> None:
            with contextlib.suppress(MissionStopped):
                drone.autopilot.hover(5.0)

        def at_spot(_: Waypoint, photo: bytes) -> None:
            drone.stay_or_go(drone.start(detector.process_photo, photo, mode="light"), act)

        photograph_each(drone, at_spot)

    whole = fly(rows(), mission=in_the_air(program), shows=[PLAN[2]])
    arrived_s = next(event.t for event in of(whole.events, schema.AnswerTaken) if event.demanded)
    part = fly(rows(), mission=in_the_air(program), shows=[PLAN[2]], stopped_at_s=arrived_s + 1.0)
    assert isinstance(part.error, MissionStopped)
    assert part.result.not_acted_on == [2] and of(part.events, schema.Acted) == []


def ended(config: Any, by: str, at_s: float, shows: list[Position]) -> Part:
    match by:
        case "the reserve":  # is looked at once a second
            percent = 100.0 - 100.0 * (at_s - 0.5) / 1e3
            config = replace(config, mission=replace(config.mission, reserve_percent=percent))
            part = fly(config, shows=shows, autopilot=partial(ModelAutopilot, endurance_s=1e3))
            assert isinstance(part.error, ReserveReached)
        case "the pilot":
            takes = FaultConfig(target="autopilot", kind="pilot", from_s=at_s)
            part = fly(config, shows=shows, autopilot=partial(ModelAutopilot, incidents=[takes]))
            assert isinstance(part.error, AutopilotOverruled)
        case _:
            part = fly(config, shows=shows, stopped_at_s=at_s)
            assert isinstance(part.error, MissionStopped)
    return part


def test_a_resumed_row_with_gaps_is_flown_without_stops() -> None:
    """The newest photos were computed first."""
    first = fly(rows(order="newest"), killed_at_s=47.0)
    both = fly(rows(order="newest"), after=first)
    assert both.error is None
    again = after_resumption(both, first)
    photos = [event.waypoint for event in of(again, schema.CallStarted)]
    assert photos[:3] == [2, 4, 5], "0, 1 and 3 have their answers"
    assert [event.waypoint for event in of(again, schema.Arrived) if event.passing][:1] == [4]


def test_a_photo_that_fails_leaves_the_others() -> None:
    """The bundled survey tries twice, and flies on."""

    class Fails(ModelCamera):
        async def take_photo(self, at: Position) -> Photo:
            if 55.0 < at.east_m < 65.0 and at.north_m < 10.0:
                raise CameraError("camera", "no frame")
            return await super().take_photo(at)

    part = fly(rows(), camera=Fails)
    assert part.error is None
    assert {event.waypoint for event in of(part.events, schema.CallStarted)} == set(range(12)) - {3}
    assert max(offs_m(part.events, PLAN)) < 1.0


def test_a_defect_of_offloading_holds_up_no_call_in_line() -> None:
    """The third decision raises, with calls in line."""
    decide, count = Selection.decide, itertools.count()

    def fails(self: Selection, *call: Any, **more: Any) -> Any:
        if next(count) == 2:
            raise KeyError("a defect")
        return decide(self, *call, **more)

    with patch.object(Selection, "decide", fails):
        part = fly(rows())
    assert part.error is None
    assert len(of(part.events, schema.OffloadingFailed)) == 1
    calls = of(part.events, schema.Call)
    assert [call.waypoint for call in calls] == list(range(12)), "each once, the oldest first"
    ends = [call.t for call in calls]
    assert min(later - sooner for sooner, later in itertools.pairwise(ends)) >= 10.0, "one at a time"


def test_a_call_that_runs_once_computes_beside_no_other() -> None:
    def program(drone: Drone, detector: Detector) -> None:
        photograph_each(drone, lambda _, photo: drone.start(detector.process_photo, photo, mode="heavy"))

    with patch.object(Method, "once", property(lambda _: True)):
        ends = [call.t for call in of(flown(program), schema.Call)]
    assert min(later - sooner for sooner, later in itertools.pairwise(ends)) >= 10.0


def test_of_the_demands_that_came_during_an_act_the_nearest_is_met_first() -> None:
    known = at_once(scenario(waypoints_m=ROWS, photos={"every_m": 20.0}, action_s=600.0))
    slow = tuple(replace(each, local_call_s={"light": 3.0, "heavy": 40.0}) for each in known.services)
    shows = [Position(20.0, 0.0), Position(100.0, 0.0), Position(20.0, 20.0)]  # spots 1, 5 and 10
    part = fly(replace(known, services=slow), shows=shows)
    assert [event.waypoint for event in of(part.events, schema.Acted)] == [1, 10, 5]
