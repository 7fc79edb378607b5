"""The home for which a plan was made, compared with the vehicle's own before arming.

A plan's altitudes above the sea become altitudes above the vehicle's own home, which the vehicle reports.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import msgspec
from msgspec import Struct

from upwash.config.drone import DroneConfig, MissionConfig, PlanFile
from upwash.config.places import altitudes_above_sea, is_planned_home
from upwash.core.geo import Position, ground_distance_m
from upwash.errors import AutopilotRefused
from upwash.ports import VehicleLimits

HOMES_AGREE_M = 30.0  # the error of a GPS in height, and of the terrain of a ground station
_STEADY_M = 3.0  # less is the drift of a GPS in height between two looks
_FAR_M = 100.0


class PlannedHome(Struct, frozen=True):
    """A plan's home; None for what the plan does not have.

    If `counts_from_sea`, the plan's altitudes above the sea were converted with `above_sea_m`.
    """

    place: Position | None = None
    above_sea_m: float | None = None
    counts_from_sea: bool = False

    def require_same(self, limits: VehicleLimits) -> None:
        """Raises AutopilotRefused if the vehicle's home is at another altitude than when the plan was converted."""
        if self.counts_from_sea and self._apart_m(limits) > HOMES_AGREE_M:
            raise AutopilotRefused(
                "arm",
                f"the plan's altitudes above the sea were converted with a home at {self.above_sea_m:g} m, and the "
                f"vehicle's home is now at {limits.home_above_sea_m:g} m, more than {HOMES_AGREE_M:g} m from that; "
                "wait for a better fix, and start again; nothing was sent",
            )

    def doubts(self, limits: VehicleLimits, vehicle: Position) -> Iterator[str]:
        """Warnings about the plan's home, for a person before arming."""
        most_m = _STEADY_M if self.counts_from_sea else HOMES_AGREE_M
        if self._apart_m(limits) > most_m:
            own_m, told_m = self.above_sea_m, limits.home_above_sea_m
            homes = f"{own_m:g} m above the sea, and the vehicle's home {told_m:g} m"
            if self.counts_from_sea:
                yield f"the plan's altitudes above the sea were converted with a home at {homes}"
            else:
                yield f"the plan's home is {homes}: check that the plan is of this place"
        if self.place is not None and (away_m := ground_distance_m(self.place, vehicle)) > _FAR_M:
            yield f"the vehicle stands {away_m:.0f} m from the plan's home, and returns to its own home"

    def _apart_m(self, limits: VehicleLimits) -> float:
        """The difference of the homes' altitudes above the sea, in metres; 0 if one is unknown."""
        if self.above_sea_m is None or limits.home_above_sea_m is None:
            return 0.0
        return abs(self.above_sea_m - limits.home_above_sea_m)


def planned_home(mission: MissionConfig) -> PlannedHome:
    """The home of the mission's plan; an empty `PlannedHome` without a plan, or where the plan has no home."""
    plan = mission.plan.plan if mission.plan is not None else None
    if plan is None or not is_planned_home(mission, plan):
        return PlannedHome()
    counts_from_sea = altitudes_above_sea(mission) is not None
    return PlannedHome(
        place=Position(0.0, 0.0) if plan.home is not None else None,
        above_sea_m=plan.reference_above_sea_m if counts_from_sea else plan.home_above_sea_m,
        counts_from_sea=counts_from_sea,
    )


_LOWEST_M = 1.0  # above home


def above_home(config: DroneConfig, home_above_sea_m: float) -> DroneConfig:
    """The configuration with altitudes above the sea converted to altitudes above home.

    Raises AutopilotRefused if the plan has another altitude of its home, or a place would not be above home.
    """
    file, above = config.mission.plan, altitudes_above_sea(config.mission)
    if file is None or above is None:
        return config
    home_m = above.home_above_sea_m
    if home_m is not None and abs(home_m - home_above_sea_m) > HOMES_AGREE_M:
        raise AutopilotRefused(
            "arm",
            f"{file.file}: item {above.above_sea_level} counts its altitude from the sea; the plan's home is "
            f"{home_m:g} m above the sea, the vehicle's {home_above_sea_m:g} m (at most {HOMES_AGREE_M:g} m "
            "apart are allowed): correct the planned home, or give altitudes above home; nothing was sent",
        )

    def converted(what: str, above_sea_m: float) -> float:
        if (altitude_m := above_sea_m - home_above_sea_m) >= _LOWEST_M:
            return altitude_m
        raise AutopilotRefused(
            "arm",
            f"{file.file}: {what} is {above_sea_m:g} m above the sea and the vehicle's home "
            f"{home_above_sea_m:g} m: that is {altitude_m:.1f} m above home, less than {_LOWEST_M:g} m; give an "
            "altitude above home, or check the vehicle's altitude; nothing was sent",
        )

    takeoff_m, waypoints = config.mission.altitude_m, []
    if above.takeoff_above_sea_m is not None:
        takeoff_m = converted("the take-off", above.takeoff_above_sea_m)
    for waypoint in file.plan.waypoints:
        place = waypoint.place
        if waypoint.above_sea_m is not None:
            place = replace(place, altitude_m=converted(f"item {waypoint.item}", waypoint.above_sea_m))
        waypoints.append(replace(waypoint, place=place))
    plan = replace(file.plan, waypoints=tuple(waypoints), reference_above_sea_m=home_above_sea_m)
    mission = msgspec.structs.replace(config.mission, plan=PlanFile(file.file, plan), altitude_m=takeoff_m)
    return msgspec.structs.replace(config, mission=mission)
