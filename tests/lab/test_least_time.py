"""The least times of missions, alone and of several that share servers."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from upwash.core.planning.schedule import ComingCall, Offer
from upwash.lab.least_time import SharedMission, bound, shared_s


def test_without_joins_each_call_runs_where_it_is_fastest() -> None:
    calls = [
        ComingCall(10.0, 5.0, [Offer("a", 2.0, 0.0), Offer("b", 1.0, 0.0)]),
        ComingCall(10.0, 5.0, [Offer("a", 12.0, 5.0)]),
        ComingCall(10.0, 5.0, []),
    ]
    assert bound(calls, {"a": 3.0, "b": 3.0}).free_s == 1.0 + 10.0 + 10.0


def test_joins_are_paid_for_where_no_flight_hides_them() -> None:
    calls = [
        ComingCall(10.0, 5.0, [Offer("a", 1.0, 5.0)]),
        ComingCall(10.0, 2.0, [Offer("b", 1.0, 2.0)]),
    ]
    assert bound(calls, {"a": 3.0, "b": 3.0}).with_joins_s == 1.0 + (3.0 - 2.0) + 1.0


def test_the_bound_with_joins_is_never_below_the_other_not_even_by_rounding() -> None:
    found = bound([ComingCall(0.1, 0.0, [])] * 10, {})
    assert found.free_s <= found.with_joins_s == pytest.approx(1.0)


def mission(begun_s: float = 0.0, local_s: float = 100.0, free_s: float = 20.0) -> SharedMission:
    return SharedMission(begun_s, local_s, free_s)


def test_one_mission_is_bounded_by_itself_or_by_what_it_can_save() -> None:
    assert shared_s([mission()], math.inf) == 20.0
    assert shared_s([mission()], 9.0) == 20.0
    assert shared_s([mission()], 1.0) == 50.0  # 50 s with the server save 50 s
    assert shared_s([mission()], 0.0) == 100.0
    assert shared_s([mission(begun_s=1000.0)], 1.0) == 50.0


def test_missions_that_share_a_server_end_one_after_the_other_at_best() -> None:
    # Served by turns, both would end at 66.7 s: the sum is least where one has the server until it is done.
    assert shared_s([mission(), mission()], 1.0) == pytest.approx((50.0 + 75.0) / 2)
    assert shared_s([mission(), mission()], math.inf) == 20.0


def test_what_a_server_saved_before_a_mission_began_is_not_for_it() -> None:
    early, late = mission(local_s=100.0), mission(begun_s=200.0, local_s=100.0)
    assert shared_s([early, late], 1.0) <= 50.0 + 1e-9
    assert shared_s([late, late], 1.0) == pytest.approx((50.0 + 75.0) / 2)


missions = st.lists(
    st.builds(
        lambda begun_s, free_s, more_s: SharedMission(begun_s, free_s + more_s, free_s),
        st.floats(0, 500),
        st.floats(1, 500),
        st.floats(0, 500),
    ),
    min_size=1,
    max_size=8,
)


@given(missions=missions, saved_per_s=st.floats(0, 20), served=st.data())
def test_no_way_of_serving_them_is_better(
    missions: list[SharedMission], saved_per_s: float, served: st.DataObject
) -> None:
    """The server gives all it can to one mission after the other, in some order, as long as that can gain."""
    order = served.draw(st.permutations(missions))
    now_s, took_s = 0.0, 0.0
    for each in order:
        begins_s = max(now_s, each.begun_s)
        most_s = each.local_s - each.free_s
        served_s = 0.0
        if saved_per_s > 0:  # it saves until it has saved all it can, or is over
            left_s = max(0.0, each.begun_s + each.local_s - begins_s)
            served_s = min(most_s / saved_per_s, left_s / (1 + saved_per_s))
        now_s = begins_s + served_s
        took_s += each.local_s - saved_per_s * served_s
    assert shared_s(missions, saved_per_s) <= took_s / len(missions) + 1e-6


@given(missions=missions, saved_per_s=st.floats(0, 20), more=st.floats(0, 20))
def test_it_lies_between_the_missions_own_bounds_and_the_drones_alone(
    missions: list[SharedMission], saved_per_s: float, more: float
) -> None:
    count = len(missions)
    bound_s = shared_s(missions, saved_per_s)
    assert sum(each.free_s for each in missions) / count <= bound_s + 1e-6
    assert bound_s <= sum(each.local_s for each in missions) / count + 1e-6
    assert shared_s(missions, saved_per_s + more) <= bound_s + 1e-6
