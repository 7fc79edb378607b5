from __future__ import annotations

import math
from statistics import fmean

import pytest
from hypothesis import given
from hypothesis import strategies as st

from upwash.core.knowledge.estimates import Beliefs, Estimates, Window, offline_remote_s
from upwash.core.knowledge.sending import BothWays, Less
from upwash.core.operation import Operation, name_of, server_of

LIGHT = Operation("detector", "process_photo", "light")
HEAVY = Operation("detector", "process_photo", "heavy")
delays_s = st.floats(0.01, 100.0)


def two_operations(*, remote_s: dict[Operation, float] | None = None) -> Estimates:
    """Light 3 s and heavy 10 s here, 1 s and 2 s on s1; s2 hosts light alone, in 1.5 s."""
    return Estimates(
        local_s={LIGHT: 3.0, HEAVY: 10.0},
        servers={
            "s1": Beliefs(11.5, 3.5, remote_s or {LIGHT: 1.0, HEAVY: 2.0}),
            "s2": Beliefs(20.0, 5.0, {LIGHT: 1.5}),
        },
    )


def test_an_operation_is_named_by_service_method_and_key() -> None:
    assert str(HEAVY) == "detector.process_photo[heavy]"
    assert str(Operation("detector", "ping")) == "detector.ping"


def test_the_drone_has_the_name_of_no_server() -> None:
    assert [server_of(name_of(server)) for server in (None, "s1")] == [None, "s1"]
    assert name_of(None) == "local"


@given(offline_s=delays_s, observed_s=st.lists(delays_s, max_size=8))
def test_a_window_is_the_mean_of_the_last_three_filled_with_the_offline_estimate(
    offline_s: float, observed_s: list[float]
) -> None:
    window = Window.filled(offline_s)
    for delay_s in observed_s:
        window = window.observe(delay_s)
    assert window.mean_s == pytest.approx(fmean([offline_s, offline_s, offline_s, *observed_s][-3:]))


@given(delays_s)
def test_equal_observations_are_met_to_the_last_bit(delay_s: float) -> None:
    assert Window.filled(delay_s).mean_s == delay_s


def test_the_first_remote_estimate_is_processing_plus_transfer() -> None:
    assert offline_remote_s(processing_s=0.6, data_bytes=425_500, bandwidth_bit_s=54e6) == pytest.approx(
        0.6 + 3_404_000 / 54_000_000
    )


def test_every_estimate_starts_with_what_was_believed_on_the_ground() -> None:
    estimates = two_operations()
    assert set(estimates.operations) == {LIGHT, HEAVY}
    assert estimates.local_s(HEAVY) == 10.0
    assert estimates.remote_s("s1", HEAVY) == 2.0
    assert estimates.check_s("s1", running=False) == 11.5
    assert estimates.check_s("s1", running=True) == 3.5


def test_a_call_changes_the_estimate_of_its_own_operation_and_place_only() -> None:
    estimates = two_operations()
    estimates.observe_remote("s1", LIGHT, 4.0, now_s=5.0)
    estimates.observe_local(HEAVY, 16.0)
    assert estimates.remote_s("s1", LIGHT) == 2.0
    assert estimates.remote_s("s2", LIGHT) == 1.5
    assert estimates.remote_s("s1", HEAVY) == 2.0
    assert estimates.local_s(HEAVY) == 12.0
    assert estimates.local_s(LIGHT) == 3.0


def test_a_check_changes_the_estimate_of_its_own_kind_and_server_only() -> None:
    estimates = two_operations()
    estimates.observe_check("s1", 14.5, started=True)
    assert estimates.check_s("s1", running=False) == 12.5
    assert estimates.check_s("s1", running=True) == 3.5
    estimates.observe_check("s1", 6.5, started=False)
    assert estimates.check_s("s1", running=False) == 12.5
    assert estimates.check_s("s1", running=True) == 4.5
    assert estimates.check_s("s2", running=True) == 5.0


def test_no_estimate_where_the_operation_is_unknown_or_not_hosted() -> None:
    unknown = Operation("counter", "count")
    estimates = two_operations()
    assert estimates.remote_s("s2", HEAVY) is None
    assert estimates.local_s(unknown) is None
    estimates.observe_local(unknown, 1.0)
    assert estimates.local_s(unknown) is None
    assert estimates.mean_call_s() == 6.5


