"""An allowance is what it says in the long run, and no more at once."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from upwash.core.admission.limits import Allowance


def test_an_allowance_is_spent_at_once_and_comes_back_with_time() -> None:
    allowance = Allowance(2.0, at_once=3.0)
    assert [allowance.take(1, now_s=10.0) for _ in range(4)] == [True, True, True, False]
    assert allowance.take(1, now_s=10.5)
    assert not allowance.take(1, now_s=10.9)
    assert [allowance.take(1, now_s=1000.0) for _ in range(4)] == [True, True, True, False]


def test_who_takes_on_credit_is_told_how_long_to_wait() -> None:
    allowance = Allowance(2.0, at_once=3.0)
    assert allowance.take_anyway_s(3, now_s=0.0) == 0.0
    assert allowance.take_anyway_s(4, now_s=0.0) == 2.0
    assert allowance.take_anyway_s(0, now_s=2.0) == 0.0


def test_what_is_more_than_there_ever_is_costs_nothing() -> None:
    allowance = Allowance(1.0, at_once=2.0)
    assert not allowance.take(3, now_s=100.0)
    assert allowance.take(2, now_s=100.0)


@given(st.lists(st.tuples(st.floats(0, 10), st.integers(1, 5)), max_size=50))
def test_in_any_time_no_more_is_taken_than_at_once_and_what_came_in(asked: list[tuple[float, int]]) -> None:
    allowance, now_s, taken = Allowance(3.0, at_once=7.0), 0.0, 0
    for later_s, count in asked:
        now_s += later_s
        taken += count if allowance.take(count, now_s=now_s) else 0
        assert taken <= 7.0 + 3.0 * now_s + 1e-6
