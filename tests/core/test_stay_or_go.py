"""Whether a drone waits for an answer or flies on."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from upwash.core.planning.legs import Leg
from upwash.core.planning.stay_or_go import Outlook, StayRule

LEG = Leg(20.0, 4.0, 1.0)  # 9 s
delays_s = st.floats(0.01, 60.0)


def outlook(delay_s: float, *, leg: Leg = LEG, photo_s: float = 1.0, go_s: float | None = None) -> Outlook:
    return Outlook(leg, photo_s, delay_s, delay_s if go_s is None else go_s)


def learnt(demands: int, answers: int) -> StayRule:
    rule = StayRule("learn")
    for number in range(answers):
        rule.answered(1.0, demanded=number < demands)
    return rule


def threshold(each: Outlook) -> float:
    """The chance at which staying and going come to the same."""
    return each.saved_s / (each.saved_s + each.lost_s)


@pytest.mark.parametrize(
    ("delay_s", "chance"),
    [(0.7, 0.25), (3.0, 0.25), (7.7, 0.43), (10.0, 0.53)],  # as a model of the question has them
)
def test_the_chance_up_to_which_going_pays_for_legs_of_20_m(delay_s: float, chance: float) -> None:
    assert threshold(outlook(delay_s, photo_s=0.0)) == pytest.approx(chance, abs=0.06)


def test_while_it_speeds_up_turning_back_costs_three_times_the_delay() -> None:
    each = outlook(3.0)
    assert each.saved_s == 3.0
    assert each.lost_s == pytest.approx(9.0)


def test_what_the_leg_and_the_photo_do_not_hide_is_waited_for() -> None:
    each = outlook(12.0)
    assert each.saved_s == pytest.approx(10.0)
    assert each.lost_s == pytest.approx(8.0), "a leg back, and the next photo is taken"


def test_a_call_that_loses_its_server_on_the_way_is_no_reason_to_go() -> None:
    assert StayRule("learn").decide(outlook(0.7, go_s=30.0)).goes is False
    assert outlook(0.7, go_s=30.0).saved_s < 0


@pytest.mark.parametrize(("demands", "answers", "goes"), [(0, 0, True), (0, 40, True), (20, 40, False)])
def test_it_learns_from_answers(demands: int, answers: int, goes: bool) -> None:
    assert learnt(demands, answers).decide(outlook(8.0)).goes is goes


@pytest.mark.parametrize(
    ("delay_s", "goes", "why"),
    [
        (3.0, False, "going costs 0.00 s on average"),  # 3 of 4 times it saves 3 s, and else it loses 9 s
        (8.0, True, "going gains 3.50 s on average"),
    ],
)
def test_it_goes_only_if_that_gains(delay_s: float, goes: bool, why: str) -> None:
    verdict = StayRule("learn").decide(outlook(delay_s))
    assert (verdict.goes, verdict.why) == (goes, why)


def test_what_was_long_ago_is_forgotten() -> None:
    rule = learnt(40, 40)
    for _ in range(40):
        rule.answered(1.0, demanded=False)
    assert rule.chance == pytest.approx(1 / 44)


def test_the_last_waypoint_stays_and_so_does_who_is_told_to() -> None:
    assert not StayRule("go").decide(None).goes
    assert not StayRule("stay").decide(outlook(10.0)).goes
    assert StayRule("go").decide(outlook(10.0)).goes


@given(delay_s=delays_s, photo_s=st.floats(0.0, 3.0), length_m=st.floats(1.0, 200.0))
def test_going_never_saves_more_than_the_delay_and_turning_back_never_gains(
    delay_s: float, photo_s: float, length_m: float
) -> None:
    each = outlook(delay_s, leg=Leg(length_m, 4.0, 1.0), photo_s=photo_s)
    assert 0 <= each.saved_s <= delay_s
    assert each.lost_s >= -photo_s - 1e-6


@given(delay_s=delays_s, demands=st.integers(0, 39))
def test_more_demands_never_make_it_go(delay_s: float, demands: int) -> None:
    fewer, more = (learnt(each, 40).decide(outlook(delay_s)).goes for each in (demands, demands + 1))
    assert fewer or not more
