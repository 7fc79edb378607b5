"""Where calls to come are expected to run."""

from __future__ import annotations

from collections.abc import Mapping

from upwash.core.geo import Position
from upwash.core.knowledge.coverage import Coverage, MeasuredPlace
from upwash.core.knowledge.estimates import Beliefs, Estimates
from upwash.core.operation import Operation
from upwash.core.planning.mission_model import ExpectedCall
from upwash.core.policies.names import make_policy
from upwash.core.selection.call_forecast import CallForecast, CallPlace

HEAVY, UNKNOWN = Operation("detector", "look", "heavy"), Operation("detector", "count")
LOCAL_S, REMOTE_S, CHECK_S, CHECK_RUNNING_S = 10.0, 0.7, 12.0, 3.0


def placing(
    here: CallPlace | None = None,
    *,
    policy: str = "location-aware",
    unusable_s: Mapping[str, float] | None = None,
) -> CallForecast:
    """With a server that is much faster than the drone, and one that is slower."""
    estimates = Estimates(
        local_s={HEAVY: LOCAL_S},
        servers={
            "s1": Beliefs(CHECK_S, CHECK_RUNNING_S, {HEAVY: REMOTE_S}),
            "slow": Beliefs(0.0, 0.0, {HEAVY: 2 * LOCAL_S}),
        },
    )
    chosen = make_policy(policy, gain_switch=0.25, gain_wait=0.25)
    return CallForecast(chosen, estimates, here=here or CallPlace(), unusable_s=unusable_s or {})


def call(gap_s: float, **in_range_s: float) -> ExpectedCall:
    return ExpectedCall(HEAVY, gap_s, in_range_s)


def test_a_check_begins_as_a_range_is_entered_and_goes_on_while_the_drone_computes() -> None:
    ahead = placing()
    places = list(ahead.places([call(5.0, s1=2.0), call(1.0, s1=1.0)]))
    assert places == [CallPlace("s1", CHECK_S - 2.0), CallPlace("s1", 0.0)]
    assert [ahead.delay_s(place, call(0.0)) for place in places] == [LOCAL_S, REMOTE_S]


def test_a_check_that_is_nearly_over_is_waited_for() -> None:
    ahead = placing(CallPlace("s1", 8.0))
    (place,) = ahead.places([call(3.0, s1=3.0)])
    assert place == CallPlace("s1", 5.0)
    assert ahead.delay_s(place, call(0.0)) == 5.0 + REMOTE_S
    assert ahead.delay_s(CallPlace("s1", 7.0), call(0.0)) == LOCAL_S, "it would gain less than a quarter"


def test_a_server_without_a_range_is_as_fast_as_at_the_place_of_the_call() -> None:
    place = MeasuredPlace(Position(500.0, 0.0), tried=1, answered=1)
    place.note(HEAVY, 5.0)
    beliefs = {"lte": Beliefs(CHECK_S, 3.0, {HEAVY: REMOTE_S})}
    estimates = Estimates(local_s={HEAVY: LOCAL_S}, servers=beliefs, coverage=Coverage({"lte": [place]}))
    estimates.locate(Position(0.0, 0.0))
    chosen = make_policy("location-aware", gain_switch=0.25, gain_wait=0.25)
    ahead = CallForecast(chosen, estimates, here=CallPlace(), unusable_s={})
    for at, delay_s in ((Position(500.0, 0.0), 5.0), (Position(0.0, 0.0), REMOTE_S)):
        assert ahead.delay_s(CallPlace("lte"), ExpectedCall(HEAVY, 0.0, {}, at)) == delay_s


def test_a_server_that_is_ready_and_hardly_faster_is_called() -> None:
    estimates = Estimates(local_s={HEAVY: LOCAL_S}, servers={"s1": Beliefs(CHECK_S, 3.0, {HEAVY: 9.0})})
    chosen = make_policy("location-aware", gain_switch=0.25, gain_wait=0.25)
    ahead = CallForecast(chosen, estimates, here=CallPlace(), unusable_s={})
    assert ahead.delay_s(CallPlace("s1"), call(0.0)) == 9.0
    assert ahead.delay_s(CallPlace("s1", 0.5), call(0.0)) == LOCAL_S


def test_opportunistic_is_expected_to_stay_where_it_is_and_else_to_take_the_range_that_it_entered_first() -> (
    None
):
    ahead = placing(CallPlace("slow"), policy="opportunistic")
    places = ahead.places([call(5.0, s1=5.0, slow=5.0), call(5.0, s1=5.0), call(5.0, s1=1.0, slow=3.0)])
    assert [place.server for place in places] == ["slow", "s1", "s1"]
    first = placing(policy="opportunistic").places([call(5.0, s1=1.0, slow=3.0)])
    assert [place.server for place in first] == ["slow"]


def test_services_run_on_a_server_that_was_checked_before() -> None:
    places = list(placing().places([call(1.0, s1=1.0), call(1.0), call(1.0, s1=1.0)]))
    assert places == [CallPlace("s1", CHECK_S - 1.0), CallPlace(), CallPlace("s1", CHECK_RUNNING_S - 1.0)]


def test_a_server_counts_once_it_can_be_used_again() -> None:
    calls = [call(1.0, s1=1.0), call(1.0, s1=1.0)]
    assert [place.server for place in placing(unusable_s={"s1": 1.0 + LOCAL_S + 1.0}).places(calls)] == [
        None,
        "s1",
    ]
    assert [place.server for place in placing(unusable_s={"s1": 12.1}).places(calls)] == [None, None]


def test_the_policy_has_its_say() -> None:
    calls = [call(1.0, slow=1.0)]
    assert list(placing().places(calls)) == [CallPlace()]
    assert list(placing(policy="opportunistic").places(calls)) == [CallPlace("slow")]
    assert list(placing(policy="local-only").places([call(20.0, s1=20.0)])) == [CallPlace()]


def test_a_call_of_which_nothing_is_known_takes_no_time() -> None:
    assert placing().delay_s(CallPlace("s1"), call(0.0), UNKNOWN) == 0.0
