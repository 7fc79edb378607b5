"""Checks of a mission's places against the vehicle's position and its own fence."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence

from msgspec import Struct

from upwash.core.geo import Circle, Position, Via, Waypoint, ground_distance_m
from upwash.core.vehicle.geofence import Fence, breached_by_leg, breached_by_move, breached_by_position
from upwash.core.vehicle.return_place import RallyPoints, ReturnPlace
from upwash.drone.home import PlannedHome
from upwash.errors import AutopilotRefused
from upwash.plans import Ending
from upwash.ports import VehicleLimits

_CARRIED_M = 20.0  # from where it was switched on; less is the drift of a GPS
_REMEDY = "change the plan or the vehicle's fence; nothing was sent"


class Site(Struct, frozen=True):
    """The waypoints of a mission, the fences of its plan, and how it begins and ends.

    `takeoff_m` is the altitude of the take-off; the vehicle may start at most `farthest_start_m` from a waypoint.
    After the last waypoint it flies over `leaving`. A plan's `way` has all places where it turns.
    """

    waypoints: Sequence[Waypoint]
    fences: Sequence[Fence]
    farthest_start_m: float
    takeoff_m: float
    ending: Ending = "return"
    home: PlannedHome = PlannedHome()
    leaving: Sequence[Via] = ()
    way: Sequence[Position] = ()

    def require_reachable(self, vehicle: Position) -> None:
        """Raises AutopilotRefused if the vehicle stands farther than `farthest_start_m` from every waypoint."""
        distances_m = (ground_distance_m(vehicle, waypoint.position) for waypoint in self.waypoints)
        nearest_m = min(distances_m, default=0.0)
        if nearest_m > self.farthest_start_m:
            raise AutopilotRefused(
                "arm",
                f"the vehicle stands {_far(nearest_m)} from the nearest waypoint; at most "
                f"autopilot.farthest_start_m = {self.farthest_start_m:g} is allowed: check mission.home, the "
                "waypoints and where the vehicle believes to be, or raise it; nothing was sent",
            )

    def require_within(self, limits: VehicleLimits, vehicle: Position) -> None:
        """Raises AutopilotRefused if the vehicle's own fence forbids a part of the flight.

        The parts are the vehicle's position, the take-off, each way and waypoint, the way home and the landing. Also
        raised if the vehicle's home is not at the altitude with which the mission was converted.
        """
        self.home.require_same(limits)
        for what, why in self._forbidden(limits, vehicle):
            raise AutopilotRefused("arm", f"the vehicle's own fence forbids {what}: {why}; {_REMEDY}")

    def require_leg(self, limits: VehicleLimits, start: Position, target: Position) -> None:
        """Raises AutopilotRefused if the plan's geofence or the vehicle's own fence forbids the leg."""
        step = f"goto {target.east_m:.1f} m east, {target.north_m:.1f} m north"
        for fences, whose in ((self.fences, " of the plan's geofence"), (limits.fences, "")):
            if (fence := breached_by_move(fences, start, target)) is not None:
                raise AutopilotRefused(step, f"{fence.name}{whose} is in the way; nothing was sent")
        require_altitude(limits, target.altitude_m, step=step)

    def allows_leg(self, limits: VehicleLimits, start: Position, target: Position) -> bool:
        """Whether no fence forbids the leg."""
        try:
            self.require_leg(limits, start, target)
        except AutopilotRefused:
            return False
        return True

    def doubts(self, limits: VehicleLimits, vehicle: Position) -> Iterator[str]:
        """Warnings for a person about a flight that is allowed."""
        yield from self.home.doubts(limits, vehicle)
        if limits.home is not None and (away_m := ground_distance_m(limits.home, vehicle)) > _CARRIED_M:
            yield (
                f"the vehicle stands {_far(away_m)} from its own home: it may set its home anew at arming, and then "
                "its way home and the fence around its home are others"
            )
        if limits.untold:
            untold = ", ".join(limits.untold)
            yield f"the vehicle did not tell {untold}: the mission is not held against all of its own fence"
        yield from itertools.islice(self._too_near(limits), 1)
        home, crossing = _home(limits, vehicle), dict[int, Fence]()
        yield from self._returns_elsewhere(limits.rally, home)
        for waypoint in self.waypoints:
            end = limits.rally.chosen(waypoint.position, home).position
            if (fence := breached_by_leg(limits.fences, waypoint.position, end)) is not None:
                crossing[waypoint.index] = fence
        if crossing:
            yield (
                f"a straight way home from {_waypoints(list(crossing))} {_crosses(next(iter(crossing.values())))}: a "
                "return that begins there, by a fail-safe too, breaches the vehicle's own fence"
            )

    def _returns_elsewhere(self, rally: RallyPoints, home: Position) -> Iterator[str]:
        """Warnings about rally points, where returns end instead of at home."""
        ends: dict[ReturnPlace, list[int]] = {}
        for waypoint in self.waypoints:
            end = rally.chosen(waypoint.position, home)
            if end.name != "home":
                ends.setdefault(end, []).append(waypoint.index)
        for end, indices in ends.items():
            away = _far(ground_distance_m(end.position, home))
            yield f"a return from {_waypoints(indices)} ends at the vehicle's {end.name}, {away} from home"

    def _forbidden(self, limits: VehicleLimits, vehicle: Position) -> Iterator[tuple[str, str]]:
        if why := _outside_areas(limits, vehicle):
            yield f"the place where the vehicle stands ({_place(vehicle)})", why
        if why := _outside_altitudes(limits, self.takeoff_m):
            yield f"the take-off to {self.takeoff_m:g} m", why
        before, whence = vehicle, f"where the vehicle stands ({_place(vehicle)})"
        for name, place in self._places():
            if why := _outside_altitudes(limits, place.altitude_m) or _outside_areas(limits, place):
                yield name, why
            if why := _crossed_areas(limits, before, place):
                yield name, f"the way there from {whence} {why}"
            before, whence = place, name
        names = limits.names
        if limits.highest_m is not None and limits.returns_at_m >= limits.highest_m:
            why = f"it ends at {names.highest} = {limits.highest_m:g} m; lower {names.returns_at}"
            yield f"the way home at {names.returns_at} = {limits.returns_at_m:g} m", why
        if self.ending != "return" or not self.waypoints:
            return
        end = limits.rally.chosen(before, _home(limits, vehicle))
        if why := _outside_areas(limits, end.position):
            yield f"the landing at the vehicle's {end.name} ({_place(end.position)})", why
        if why := _crossed_areas(limits, before, end.position):
            yield f"the way {'home' if end.name == 'home' else f'to {end.name}'} from {whence}", f"it {why}"

    def _places(self) -> Iterator[tuple[str, Position]]:
        for waypoint in self.waypoints:
            for place in (via.position for via in waypoint.via):
                yield f"a place on the way to waypoint {waypoint.index} ({_place(place)})", place
            yield f"waypoint {waypoint.index}", waypoint.position
        for place in (via.position for via in self.leaving):
            yield f"a place after the last photo ({_place(place)})", place

    def _too_near(self, limits: VehicleLimits) -> Iterator[str]:
        """Warnings about places nearer to the fence than the vehicle's margin, where it may overshoot."""
        names, margin_m, places = limits.names, limits.margin_m, list(self._places())
        overshoots = "the vehicle may overshoot into its own fence"
        for what, altitude_m in [
            ("the take-off", self.takeoff_m),
            *((it, at.altitude_m) for it, at in places),
        ]:
            if limits.highest_m is not None and limits.highest_m - altitude_m < margin_m:
                yield (
                    f"{what} at {altitude_m:g} m is nearer than {names.margin} = {margin_m:g} m to "
                    f"{names.highest} = {limits.highest_m:g} m: {overshoots}"
                )
        for (name, place), fence in itertools.product(places, limits.fences):
            if (clearance_m := fence.clearance_m(place)) < margin_m:
                yield (
                    f"{name} is {clearance_m:.1f} m from the border of {fence.name}, nearer than "
                    f"{names.margin} = {margin_m:g} m: {overshoots}"
                )


