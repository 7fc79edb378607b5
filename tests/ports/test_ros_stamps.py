"""The stamps of images of ROS 2, without ROS: an age, or the time of another clock."""

from __future__ import annotations

from datetime import UTC, datetime
from types import SimpleNamespace

import pytest

from upwash.ros.topics import age_s, other_clock

NOW_S = 1_900_000_000


@pytest.mark.parametrize(
    ("stamp_s", "age", "is_apart"),
    [
        (NOW_S - 5, 5.0, False),
        (NOW_S - 6, 0.0, True),
        (NOW_S + 4, 0.0, False),
        (NOW_S + 6, 0.0, True),
        (0, 0.0, True),
    ],
)
def test_a_stamp_more_than_five_seconds_off_is_of_another_clock(
    stamp_s: int, age: float, is_apart: bool
) -> None:
    now = SimpleNamespace(nanoseconds=NOW_S * 10**9)
    node = SimpleNamespace(get_clock=lambda: SimpleNamespace(now=lambda: now))
    image = SimpleNamespace(header=SimpleNamespace(stamp=SimpleNamespace(sec=stamp_s, nanosec=0)))
    assert age_s(node, image) == age
    apart = other_clock(NOW_S, stamp_s)
    assert (apart is not None) is is_apart
    assert apart is None or apart.camera == datetime.fromtimestamp(stamp_s, UTC)
