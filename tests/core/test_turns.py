"""The laws of core/admission/turns.py: who gets a slot next, and who yields one."""

from __future__ import annotations

from upwash.core.admission.admission import AdmissionController, AdmissionSettings, Available
from upwash.core.admission.clients import AccountStatus, Client
from upwash.core.admission.leases import Admit
from upwash.core.admission.server import Command, Denied, ServerOffer
from upwash.core.admission.turns import Turns
from upwash.core.admission.usage import LeaseEnded


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
    turns.took("holder", now_s=100.0)
    for now_s in (100.0, 102.0, 104.0):
        turns.asked("waiter", now_s=now_s)
    assert turns.over("waiter", now_s=129.9) == [], "its turn is not over"
    assert turns.over("waiter", now_s=130.0) == ["holder"]


def test_a_holder_that_has_had_hardly_more_keeps_its_slot() -> None:
    turns = Turns(30.0)
    turns.took("first", now_s=0.0)
    turns.asked("second", now_s=0.0)
    turns.gave_back("first", now_s=31.0)
    turns.took("second", now_s=31.0)
    for now_s in (31.0, 33.0):
        turns.asked("first", now_s=now_s)
    assert turns.over("first", now_s=61.0) == [], "30 s against 31 s"
    assert turns.over("first", now_s=77.0) == [], "46 s against 31 s: half a turn more"
    assert turns.over("first", now_s=77.1) == ["second"]


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


def test_accounts_are_forgotten_once_the_last_one_waits_no_more() -> None:
    turns = Turns(30.0)
    turns.took("d1", now_s=0.0)
    turns.asked("d2", now_s=49.0)
    turns.gave_back("d1", now_s=50.0)
    turns.asked("d1", now_s=60.0)
    (account,) = turns.waiting(now_s=60.0)
    assert (account.drone, account.had_s) == ("d1", 0.0)


def test_accounts_are_forgotten_once_nobody_is_there() -> None:
    turns = Turns(30.0)
    turns.took("d1", now_s=0.0)
    turns.gave_back("d1", now_s=50.0)
    turns.took("d2", now_s=60.0)
    turns.asked("d1", now_s=61.0)
    (account,) = turns.waiting(now_s=61.0)
    assert account.had_s == 1.0


# --- a server -----------------------------------------------------------------------------------------------


class Crowded:
    """A daemon's server without services, and drones that ask for its slots."""

    def __init__(self, *holders: str, turn_s: float = 30.0, lease_s: float = 1000.0) -> None:
        self.turn_s = turn_s
        settings = AdmissionSettings(lease_s=lease_s)
        self.core = AdmissionController({"s1": self.offer(len(holders))}, settings)
        for drone in holders:
            self.ask(drone, 0.0)

    def offer(self, slots: int) -> ServerOffer:
        return ServerOffer(frozenset(), slots, self.turn_s)

    def ask(self, drone: str, now_s: float) -> tuple[bool, list[Command]]:
        answer, commands = self.core.availability("s1", [], Client(drone), now_s=now_s)
        return isinstance(answer, Available), commands

    def keep_asking(self, *drones: str, until_s: float) -> None:
        """Has the drones wait since 0 s."""
        for now_s in range(0, int(until_s) + 1, 5):
            for drone in drones:
                assert not self.ask(drone, float(now_s))[0]

    def accounts(self, now_s: float) -> list[str]:
        return [account.drone for account in self.core.servers(now_s=now_s)[0].accounts]

    @property
    def holders(self) -> frozenset[str]:
        return self.core.leases("s1")


def test_a_turn_that_is_over_gives_the_slot_away_and_leaves_ten_seconds_for_calls_under_way() -> None:
    crowded = Crowded("d1")
    crowded.keep_asking("d2", until_s=29.0)
    assert crowded.ask("d2", 30.0) == (
        True,
        [
            LeaseEnded("s1", "d1", 30.0, calls=0, computed_s=0.0),
            Admit("s1", frozenset(), finishing=frozenset({"d1"})),
            Admit("s1", frozenset({"d2"}), finishing=frozenset({"d1"})),
        ],
    )
    assert crowded.core.servers(now_s=30.0)[0].turns_ended == 1
    assert crowded.core.next_end_s(now_s=30.0) == 40.0
    assert crowded.core.look(now_s=39.9) == []
    assert crowded.core.look(now_s=40.0) == [Admit("s1", frozenset({"d2"}))]


def test_of_two_that_wait_the_second_ends_no_turn_and_takes_no_slot_of_the_first() -> None:
    crowded = Crowded("d1")
    crowded.keep_asking("d2", "d3", until_s=29.0)
    assert crowded.ask("d3", 30.0) == (False, [])
    assert crowded.ask("d2", 30.0)[0]
    crowded.core.leave("s1", Client("d2"), now_s=31.0)
    crowded.ask("d1", 31.0)
    assert not crowded.ask("d1", 32.0)[0], "it has had more than d3, for which the slot is"
    assert crowded.ask("d3", 33.0)[0]


def test_where_a_reload_took_slots_away_a_turn_that_ends_may_still_make_no_room() -> None:
    crowded = Crowded("d1", "d2")
    crowded.core.offer({"s1": crowded.offer(1)}, outdated=frozenset())
    crowded.keep_asking("d3", until_s=29.0)
    assert not crowded.ask("d3", 30.0)[0]
    assert len(crowded.holders) == 1
    assert crowded.ask("d3", 31.0)[0]
    assert crowded.holders == {"d3"}


def test_a_drone_whose_turn_ended_counts_as_present_until_its_lease_would_have_ended() -> None:
    for asks_s, had_s in ((20.0, 6.0), (30.0, 6.0), (31.0, 25.0)):
        crowded = Crowded("d1", turn_s=5.0, lease_s=30.0)
        crowded.keep_asking("d2", until_s=4.0)
        assert crowded.ask("d2", 6.0)[0]
        crowded.ask("d2", 19.0)
        crowded.ask("d1", asks_s)
        (account, _) = crowded.core.servers(now_s=asks_s)[0].accounts
        assert (account.drone, account.had_s) == ("d1", had_s)


def test_a_drone_that_leaves_gives_back_its_slot_or_its_place_in_the_queue() -> None:
    crowded = Crowded("d1")
    crowded.ask("d2", 1.0)
    assert crowded.accounts(1.0) == ["d1", "d2"]
    crowded.core.leave("s1", Client("d2"), now_s=2.0)
    assert crowded.accounts(2.0) == ["d1"]
    crowded.core.leave("s1", Client("d1"), now_s=3.0)
    assert crowded.accounts(3.0) == []


def test_a_denial_is_news_once_for_each_wait() -> None:
    crowded = Crowded("d1")
    answers = [crowded.core.availability("s1", [], Client("d2"), now_s=now_s)[0] for now_s in (0.0, 2.0, 9.0)]
    assert [isinstance(answer, Denied) and answer.is_news for answer in answers] == [True, False, True]
    assert crowded.core.refused_times["s1"] == 2