def require_altitude(limits: VehicleLimits, altitude_m: float, *, step: str) -> None:
    """Raises AutopilotRefused if the vehicle's own fence forbids the altitude above home."""
    if why := _outside_altitudes(limits, altitude_m):
        raise AutopilotRefused(step, f"the vehicle's own fence forbids it: {why}; nothing was sent")


def _outside_altitudes(limits: VehicleLimits, altitude_m: float) -> str:
    if limits.highest_m is not None and altitude_m >= limits.highest_m:
        return f"it is {altitude_m:g} m up, the fence ends at {limits.names.highest} = {limits.highest_m:g} m"
    if limits.lowest_m is not None and altitude_m <= limits.lowest_m:
        return f"it is {altitude_m:g} m up, the fence begins at {limits.names.lowest} = {limits.lowest_m:g} m"
    return ""


def _outside_areas(limits: VehicleLimits, place: Position) -> str:
    if (fence := breached_by_position(limits.fences, place)) is None:
        return ""
    apart = ""
    if isinstance(fence.area, Circle):
        away_m, radius_m = ground_distance_m(place, fence.area.centre), fence.area.radius_m
        apart = f", {away_m:.0f} m from its centre with a radius of {radius_m:g} m"
    return f"it lies {'outside' if fence.inclusion else 'inside'} {fence.name}{apart}"


def _crossed_areas(limits: VehicleLimits, start: Position, end: Position) -> str:
    fence = breached_by_leg(limits.fences, start, end)
    return "" if fence is None else _crosses(fence)


def _crosses(fence: Fence) -> str:
    return f"{'leaves' if fence.inclusion else 'crosses'} {fence.name}"


def _home(limits: VehicleLimits, vehicle: Position) -> Position:
    return vehicle if limits.home is None else limits.home


def _place(place: Position) -> str:
    return f"{place.east_m:.0f} m east, {place.north_m:.0f} m north"


def _waypoints(indices: Sequence[int]) -> str:
    first = indices[0]
    return (
        f"waypoint {first}" if len(indices) == 1 else f"{len(indices)} waypoints, the first of them {first},"
    )


def _far(distance_m: float) -> str:
    return f"{distance_m / 1000:.1f} km" if distance_m >= 1000 else f"{distance_m:.0f} m"
