"""What servers promise of a deadline, and when the second one is asked."""

from __future__ import annotations

import math
import random

import pytest

from upwash.core.operation import Operation
from upwash.core.selection.deadlines import AnswerDeadline, Deadlines, Delays, prospect

LOOK = Operation("detector", "look")
OFTEN = [0.4] * 950 + [math.inf] * 49  # as told of a server that stalls in 5 % of its calls


def test_two_servers_promise_what_one_alone_does_not() -> None:
    alone = prospect(AnswerDeadline(1.5, 0.99, 0.1), Delays(OFTEN), None)
    assert 0.93 < alone.probability < 0.94 and alone.after_s is None  # of 95 % that were in time
    both = prospect(AnswerDeadline(1.5, 0.99, 0.1), Delays(OFTEN), Delays(OFTEN))
    assert both.probability == 0.99
    assert both.extra == pytest.approx(0.05)
    assert both.after_s == pytest.approx(1.05)  # as late as the second server allows


def test_one_server_that_keeps_the_deadline_is_asked_alone() -> None:
    assert prospect(AnswerDeadline(1.5, 0.9, 0.1), Delays(OFTEN), Delays(OFTEN)).after_s is None


def test_a_second_server_of_which_nothing_is_known_changes_nothing() -> None:
    alone = prospect(AnswerDeadline(1.5, 0.99, 0.1), Delays(OFTEN), None)
    assert prospect(AnswerDeadline(1.5, 0.99, 0.1), Delays(OFTEN), Delays()) == alone


def test_the_second_server_is_asked_later_than_the_probability_needs_if_its_share_is_bounded() -> None:
    times = [0.01 * number for number in range(1, 1000)]
    free = prospect(AnswerDeadline(5.0, 0.7, 1.0), Delays(times), Delays(times))
    assert free.probability == 0.7 and free.extra > 0.75
    bound = prospect(AnswerDeadline(5.0, 0.7, 0.6), Delays(times), Delays(times))
    assert bound.extra <= 0.6 and 0.48 < bound.probability < 0.6


def test_a_second_server_that_would_answer_too_late_gets_no_call() -> None:
    slow = [1.45] * 930 + [9.0] * 69  # so slow that only a share of 0.1 is spared for 0.05 s
    told = prospect(AnswerDeadline(1.5, 0.99, 0.1), Delays(slow), Delays([0.4] * 99))
    assert told.after_s is None and told.probability == pytest.approx(0.913, abs=0.003)


def test_a_second_server_whose_share_is_used_up_is_asked_and_not_counted() -> None:
    often = [0.4] * 850 + [math.inf] * 149
    told = prospect(AnswerDeadline(1.5, 0.9, 0.1), Delays(often), Delays(OFTEN))
    assert told.after_s == pytest.approx(1.05) and told.extra == 0.1
    assert 0.82 < told.probability < 0.83  # the first server's


@pytest.mark.parametrize(("probability", "servers"), [(0.9, 1), (0.99, 1), (0.99, 2), (0.999, 1), (0.999, 2)])
def test_a_probability_needs_that_many_delays_in_time(probability: float, servers: int) -> None:
    deadline = AnswerDeadline(1.5, probability, 0.1)
    needed = deadline.delays_needed(servers)
    assert (probability, servers) != (0.99, 1) or needed == 299

    def promised(known: int) -> float:
        second = Delays([0.4] * known) if servers > 1 else None
        return prospect(deadline, Delays([0.4] * known), second).probability

    assert promised(needed) >= probability > promised(needed - 1)


@pytest.mark.parametrize("in_time", [0.985, 0.93])
@pytest.mark.parametrize("count", [60, 400])
def test_no_more_than_one_promise_in_twenty_is_too_high(in_time: float, count: int) -> None:
    chance = random.Random(f"{in_time}/{count}")
    rate, deadline = -math.log(1 - in_time) / 1.5, AnswerDeadline(1.5, 0.99, 0.2)

    def share_by(at_s: float) -> float:
        return 1 - math.exp(-rate * at_s)

    def drawn() -> Delays:
        return Delays([chance.expovariate(rate) for _ in range(count)])

    high = {"one": 0, "two": 0}
    for _ in range(300):
        high["one"] += prospect(deadline, drawn(), None).probability > in_time
        plan, true = prospect(deadline, drawn(), drawn()), in_time
        if plan.after_s is not None:
            helped = min(1.0, deadline.extra / (1 - share_by(plan.after_s)))
            true = 1 - (1 - in_time) * (1 - helped * share_by(deadline.within_s - plan.after_s))
        high["two"] += plan.probability > true
    assert all(count <= 0.05 * 300 + 8 for count in high.values())  # two deviations above


@pytest.mark.parametrize("seed", range(20))
def test_what_happens_is_at_least_what_is_promised(seed: int) -> None:
    chance = random.Random(seed)

    def times() -> list[float]:
        stalls = chance.choice((0.01, 0.05, 0.2))
        return [
            chance.uniform(0.2, 1.0) if chance.random() > stalls else chance.uniform(2.0, 9.0)
            for _ in range(1000)
        ]

    first, second = times(), times()
    deadline = AnswerDeadline(
        chance.uniform(1.2, 2.5), chance.choice((0.9, 0.99, 0.999)), chance.choice((0.1, 1.0))
    )
    plan = prospect(deadline, Delays(first), Delays(second))
    after_s = math.inf if plan.after_s is None else plan.after_s
    in_time = asked = 0
    for calls in range(20_000):
        one_s, other_s = chance.choice(first), chance.choice(second)
        asks = one_s > after_s and asked < deadline.extra * calls
        asked += asks
        in_time += min(one_s, after_s + other_s if asks else math.inf) <= deadline.within_s
    assert in_time / 20_000 > plan.probability - 0.006
    assert asked / 20_000 == pytest.approx(plan.extra, abs=0.01)
    assert plan.extra <= deadline.extra + 0.001


def test_few_delays_promise_little_and_the_oldest_are_forgotten() -> None:
    delays = Delays([0.5] * 9)
    assert delays.share_by(1.0) == 0.9
    assert delays.least_share_by(1.0, 0.05) == pytest.approx(0.05 ** (1 / 9))
    for _ in range(3000):
        delays.add(2.0)
    assert (delays.known, delays.share_by(1.0)) == (3000, 0.0)


def test_a_second_server_gets_one_call_and_the_allowed_share() -> None:
    deadlines = Deadlines({LOOK: AnswerDeadline(1.5, 0.99, 0.1)})
    asked = 0
    for _ in range(100):
        deadlines.called(LOOK)
        if deadlines.may_ask(LOOK):
            deadlines.asked(LOOK)
            asked += 1
    assert asked == 11


def test_delays_of_the_flight_count_and_calls_without_an_answer_too() -> None:
    deadlines = Deadlines({LOOK: AnswerDeadline(1.5, 0.5, 1.0)}, {("s1", LOOK): [0.4] * 3})
    told = deadlines.prospect(LOOK, "s1", "s2")
    assert told is not None and told.probability == pytest.approx(0.05 ** (1 / 3)) and told.after_s is None
    for _ in range(6):
        deadlines.answered("s1", LOOK, math.inf)
        deadlines.answered("s2", LOOK, 1.0)
    told = deadlines.prospect(LOOK, "s1", "s2")
    assert told is not None and told.after_s == pytest.approx(0.45)
    assert deadlines.prospect(Operation("other", "look"), "s1", "s2") is None
