"""How an ArduCopter comes up: what it says, what it knows and why it cannot be armed, by the time since boot.

The times are those of a real ArduCopter (SITL, version 4.7), which estimates its position after 41.4 s. For a
stand-in that is ready sooner all steps are faster; a later one only waits longer for its position.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

RECORDED_S = 41.4
CRITICAL, WARNING, NOTICE, INFORMATION = 2, 4, 5, 6  # MAV_SEVERITY

_UP_S = 3.0
_ESTIMATES_S, _ALIGNED_S = 4.4, 5.8
_RECEIVER_S, _FIX_S = 9.6, 10.2
_GYROS_SETTLING_S, _SENSORS_SETTLED_S = 13.35, 23.4
_PLACED_S = 20.0
_READIES_S = 41.3  # nothing happens from here on until it is ready
_FIRST_COMPLAINT_S, _COMPLAINS_EVERY_S = 30.4, 31.0

EKF_UNINITIALISED = 1024
EKF_SETTLING = 0
EKF_HOLDS_STILL = 167  # attitude, velocity and height: it assumes that it stands still
EKF_FLIES_BY_GPS = 831


@dataclass(frozen=True, slots=True)
class Text:
    """A text of the vehicle and its MAV_SEVERITY."""

    words: str
    severity: int = CRITICAL


_T = TypeVar("_T")


class RecordedStory(Generic[_T]):
    """What happens at recorded times after its beginning."""

    def __init__(self, parts: Sequence[tuple[float, _T]]) -> None:
        self._parts = parts
        self.begin()

    def begin(self) -> None:
        """Starts the story again from its beginning."""
        self.told_s = -1.0

    def next(self, elapsed_s: float) -> list[_T]:
        """The parts that became due since the last call; each is returned once."""
        told_s, self.told_s = self.told_s, elapsed_s
        return [part for at_s, part in self._parts if told_s < at_s <= elapsed_s]


_TEXTS = tuple(
    (at_s, Text(words, INFORMATION))
    for at_s, words in (
        (0.0, "Barometer 1 calibration complete"),
        (0.0, "Barometer 2 calibration complete"),
        (0.0, "ArduPilot Ready"),
        (0.0, "AHRS: DCM active"),
        (2.6, "RC7: SaveWaypoint LOW"),
        (_ESTIMATES_S, "EKF3 IMU0 initialised"),
        (_ESTIMATES_S, "EKF3 IMU1 initialised"),
        (_ESTIMATES_S, "AHRS: EKF3 active"),
        (5.6, "EKF3 IMU0 tilt alignment complete"),
        (5.6, "EKF3 IMU1 tilt alignment complete"),
        (_ALIGNED_S, "EKF3 IMU0 MAG0 initial yaw alignment complete"),
        (_ALIGNED_S, "EKF3 IMU1 MAG0 initial yaw alignment complete"),
        (9.6, "GPS 1: probing for u-blox at 230400 baud"),
        (9.8, "GPS 1: detected u-blox"),
    )
)
_TEXTS_BY_GPS = tuple(
    (at_s, Text(words, INFORMATION))
    for at_s, words in (
        (_PLACED_S, "EKF3 IMU0 origin set"),
        (_PLACED_S, "Field Elevation Set: 0m"),
        (_PLACED_S, "EKF3 IMU1 origin set"),
        (RECORDED_S, "EKF3 IMU0 is using GPS"),
        (RECORDED_S + 0.2, "EKF3 IMU1 is using GPS"),
    )
)


class Boot:
    """One start, ready after `ready_s`; it waits for GPS where that is missing."""

    def __init__(self, ready_s: float) -> None:
        self._ready_s = ready_s
        self._share = min(1.0, ready_s / RECORDED_S)
        self._without_gps_s = 0.0
        self._looked_s = 0.0
        self._said, self._said_by_gps = RecordedStory(_TEXTS), RecordedStory(_TEXTS_BY_GPS)
        self._complains_s = self._scaled(_FIRST_COMPLAINT_S)

    def look(self, uptime_s: float, *, gps: bool) -> None:
        """Notes whether there is GPS now; all steps that need GPS are delayed by the time without it."""
        begins_s = max(self._looked_s, self._scaled(_FIX_S))
        if not gps and not self.places(self._looked_s) and uptime_s > begins_s:
            self._without_gps_s += uptime_s - begins_s
        self._looked_s = uptime_s

    def is_up(self, uptime_s: float) -> bool:
        """Whether the vehicle runs its checks before arming."""
        return uptime_s >= self._scaled(_UP_S)

    def hears_satellites(self, uptime_s: float) -> bool:
        """Whether its receiver has had the time for a fix."""
        return uptime_s >= self._scaled(_FIX_S)

    def places(self, uptime_s: float) -> bool:
        """Whether it has an origin to tell positions from."""
        return uptime_s - self._without_gps_s >= self._scaled(_PLACED_S)

    def estimates(self, uptime_s: float) -> bool:
        """Whether its position estimate is good enough to fly by."""
        return uptime_s - self._without_gps_s >= self._ready_s

    def ekf_flags(self, uptime_s: float) -> int:
        """The sources of the position estimate, as the flags of EKF_STATUS_REPORT."""
        if self.estimates(uptime_s):
            return EKF_FLIES_BY_GPS
        if uptime_s >= self._scaled(_ALIGNED_S):
            return EKF_HOLDS_STILL
        return EKF_SETTLING if uptime_s >= self._scaled(_ESTIMATES_S) else EKF_UNINITIALISED

    def texts(self, uptime_s: float) -> tuple[Text, ...]:
        """The texts that became due since the last call; each is returned once."""
        by_gps_s = uptime_s - self._without_gps_s
        said = self._said.next(self._recorded_s(uptime_s))
        return (*said, *self._said_by_gps.next(self._recorded_s(by_gps_s)))

    def sensors_object(self, uptime_s: float) -> tuple[str, ...]:
        """The reasons why the sensors are not ready; empty once they are."""
        if uptime_s < self._scaled(_ALIGNED_S):
            return "Need Alt Estimate", "Accels inconsistent", "EKF attitude is bad"
        if uptime_s < self._scaled(_GYROS_SETTLING_S):
            return ("Accels inconsistent",)
        return ("Gyros inconsistent",) if uptime_s < self._scaled(_SENSORS_SETTLED_S) else ()

    def place_objects(self, uptime_s: float, *, gps: bool, by_position: bool) -> tuple[str, ...]:
        """The reasons why the place is not known well enough; `by_position`: for a mode that flies by position."""
        if uptime_s >= self._scaled(_RECEIVER_S) and not (gps and self.hears_satellites(uptime_s)):
            return ("GPS 1: Bad fix",)
        if not self.places(uptime_s):
            return ("AHRS: waiting for home",)
        return () if self.estimates(uptime_s) or not by_position else ("Need Position Estimate",)

    def complains(self, uptime_s: float) -> bool:
        """Whether the reasons against arming are due to be sent, as they are twice a minute."""
        if uptime_s < self._complains_s:
            return False
        self._complains_s = max(self._complains_s + _COMPLAINS_EVERY_S, uptime_s)
        return True

    def complain_at(self, uptime_s: float) -> None:
        """Moves the next complaint to that time."""
        self._complains_s = uptime_s

    def _scaled(self, recorded_s: float) -> float:
        return recorded_s * self._share

    def _recorded_s(self, uptime_s: float) -> float:
        """The time since boot at which the recorded vehicle had got as far as this one at `uptime_s`."""
        if uptime_s >= self._ready_s:
            return RECORDED_S + uptime_s - self._ready_s
        return min(uptime_s / self._share, _READIES_S)
