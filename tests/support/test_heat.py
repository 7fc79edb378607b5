"""How the heat of calls adds up that are computed at the same time."""

from __future__ import annotations

import pytest

from upwash.support.heat import Heat, Surroundings

COOL = Surroundings(ambient_c=20.0, load_w=4.0)  # far from the temperature at which it gets slower
Call = tuple[float, float]  # when it begins, and how long it takes

BESIDE_EACH_OTHER: list[list[Call]] = [
    [(0.0, 5.0), (0.0, 5.0)],
    [(0.0, 4.0), (2.0, 6.0)],
    [(0.0, 10.0), (2.0, 2.0), (3.0, 8.0)],
    [(0.0, 2.0), (5.0, 2.0), (5.5, 1.0)],
]


def after(*calls: Call, at_s: float) -> Heat:
    """A computer after these calls."""
    heat = Heat(COOL)
    for begins_s, takes_s in calls:
        assert heat.work(takes_s, now_s=begins_s) == pytest.approx(takes_s)
    heat.rest(at_s)
    return heat


@pytest.mark.parametrize("calls", BESIDE_EACH_OTHER)
@pytest.mark.parametrize("in_order", [True, False])
def test_calls_beside_each_other_add_their_heat(calls: list[Call], in_order: bool) -> None:
    together = after(*(calls if in_order else reversed(calls)), at_s=12.0)
    alone = [after(call, at_s=12.0) for call in calls]
    assert together.temperature_c - COOL.ambient_c == pytest.approx(
        sum(each.temperature_c - COOL.ambient_c for each in alone)
    )
    assert together.burnt_j == pytest.approx(sum(each.burnt_j for each in alone))


def test_calls_beside_each_other_slow_down_what_comes_after_them() -> None:
    def next_s(calls_at_once: int) -> float:
        heat = Heat(Surroundings(ambient_c=45.0, load_w=4.0))
        for _ in range(calls_at_once):
            heat.work(10.0, now_s=0.0)
        return heat.work(10.0, now_s=20.0)

    assert next_s(2) > next_s(1) == 10.0
