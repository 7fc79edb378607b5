"""A plan's altitudes above the sea become altitudes above the vehicle's own home, which the vehicle tells."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import msgspec

from upwash.config import AltitudesAboveSea, DroneConfig, PlanFile, altitudes_above_sea
from upwash.drone.planned_home import HOMES_AGREE_M
from upwash.errors import AutopilotRefused
from upwash.plans import PlannedWaypoint

_LOWEST_M = 1.0  # above home


def above_home(config: DroneConfig, home_above_sea_m: float) -> DroneConfig:
    """The configuration with all altitudes above a home that lies so high above the sea.

    Raises AutopilotRefused where the plan knows another altitude of its home, or a place would not lie above home.
    """
    file, above = config.mission.plan, altitudes_above_sea(config.mission)
    if file is None or above is None:
        return config
    _require_same_home(file, above, home_above_sea_m)
    waypoints = tuple(_above_home(each, home_above_sea_m) for each in file.plan.waypoints)
    takeoff_m = config.mission.altitude_m
    if above.takeoff_m is not None:
        takeoff_m = above.takeoff_m - home_above_sea_m
    for what, above_sea_m, altitude_m in _counted_from_sea(above, waypoints, takeoff_m):
        if altitude_m < _LOWEST_M:
            raise AutopilotRefused(
                "arm",
                f"{file.file}: {what} is {above_sea_m:g} m above the sea and the vehicle's home "
                f"{home_above_sea_m:g} m: that is {altitude_m:.1f} m above home, less than {_LOWEST_M:g} m; give an "
                "altitude above home, or check the vehicle's altitude; nothing was sent",
            )
    plan = replace(file.plan, waypoints=waypoints, reference_above_sea_m=home_above_sea_m)
    mission = msgspec.structs.replace(config.mission, plan=PlanFile(file.file, plan), altitude_m=takeoff_m)
    return msgspec.structs.replace(config, mission=mission)


def _require_same_home(file: PlanFile, above: AltitudesAboveSea, home_above_sea_m: float) -> None:
    if above.home_m is not None and abs(above.home_m - home_above_sea_m) > HOMES_AGREE_M:
        raise AutopilotRefused(
            "arm",
            f"{file.file}: item {above.item} counts its altitude from the sea; the plan's home is "
            f"{above.home_m:g} m above the sea, the vehicle's {home_above_sea_m:g} m (at most {HOMES_AGREE_M:g} m "
            "apart are allowed): correct the planned home, or give altitudes above home; nothing was sent",
        )


def _above_home(waypoint: PlannedWaypoint, home_above_sea_m: float) -> PlannedWaypoint:
    if waypoint.above_sea_m is None:
        return waypoint
    return replace(
        waypoint, place=replace(waypoint.place, altitude_m=waypoint.above_sea_m - home_above_sea_m)
    )


def _counted_from_sea(
    above: AltitudesAboveSea, waypoints: tuple[PlannedWaypoint, ...], takeoff_m: float
) -> Iterator[tuple[str, float, float]]:
    """What it is, and its altitudes above the sea and above home."""
    if above.takeoff_m is not None:
        yield "the take-off", above.takeoff_m, takeoff_m
    for waypoint in waypoints:
        if waypoint.above_sea_m is not None:
            yield f"item {waypoint.item}", waypoint.above_sea_m, waypoint.place.altitude_m
