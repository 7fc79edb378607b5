"""When a mission is expected at its waypoints and over, before it takes off."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from upwash.core.geo import Circle, Position, Waypoint
from upwash.core.knowledge.estimates import Beliefs, Estimates
from upwash.core.operation import Operation
from upwash.core.planning.legs import ARDUCOPTER, Leg, Pace
from upwash.core.planning.mission_model import MissionBeliefs, MissionModel, StopCall
from upwash.core.policies.names import make_policy
from upwash.core.selection.commands import Effect
from upwash.core.selection.events import MissionBegun
from upwash.core.selection.selection import Selection
from upwash.core.selection.settings import SelectionSettings
from upwash.core.vehicle.way_home import EnergyFacts, WayHome
from upwash.eventlog.schema import Foreseen

LOOK, COUNT = Operation("detector", "look"), Operation("counter", "count")
LEG_S, PHOTO_S, TAKEOFF_S, AT_ONCE = 9.0, 1.0, 10.0, 1e9  # a leg of 20 m at 4 m/s and 1 m/s²
PLAN = [Waypoint(number, Position(20.0 * number, 0.0, 20.0)) for number in range(4)]
VEHICLE = EnergyFacts(
    home=PLAN[0].position,
    way_home=WayHome(0.0, AT_ONCE, AT_ONCE, AT_ONCE, 16.0, AT_ONCE, 0.0, AT_ONCE),
)


RETURNS_AT_4_M_S = replace(VEHICLE, way_home=WayHome(0.0, AT_ONCE, 4.0, 1.0, 16.0, AT_ONCE, 0.0, AT_ONCE))


def begin(
    plan: list[Waypoint], stop: list[StopCall], *, vehicle: EnergyFacts = VEHICLE, lands: bool = False
) -> list[Effect]:
    """A mission over these waypoints begins; a server has those at 20 and 40 m in range, and gains at looks alone."""
    selection = Selection(
        {"s1": Circle(Position(30.0, 0.0, 20.0), 15.0)},
        estimates=Estimates(
            local_s={LOOK: 10.0, COUNT: 2.0},
            servers={"s1": Beliefs(check_s=3.0, check_running_s=2.0, remote_s={LOOK: 1.0, COUNT: 2.0})},
        ),
        policy=make_policy("location-aware", gain_switch=0.25, gain_wait=0.25),
        settings=SelectionSettings(lands=lands),
        mission=MissionBeliefs(plan, 4.0, Pace(1.0, lifting_s=TAKEOFF_S), stop),
    )
    return selection.handle(MissionBegun(vehicle), now_s=3.0, position=Position(0.0, 0.0))


def foreseen(
    plan: list[Waypoint], stop: list[StopCall], *, vehicle: EnergyFacts = VEHICLE, lands: bool = False
) -> Foreseen:
    (effect,) = begin(plan, stop, vehicle=vehicle, lands=lands)
    assert isinstance(effect, Foreseen)
    return effect


def test_each_waypoint_is_foreseen_after_the_legs_photos_and_calls_before_it() -> None:
    expected = foreseen(PLAN, [StopCall(LOOK, PHOTO_S)])
    first = TAKEOFF_S
    second = first + PHOTO_S + 10.0 + LEG_S
    third = second + PHOTO_S + 1.0 + LEG_S
    fourth = third + PHOTO_S + 1.0 + LEG_S
    assert expected.reached_s == pytest.approx([first, second, third, fourth], abs=0.01)
    assert expected.as_asked_s == pytest.approx(fourth + PHOTO_S + 10.0 + 16.0, abs=0.01)
    assert expected.finish_by_s is None and expected.lightest_s is None


@pytest.mark.parametrize("assumed", [True, False])
def test_the_pace_of_the_vehicle_that_was_found_counts_where_the_file_has_none(assumed: bool) -> None:
    found = Pace(4.0, settling_s=0.5, lifting_s=3.0, climb_m_s=2.0, home_share=0.5)
    selection = Selection(
        {},
        estimates=Estimates(local_s={LOOK: 10.0}, servers={}),
        policy=make_policy("local-only", gain_switch=0.25, gain_wait=0.25),
        settings=SelectionSettings(takeoff_m=20.0),
        mission=MissionBeliefs(
            PLAN, 4.0, Pace(1.0, lifting_s=TAKEOFF_S), [StopCall(LOOK, PHOTO_S)], assumed=assumed
        ),
    )
    begun = MissionBegun(VEHICLE, found)
    (effect,) = selection.handle(begun, now_s=3.0, position=Position(0.0, 0.0))
    assert isinstance(effect, Foreseen)
    takeoff_s, leg_s, home_s = (13.0, 6.5, 8.0) if assumed else (TAKEOFF_S, LEG_S, 16.0)
    stops_s = [takeoff_s + number * (leg_s + PHOTO_S + 10.0) for number in range(4)]
    assert effect.reached_s == pytest.approx(stops_s, abs=0.01)
    assert effect.as_asked_s == pytest.approx(stops_s[-1] + PHOTO_S + 10.0 + home_s, abs=0.01)


def test_a_leg_of_the_pace_that_was_found_teaches_nothing_new() -> None:
    beliefs = MissionBeliefs(PLAN, 4.0, stop=[StopCall(LOOK, PHOTO_S)], assumed=True)
    model = MissionModel(beliefs, {})
    model.begun(ARDUCOPTER)
    expected_s = Leg(20.0, 4.0, ARDUCOPTER.acceleration_m_s2, ARDUCOPTER.settling_s).duration_s
    model.leg_begun(PLAN[0].position, PLAN[1].position, None, now_s=0.0)
    model.arrived(now_s=expected_s)
    following = model.next_leg()
    assert following is not None and following.leg.duration_s == pytest.approx(expected_s)


def test_every_call_of_a_stop_counts() -> None:
    one = foreseen(PLAN, [StopCall(LOOK, PHOTO_S)])
    two = foreseen(PLAN, [StopCall(LOOK, PHOTO_S), StopCall(COUNT, 0.0)])
    assert len(two.reached_s) == len(PLAN)
    longer_s = [after - before for after, before in zip(two.reached_s, one.reached_s, strict=True)]
    assert longer_s == pytest.approx([0.0, 2.0, 4.0, 6.0], abs=0.01)
    assert two.as_asked_s == pytest.approx(one.as_asked_s + 8.0, abs=0.01)


def test_a_mission_that_lands_at_its_last_waypoint_does_not_fly_home() -> None:
    stop = [StopCall(LOOK, PHOTO_S)]
    returns = foreseen(PLAN, stop, vehicle=RETURNS_AT_4_M_S)
    lands = foreseen(PLAN, stop, vehicle=RETURNS_AT_4_M_S, lands=True)
    assert returns.reached_s == lands.reached_s
    assert returns.as_asked_s - lands.as_asked_s == pytest.approx(60 / 4.0 + 4.0, abs=0.01)


@pytest.mark.parametrize(("plan", "stop"), [([], [StopCall(LOOK, PHOTO_S)]), (PLAN, [])])
def test_nothing_is_foreseen_where_no_waypoint_or_no_call_is_known(
    plan: list[Waypoint], stop: list[StopCall]
) -> None:
    assert begin(plan, stop) == []