def test_a_server_cannot_host_what_the_drone_has_no_local_estimate_of() -> None:
    estimates = Estimates(local_s={LIGHT: 3.0}, servers={"s1": Beliefs(11.5, 3.5, {LIGHT: 1.0, HEAVY: 2.0})})
    assert estimates.remote_s("s1", HEAVY) is None
    estimates.forget_slow_calls("s1", now_s=1000.0, retry_s=300.0)
    assert estimates.mean_call_s("s1") == 1.0


def test_operations_count_the_same_until_three_calls_were_seen() -> None:
    estimates = two_operations()
    for _ in range(2):
        estimates.observe_local(LIGHT, 3.0)
        assert estimates.mean_call_s() == pytest.approx((3.0 + 10.0) / 2)
    estimates.observe_remote("s1", HEAVY, 2.0, now_s=1.0)
    assert estimates.mean_call_s() == pytest.approx((2 * 3.0 + 10.0) / 3)
    assert estimates.mean_call_s("s1") == pytest.approx((2 * 1.0 + 2.0) / 3)


def test_each_call_counts_where_it_would_run_fastest() -> None:
    estimates = two_operations(remote_s={LIGHT: 9.0, HEAVY: 2.0})
    assert estimates.mean_call_s("s1") == pytest.approx((3.0 + 2.0) / 2)  # light stays on the drone
    assert estimates.mean_call_s("s2") == pytest.approx(
        (1.5 + 10.0) / 2
    )  # so does heavy, which s2 does not host


@given(
    calls=st.lists(st.sampled_from([LIGHT, HEAVY]), min_size=3, max_size=9),
    local_s=st.tuples(delays_s, delays_s),
    remote_s=st.tuples(delays_s, delays_s),
)
def test_the_gain_of_a_server_that_hosts_everything(
    calls: list[Operation], local_s: tuple[float, float], remote_s: tuple[float, float]
) -> None:
    call = dict(zip((LIGHT, HEAVY), local_s, strict=True))
    call_s = dict(zip((LIGHT, HEAVY), remote_s, strict=True))
    estimates = Estimates(local_s=call, servers={"s": Beliefs(11.5, 3.5, call_s)})
    for operation in calls:
        estimates.observe_local(operation, call[operation])
    weight = {operation: calls.count(operation) for operation in call}
    gain = sum(weight[o] * (call[o] - min(call[o], call_s[o])) for o in call) / sum(
        weight[o] * call[o] for o in call
    )
    mean_s = estimates.mean_call_s()
    assert (mean_s - estimates.mean_call_s("s")) / mean_s == pytest.approx(gain, abs=1e-9)


def slow_s1() -> Estimates:
    """s1 is believed to take 2 s for a heavy call, took 10 s thrice (as long as the drone), at last at 100 s."""
    estimates = two_operations()
    for at_s in (0.0, 50.0, 100.0):
        estimates.observe_remote("s1", HEAVY, 10.0, now_s=at_s)
    return estimates


def test_a_server_that_became_slow_gets_another_chance_after_retry_s() -> None:
    estimates = slow_s1()
    assert estimates.next_forgetting_s("s1", retry_s=300.0) == 400.0
    assert not estimates.forget_slow_calls("s1", now_s=399.9, retry_s=300.0)
    assert estimates.remote_s("s1", HEAVY) == 10.0
    assert estimates.forget_slow_calls("s1", now_s=400.0, retry_s=300.0)
    assert estimates.remote_s("s1", HEAVY) == 2.0
    assert not estimates.forget_slow_calls("s1", now_s=900.0, retry_s=300.0)


def test_another_chance_fills_the_whole_window() -> None:
    estimates = slow_s1()
    estimates.forget_slow_calls("s1", now_s=400.0, retry_s=300.0)
    estimates.observe_remote("s1", HEAVY, 8.0, now_s=401.0)
    assert estimates.remote_s("s1", HEAVY) == pytest.approx((2.0 + 2.0 + 8.0) / 3)


def test_what_is_still_faster_than_local_is_not_forgotten() -> None:
    estimates = two_operations()
    estimates.observe_remote("s1", HEAVY, 8.0, now_s=0.0)
    estimates.forget_slow_calls("s1", now_s=1000.0, retry_s=300.0)
    assert estimates.remote_s("s1", HEAVY) == 4.0


def test_the_chance_of_one_server_is_not_that_of_another() -> None:
    estimates = two_operations()
    for server in ("s1", "s2"):
        for _ in range(3):
            estimates.observe_remote(server, LIGHT, 5.0, now_s=0.0)
    estimates.forget_slow_calls("s1", now_s=300.0, retry_s=300.0)
    assert estimates.remote_s("s1", LIGHT) == 1.0
    assert estimates.remote_s("s2", LIGHT) == 5.0


