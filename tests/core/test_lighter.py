"""What the laws of lighter.py come to over a whole mission, and what a mission's forecast is made of."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
from hypothesis import given
from hypothesis import strategies as st

from upwash.core.geo import Circle, Position, Waypoint
from upwash.core.knowledge.estimates import Beliefs, Estimates
from upwash.core.operation import Operation
from upwash.core.planning.legs import Pace
from upwash.core.planning.mission_model import MissionBeliefs, StopCall
from upwash.core.policies.names import make_policy
from upwash.core.policies.policy import Lightened
from upwash.core.selection.events import LegBegun, LegEnded, LocalCallEnded, MissionBegun
from upwash.core.selection.mission_times import is_lighter
from upwash.core.selection.selection import Selection
from upwash.core.selection.settings import LighterSettings, SelectionSettings
from upwash.core.vehicle.way_home import EnergyFacts, WayHome
from upwash.eventlog.schema import Foreseen

HEAVY, LIGHT = Operation("detector", "look", "heavy"), Operation("detector", "look", "light")


@dataclass(frozen=True)
class Photo:
    """A call whose two modes take so long, by the forecast, and by how much longer it takes in truth."""

    heavy_s: float
    light_s: float
    longer_s: float = 0.0

    @property
    def saves_s(self) -> float:
        return self.heavy_s - self.light_s


@dataclass(frozen=True)
class Flown:
    lighter: tuple[bool, ...]
    ended_s: float


def fly(photos: list[Photo], budget_s: float) -> Flown:
    """A mission that is judged anew at each call, by the time that it really used so far."""
    now_s, lighter = 0.0, []
    for number, photo in enumerate(photos):
        coming = photos[number + 1 :]
        late_s = now_s + sum(each.heavy_s for each in (photo, *coming)) - budget_s
        lighter.append(is_lighter(photo.saves_s, [each.saves_s for each in coming], late_s))
        if late_s <= 0:
            assert not lighter[-1], "never where the forecast fits"
        now_s += (photo.light_s if lighter[-1] else photo.heavy_s) + photo.longer_s
    return Flown(tuple(lighter), now_s)


def seconds(longest: int) -> st.SearchStrategy[float]:
    return st.integers(0, 8 * longest).map(lambda eighths: eighths / 8)  # whose sums are exact


def photos(*, longer_s: float = 0.0) -> st.SearchStrategy[list[Photo]]:
    one = st.builds(
        lambda light_s, saves_s, longer: Photo(light_s + saves_s, light_s, longer),
        seconds(4),
        seconds(10),
        seconds(2).map(lambda found_s: (found_s - 1) * longer_s),
    )
    return st.lists(one, min_size=1, max_size=12)


@given(photos(), seconds(100))
def test_a_true_forecast_is_met_with_as_few_lighter_calls_as_can_be(
    mission: list[Photo], budget_s: float
) -> None:
    flown = fly(mission, budget_s)
    fits = sum(each.light_s for each in mission) <= budget_s
    if fits:
        assert flown.ended_s <= budget_s
    else:
        assert flown.ended_s == sum(each.light_s for each in mission), "light is flown"
    late_s, fewest = sum(each.heavy_s for each in mission) - budget_s, 0
    for saves_s in sorted((each.saves_s for each in mission), reverse=True):
        if late_s <= 0 or saves_s == 0:
            break
        late_s, fewest = late_s - saves_s, fewest + 1
    assert sum(flown.lighter) == fewest


@given(photos(), seconds(100), seconds(100))
def test_less_time_makes_no_call_heavier(mission: list[Photo], one_s: float, other_s: float) -> None:
    less, more = fly(mission, min(one_s, other_s)), fly(mission, max(one_s, other_s))
    assert all(hurried or not calm for hurried, calm in zip(less.lighter, more.lighter, strict=True))


@given(photos(longer_s=0.5), seconds(100))
def test_a_wrong_forecast_costs_no_more_than_it_was_off_since_the_last_heavy_call(
    mission: list[Photo], budget_s: float
) -> None:
    flown = fly(mission, budget_s)
    could_save = [number for number, each in enumerate(mission) if each.saves_s > 0]
    heavy = [number for number in could_save if not flown.lighter[number]]
    if heavy:
        off_s = sum(each.longer_s for each in mission[heavy[-1] :])
        assert flown.ended_s <= budget_s + max(0.0, off_s)


# --- the forecast -------------------------------------------------------------------------------------------

PLAN = [Waypoint(number, Position(20.0 * number, 0.0, 20.0)) for number in range(6)]
LEG_S, PHOTO_S, HOME_S, TAKEOFF_S = 9.0, 1.0, 16.0, 10.0  # 20 m at 4 m/s and 1 m/s²
AT_ONCE = 1e9
VEHICLE = EnergyFacts(
    home=PLAN[0].position,
    way_home=WayHome(0.0, AT_ONCE, AT_ONCE, AT_ONCE, HOME_S, AT_ONCE, 0.0, AT_ONCE),
)


def begun(
    finish_by_s: float, *, policy: str = "location-aware", light_s: float = 3.0
) -> tuple[Selection, Foreseen]:
    """Six waypoints, of which a server's range has those at 40 and 60 m; the vehicle has just been armed."""
    estimates = Estimates(
        local_s={HEAVY: 10.0, LIGHT: light_s},
        servers={"s1": Beliefs(check_s=4.0, check_running_s=2.0, remote_s={HEAVY: 0.7, LIGHT: 0.3})},
    )
    selection = Selection(
        {"s1": Circle(Position(50.0, 0.0, 20.0), 20.0)},
        estimates=estimates,
        policy=make_policy(policy, gain_switch=0.25, gain_wait=0.25),
        settings=SelectionSettings(lighter=LighterSettings(finish_by_s, {HEAVY: LIGHT})),
        mission=MissionBeliefs(PLAN, 4.0, Pace(1.0, lifting_s=TAKEOFF_S), [StopCall(HEAVY, PHOTO_S)]),
    )
    (foreseen,) = selection.handle(MissionBegun(VEHICLE), now_s=0.0, position=Position(0.0, 0.0))
    assert isinstance(foreseen, Foreseen)
    return selection, foreseen


