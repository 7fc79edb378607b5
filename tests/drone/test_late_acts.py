"""Acts of late answers that cost less further on: on rows, and at stops where the drone went on."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from functools import partial
from types import SimpleNamespace
from typing import Any, NamedTuple

import msgspec
import pytest
from tests.drone.test_pending import in_the_air, of
from tests.drone.test_resume import at_once, fly, scenario
from tests.drone.test_rows import ROWS
from tests.drone.test_stay_or_go import going

from upwash import Drone
from upwash.config.drone import DroneConfig
from upwash.core.geo import Position, Waypoint
from upwash.core.planning.acts import Acts, cheapest
from upwash.core.planning.legs import Pace
from upwash.drone.late_acts import LateActs, Onwards
from upwash.eventlog import schema
from upwash.services import Detector
from upwash.sim.loop import run_virtually

ACTION_S = 5.0
# Answers take 10 s; that to the photo of spot 3, at 60 m, has a demand. The second row passes 20 m beside.
SHOWN = Position(60.0, 0.0)
BESIDE = [[0, 0], [10, 0], [60, 0], [60, 10], [0, 10]]


def rows(**mission: Any) -> DroneConfig:
    photos = {"every_m": 20.0}
    return scenario(waypoints_m=ROWS, photos=photos, action_s=ACTION_S, **mission)


def within(config: DroneConfig, within_s: float) -> DroneConfig:
    policy = msgspec.structs.replace(config.policy, act_within_s=within_s)
    return msgspec.structs.replace(config, policy=policy)


def test_an_act_is_put_off_and_done_once_where_it_makes_the_way_least_longer() -> None:
    late, soon = (fly(config, shows=[SHOWN]) for config in (rows(), at_once(rows())))
    assert late.error is None and soon.error is None
    (put_off,) = of(late.events, schema.PutOff)
    assert put_off.waypoint == 3 and put_off.extra_s < put_off.at_once_s
    assert not of(soon.events, schema.PutOff)
    assert [event.waypoint for event in of(late.events, schema.Acted)] == [3]
    gained_s = soon.result.mission_time_s - late.result.mission_time_s
    assert gained_s == pytest.approx(put_off.at_once_s - put_off.extra_s, abs=1.0)


def test_behind_a_last_spot_that_is_no_row_end_an_act_is_done_where_it_was_put_off_to() -> None:
    ends = [[0, 0], [107, 0], [107, 10], [0, 10], [0, 20], [107, 20]]  # spots up to 100 m, and from 7 m on
    config = scenario(waypoints_m=ends, photos={"every_m": 20.0}, action_s=ACTION_S)
    late = fly(config, shows=[Position(80.0, 0.0)])
    assert late.error is None
    (put_off,), (acted,) = of(late.events, schema.PutOff), of(late.events, schema.Acted)
    assert acted.t - ACTION_S < put_off.t + put_off.in_s + 10.0


@pytest.mark.parametrize("within_s", [0.0, 15.0, 30.0, 60.0])
def test_an_act_begins_within_its_limit(within_s: float) -> None:
    flight = fly(within(rows(), within_s), shows=[SHOWN, Position(20.0, 0.0)])
    assert flight.error is None
    heard_s = {event.waypoint: event.t for event in of(flight.events, schema.Demanded)}
    begun_s = {event.waypoint: event.t - ACTION_S for event in of(flight.events, schema.Acted)}
    assert set(begun_s) == set(heard_s) == {1, 3}
    back_s = 25.0  # of a drone that turns back at once
    assert all(begun_s[spot] - heard_s[spot] <= max(within_s, back_s) for spot in heard_s)


def test_a_flight_that_ends_names_the_acts_that_were_put_off_and_is_taken_up_again() -> None:
    whole = fly(rows(), shows=[SHOWN])
    (put_off,) = of(whole.events, schema.PutOff)
    first = fly(rows(), shows=[SHOWN], stopped_at_s=put_off.t + 1.0)
    assert first.result.not_acted_on == [3]
    both = fly(rows(), shows=[SHOWN], after=first)
    assert both.error is None and both.result.completed
    assert [event.waypoint for event in of(both.events, schema.Acted)] == [3]


def test_at_stops_too_the_act_of_an_answer_that_comes_on_the_way_is_put_off() -> None:
    config = going(scenario(waypoints_m=BESIDE, action_s=ACTION_S))
    late, soon = (fly(each, shows=[Position(0.0, 0.0)]) for each in (config, at_once(config)))
    assert late.error is None and soon.error is None
    for flight in (late, soon):
        assert Counter(event.waypoint for event in of(flight.events, schema.Acted)) == {0: 1}
    assert of(late.events, schema.PutOff)
    assert late.result.mission_time_s < soon.result.mission_time_s - 5.0


class Late(NamedTuple):
    """What is asked of a late answer."""

    place: Position
    waypoint: int
    object: int | None = None


def test_an_act_that_fails_leaves_the_others_to_the_next_verb() -> None:
    acted: list[float] = []

    def act(drone: Drone) -> None:
        acted.append(drone.autopilot.position.east_m)
        if len(acted) == 1:
            raise ValueError("it cannot be done")

    def program(drone: Drone, detector: Detector) -> None:
        for waypoint in drone.plan:
            tried(partial(drone.autopilot.goto, waypoint))
            pending = drone.start(detector.process_photo, drone.camera.take_photo(), mode="heavy")
            drone.stay_or_go(pending, lambda _: act(drone), demands=partial(_is_of_first_two, waypoint.index))
        tried(drone.autopilot.hold)

    def tried(verb: Callable[[], object]) -> None:
        try:
            verb()
        except ValueError:
            assert len(acted) == 1
            verb()

    flight = fly(going(scenario(waypoints_m=BESIDE)), mission=in_the_air(program))
    assert flight.error is None
    assert sorted(acted) == pytest.approx([0.0, 10.0], abs=0.1)


def _is_of_first_two(index: int, _: object) -> bool:
    return index < 2


PLAN = [Waypoint(number, Position(20.0 * number, 0.0)) for number in range(4)]


def decides(*, spare_s: float | None = None, allowed: bool = True) -> bool:
    """Whether an act beside the plan's third waypoint is put off by a drone at the first."""
    answer: Any = Late(Position(40.0, 5.0), 0)
    here = PLAN[0].position
    legs: Any = SimpleNamespace(
        autopilot=SimpleNamespace(position=here, stopping_place=here),
        journal=SimpleNamespace(record=lambda _: None),
        site=SimpleNamespace(waypoints=PLAN),
        position=here,
        allows=lambda *_: allowed,
    )

    def home_s(place: Position) -> float:
        return 10.0 + place.east_m / 4.0

    async def decided() -> bool:
        acts = Acts[Any](PLAN, ground_speed_m_s=4.0, pace=Pace(), photo_s=0.0, home_s=home_s)
        late = LateActs(
            legs,
            acts,
            when_to_act=cheapest,
            within_s=math.inf,
            home_s=home_s,
            spare_s=lambda: spare_s,
        )
        onwards = Onwards(PLAN[1], PLAN[1].position)
        return await late.puts_off(answer, onwards)

    return run_virtually(decided())


def test_the_reserve_comes_before_a_cheaper_act() -> None:
    assert decides() and decides(spare_s=100.0)
    assert not decides(spare_s=5.0), "it would not be there before the reserve ends the mission"


def test_no_act_is_put_off_to_where_a_fence_forbids_the_way() -> None:
    assert not decides(allowed=False)
