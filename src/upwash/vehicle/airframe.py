"""How a stand-in ArduCopter flies, drawn as stretches."""

from __future__ import annotations

from typing import Protocol

from upwash.core.geo import Position, Velocity
from upwash.vehicle.kinematics import Phase, Stretch


class Airframe(Protocol):
    """How a vehicle flies: `vehicle.arducopter` is one, `Symmetric` another."""

    @property
    def spool_up_s(self) -> float:
        """How long a take-off stays on the ground."""

    def takeoff(self, ground: Position, altitude_m: float) -> tuple[Phase, ...]:
        """Straight up to the altitude."""

    def waypoint_leg(self, start: Position, end: Position, *, ground_speed_m_s: float) -> tuple[Phase, ...]:
        """From rest to rest."""

    def redirected(
        self, start: Position, velocity: Velocity, end: Position, *, ground_speed_m_s: float
    ) -> tuple[Stretch, ...]:
        """From that velocity to rest at a target."""

    def brake(self, start: Position, velocity: Velocity) -> tuple[Phase, ...]:
        """To rest, straight ahead."""

    def way_home(
        self,
        start: Position,
        velocity: Velocity,
        home: Position,
        *,
        ground_speed_m_s: float,
        altitude_m: float,
    ) -> tuple[Stretch, ...]:
        """To rest above home, no lower than the altitude."""

    def landing(self, start: Position) -> tuple[Phase, ...]:
        """From rest straight down to the ground."""