OTHER_S = TAKEOFF_S + 5 * LEG_S + 6 * PHOTO_S + HOME_S


@pytest.mark.parametrize(
    ("policy", "heavy_s", "light_s"),
    [("location-aware", 4 * 10 + 2 * 0.7, 4 * 3 + 2 * 0.3), ("local-only", 60.0, 18.0)],
)
def test_a_mission_is_foreseen_by_its_policy_before_it_takes_off(
    policy: str, heavy_s: float, light_s: float
) -> None:
    _, foreseen = begun(500.0, policy=policy)
    assert foreseen.as_asked_s == pytest.approx(OTHER_S + heavy_s, abs=0.01)
    assert foreseen.lightest_s == pytest.approx(OTHER_S + light_s, abs=0.01)
    assert foreseen.finish_by_s == 500.0


def first_call(selection: Selection, *, at_s: float, operation: Operation = HEAVY) -> Lightened | None:
    """As it is decided at the first waypoint, where the photo has just been taken."""
    here = PLAN[0].position
    selection.handle(LegBegun(here, None), now_s=at_s - PHOTO_S, position=here)
    selection.handle(LegEnded(), now_s=at_s - PHOTO_S, position=here)
    decision, _ = selection.decide(operation, now_s=at_s, position=here)
    return decision.inputs.lightened


def test_a_call_is_lighter_exactly_where_the_mission_would_be_over_too_late() -> None:
    needed_s = OTHER_S + 4 * 10 + 2 * 0.7
    at_s = TAKEOFF_S + PHOTO_S
    assert first_call(begun(needed_s + 0.01)[0], at_s=at_s) is None
    lightened = first_call(begun(needed_s - 0.01)[0], at_s=at_s)
    assert lightened is not None and (lightened.operation, lightened.asked) == (LIGHT, HEAVY)
    assert lightened.forecast_s == pytest.approx(needed_s, abs=0.01)


