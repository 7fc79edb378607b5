"""The laws of core/admission/turns.py: who gets a slot next, and who yields one."""

from __future__ import annotations

from upwash.core.admission.clients import AccountStatus
from upwash.core.admission.turns import Turns


def order(turns: Turns, *, now_s: float) -> list[str]:
    return [each.drone for each in turns.waiting(now_s=now_s)]


def test_a_free_slot_is_for_who_has_had_least_then_for_who_waits_longest_then_by_name() -> None:
    turns = Turns(30.0)
    turns.took("holder", now_s=0.0)
    turns.asked("later", now_s=2.0)
    turns.gave_back("holder", now_s=10.0)
    turns.asked("late-b", now_s=4.0)
    turns.asked("late-a", now_s=4.0)
    turns.asked("holder", now_s=4.0)
    assert order(turns, now_s=4.0) == ["later", "late-a", "late-b", "holder"]
    assert turns.rank("late-b", now_s=4.0) == 2


def test_nobody_saves_up_by_staying_away() -> None:
    turns = Turns(30.0)
    turns.took("worker", now_s=0.0)
    turns.asked("newcomer", now_s=100.0)
    (account,) = turns.waiting(now_s=100.0)
    assert account.had_s == 100.0, "it counts as one that has had as much as the least of those present"


def test_nobody_loses_what_counts_against_it_by_going_and_coming_back() -> None:
    turns = Turns(30.0)
    turns.took("greedy", now_s=0.0)
    turns.took("modest", now_s=90.0)  # which starts at 90 s, too
    turns.gave_back("modest", now_s=95.0)
    turns.took("modest", now_s=150.0)  # of 150 s, as greedy has
    turns.gave_back("greedy", now_s=200.0)
    turns.asked("greedy", now_s=201.0)
    (account,) = turns.waiting(now_s=201.0)
    assert account.had_s == 201.0, "modest has had 201 s by now, and greedy no less"


def test_who_yields_and_does_not_know_yet_is_not_taken_to_have_stayed_away() -> None:
    for drone, expected_until_s, had_s in (("unaware", 30.0, 5.0), ("gone", 10.0, 13.0)):
        turns = Turns(5.0)
        turns.took(drone, now_s=0.0)
        turns.asked("other", now_s=0.0)
        turns.yields(drone, expected_until_s=expected_until_s)
        turns.gave_back(drone, now_s=5.0)
        turns.took("other", now_s=5.0)
        turns.asked(drone, now_s=18.0)
        (account,) = turns.waiting(now_s=18.0)
        assert account.had_s == had_s, drone


def test_a_holder_yields_after_a_turn_to_one_that_has_had_less_by_more_than_half_of_it() -> None:
    turns = Turns(30.0)
    turns.took("holder", now_s=0.0)
    for now_s in (0.0, 2.0, 4.0):
        turns.asked("waiter", now_s=now_s)
    assert turns.over("waiter", now_s=29.9) == [], "its turn is not over"
    assert turns.over("waiter", now_s=30.0) == ["holder"]


def test_a_holder_that_has_had_hardly_more_keeps_its_slot() -> None:
    turns = Turns(30.0)
    turns.took("first", now_s=0.0)
    turns.asked("second", now_s=0.0)
    turns.gave_back("first", now_s=31.0)
    turns.took("second", now_s=31.0)
    for now_s in (31.0, 33.0):
        turns.asked("first", now_s=now_s)
    assert turns.over("first", now_s=61.0) == [], "30 s against 31 s"
    assert turns.over("first", now_s=77.5) == ["second"]


def test_of_several_the_one_that_has_had_most_yields_first() -> None:
    turns = Turns(30.0)
    turns.took("more", now_s=0.0)
    turns.asked("less", now_s=0.0)
    turns.took("less", now_s=20.0)
    for now_s in (40.0, 42.0):
        turns.asked("waiter", now_s=now_s)
    assert turns.over("waiter", now_s=80.0) == ["more", "less"]


def test_nobody_yields_to_a_drone_that_has_asked_only_once() -> None:
    turns = Turns(30.0)
    turns.took("holder", now_s=0.0)
    turns.asked("passer-by", now_s=50.0)
    assert turns.over("passer-by", now_s=50.0) == []
    turns.asked("passer-by", now_s=52.0)
    assert turns.over("passer-by", now_s=52.0) == [], "it has had as much as the holder when it came"
    assert turns.over("passer-by", now_s=66.0) == ["holder"]


def test_who_misses_three_questions_waits_no_more_and_loses_its_place() -> None:
    turns = Turns(30.0)
    turns.took("holder", now_s=0.0)
    turns.asked("lost", now_s=0.0)
    turns.asked("other", now_s=2.0)
    turns.asked("other", now_s=6.0)
    assert order(turns, now_s=6.0) == ["lost", "other"]
    assert order(turns, now_s=6.1) == ["other"]
    turns.asked("lost", now_s=8.0)
    assert order(turns, now_s=8.0) == ["other", "lost"]


def test_an_account_tells_how_long_a_drone_holds_or_waits() -> None:
    turns = Turns(30.0)
    turns.took("d2", now_s=0.0)
    turns.asked("d1", now_s=5.0)
    assert turns.status(now_s=8.0) == [
        AccountStatus("d1", had_s=5.0, holds_s=None, waits_s=3.0),
        AccountStatus("d2", had_s=8.0, holds_s=8.0, waits_s=None),
    ]


def test_accounts_are_forgotten_once_nobody_is_there() -> None:
    turns = Turns(30.0)
    turns.took("d1", now_s=0.0)
    turns.gave_back("d1", now_s=50.0)
    turns.took("d2", now_s=60.0)
    turns.asked("d1", now_s=61.0)
    (account,) = turns.waiting(now_s=61.0)
    assert account.had_s == 1.0