def test_a_call_cut_short_raises_the_estimate_and_weighs_nothing() -> None:
    estimates = two_operations()
    for _ in range(3):
        estimates.observe_remote_cut("s1", HEAVY, 8.0, now_s=10.0)
    assert estimates.remote_s("s1", HEAVY) == 8.0
    assert estimates.mean_call_s() == pytest.approx((3.0 + 10.0) / 2), "no call was counted"


def test_a_call_cut_short_is_known_at_once_where_servers_are_compared() -> None:
    estimates = two_operations()
    before_s = estimates.mean_call_s("s1")
    estimates.observe_remote_cut("s1", HEAVY, 8.0, now_s=10.0)
    assert estimates.mean_call_s("s1") == pytest.approx(before_s + (8.0 - 2.0) / 3 / 2)


def test_a_call_cut_short_sooner_than_expected_says_nothing() -> None:
    estimates = two_operations()
    estimates.observe_remote_cut("s1", HEAVY, 1.9, now_s=10.0)
    assert estimates.remote_s("s1", HEAVY) == 2.0


def test_a_call_cut_short_as_it_was_expected_to_end_says_nothing() -> None:
    estimates = two_operations()
    for delay_s in (1.0, 2.0, 3.0):
        estimates.observe_remote("s1", HEAVY, delay_s, now_s=0.0)
    estimates.observe_remote_cut("s1", HEAVY, 2.0, now_s=10.0)
    assert estimates.remote_s("s1", HEAVY) == 2.0
    estimates.observe_remote_cut("s2", HEAVY, 20.0, now_s=10.0)
    assert estimates.remote_s("s2", HEAVY) is None, "s2 does not host it"


def slow_apart() -> Estimates:
    """A heavy call takes 10 s on the drone, and is believed to take 2 s on s1."""
    servers = {"s1": Beliefs(11.5, 3.5, {HEAVY: 2.0})}
    return Estimates(local_s={HEAVY: 10.0}, servers=servers, slow_apart=True)


def test_a_slow_call_that_is_kept_apart_bounds_the_next_one_until_a_fast_one() -> None:
    estimates = slow_apart()
    estimates.observe_remote_cut("s1", HEAVY, 30.0, now_s=0.0)
    assert estimates.remote_s("s1", HEAVY) == 2.0, "it was cut short"
    for slow_s in (12.0, 10.0):
        estimates.observe_remote("s1", HEAVY, slow_s, now_s=0.0)
        assert (estimates.remote_s("s1", HEAVY), estimates.remote_s("s1", HEAVY, slow=False)) == (slow_s, 2.0)
    estimates.observe_remote("s1", HEAVY, 5.0, now_s=1.0)
    assert estimates.remote_s("s1", HEAVY) == estimates.remote_s("s1", HEAVY, slow=False) == 3.0
    assert estimates.remote_s("s1", LIGHT, slow=False) is None


def test_a_slow_call_that_is_kept_apart_is_forgotten_after_retry_s() -> None:
    estimates = slow_apart()
    assert estimates.next_forgetting_s("s1", retry_s=300.0) == math.inf
    estimates.observe_remote("s1", HEAVY, 12.0, now_s=7.0)
    assert estimates.mean_call_s("s1") == 10.0
    assert estimates.next_forgetting_s("s1", retry_s=300.0) == 307.0
    assert not estimates.forget_slow_calls("s1", now_s=306.9, retry_s=300.0)
    assert estimates.forget_slow_calls("s1", now_s=307.0, retry_s=300.0)
    assert estimates.mean_call_s("s1") == estimates.remote_s("s1", HEAVY) == 2.0
    assert not estimates.forget_slow_calls("s1", now_s=400.0, retry_s=300.0)
    assert estimates.next_forgetting_s("s1", retry_s=300.0) == math.inf


def test_a_late_call_changes_the_mean_at_once_and_is_counted_as_no_second_one() -> None:
    estimates = two_operations()
    for _ in range(2):
        estimates.observe_local(LIGHT, 3.0)
    before_s = estimates.mean_call_s("s1")
    estimates.observe_remote("s1", HEAVY, 8.0, now_s=1.0, late=True)
    assert estimates.mean_call_s("s1") == pytest.approx(before_s + (8.0 - 2.0) / 3 / 2)


def test_a_start_takes_what_it_adds_to_a_check() -> None:
    estimates = two_operations()
    assert estimates.start_s("s1") == 8.0
    for _ in range(3):
        estimates.observe_check("s1", 12.0, started=False)
    assert estimates.start_s("s1") == 0.0