def test_a_call_that_would_save_nothing_is_not_lighter_however_late_the_mission_is() -> None:
    for light_s in (10.0, 11.0):
        assert first_call(begun(1.0, light_s=light_s)[0], at_s=TAKEOFF_S + PHOTO_S) is None


def test_time_that_was_lost_so_far_counts() -> None:
    needed_s, at_s = OTHER_S + 4 * 10 + 2 * 0.7, TAKEOFF_S + PHOTO_S
    assert first_call(begun(needed_s + 5.0)[0], at_s=at_s + 4.9) is None
    assert first_call(begun(needed_s + 5.0)[0], at_s=at_s + 5.1) is not None


def test_what_is_asked_for_light_stays_so_and_says_nothing() -> None:
    assert first_call(begun(1.0)[0], at_s=TAKEOFF_S + PHOTO_S, operation=LIGHT) is None


def test_nothing_is_lighter_before_the_mission_has_begun() -> None:
    estimates = Estimates(local_s={HEAVY: 10.0, LIGHT: 3.0}, servers={})
    selection = Selection(
        {},
        estimates=estimates,
        policy=make_policy("look-ahead", gain_switch=0.25, gain_wait=0.25),
        settings=SelectionSettings(lighter=LighterSettings(1.0, {HEAVY: LIGHT})),
        mission=MissionBeliefs(PLAN, 4.0, Pace(1.0), [StopCall(HEAVY, PHOTO_S)]),
    )
    assert first_call(selection, at_s=10.0) is None


def test_the_calls_to_come_are_expected_as_they_are_asked_for() -> None:
    """A lighter call at one stop is no reason to expect light calls at the next ones."""
    selection, _ = begun(OTHER_S + 4 * 10 + 2 * 0.7 - 0.01)
    at_s = TAKEOFF_S + PHOTO_S
    assert first_call(selection, at_s=at_s) is not None
    selection.handle(LocalCallEnded(LIGHT, 3.0), now_s=at_s + 3, position=PLAN[0].position)
    selection.handle(LegBegun(PLAN[1].position, None), now_s=at_s + 3, position=PLAN[0].position)
    assert {call.operation for call in selection.planning.mission.rest(PLAN[0].position, now_s=at_s + 3)} == {
        HEAVY
    }


def test_a_call_that_falls_back_is_judged_as_one_on_the_drone() -> None:
    """On the server it saves 0.4 s, less than calls to come on the drone; on the drone as much as they do."""
    selection, _ = begun(OTHER_S + 4 * 10 + 2 * 0.7 - 7.0)
    here = PLAN[2].position
    at_s = TAKEOFF_S + 2 * (LEG_S + PHOTO_S + 10.0) + PHOTO_S
    selection.handle(LegBegun(here, None), now_s=at_s - 2.0, position=here)
    selection.handle(LegEnded(), now_s=at_s - PHOTO_S, position=here)
    decision, _ = selection.decide(HEAVY, now_s=at_s, position=here)
    assert decision.inputs.lightened is None
    lightened = selection.fall_back(HEAVY, now_s=at_s + 3.0, position=here)
    assert lightened is not None and lightened.operation == LIGHT
    coming_s = 10.0 + 3 * (LEG_S + PHOTO_S) + 0.7 + 2 * 10.0 + HOME_S
    assert lightened.forecast_s == pytest.approx(at_s + 3.0 + coming_s, abs=0.01)
    selection.locate(here, at_s + 4.0)
    outlook = selection.planning.outlook()
    assert outlook is not None and outlook.stay_s == pytest.approx(3.0 - 1.0)


def test_a_call_that_falls_back_in_time_runs_as_it_was_asked_for() -> None:
    selection, _ = begun(1e9)
    assert first_call(selection, at_s=TAKEOFF_S + PHOTO_S) is None
    assert selection.fall_back(HEAVY, now_s=TAKEOFF_S + 5.0, position=PLAN[0].position) is None
