"""The reference of a mission's altitudes: home, or the sea.

An altitude above the sea is sure only at the vehicle, which knows how high its own home lies.
"""

from __future__ import annotations

from dataclasses import dataclass

from upwash.config.drone import MissionConfig
from upwash.plans import Plan


@dataclass(frozen=True, slots=True)
class AltitudesAboveSea:
    """The part of a plan's altitudes that counts from the sea; all in metres above it, as ground stations have it.

    `item` is the first such item. `home_m` is the planned home's altitude, None where the plan does not know it or
    the mission has another home. `reference_m` is what `Waypoint.position` was converted with: `home_m`, or an
    assumed altitude of home. `takeoff_m` is what `mission.altitude_m` comes from, None where that counts from home.
    The altitudes of waypoints are in `Waypoint.above_sea_m`.
    """

    item: int
    home_m: float | None
    reference_m: float
    takeoff_m: float | None


def altitudes_above_sea(mission: MissionConfig) -> AltitudesAboveSea | None:
    """What the mission's plan says of altitudes above the sea; None where all altitudes count from home."""
    plan = mission.plan.plan if mission.plan is not None else None
    if plan is None or plan.above_sea_level is None:
        return None
    return AltitudesAboveSea(
        item=plan.above_sea_level,
        home_m=plan.home_above_sea_m if is_planned_home(mission, plan) else None,
        reference_m=plan.reference_above_sea_m,
        takeoff_m=plan.takeoff_above_sea_m,
    )


def is_planned_home(mission: MissionConfig, plan: Plan) -> bool:
    """Whether the mission's home is the plan's."""
    planned, home = plan.home, mission.home
    if planned is None or home is None:
        return planned is None and home is None
    return (planned.latitude_deg, planned.longitude_deg) == (home.latitude_deg, home.longitude_deg)
