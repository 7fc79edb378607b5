"""What differs between the firmwares before any verb: how modes are called, and when a fail-safe chose one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from upwash.mavlink.version import Version
from upwash.real.mavlink.hearing import Message
from upwash.real.mavlink.ranges import RANGES, Ranges
from upwash.real.mavlink.telemetry import Telemetry


def _nothing_more(_telemetry: Telemetry, _message: Message, _now_s: float) -> None:
    """It reports nothing of its own."""


@dataclass(frozen=True, slots=True)
class Firmware:
    """One kind of autopilot, as a heartbeat tells it.

    `mode_name` names a custom mode, `own_mode` is the one in which the program steers. `failsafe` says why a
    fail-safe may have chosen the mode of that name, or nothing. `streams_hz` are the reports that the driver needs,
    by message; `sent_at_times` are those of them that the vehicle sends only while it has something to tell.
    `always_has` is the name of a parameter that all its versions have. `oldest` is the oldest version that can be
    flown, as upwash `needs` what older ones lack. `ranges` are those of the numbers that the driver uses. `take` has
    the telemetry remember what only this firmware reports, at that time.
    """

    name: str
    autopilot: int  # MAV_AUTOPILOT
    own_mode: str
    mode_name: Callable[[int], str]
    failsafe: Callable[[Telemetry, str], str]
    streams_hz: Mapping[int, float]
    always_has: str
    oldest: Version
    needs: str
    ranges: Ranges = field(default_factory=lambda: RANGES)
    keeps_targets: bool = False  # in `own_mode` it reports the last target that it was sent to
    sent_at_times: frozenset[int] = frozenset()
    take: Callable[[Telemetry, Message, float], None] = _nothing_more
    sends_parameters_as_bytes: bool = False  # an integer's bytes lie in the float that carries a parameter
