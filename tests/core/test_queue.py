"""The queue of an instance: what a new call has before it, and which calls may wait."""

from __future__ import annotations

import math
import random

import pytest

from upwash.core.admission.queue import CallQueue
from upwash.errors import NotBegun


def after(*took_s: float, lanes: int = 1) -> CallQueue:
    """A queue at second 0, whose latest calls took as long."""
    queue = CallQueue(lanes)
    for each_s in took_s:
        call = queue.arrive(None, now_s=-each_s)
        queue.begin(call, now_s=-each_s)
        queue.end(call, now_s=0.0)
    return queue


def begun(queue: CallQueue, now_s: float) -> int:
    call = queue.arrive(None, now_s=now_s)
    queue.begin(call, now_s=now_s)
    return call


def test_the_calls_before_a_new_one_count_as_the_latest_calls_took() -> None:
    queue = after(2.0, 3.0, 4.0)
    assert queue.ahead_s(now_s=0.0) == 0.0
    begun(queue, 0.0)
    assert queue.ahead_s(now_s=1.0) == pytest.approx(2.0)
    for waiting in range(1, 4):
        queue.arrive(None, now_s=1.0)
        assert queue.ahead_s(now_s=1.0) == pytest.approx(2.0 + 3.0 * waiting)


def test_a_free_lane_is_no_queue_and_the_next_to_be_free_counts() -> None:
    queue = after(3.0, lanes=2)
    begun(queue, 0.0)
    assert queue.ahead_s(now_s=1.0) == 0.0
    begun(queue, 1.0)
    assert queue.ahead_s(now_s=1.0) == 2.0
    queue.arrive(None, now_s=1.0)
    assert queue.ahead_s(now_s=1.0) == 3.0
    queue.arrive(None, now_s=1.0)
    assert queue.ahead_s(now_s=1.0) == 5.0


def test_a_call_that_takes_longer_than_usual_may_take_as_much_longer_again() -> None:
    queue = after(3.0)
    begun(queue, 0.0)
    assert [queue.ahead_s(now_s=now_s) for now_s in (2.0, 3.0, 5.0, 33.0)] == [1.0, 0.0, 2.0, 30.0]


def test_nothing_is_said_before_a_call_has_shown_how_long_calls_take() -> None:
    queue = CallQueue(1)
    begun(queue, 0.0)
    queue.arrive(0.0, now_s=5.0)
    assert queue.ahead_s(now_s=5.0) == 0.0


def test_a_call_that_would_wait_for_too_long_is_not_taken() -> None:
    queue = after(3.0)
    begun(queue, 0.0)
    with pytest.raises(NotBegun, match=r"2\.0 s of calls") as told:
        queue.arrive(1.9, now_s=1.0)
    assert told.value.queue_s == 2.0
    assert queue.ahead_s(now_s=1.0) == 2.0
    queue.arrive(2.0, now_s=1.0)
    queue.arrive(None, now_s=1.0)
    assert queue.ahead_s(now_s=1.0) == 8.0


def test_who_gives_up_leaves_the_queue_and_shows_nothing_of_how_long_calls_take() -> None:
    queue = after(3.0)
    first, second = begun(queue, 0.0), queue.arrive(None, now_s=0.0)
    queue.leave(second)
    assert queue.ahead_s(now_s=1.0) == 2.0
    queue.leave(first)
    queue.leave(first)
    assert queue.ahead_s(now_s=1.0) == 0.0
    begun(queue, 1.0)
    assert queue.ahead_s(now_s=1.0) == 3.0


@pytest.mark.parametrize("seed", range(20))
def test_calls_that_take_equally_long_begin_when_the_queue_said(seed: int) -> None:
    chance = random.Random(seed)
    lanes, call_s = chance.randint(1, 3), chance.uniform(0.5, 4.0)
    queue, free_s, now_s = after(call_s, lanes=lanes), [0.0] * lanes, 0.0
    due: list[tuple[float, float, int]] = []  # begins and ends
    for _ in range(30):
        now_s += chance.uniform(0.0, 2.0) * call_s / lanes
        for begins_s, ends_s, call in sorted(due):
            if begins_s <= now_s:
                queue.begin(call, now_s=begins_s)
            if ends_s <= now_s:
                queue.end(call, now_s=ends_s)
        due = [each for each in due if each[1] > now_s]
        begins_s = max(now_s, min(free_s))
        assert queue.ahead_s(now_s=now_s) == pytest.approx(begins_s - now_s, abs=1e-9)
        free_s[free_s.index(min(free_s))] = begins_s + call_s
        due.append((begins_s, begins_s + call_s, queue.arrive(math.inf, now_s=now_s)))
