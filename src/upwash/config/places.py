"""Where a configured mission goes and where its servers are, on the plane around the mission's home.

Altitudes count from home, or from the sea. An altitude above the sea is sure only at the vehicle, which knows the
altitude of its own home.
"""

from __future__ import annotations

import math
from collections.abc import Container, Iterator, Sequence
from dataclasses import replace

import msgspec

from upwash.config.drone import DroneConfig, GridConfig, MissionConfig, PlanFile, ServerConfig, VehicleConfig
from upwash.config.plan_photos import planned_photos
from upwash.config.traces import read_track
from upwash.config.values import HomeConfig
from upwash.core.geo import (
    Circle,
    GeoPosition,
    LocalFrame,
    Measured,
    Position,
    Reach,
    Waypoint,
    ground_distance_m,
    part_way,
)
from upwash.core.knowledge.coverage import Coverage
from upwash.core.planning.demand_map import DemandMap, near_m
from upwash.core.planning.order import Sweep, sweeps
from upwash.core.vehicle.geofence import Fence
from upwash.core.vehicle.track import Track
from upwash.plans import Ending, FlightPlan

_LAST_SPOT = 1e-6  # of the distance between spots: nearer to a row's end, the end is a spot


def waypoints(mission: MissionConfig) -> tuple[Waypoint, ...]:
    """The mission's waypoints in the order of the file, which is the order of their indices."""
    if mission.plan is not None:
        if mission.photos is None:
            return corners(mission, mission.plan.plan)
        return planned_photos(mission).waypoints
    step_m = None if mission.photos is None else mission.photos.step_m(mission.ground_speed_m_s)
    if step_m is None:
        return tuple(Waypoint(index, place) for index, place in enumerate(_places(mission)))
    spots = ((spot, end) for start, end in row_ends(mission) for spot in _spots(start, end, step_m))
    return tuple(Waypoint(index, spot, row_end=end) for index, (spot, end) in enumerate(spots))


def corners(mission: MissionConfig, plan: FlightPlan) -> tuple[Waypoint, ...]:
    """The plan's waypoints, with a photo or without."""
    frame = _frame(mission.home)
    return tuple(
        Waypoint(index, frame.position(item.place), item.ground_speed_m_s, item.above_sea_m, item.hold_s)
        for index, item in enumerate(plan.waypoints)
    )


def row_ends(mission: MissionConfig) -> list[tuple[Position, Position]]:
    """The start and the end of each row of the grid, or of the legs 0, 2, 4 ... of `waypoints_m`."""
    places = _places(mission)
    count = mission.grid.columns if mission.grid else 2
    return [(places[first], places[first + count - 1]) for first in range(0, len(places) - count + 1, count)]


def _places(mission: MissionConfig) -> list[Position]:
    given = _grid_places(mission.grid) if mission.grid else mission.waypoints_m or ()
    return [Position(east_m, north_m, mission.altitude_m) for east_m, north_m in given]


def _spots(start: Position, end: Position, every_m: float) -> Iterator[Position]:
    length_m = ground_distance_m(start, end)
    yield start
    for number in range(1, math.floor(length_m / every_m + _LAST_SPOT) + 1):
        yield part_way(start, end, min(1.0, number * every_m / length_m))


def stands(mission: MissionConfig) -> Position:
    """Where the vehicle is expected to stand: at home, or at the first waypoint where that is no plan's."""
    return Position(0.0, 0.0) if mission.plan is not None else waypoints(mission)[0].position


def movable_waypoints(mission: MissionConfig) -> tuple[Waypoint, ...]:
    """The mission's waypoints, to be flown in any order.

    Where a plan sets speeds each has its own: what a plan sets once else holds until it sets another.
    """
    given = waypoints(mission)
    if all(waypoint.ground_speed_m_s is None for waypoint in given):
        return given
    return tuple(
        replace(waypoint, ground_speed_m_s=waypoint.ground_speed_m_s or mission.ground_speed_m_s)
        for waypoint in given
    )


def sweeps_of(mission: MissionConfig) -> tuple[Sweep, ...]:
    """The sweeps of the mission's waypoints; none where they form no grid."""
    return sweeps(movable_waypoints(mission))


def geofence(mission: MissionConfig) -> tuple[Fence, ...]:
    """The fences of the mission's plan."""
    if mission.plan is None:
        return ()
    frame = _frame(mission.home)
    return tuple(fence.fence(frame) for fence in mission.plan.plan.fences)


def as_planned(
    mission: MissionConfig, file: PlanFile, *, named: Container[str], photo_s: float
) -> MissionConfig:
    """The mission over the file's plan, with what the plan says wherever the configuration names nothing."""
    plan = replace(file.plan, photo_s=photo_s)
    if "altitude_m" in named:
        plan = replace(plan, takeoff_above_sea_m=None)
    planned = {
        "home": plan.home and HomeConfig.at(plan.home),
        "altitude_m": plan.takeoff_altitude_m or plan.waypoints[0].place.altitude_m,
        "ground_speed_m_s": plan.ground_speed_m_s or mission.ground_speed_m_s,
    }
    return msgspec.structs.replace(
        mission,
        plan=PlanFile(file.file, plan),
        **{key: value for key, value in planned.items() if key not in named},
    )


def file_notices(config: DroneConfig) -> list[str]:
    """What of the configuration's plans is flown otherwise than they say, or not at all, and which maps are damaged.

    Each is a sentence with the file, a plan's items, and the reason.
    """
    maps = (config.network.coverage_map, config.policy.demand_map)
    found = [kept.notice for kept in maps if kept is not None and kept.notice]
    plans = (config.mission.plan, *(drone.plan for drone in config.drones))
    for file in filter(None, plans):
        found += (
            f"{file.file}: {notice}"
            for notice in file.plan.notices
            if config.mission.photos is None or not notice.only_without_photos
        )
    return list(dict.fromkeys(found))


