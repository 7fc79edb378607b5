"""How an ArduCopter flies from rest, as its flights at 4 m/s show (SITL, version 4.7, default parameters, no wind).

At other speeds it is assumed to keep its accelerations. It overshoots a waypoint by 0.4 m and creeps back while it
hovers; that is left out, and so is the 1 % by which it exceeds the speed that it was told.
"""

from __future__ import annotations

from upwash.core.geo import Position
from upwash.vehicle.kinematics import Phase, Ramp, Velocity, leg, ramped_leg, settled_s, steadily

_REACTION_S = 0.1
_FASTER = Ramp(((0.5, 2.8), (0.6, 2.8), (0.7, 0.4), (2.3, 0.0)))
_SLOWER = Ramp(((0.73, -0.97), (1.03, -1.83), (2.4, 0.0)))
_ARRIVED_M, _ARRIVED_M_S = 1.0, 0.5  # near and slow enough for the next target

_SPOOL_UP_S = 3.3
_CLIMB_M_S = 2.54
_CLIMB_FASTER = Ramp(((0.3, 1.7), (1.19, 1.7), (0.3, 0.0)))
_CLIMB_SLOWER = Ramp(((0.3, -0.65), (3.6, -0.65), (0.3, 0.0)))

_RETURN_M_S, _RETURN_M_S2 = 10.0, 1.6
_RETURN_ALTITUDE_M = 15.0  # it climbs so high before it returns
_HOVER_S = 7.0
_DESCENT_M_S, _DESCENT_M_S2 = 1.5, 1.0
_SLOWLY_BELOW_M, _LANDING_M_S = 10.0, 0.5


def waypoint_leg(start: Position, end: Position, *, ground_speed_m_s: float) -> tuple[Phase, ...]:
    """A leg from rest to rest, with the time it takes to react."""
    way = ramped_leg(start, end, cruise_m_s=ground_speed_m_s, faster=_FASTER, slower=_SLOWER)
    return (_pause(start, _REACTION_S), *way)


def arrival_s(phases: tuple[Phase, ...]) -> float:
    """When the vehicle counts as arrived, though it still moves a little: 1 m before the end, below 0.5 m/s."""
    return settled_s(phases, distance_m=_ARRIVED_M, speed_m_s=_ARRIVED_M_S)


def takeoff(ground: Position, altitude_m: float) -> tuple[Phase, ...]:
    """Spools up, then climbs straight up to the altitude."""
    return (
        _pause(ground, _SPOOL_UP_S),
        *_climb(ground, Position(ground.east_m, ground.north_m, altitude_m)),
    )


def return_and_land(start: Position, home: Position) -> tuple[Phase, ...]:
    """Climbs to the altitude of returns if it is lower, flies home, hovers and lands."""
    altitude_m = max(start.altitude_m, _RETURN_ALTITUDE_M)
    above_start = Position(start.east_m, start.north_m, altitude_m)
    above_home = Position(home.east_m, home.north_m, altitude_m)
    return (
        *_climb(start, above_start),
        *leg(above_start, above_home, cruise_m_s=_RETURN_M_S, acceleration_m_s2=_RETURN_M_S2),
        _pause(above_home, _HOVER_S),
        *landing(above_home),
    )


def landing(start: Position) -> tuple[Phase, ...]:
    """Descends to the ground, slowly on the last metres."""
    low = Position(start.east_m, start.north_m, min(start.altitude_m, _SLOWLY_BELOW_M))
    ground = Position(start.east_m, start.north_m)
    return (
        *leg(start, low, cruise_m_s=_DESCENT_M_S, acceleration_m_s2=_DESCENT_M_S2),
        *steadily(low, ground, duration_s=low.altitude_m / _LANDING_M_S),
    )


def _climb(start: Position, end: Position) -> tuple[Phase, ...]:
    return ramped_leg(start, end, cruise_m_s=_CLIMB_M_S, faster=_CLIMB_FASTER, slower=_CLIMB_SLOWER)


def _pause(place: Position, duration_s: float) -> Phase:
    return Phase(place, Velocity(), 0.0, 0.0, duration_s)