def test_a_call_is_the_first_of_its_service_until_one_was_computed_since_the_start() -> None:
    estimates = two_operations()
    assert estimates.is_first_call("s1", HEAVY)
    estimates.observe_remote("s1", LIGHT, 1.0, now_s=5.0)
    assert not estimates.is_first_call("s1", HEAVY)  # the same service, in the same instance
    assert estimates.is_first_call("s2", LIGHT)
    estimates.services_started("s1")
    assert estimates.is_first_call("s1", HEAVY)


@pytest.mark.parametrize("waited_s", [0.5, 4.0])
def test_a_call_that_was_cut_short_was_a_call(waited_s: float) -> None:
    estimates = two_operations()
    estimates.observe_remote_cut("s1", LIGHT, waited_s, now_s=5.0)
    assert not estimates.is_first_call("s1", LIGHT)


# --- a part before sending ----------------------------------------------------------------------------------


def less(*, loss: float = 0.01, most_loss: float = 0.02) -> Estimates:
    """Heavy calls take 2 s, of which the transfer takes 1.6 s; a part of 0.1 s leaves a quarter of it."""
    return Estimates(
        local_s={LIGHT: 3.0, HEAVY: 10.0},
        servers={"s1": Beliefs(11.5, 3.5, {LIGHT: 1.0, HEAVY: 2.0}, transfer_s={HEAVY: 1.6, LIGHT: 0.8})},
        slow_apart=True,
        less={HEAVY: Less(takes_s=0.1, share=0.25, loss=loss)},
        most_loss=most_loss,
    )


@pytest.mark.parametrize(
    ("loss", "most_loss", "remote_s"),
    [(0.01, 0.02, 0.9), (0.02, 0.02, 0.9), (0.03, 0.02, 2.0), (0.01, 0.0, 2.0), (0.0, 0.0, 2.0)],
)
def test_less_is_sent_only_where_the_user_allows_some_loss(
    loss: float, most_loss: float, remote_s: float
) -> None:
    known = less(loss=loss, most_loss=most_loss)
    assert known.remote_s("s1", HEAVY) == pytest.approx(remote_s)
    assert known.remote_s("s1", HEAVY, slow=False) == pytest.approx(remote_s)
    assert known.remote_s("s1", LIGHT) == 1.0
    assert (known.both_ways_s("s1", HEAVY) is None) == (remote_s == 2.0)


@given(whole_s=delays_s, takes_s=st.floats(0.0, 1.0), share=st.floats(0.01, 1.0), fixed_s=st.floats(0.0, 9.0))
def test_what_calls_with_less_to_send_took_is_what_the_next_one_is_expected_to_take(
    whole_s: float, takes_s: float, share: float, fixed_s: float
) -> None:
    both = BothWays(Less(takes_s, share, 0.0), fixed_s)
    assert both.whole_s(both.less_s(whole_s)) == pytest.approx(whole_s, rel=1e-6)


def test_a_link_that_gets_faster_has_the_request_sent_whole_again_and_a_slow_one_has_not() -> None:
    known = less()
    for delay_s, expected in ((0.9, (2.0, 0.9)), (0.52, (0.48, 0.52)), (3.0, (10.4, 3.0))):
        for _ in range(3):
            known.observe_remote("s1", HEAVY, delay_s, now_s=0.0, less=True)
        assert known.both_ways_s("s1", HEAVY) == pytest.approx(expected)
        assert known.remote_s("s1", HEAVY) == pytest.approx(min(expected))


def test_a_call_with_less_to_send_is_slow_by_what_it_took_and_not_by_what_it_had_taken_whole() -> None:
    known = less()
    for delay_s in (9.0, 9.0, 9.0):
        known.observe_remote("s1", HEAVY, delay_s, now_s=0.0, less=True)
    assert known.remote_s("s1", HEAVY) == pytest.approx(9.0)
    assert not known.forget_slow_calls("s1", now_s=1000.0, retry_s=300.0)


def test_a_part_that_fails_three_times_in_a_row_is_not_tried_any_more() -> None:
    known = less()
    for _ in range(2):
        known.part_failed("detector")
    known.observe_remote("s1", HEAVY, 0.9, now_s=0.0, less=True)
    for _ in range(2):
        known.part_failed("detector")
        assert known.remote_s("s1", HEAVY) == pytest.approx(0.9)
    known.part_failed("detector")
    assert not known.tries_part("detector")
    assert known.remote_s("s1", HEAVY) == pytest.approx(2.0)