def altitudes_above_sea(mission: MissionConfig) -> FlightPlan | None:
    """The mission's plan, if the plan counts altitudes from the sea; with a home's altitude only for that home."""
    plan = mission.plan.plan if mission.plan is not None else None
    if plan is None or plan.above_sea_level is None:
        return None
    return plan if is_planned_home(mission, plan) else replace(plan, home_above_sea_m=None)


def is_planned_home(mission: MissionConfig, plan: FlightPlan) -> bool:
    """Whether the mission's home is the plan's."""
    return (plan.home and HomeConfig.at(plan.home)) == mission.home


def ending(mission: MissionConfig) -> Ending:
    """How the mission ends when all went well."""
    return mission.plan.plan.ending if mission.plan is not None else "return"


def server_position(server: ServerConfig, home: HomeConfig | None) -> Position:
    """Where the server stands; a place in degrees needs `home`."""
    if server.east_m is not None and server.north_m is not None:
        return Position(server.east_m, server.north_m)
    if server.latitude_deg is None or server.longitude_deg is None:
        raise ValueError(f"server {server.name} has no place: read its configuration from a file")
    return _frame(home).position(GeoPosition(server.latitude_deg, server.longitude_deg))


def server_places(config: DroneConfig) -> dict[str, Position]:
    """Where each server stands, by its name; a server without a place stands at home."""
    return {
        server.name: Position(0.0, 0.0)
        if server.east_m is None and server.latitude_deg is None
        else server_position(server, config.mission.home)
        for server in config.servers
    }


def server_areas(config: DroneConfig) -> dict[str, Reach]:
    """Where each server is believed to be in range, by its name: everywhere, for one without a range."""
    return {server.name: _reach(server, config, server.believed_range_m) for server in config.servers}


def true_areas(config: DroneConfig) -> dict[str, Reach]:
    """Where each simulated server is really in range, by its name."""
    return {server.name: _reach(server, config, true_range_m(server)) for server in config.servers}


def true_range_m(server: ServerConfig) -> float | None:
    """How far the simulated server is reached, in metres; None where the file does not say."""
    return server.believed_range_m if server.truth.range_m is None else server.truth.range_m


def measured_servers(config: DroneConfig) -> tuple[str, ...]:
    """The servers without a range."""
    return tuple(server.name for server in config.servers if server.believed_range_m is None)


def coverage_of(config: DroneConfig) -> Coverage | None:
    """What earlier flights measured of the servers without a range; None where there are none."""
    servers, file = measured_servers(config), config.network.coverage_map
    if not servers:
        return None
    known = file.places(_centre(config.mission)) if file is not None else {}
    return Coverage({server: known.get(server, ()) for server in servers})


def coverage_kept(config: DroneConfig, coverage: Coverage) -> None:
    """Writes the map to its file, where the configuration names one; raises NotWritten."""
    if config.network.coverage_map is not None:
        config.network.coverage_map.keep(coverage, _centre(config.mission))


def demand_map_of(config: DroneConfig, plan: Sequence[Waypoint]) -> DemandMap | None:
    """Where earlier flights' answers had demands; None where the configuration names no file."""
    file = config.policy.demand_map
    return None if file is None else DemandMap(file.places(_centre(config.mission)), near_m=near_m(plan))


def demands_kept(config: DroneConfig, known: DemandMap) -> None:
    """Writes the map to its file, where the configuration names one; raises NotWritten."""
    if config.policy.demand_map is not None:
        config.policy.demand_map.keep(known, _centre(config.mission))


def _reach(server: ServerConfig, config: DroneConfig, radius_m: float | None) -> Reach:
    if radius_m is None:
        return Measured()
    return Circle(server_position(server, config.mission.home), radius_m)


def track_of(vehicle: VehicleConfig, mission: MissionConfig) -> Track | None:
    """The track that the simulated vehicle flies; None without one. Raises ConfigError for a file that is none.

    Times count from the file's first row. Without altitudes the track is as high as the mission's take-off.
    """
    if vehicle.track_csv is None:
        return None
    rows = read_track(vehicle.track_csv, frame_of(mission)).rows
    return Track(
        [row[0] - rows[0][0] for row in rows],
        [Position(row[1], row[2], max(0.0, row[3]) if row[3:] else mission.altitude_m) for row in rows],
    )


def frame_of(mission: MissionConfig) -> LocalFrame | None:
    """Where on the Earth the mission's metres are; None where it has no home."""
    return None if mission.home is None else LocalFrame(mission.home.place)


def _centre(mission: MissionConfig) -> GeoPosition | None:
    return None if mission.home is None else mission.home.place


def _frame(home: HomeConfig | None) -> LocalFrame:
    if home is None:
        raise ValueError("degrees without a home: read the configuration from a file")
    return LocalFrame(home.place)


def _grid_places(grid: GridConfig) -> list[tuple[float, float]]:
    """Where the waypoints are, in the order of the flight."""
    rows, columns = list(range(grid.rows)), list(range(grid.columns))
    if grid.start.startswith("top"):
        rows.reverse()
    if grid.start.endswith("right"):
        columns.reverse()
    places = []
    for row in rows:
        places += [(column * grid.spacing_m, row * grid.spacing_m) for column in columns]
        if grid.rows_alternate:
            columns.reverse()
    return places
