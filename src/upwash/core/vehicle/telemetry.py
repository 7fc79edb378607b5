"""A vehicle's reports, as a mission reads them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Literal, TypeAlias

from upwash.core.geo import Position, Velocity

FixKind: TypeAlias = Literal["none", "2d", "3d", "dgps", "rtk-float", "rtk-fixed"]

# A receiver without a time says 1970, or 1980, where GPS begins. A receiver that miscounts weeks says 2006 or 2080.
_EARLIEST_UNIX_S, _LATEST_UNIX_S = (datetime(year, 1, 1, tzinfo=UTC).timestamp() for year in (2025, 2060))


def gps_time(unix_s: float) -> float | None:
    """The time that a receiver says, in seconds since 1970; None where it does not know the time."""
    return unix_s if _EARLIEST_UNIX_S <= unix_s < _LATEST_UNIX_S else None


@dataclass(frozen=True, slots=True)
class Attitude:
    """The vehicle's attitude in degrees: roll to the right, pitch nose up, yaw clockwise from north (0 to 360)."""

    roll_deg: float
    pitch_deg: float
    yaw_deg: float


@dataclass(frozen=True, slots=True)
class GpsFix:
    """The satellite receiver's fix: its kind, the satellites in use, the horizontal dilution of precision.

    `error_m` is the receiver's own estimate of its horizontal error. All but the kind are None if they are not
    reported.
    """

    kind: FixKind
    satellites: int | None = None
    hdop: float | None = None
    error_m: float | None = None


@dataclass(frozen=True, slots=True)
class Telemetry:
    """The vehicle's last reports; None for what it has not reported.

    `position` is relative to the mission's home, `velocity` over the ground, `mode` the autopilot's own name.
    `batteries` has the charge of each battery that the vehicle flies with, in percent, by its number from 1 on.
    `gimbal` is the attitude of a gimbal over the ground; its camera looks ahead.
    """

    position: Position
    mode: str
    armed: bool
    velocity: Velocity | None = None
    attitude: Attitude | None = None
    heading_deg: float | None = None
    gps: GpsFix | None = None
    batteries: Mapping[int, float | None] = field(default_factory=dict)
    gimbal: Attitude | None = None

    @property
    def charges_percent(self) -> Mapping[int, float]:
        """The known charges of the batteries, in percent, by number."""
        return {number: percent for number, percent in self.batteries.items() if percent is not None}

    @property
    def battery_percent(self) -> float | None:
        """The charge of the lowest battery in percent; None if no charge is reported."""
        return min(self.charges_percent.values(), default=None)

    @property
    def lowest_battery(self) -> int | None:
        """The number of the lowest battery; None unless several are reported."""
        charges = self.charges_percent
        return min(charges, key=charges.__getitem__) if charges and len(self.batteries) > 1 else None

    @property
    def ground_speed_m_s(self) -> float | None:
        """The ground speed; None if not reported."""
        return None if self.velocity is None else self.velocity.ground_m_s

    @property
    def climb_m_s(self) -> float | None:
        """The rate of climb, negative in a descent; None if not reported."""
        return None if self.velocity is None else self.velocity.up_m_s
