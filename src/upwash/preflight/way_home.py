"""How far home is at the farthest waypoint, and what that asks of the battery."""

from __future__ import annotations

from msgspec import Struct

from upwash.config import DroneConfig, waypoints
from upwash.core.geo import Position, ground_distance_m
from upwash.core.vehicle.way_home import ARDUCOPTER, UNKNOWN, WayHome, descent_s, time_home_s

_HOME = Position(0.0, 0.0)
PX4_LOW_PERCENT = 15.0  # BAT_LOW_THR as a PX4 is delivered


class Farthest(Struct, frozen=True, kw_only=True):
    """The waypoint from which the way home takes longest, without wind; the way down with `on_failure = "land"`.

    `out_s` is the least time there from the ground, and `needed_percent` what the way home takes of the battery, None
    where the file does not say how long that lasts.
    """

    waypoint: int
    away_m: float
    out_s: float
    home_s: float
    needed_percent: float | None


def farthest(config: DroneConfig) -> Farthest:
    """Of all waypoints of the plan."""
    way = believed_way_home(config)
    _, found = max(
        ((_down_s(each.position, config, way), each) for each in waypoints(config.mission)),
        key=lambda pair: pair[0],
    )
    home_s, endurance_s = _down_s(found.position, config, way), config.vehicle.endurance_s
    away_m = ground_distance_m(found.position, _HOME)
    climb_s = found.position.altitude_m / way.climb_m_s
    return Farthest(
        waypoint=found.index,
        away_m=away_m,
        out_s=climb_s + away_m / (found.ground_speed_m_s or config.mission.ground_speed_m_s),
        home_s=home_s,
        needed_percent=100 * home_s / endurance_s if endurance_s else None,
    )


def believed_way_home(config: DroneConfig) -> WayHome:
    """How the vehicle returns; before it is connected only the simulated one's profile says so."""
    return ARDUCOPTER if config.vehicle.profile == "arducopter" else UNKNOWN


def _down_s(place: Position, config: DroneConfig, way: WayHome) -> float:
    if config.autopilot.on_failure == "land":
        return way.hover_s + descent_s(place.altitude_m, way)
    return time_home_s(place, _HOME, way)
