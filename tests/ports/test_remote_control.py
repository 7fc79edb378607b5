"""Whether the pilot's sticks and switches have just moved, by what the vehicle reports of its remote control."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.real.mavlink.telemetry import RemoteControl

MIDDLE = [1500] * 18


def channels(values_us: list[int], *, count: int = 18) -> mavlink.MAVLink_message:
    return mavlink.MAVLink_rc_channels_message(0, count, *values_us, 255)


def moved(*reports: tuple[float, list[int]], now_s: float) -> bool | None:
    """What is known at the end of reports, each with its time."""
    remote = RemoteControl()
    for at_s, values_us in reports:
        remote.take(channels(values_us), at_s)
    return remote.moved(now_s)


def one(channel: int, value_us: int) -> list[int]:
    return [value_us if number == channel else other for number, other in enumerate(MIDDLE)]


@pytest.mark.parametrize("channel", [0, 17])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_stick_or_switch_has_moved_for_as_long_as_the_report_of_a_mode_may_take(
    channel: int, sign: int
) -> None:
    reports = (10.0, MIDDLE), (11.0, one(channel, 1500 + sign * 50))
    assert moved(*reports, now_s=11.0)
    assert moved(*reports, now_s=12.5)
    assert moved(*reports, now_s=12.6) is False


def test_noise_moves_nothing_and_adds_up_to_a_move() -> None:
    assert moved((10.0, MIDDLE), (11.0, one(0, 1549)), now_s=11.0) is False
    assert moved((10.0, MIDDLE), (11.0, one(0, 1530)), (12.0, one(0, 1560)), now_s=12.0)
    assert moved((10.0, MIDDLE), (11.0, one(0, 1560)), (14.0, one(0, 1590)), now_s=14.0) is False


@pytest.mark.parametrize("unused_us", [0, 0xFFFF])
def test_a_channel_that_comes_or_goes_is_no_move(unused_us: int) -> None:
    assert moved((10.0, MIDDLE), (11.0, one(3, unused_us)), now_s=11.0) is False
    assert moved((10.0, one(3, unused_us)), (11.0, MIDDLE), now_s=11.0) is False


def test_without_a_fresh_report_nothing_is_known() -> None:
    assert moved(now_s=1.0) is None
    assert moved((10.0, MIDDLE), now_s=10.0) is False
    assert moved((10.0, MIDDLE), now_s=12.0) is False
    assert moved((10.0, MIDDLE), now_s=12.1) is None


def test_a_vehicle_without_a_remote_control_tells_nothing_of_it() -> None:
    remote = RemoteControl()
    remote.take(channels(MIDDLE), 10.0)
    remote.take(channels(MIDDLE, count=0), 10.5)
    assert remote.moved(10.5) is None
