"""Where a mission is to be flown, held against where the vehicle stands and what its own fence allows."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

from upwash.core.geo import Position, Waypoint, ground_distance_m
from upwash.core.geofence import Fence, breached_by_leg, breached_by_position
from upwash.errors import AutopilotRefused
from upwash.ports import VehicleLimits


@dataclass(frozen=True, slots=True)
class Site:
    """The waypoints of a mission, the fences of its plan, and from how far away it may begin."""

    waypoints: Sequence[Waypoint]
    fences: Sequence[Fence]
    farthest_start_m: float

    def require_reachable(self, vehicle: Position) -> None:
        """Raises AutopilotRefused where the vehicle stands too far from all of the mission."""
        distances_m = (ground_distance_m(vehicle, waypoint.position) for waypoint in self.waypoints)
        nearest_m = min(distances_m, default=0.0)
        if nearest_m > self.farthest_start_m:
            raise AutopilotRefused(
                "arm",
                f"the vehicle stands {_far(nearest_m)} from the nearest waypoint; at most "
                f"autopilot.farthest_start_m = {self.farthest_start_m:g} is allowed: check mission.home, the "
                "waypoints and where the vehicle believes to be, or raise it; nothing was sent",
            )

    def require_within(self, limits: VehicleLimits) -> None:
        """Raises AutopilotRefused where the vehicle's own fence forbids a waypoint or the way to one."""
        for waypoint in self.waypoints:
            place = waypoint.position
            if limits.highest_m is not None and place.altitude_m > limits.highest_m:
                _refuse(
                    waypoint, f"it is {place.altitude_m:g} m up, the fence ends at {limits.highest_m:g} m"
                )
            if (fence := breached_by_position(limits.fences, place)) is not None:
                _refuse(waypoint, f"it lies {'outside' if fence.inclusion else 'inside'} {fence.name}")
        for start, end in itertools.pairwise(self.waypoints):
            if (fence := breached_by_leg(limits.fences, start.position, end.position)) is not None:
                _refuse(end, f"the way there from waypoint {start.index} crosses {fence.name}")


def _refuse(waypoint: Waypoint, why: str) -> None:
    raise AutopilotRefused(
        "arm",
        f"the vehicle's own fence forbids waypoint {waypoint.index}: {why}; change the plan or the vehicle's fence; "
        "nothing was sent",
    )


def _far(distance_m: float) -> str:
    return f"{distance_m / 1000:.1f} km" if distance_m >= 1000 else f"{distance_m:.0f} m"
