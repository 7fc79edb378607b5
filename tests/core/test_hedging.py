"""When the drone's own service starts on a remote call, and how much work that may add."""

from __future__ import annotations

import pytest

from upwash.core.knowledge.estimates import Beliefs, Estimates
from upwash.core.operation import Operation
from upwash.core.policies.policy import Remote
from upwash.core.selection.hedging import Hedge, HedgeRule, Hedging, quantile_s

HEAVY = Operation("detector", "process_photo", "heavy")
EXCEEDS_BY_S = 0.001


def hedging(rule: HedgeRule | None = HedgeRule()) -> Hedging:  # noqa: B008 - a value
    """Of a drone that needs 10 s for a call."""
    remote_s = {"s1": {HEAVY: 0.7}, "s2": {HEAVY: 2.0}}
    servers = {server: Beliefs(10.0, 3.0, delays_s) for server, delays_s in remote_s.items()}
    estimates = Estimates(local_s={HEAVY: 10.0}, servers=servers)
    return Hedging(estimates, rule)


def plan(
    hedging: Hedging, server: str = "s1", *, deadline_s: float = 2.8, is_busy: bool = False
) -> Hedge | None:
    return hedging.plan(Remote(server, deadline_s, ""), HEAVY, is_busy=is_busy)


def times_s(hedge: Hedge | None) -> tuple[float, float]:
    assert hedge is not None
    return hedge.after_s, hedge.deadline_s


def test_before_any_call_twice_the_offline_estimate_stands_in_for_the_quantile() -> None:
    new = hedging()
    new.called(HEAVY)
    assert times_s(plan(new)) == pytest.approx((1.4 + EXCEEDS_BY_S, 11.4 + EXCEEDS_BY_S))


def test_a_quantile_is_told_by_enough_delays() -> None:
    delays_s = [tenths / 10 for tenths in range(1, 19)]
    assert quantile_s(delays_s, 0.95, offline_s=0.7) == pytest.approx(3.6)  # 18 delays cannot tell a p95
    assert quantile_s([*delays_s, 1.9], 0.95, offline_s=0.7) == 1.9
    assert quantile_s(delays_s, 0.5, offline_s=0.7) == 1.0


def test_what_was_long_ago_is_forgotten() -> None:
    new = hedging(HedgeRule(after="p99"))
    new.called(HEAVY)
    for delay_s in (50.0, *[0.7] * 100):
        new.answered("s1", HEAVY, delay_s)
    assert times_s(plan(new))[0] == pytest.approx(0.7 + EXCEEDS_BY_S)


def test_each_server_has_delays_of_its_own() -> None:
    new = hedging()
    new.called(HEAVY)
    for _ in range(19):
        new.answered("s1", HEAVY, 0.8)
    assert times_s(plan(new)) == pytest.approx((0.8 + EXCEEDS_BY_S, 10.8 + EXCEEDS_BY_S))
    assert times_s(plan(new, "s2", deadline_s=8.0)) == pytest.approx(
        (4.0 + EXCEEDS_BY_S, 14.0 + EXCEEDS_BY_S)
    )


def test_the_drone_starts_at_the_ordinary_deadline_at_the_latest() -> None:
    new = hedging()
    new.called(HEAVY)
    assert plan(new, "s2", deadline_s=3.0) == Hedge(after_s=3.0, deadline_s=13.0)


def test_work_for_nothing_is_paid_for_by_later_calls() -> None:
    new = hedging(HedgeRule(budget=0.1))
    new.called(HEAVY)
    new.overtaken(Hedge(1.0, 11.0), Remote("s1", 2.8, ""), HEAVY, onboard_s=1.8)
    for _ in range(9):
        assert plan(new) is None
        new.called(HEAVY)
    assert plan(new) is None  # all of 10 s is used
    new.called(HEAVY)
    assert plan(new) is not None


def test_an_answer_after_the_ordinary_deadline_adds_no_work() -> None:
    new = hedging(HedgeRule(budget=0.1))
    new.called(HEAVY)
    new.overtaken(Hedge(1.0, 11.0), Remote("s1", 2.8, ""), HEAVY, onboard_s=1.9)
    assert plan(new) is not None


def test_no_call_is_hedged_without_a_budget_or_behind_a_loser_or_of_an_unknown_delay() -> None:
    new, off = hedging(), hedging(None)
    for each in (new, off):
        each.called(HEAVY)
    assert plan(off) is None
    assert plan(new, is_busy=True) is None
    assert new.plan(Remote("s1", 2.8, ""), Operation("detector", "other"), is_busy=False) is None
    assert plan(new) is not None
