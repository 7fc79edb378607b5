"""When a failed server is asked and trusted again: the laws at the top of recovery.py."""

from __future__ import annotations

import math
from itertools import islice, pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from upwash.core.operation import Operation
from upwash.core.selection.recovery import Probing, Recovery, ServerFailures

LOOK, READ = Operation("detector", "look"), Operation("gauge", "read")


@given(st.floats(0.2, 60), st.floats(1, 5), st.floats(0, 10))
def test_pauses_begin_with_the_longer_of_the_two_and_grow_to_the_longest(
    first_s: float, times: float, alone_s: float
) -> None:
    probing = Probing(first_s, first_s * times)
    first, *rest = islice(probing.pauses_s(alone_s=alone_s), 50)
    assert first == max(first_s, alone_s)
    assert all(earlier <= later for earlier, later in pairwise(rest))
    assert rest[0] == first_s and rest[-1] == probing.longest_s


def test_pauses_between_probes_grow_by_a_quarter() -> None:
    assert list(islice(Probing(0.5, 1.0).pauses_s(), 6)) == [0.5, 0.5, 0.625, 0.78125, 0.9765625, 1.0]


def test_each_failure_leaves_a_server_alone_for_twice_as_long_up_to_ten_seconds() -> None:
    failures, now_s, alone_s = ServerFailures(), 0.0, []
    for _ in range(7):
        failures = failures.after(now_s)
        alone_s.append(failures.alone_s)
        now_s += failures.alone_s + 1.0
    assert alone_s == [0.0, 1.0, 2.0, 4.0, 8.0, 10.0, 10.0]


def test_failures_are_forgotten_after_a_minute_without_any() -> None:
    twice = ServerFailures().after(0.0).after(1.0)
    assert twice.after(62.0).count == 3
    assert twice.after(62.1).count == 1


def doubted() -> Recovery:
    recovery = Recovery(Probing())
    recovery.failed("s1", [LOOK, READ], now_s=100.0)
    return recovery


def test_every_operation_of_a_failed_server_is_in_doubt_until_one_is_answered_in_time() -> None:
    recovery = doubted()
    recovery.answered("s1", LOOK, 0.7, local_s=3.0, now_s=101.0)
    assert not recovery.in_doubt("s1", LOOK)
    assert recovery.in_doubt("s1", READ) and recovery.in_doubt("s1")
    assert not recovery.in_doubt("s2")


def test_one_trial_is_under_way_at_a_time_whatever_the_operation() -> None:
    recovery = doubted()
    assert recovery.trial_due_s("s1", LOOK) == 100.0
    recovery.trials.add("s1")
    assert recovery.trial_due_s("s1", READ) == math.inf
    recovery.trials.discard("s1")
    assert recovery.trial_due_s("s1", READ) == 100.0


def test_a_trial_is_over_when_it_is_answered_and_when_its_server_fails() -> None:
    recovery = doubted()
    recovery.trials.add("s1")
    recovery.failed("s1", [LOOK], now_s=101.0)
    assert recovery.trial_due_s("s1", READ) == 100.0
    recovery.trials.add("s1")
    recovery.answered("s1", LOOK, 0.7, local_s=3.0, now_s=102.0)
    assert recovery.trial_due_s("s1", READ) == 100.0
    assert recovery.trial_due_s("s1", LOOK) == -math.inf


def test_an_answer_as_late_as_the_drones_own_ends_no_doubt() -> None:
    recovery = doubted()
    recovery.answered("s1", LOOK, 3.0, local_s=3.0, now_s=101.0)
    assert recovery.in_doubt("s1", LOOK)


@pytest.mark.parametrize(("slow_for_s", "pause_s"), [(0.0, 0.0), (30.0, 1.0), (150.0, 5.0), (5000.0, 10.0)])
def test_who_has_been_slow_for_long_is_tried_less_often(slow_for_s: float, pause_s: float) -> None:
    recovery = doubted()
    recovery.answered("s1", LOOK, 5.6, local_s=3.0, now_s=100.0 + slow_for_s)
    assert recovery.trial_due_s("s1", LOOK) == pytest.approx(100.0 + slow_for_s + pause_s)


def test_what_does_not_count_leaves_a_server_alone_for_no_longer() -> None:
    recovery = doubted()
    for second in range(5):
        recovery.failed("s1", [LOOK], counts=False, now_s=101.0 + second)
    assert recovery.alone_s("s1", now_s=106.0) == 0.0
    recovery.failed("s1", [LOOK], now_s=107.0)
    assert recovery.alone_s("s1", now_s=107.5) == 0.5
