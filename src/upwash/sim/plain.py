"""A vehicle without a character of its own: one acceleration, and fixed times for the rest."""

from __future__ import annotations

from dataclasses import dataclass

from upwash.core.geo import Position, Velocity
from upwash.core.vehicle.way_home import WayHome
from upwash.vehicle.body.kinematics import Phase, braking, duration_s, leg, steadily

_AT_ONCE = 1e9  # metres a second, and more of them each second


@dataclass(frozen=True, slots=True)
class Plain:
    """Speeds up and brakes alike, and takes off, returns and lands in given times whatever the distance."""

    acceleration_m_s2: float
    takeoff_s: float
    return_and_land_s: float

    @property
    def returning(self) -> WayHome:
        """In its time, whatever the distance."""
        return WayHome(
            altitude_m=0.0,
            climb_m_s=_AT_ONCE,
            speed_m_s=_AT_ONCE,
            acceleration_m_s2=_AT_ONCE,
            hover_s=self.return_and_land_s,
            descent_m_s=_AT_ONCE,
            slowly_below_m=0.0,
            landing_m_s=_AT_ONCE,
        )

    def takeoff(self, ground: Position, altitude_m: float) -> tuple[Phase, ...]:
        """Straight up in its time."""
        return steadily(
            ground, Position(ground.east_m, ground.north_m, altitude_m), duration_s=self.takeoff_s
        )

    def waypoint_leg(self, start: Position, end: Position, *, ground_speed_m_s: float) -> tuple[Phase, ...]:
        """From rest to rest, under one acceleration."""
        return leg(start, end, cruise_m_s=ground_speed_m_s, acceleration_m_s2=self.acceleration_m_s2)

    def brake(self, start: Position, velocity: Velocity) -> tuple[Phase, ...]:
        """Straight ahead, under the same acceleration."""
        return braking(start, velocity, acceleration_m_s2=self.acceleration_m_s2)

    def arrival_s(self, phases: tuple[Phase, ...]) -> float:
        """At rest."""
        return duration_s(phases)

    def return_and_land(self, start: Position, home: Position) -> tuple[Phase, ...]:
        """Straight home in its time."""
        return steadily(start, home, duration_s=self.return_and_land_s)

    def landing(self, start: Position) -> tuple[Phase, ...]:
        """Straight down in the time of a return."""
        return steadily(start, Position(start.east_m, start.north_m), duration_s=self.return_and_land_s)
