"""How an ArduCopter flies from rest, as its flights at 4 m/s show (SITL, version 4.7, default parameters, no wind).

At other speeds it is assumed to keep its accelerations. It overshoots a waypoint by 0.4 m and creeps back while it
hovers; that is left out, and so is the 1 % by which it exceeds the speed that it was told.
"""

from __future__ import annotations

from upwash.core.geo import Position, distance_m
from upwash.vehicle.kinematics import (
    Phase,
    Ramp,
    Velocity,
    heading_of,
    leg,
    ramped_leg,
    resumed_leg,
    settled_s,
    steadily,
)

_REACTION_S = 0.1
_FASTER = Ramp(((0.5, 2.8), (0.6, 2.8), (0.7, 0.4), (2.3, 0.0)))
_SLOWER = Ramp(((0.73, -0.97), (1.03, -1.83), (2.4, 0.0)))
_ARRIVED_M, _ARRIVED_M_S = 1.0, 0.5  # near and slow enough for the next target

_TURNS_AT_ONCE_M_S = 0.5  # slower than this, the next target costs it no time

spool_up_s = 3.3  # after the command to take off, until it lifts
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
    cruise_m_s = _cruise_m_s(start, end, ground_speed_m_s)
    way = ramped_leg(start, end, cruise_m_s=cruise_m_s, faster=_FASTER, slower=_SLOWER)
    return (_pause(start, _REACTION_S), *way)


def rest_of_leg(
    start: Position, end: Position, *, ground_speed_m_s: float, speed_m_s: float
) -> tuple[Phase, ...]:
    """A leg from that speed to rest; empty if it is faster than it may be, or could not stop in time."""
    cruise_m_s = _cruise_m_s(start, end, ground_speed_m_s)
    if speed_m_s > cruise_m_s:
        return ()
    return resumed_leg(start, end, speed_m_s=speed_m_s, cruise_m_s=cruise_m_s, faster=_FASTER, slower=_SLOWER)


def brake(start: Position, velocity: Velocity) -> tuple[Phase, ...]:
    """To rest, straight ahead; the last of its speed costs it neither time nor way."""
    speed_m_s = velocity.speed_m_s
    if speed_m_s <= _TURNS_AT_ONCE_M_S:
        return ()
    ahead = Position(
        start.east_m + velocity.east_m_s,
        start.north_m + velocity.north_m_s,
        start.altitude_m + velocity.up_m_s,
    )
    return _SLOWER.phases(start, heading_of(start, ahead), speed_m_s)


def arrival_s(phases: tuple[Phase, ...]) -> float:
    """When the vehicle counts as arrived, though it still moves a little: 1 m before the end, below 0.5 m/s."""
    return settled_s(phases, distance_m=_ARRIVED_M, speed_m_s=_ARRIVED_M_S)


def takeoff(ground: Position, altitude_m: float) -> tuple[Phase, ...]:
    """Spools up, then climbs straight up to the altitude."""
    return (
        _pause(ground, spool_up_s),
        *_climb(ground, Position(ground.east_m, ground.north_m, altitude_m)),
    )


def return_and_land(start: Position, home: Position) -> tuple[Phase, ...]:
    """Climbs to the altitude of returns if it is lower, flies home, hovers and lands."""
    way = way_home(start, home, ground_speed_m_s=_RETURN_M_S, altitude_m=_RETURN_ALTITUDE_M)
    return *way, *landing(way[-1].end)


def way_home(
    start: Position, home: Position, *, ground_speed_m_s: float, altitude_m: float
) -> tuple[Phase, ...]:
    """Climbs to the altitude if it is lower, flies home and hovers there."""
    top_m = max(start.altitude_m, altitude_m)
    above_start = Position(start.east_m, start.north_m, top_m)
    above_home = Position(home.east_m, home.north_m, top_m)
    return (
        *_climb(start, above_start),
        *leg(above_start, above_home, cruise_m_s=ground_speed_m_s, acceleration_m_s2=_RETURN_M_S2),
        _pause(above_home, _HOVER_S),
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


def _cruise_m_s(start: Position, end: Position, ground_speed_m_s: float) -> float:
    """The ground speed, or less where the way is so steep that climb or descent would be too fast."""
    rise_m = end.altitude_m - start.altitude_m
    if rise_m == 0:
        return ground_speed_m_s
    vertical_m_s = _CLIMB_M_S if rise_m > 0 else _DESCENT_M_S
    return min(ground_speed_m_s, vertical_m_s * distance_m(start, end) / abs(rise_m))


def _pause(place: Position, duration_s: float) -> Phase:
    return Phase(place, Velocity(), 0.0, 0.0, duration_s)
