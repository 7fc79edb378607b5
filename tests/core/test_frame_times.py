"""When the frames of a stream were captured: frames that a stall kept back are old."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import accumulate

import pytest

from upwash.core.camera.frame_times import FrameTimes

PERIOD_S = 0.05


def late_s(arrivals_s: Iterable[float]) -> list[float]:
    """How long before its arrival each frame was captured."""
    times = FrameTimes()
    return [at_s - times.captured_s(at_s) for at_s in arrivals_s]


def steady(frames: int, period_s: float = PERIOD_S, begin_s: float = 0.0) -> list[float]:
    return [begin_s + period_s * frame for frame in range(frames)]


def test_frames_of_a_steady_stream_are_new_however_slow_or_uneven() -> None:
    assert set(late_s(steady(50))) == set(late_s(steady(50, 4.0))) == {0.0}
    assert set(late_s(accumulate([0.02, 0.09, 0.05, 0.2, 0.001] * 20))) == {0.0}


@pytest.mark.parametrize("stall_s", [0.6, 3.4, 8.0])
@pytest.mark.parametrize("decoding_s", [0.001, 0.01, 0.03])
def test_each_frame_that_a_stall_kept_back_has_its_own_time(stall_s: float, decoding_s: float) -> None:
    captured = steady(700)
    arrivals, free_s = [], 0.0
    for at_s in captured:
        held_s = 5.0 + stall_s if 5.0 < at_s < 5.0 + stall_s else at_s
        free_s = max(held_s, free_s + decoding_s)
        arrivals.append(free_s)
    times = FrameTimes()
    estimates = [times.captured_s(at_s) for at_s in arrivals]
    for captured_s, estimate_s, arrival_s in zip(captured, estimates, arrivals, strict=True):
        assert estimate_s <= captured_s + PERIOD_S  # nothing passes for newer than it is
        assert estimate_s <= arrival_s
    assert estimates[-50:] == arrivals[-50:]


def test_after_a_stall_that_lost_its_frames_the_second_frame_is_new() -> None:
    late = late_s([*steady(40), *steady(40, begin_s=10.0)])
    assert late[:40] == [0.0] * 40
    assert late[40] > 7
    assert late[41:] == [0.0] * 39


@pytest.mark.parametrize(("before_s", "after_s"), [(0.03, 1.0), (1.0, 0.03), (0.03, 0.2), (0.2, 0.03)])
def test_a_camera_that_changes_its_rate_soon_gives_new_frames(before_s: float, after_s: float) -> None:
    late = late_s([*steady(20, before_s), *steady(60, after_s, begin_s=20 * before_s + 3.0)])
    assert late[-30:] == [0.0] * 30


def test_a_stream_that_always_sends_ten_frames_at_once_is_not_starved() -> None:
    late = late_s(accumulate([0.4, 0.001, 0.003, 0.001, 0.002, 0.001, 0.001, 0.004, 0.001, 0.001] * 10))
    assert all(late[at + 9] == 0.0 for at in range(10, 100, 10))


def test_a_stall_within_a_burst_does_not_make_old_frames_new() -> None:
    arrivals = [*steady(40), 5.0, 5.001, 8.0, 8.001, 8.002]
    assert all(late > 2 for late in late_s(arrivals)[40:])


@pytest.mark.parametrize("clock_off", [0.8, 1.0, 1.25])
def test_a_frame_that_waited_in_a_buffer_is_as_old_as_the_streams_times_say(clock_off: float) -> None:
    """The reader is away for 2 s and then reads as fast as it can; before, it waits for each frame."""
    times, stamps = FrameTimes(), [clock_off * captured_s for captured_s in steady(200)]
    free_s, ages = 0.0, []
    for captured_s, stamp_s in zip(steady(200), stamps, strict=True):
        arrived_s = max(captured_s, free_s + 0.002)
        waited_s = arrived_s - free_s
        told_s = times.captured_s(arrived_s, waited_s=waited_s, stamp_s=1.0 + stamp_s)
        ages.append((arrived_s - captured_s, arrived_s - told_s))
        free_s = arrived_s + (2.0 if captured_s == 5.0 else 0.001)
    oldest_s = max(true_s for true_s, _ in ages)
    assert oldest_s > 1.9
    assert all(told_s == pytest.approx(true_s, abs=0.03 + 0.25 * oldest_s) for true_s, told_s in ages)
    assert ages[-1] == pytest.approx((0.0, 0.0), abs=1e-6)


def test_frames_that_came_while_the_stream_was_opened_are_known_for_what_they_are() -> None:
    times, stamps = FrameTimes(), steady(40, 0.04)
    caught_up = []
    at_s = 1.3  # when FFmpeg has studied the stream, which goes on meanwhile
    for stamp_s in stamps:
        waited_s = max(0.005, stamp_s - at_s)
        at_s += waited_s
        times.captured_s(at_s, waited_s=waited_s, stamp_s=stamp_s)
        caught_up.append(times.caught_up)
    first = caught_up.index(True)
    assert stamps[first] > 1.3 and all(caught_up[first:])


def test_a_stream_without_times_is_new_from_its_second_frame_on() -> None:
    times = FrameTimes()
    caught_up = []
    for at_s in steady(3):
        times.captured_s(at_s, waited_s=0.0)
        caught_up.append(times.caught_up)
    assert caught_up == [False, True, True]
