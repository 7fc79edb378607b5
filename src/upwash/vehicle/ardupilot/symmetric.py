"""A vehicle that speeds up and brakes alike: easy to reckon with, and as agile as wanted."""

from __future__ import annotations

from dataclasses import dataclass

from upwash.core.geo import Position, Velocity, distance_m, ground_distance_m
from upwash.vehicle.body.kinematics import Phase, braking, heading_of, leg

_STRAIGHT = 1 - 1e-6  # the cosine of an angle that is none


@dataclass(frozen=True, slots=True)
class Symmetric:
    """Its one acceleration, and its vertical speeds."""

    acceleration_m_s2: float
    climb_m_s: float
    descent_m_s: float
    spool_up_s: float = 0.0

    def takeoff(self, ground: Position, altitude_m: float) -> tuple[Phase, ...]:
        """The motion of a take-off straight up."""
        return self._leg(ground, ground.at_altitude(altitude_m), cruise_m_s=self.climb_m_s)

    def waypoint_leg(self, start: Position, end: Position, *, ground_speed_m_s: float) -> tuple[Phase, ...]:
        """The motion of a leg from rest to rest."""
        return self._leg(start, end, cruise_m_s=self._cruise_m_s(start, end, ground_speed_m_s))

    def redirected(
        self,
        start: Position,
        velocity: Velocity,
        end: Position,
        *,
        ground_speed_m_s: float,
        rests_at: Position | None = None,
    ) -> tuple[Phase, ...]:
        """The motion to a new target: straight on if the way and speed allow it, else brake first."""
        speed_m_s, cruise_m_s = velocity.speed_m_s, self._cruise_m_s(start, end, ground_speed_m_s)
        length_m = distance_m(start, end)
        if (
            length_m > 0
            and 0 < speed_m_s <= cruise_m_s
            and speed_m_s**2 <= 2 * self.acceleration_m_s2 * length_m
        ):
            ahead = heading_of(start, end)
            along_m_s = (
                ahead.east_m_s * velocity.east_m_s
                + ahead.north_m_s * velocity.north_m_s
                + ahead.up_m_s * velocity.up_m_s
            )
            if along_m_s >= _STRAIGHT * speed_m_s:
                return self._leg(start, end, cruise_m_s=cruise_m_s, speed_m_s=speed_m_s)
        braked = self.brake(start, velocity)
        here = braked[-1].end if braked else start
        return *braked, *self.waypoint_leg(here, end, ground_speed_m_s=ground_speed_m_s)

    def brake(self, start: Position, velocity: Velocity) -> tuple[Phase, ...]:
        """The motion from the velocity to rest, straight ahead."""
        return braking(start, velocity, acceleration_m_s2=self.acceleration_m_s2)

    def way_home(
        self,
        start: Position,
        velocity: Velocity,
        home: Position,
        *,
        ground_speed_m_s: float,
        altitude_m: float,
    ) -> tuple[Phase, ...]:
        """The motion of a return until the landing: brake, climb to the altitude if it is lower, home."""
        braked = self.brake(start, velocity)
        start = braked[-1].end if braked else start
        top_m = max(start.altitude_m, altitude_m)
        above_start, above_home = start.at_altitude(top_m), home.at_altitude(top_m)
        return (
            *braked,
            *self._leg(start, above_start, cruise_m_s=self.climb_m_s),
            *self._leg(above_start, above_home, cruise_m_s=ground_speed_m_s),
        )

    def landing(self, start: Position) -> tuple[Phase, ...]:
        """The motion of a landing straight down."""
        return self._leg(start, start.at_altitude(0.0), cruise_m_s=self.descent_m_s)

    def _leg(
        self, start: Position, end: Position, *, cruise_m_s: float, speed_m_s: float = 0.0
    ) -> tuple[Phase, ...]:
        return leg(
            start,
            end,
            cruise_m_s=cruise_m_s,
            acceleration_m_s2=self.acceleration_m_s2,
            speed_m_s=speed_m_s,
        )

    def _cruise_m_s(self, start: Position, end: Position, ground_speed_m_s: float) -> float:
        """The highest speed on the way that exceeds no limit: over the ground, of climb, of descent."""
        rise_m = end.altitude_m - start.altitude_m
        if rise_m == 0:
            return ground_speed_m_s
        length_m, ground_m = distance_m(start, end), ground_distance_m(start, end)
        vertical_m_s = (self.climb_m_s if rise_m > 0 else self.descent_m_s) * length_m / abs(rise_m)
        return min(vertical_m_s, ground_speed_m_s * length_m / ground_m) if ground_m else vertical_m_s
