"""The home that a plan was made for, held against the vehicle's own before arming."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from upwash.config import MissionConfig, altitudes_above_sea, is_planned_home
from upwash.core.geo import Position, ground_distance_m
from upwash.errors import AutopilotRefused
from upwash.ports import VehicleLimits

HOMES_AGREE_M = 30.0  # the error of a GPS in height, and of the terrain of a ground station
_STEADY_M = 3.0  # less is the drift of a GPS in height between two looks
_FAR_M = 100.0


@dataclass(frozen=True, slots=True)
class PlannedHome:
    """A plan's home; None where the plan does not have it.

    Where `counts_from_sea`, altitudes of the plan were converted with `above_sea_m`.
    """

    place: Position | None = None
    above_sea_m: float | None = None
    counts_from_sea: bool = False

    def require_same(self, limits: VehicleLimits) -> None:
        """Raises AutopilotRefused where the vehicle's home has risen or sunk since altitudes were converted."""
        if self.counts_from_sea and self._apart_m(limits) > HOMES_AGREE_M:
            raise AutopilotRefused(
                "arm",
                f"the plan's altitudes above the sea were converted with a home at {self.above_sea_m:g} m, and the "
                f"vehicle's home is now at {limits.home_above_sea_m:g} m (at most {HOMES_AGREE_M:g} m apart are "
                "allowed): wait for a better fix, and start again; nothing was sent",
            )

    def doubts(self, limits: VehicleLimits, vehicle: Position) -> Iterator[str]:
        """What a person should know of it before arming."""
        most_m = _STEADY_M if self.counts_from_sea else HOMES_AGREE_M
        if self._apart_m(limits) > most_m:
            homes = (
                f"{self.above_sea_m:g} m above the sea, and the vehicle's home {limits.home_above_sea_m:g} m"
            )
            if self.counts_from_sea:
                yield f"the plan's altitudes above the sea were converted with a home at {homes}"
            else:
                yield f"the plan's home is {homes}: check that the plan is of this place"
        if self.place is not None and (away_m := ground_distance_m(self.place, vehicle)) > _FAR_M:
            yield f"the vehicle stands {away_m:.0f} m from the plan's home, and returns to its own home"

    def _apart_m(self, limits: VehicleLimits) -> float:
        """How much higher or lower the vehicle's home is; 0 where one of them is not known."""
        if self.above_sea_m is None or limits.home_above_sea_m is None:
            return 0.0
        return abs(self.above_sea_m - limits.home_above_sea_m)


NO_PLANNED_HOME = PlannedHome()


def planned_home(mission: MissionConfig) -> PlannedHome:
    """The home of the mission's plan."""
    plan = mission.plan.plan if mission.plan is not None else None
    if plan is None or not is_planned_home(mission, plan):
        return NO_PLANNED_HOME
    counts_from_sea = altitudes_above_sea(mission) is not None
    return PlannedHome(
        place=Position(0.0, 0.0) if plan.home is not None else None,
        above_sea_m=plan.reference_above_sea_m if counts_from_sea else plan.home_above_sea_m,
        counts_from_sea=counts_from_sea,
    )
