"""A plan's items, one after the other, become the flight; an item that cannot be flown is left out or refused.

Where autopilots differ, an item is flown as ArduCopter flies it, with a notice.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from upwash.core.geo import GeoPosition
from upwash.plans.items import (
    ABOVE_HOME,
    ABOVE_SEA_LEVEL,
    ABOVE_TERRAIN,
    FASTEST_M_S,
    FENCE_ENABLE,
    HIGHEST_M,
    LEFT_OUT,
    OF_CAMERA,
    SET_HOME,
    TRIGGERED,
    Command,
    Item,
    PlanHome,
    PlanRefusal,
    distance_m,
    home_at,
    why_refused,
)
from upwash.plans.plan import (
    Ending,
    FlightPlan,
    PhotoTrigger,
    PlannedCircle,
    PlannedPolygon,
    PlannedWaypoint,
    PlanNotices,
)
from upwash.plans.triggers import TriggerCommands

_SAME_PLACE_M = 1.0
_ASSUMED_LOWEST_M = 20.0  # above home, of what counts from the sea where home's altitude is unknown
_FARTHEST_TAKEOFF_M = 10_000.0
_LONGEST_HOLD_S = 3600.0
_AIRSPEED, _GROUND_SPEED, _CLIMB_SPEED, _DESCENT_SPEED = range(4)
_NO_CHANGE, _DEFAULT = -1, -2
_OVER_A_PLACE = (Command.WAYPOINT, Command.SPLINE_WAYPOINT, Command.LOITER_TIME, Command.LOITER_TO_ALT)
_CLIMBING = (*_OVER_A_PLACE, Command.TAKEOFF, Command.CONDITION_GATE)
_OF_A_WAYPOINT = (
    (2, "its acceptance radius is left out: a waypoint is reached at rest"),
    (3, "its pass radius is left out: a waypoint is reached at rest"),
    (4, "its heading is left out: the vehicle turns its nose as its own settings say"),
)


def make_plan(
    home: PlanHome | None,
    items: Sequence[Item],
    notices: PlanNotices,
    *,
    fences: tuple[PlannedPolygon | PlannedCircle, ...] = (),
    ground_speed_m_s: float | None = None,
    as_arducopter: bool = False,
) -> FlightPlan:
    """The plan that the items make; raises PlanRefusal for the first item that can be refused only.

    With `as_arducopter` a waypoint's altitude of 0, or its place of 0 and 0, is that of the waypoint before, and a
    landing may have any altitude.
    """
    home = _home_of(home, items, notices)
    course = PlannedCourse(home, _reference_above_sea_m(home, items), notices, as_arducopter=as_arducopter)
    for item in items:
        course.take(item)
    course.finish()
    return FlightPlan(
        home=home.place if home else None,
        waypoints=tuple(course.waypoints),
        fences=fences,
        takeoff_altitude_m=course.takeoff.altitude_m if course.takeoff else None,
        ground_speed_m_s=ground_speed_m_s,
        ending=course.ending or "return",
        takeoff_above_sea_m=(course.takeoff or course.waypoints[0]).above_sea_m,
        above_sea_level=course.above_sea_level,
        home_above_sea_m=home.altitude_m if home else None,
        reference_above_sea_m=course.reference_above_sea_m,
        notices=notices.all(),
    )


def _home_of(home: PlanHome | None, items: Sequence[Item], notices: PlanNotices) -> PlanHome | None:
    """The home that the file names; instead of no home, or of a home far away, the place of the take-off.

    Ground stations write the home of the vehicle that they last saw, and that may have been a simulated one.
    """
    takeoff = next((item for item in items if item.command == Command.TAKEOFF and not item.is_open), None)
    if takeoff is None:
        return home
    place = takeoff.place()
    if home is None:
        notices.add("it names no home: the place of its take-off is taken for it")
    elif (away_m := distance_m(place, home.place)) > _FARTHEST_TAKEOFF_M:
        notices.add(
            f"its home is left out, as it lies {away_m / 1000:.0f} km from its take-off: the take-off's place is "
            "taken for it"
        )
    else:
        return home
    return home_at("", place.latitude_deg, place.longitude_deg)


def _reference_above_sea_m(home: PlanHome | None, items: Sequence[Item]) -> float:
    """Home's altitude above the sea, in metres.

    An unknown altitude is assumed: the lowest altitude above the sea then lies as high above home as the take-off
    does, or 20 m high without a take-off above home.
    """
    if home is not None and home.altitude_m is not None:
        return home.altitude_m
    heights = [(item, item.value(7) or 0.0) for item in items if item.command in _CLIMBING]
    from_sea_m = [height_m for item, height_m in heights if item.frame in ABOVE_SEA_LEVEL and height_m]
    takeoffs = [(item, height_m) for item, height_m in heights if item.command == Command.TAKEOFF]
    climb_m = next((height_m for item, height_m in takeoffs if item.frame in ABOVE_HOME), _ASSUMED_LOWEST_M)
    return min(filter(math.isfinite, from_sea_m), default=climb_m) - climb_m


@dataclass(frozen=True, slots=True)
class Height:
    """An altitude above home, and above the sea if the plan counts from it, in metres."""

    altitude_m: float
    above_sea_m: float | None = None


class PlannedCourse:
    """The flight that the items make, taken in one after the other."""

    def __init__(
        self,
        home: PlanHome | None,
        reference_above_sea_m: float,
        notices: PlanNotices,
        *,
        as_arducopter: bool,
    ) -> None:
        self._as_arducopter = as_arducopter
        self.reference_above_sea_m = reference_above_sea_m
        self.waypoints: list[PlannedWaypoint] = []
        self.takeoff: Height | None = None
        self.ending: Ending | None = None
        self.above_sea_level: int | None = None
        self._home = home
        self._notices = notices
        self._ground_speed_m_s: float | None = None
        self._unused_speed: Item | None = None
        self._trigger_commands = TriggerCommands()
        self._first_triggers: tuple[PhotoTrigger, ...] = ()  # before the first waypoint

    def take(self, item: Item) -> None:
        """Add the next item."""
        if self._is_trigger(item) or self._is_left_out(item):
            return
        if self.ending:
            item.refuse("comes after the plan's return or landing: remove what comes after the end")
        if not item.goes_on:
            item.refuse("does not continue by itself (autoContinue): nobody would tell the vehicle to go on")
        match item.command:
            case Command.WAYPOINT | Command.SPLINE_WAYPOINT | Command.LOITER_TIME | Command.LOITER_TO_ALT:
                self._take_waypoint(item)
            case Command.CONDITION_GATE:
                self._take_gate(item)
            case Command.TAKEOFF:
                self._take_takeoff(item)
            case Command.DELAY | Command.CONDITION_DELAY:
                self._take_delay(item)
            case Command.CHANGE_SPEED:
                self._take_speed(item)
            case Command.RETURN:
                item.require_unset(1, 2, 3, 4)
                if not item.is_open:
                    self._tell(item, "its place is left out: a return goes to the vehicle's home")
                self.ending = "return"
            case Command.LAND:
                self._take_landing(item)
            case _:
                item.refuse(why_refused(item.command))

    def finish(self) -> None:
        """Check the flight after its last item."""
        if not self.waypoints:
            raise PlanRefusal("", "no waypoint in it: add at least one")
        if self._unused_speed is not None:
            self._tell(
                self._unused_speed, "left out: no waypoint comes after it, and the end has its own speed"
            )
        if self.above_sea_level is not None and (self._home is None or self._home.altitude_m is None):
            lowest_m = min(waypoint.place.altitude_m for waypoint in self.waypoints)
            self._notices.add(
                "its altitude counts from the sea, and the plan does not know that of home: before the flight home "
                f"is assumed to lie {self.reference_above_sea_m:g} m high, and the lowest altitude "
                f"{lowest_m:g} m above it; the flight goes by what the vehicle says of its home",
                self.above_sea_level,
            )

    def _tell(self, item: Item, what: str) -> None:
        self._notices.add(f"{item.name}: {what}", item.number, of_camera=item.command in OF_CAMERA)

    def _is_left_out(self, item: Item) -> bool:
        """Whether the item is not flown; adds a notice if so."""
        why = LEFT_OUT.get(item.command)
        if item.command == SET_HOME and item.value(1) == 1 and not self.waypoints:
            why = "left out: home is where the vehicle takes off"
        if item.command == FENCE_ENABLE and item.value(1) == 0:
            why = "left out: the vehicle's own fence stays on"
        if why is not None:
            self._tell(item, why)
        return why is not None

    def _is_trigger(self, item: Item) -> bool:
        """Whether the item is a trigger of the camera; takes its command if so."""
        trigger = self._trigger_commands.take(item)
        if trigger is None:
            return False
        if isinstance(trigger, str):
            self._tell(item, trigger)
            return True
        self._notices.add(f"{item.name}: {TRIGGERED}", item.number, only_without_photos=True)
        if not self.waypoints:
            self._first_triggers += (trigger,)
        elif not self.ending:
            last = self.waypoints[-1]
            self.waypoints[-1] = replace(last, triggers=(*last.triggers, trigger))
        return True

    def _take_waypoint(self, item: Item) -> None:
        hold_s = 0.0 if item.command == Command.LOITER_TO_ALT else self._hold_s(item)
        if item.command in (Command.WAYPOINT, Command.SPLINE_WAYPOINT):
            for index, what in _OF_A_WAYPOINT:
                if item.value(index):
                    self._tell(item, what)
        if item.command == Command.SPLINE_WAYPOINT:
            self._tell(item, "flown to on a straight line, not on a curve")
        if item.is_open:
            self._stay(item, hold_s)
        else:
            self._fly_to(item, item.place(), self._flown_height(item), hold_s)

    def _take_gate(self, item: Item) -> None:
        """Take a plane across the way, where QGroundControl has a PX4 trigger its camera, as a waypoint."""
        self._notices.add(
            f"{item.name}: flown to as a waypoint; with mission.photos it is passed in flight",
            item.number,
            only_without_photos=True,
        )
        height = self._height(item) if item.value(2) else self._before()
        if height is None:
            item.refuse("has no altitude, and the plan none before it: add a take-off")
        self._fly_to(item, item.place(), height)

    def _flown_height(self, item: Item) -> Height:
        """The item's altitude; for ArduCopter's 0 the altitude before."""
        before = self._before()
        if item.value(7) != 0 or before is None or not self._as_arducopter:
            return self._height(item)
        self._tell(item, "its altitude is 0: flown at the altitude before it, as ArduCopter does")
        return before

    def _stay(self, item: Item, hold_s: float) -> None:
        """Add an item without a place: at the place before, and without an altitude at the altitude before."""
        before = self._before()
        may_stay = item.command == Command.LOITER_TIME or self._as_arducopter
        if not may_stay or before is None or self._home is None:
            item.refuse("has no place: give it latitude and longitude")
        if item.command != Command.LOITER_TIME:
            self._tell(item, "it names no place: flown where the flight is, as ArduCopter does")
        height = self._height(item) if item.value(7) else before
        if self.waypoints and self.waypoints[-1].place.altitude_m == height.altitude_m:
            self._hover(hold_s)
        else:
            place = self.waypoints[-1].place if self.waypoints else self._home.place
            self._fly_to(item, place, height, hold_s)

    def _fly_to(self, item: Item, place: GeoPosition, height: Height, hold_s: float = 0.0) -> None:
        place = replace(place, altitude_m=height.altitude_m)
        speed_m_s, above_sea_m = self._ground_speed_m_s, height.above_sea_m
        triggers, self._first_triggers = self._first_triggers, ()
        self.waypoints.append(PlannedWaypoint(item.number, place, speed_m_s, above_sea_m, hold_s, triggers))
        self._unused_speed = None

    def _hover(self, hold_s: float) -> None:
        last = self.waypoints[-1]
        self.waypoints[-1] = replace(last, hold_s=last.hold_s + hold_s)

    def _take_takeoff(self, item: Item) -> None:
        if self.waypoints or self.takeoff is not None:
            item.refuse("comes too late: only the first thing in a flight can be its take-off")
        if item.value(4):
            self._tell(item, _OF_A_WAYPOINT[-1][1])
        if not item.is_open:
            place = item.place()
            if self._home is not None and (away_m := distance_m(place, self._home.place)) > _SAME_PLACE_M:
                self._tell(
                    item,
                    f"its place, {away_m:.0f} m from the plan's home, is left out: the vehicle climbs where it "
                    "stands",
                )
        self.takeoff = self._height(item)

    def _take_delay(self, item: Item) -> None:
        hold_s = self._hold_s(item)
        if not hold_s:
            item.refuse("waits for a time of day: remove it, or give it a delay in seconds (parameter 1)")
        if not self.waypoints:
            self._tell(item, "left out: the first waypoint is where a flight can hover")
            return
        if item.command == Command.CONDITION_DELAY:
            self._tell(item, "flown as a hover at the waypoint before it, where ArduCopter would fly on")
        self._hover(hold_s)

    def _hold_s(self, item: Item) -> float:
        hold_s = item.value(1) or 0.0
        if item.command == Command.DELAY and hold_s < 0:
            return 0.0
        if not 0 <= hold_s <= _LONGEST_HOLD_S:
            item.refuse(f"holds for {hold_s:g} s: expected 0 to {_LONGEST_HOLD_S:g} s")
        return hold_s

    def _take_speed(self, item: Item) -> None:
        kind, speed_m_s = item.value(1), item.number_of(2, "speed")
        if kind in (_CLIMB_SPEED, _DESCENT_SPEED):
            self._tell(item, "left out: the vehicle climbs and sinks as fast as its own settings say")
            return
        if kind not in (_AIRSPEED, _GROUND_SPEED):
            item.refuse(f"changes speed type {kind}: choose the ground speed (type 1)")
        if kind == _AIRSPEED:
            self._tell(item, "an airspeed is flown as a ground speed, as a multicopter does")
        if item.value(3) not in (None, 0, _NO_CHANGE, _DEFAULT):
            self._tell(
                item, f"its throttle of {item.value(3):g} % is left out: a multicopter flies by the speed"
            )
        item.require_unset(4, 5, 6, 7)
        if speed_m_s == _NO_CHANGE:
            self._tell(item, "left out: a speed of -1 changes nothing")
            return
        if speed_m_s == _DEFAULT:
            self._tell(item, "a speed of -2 is flown as the speed of the mission")
            self._ground_speed_m_s = None
            return
        if not 0 < speed_m_s <= FASTEST_M_S:
            item.refuse(f"sets {speed_m_s:g} m/s: expected a speed above 0 and up to {FASTEST_M_S:g} m/s")
        self._ground_speed_m_s = speed_m_s
        self._unused_speed = item

    def _take_landing(self, item: Item) -> None:
        item.require_unset(abort_altitude=1, precision_landing=2)
        if item.value(4):
            self._tell(item, _OF_A_WAYPOINT[-1][1])
        if not item.is_open:
            if not self._is_on_the_ground(item):
                if not self._as_arducopter:
                    item.refuse("lands at an altitude: set it to home's, where a landing ends on the ground")
                self._tell(item, "its altitude is left out: a landing ends on the ground")
            self._fly_above(item)
        self.ending = "land"

    def _fly_above(self, item: Item) -> None:
        """Adds a waypoint above the place of a landing where the flight does not end there."""
        place = item.place()
        if self.waypoints and distance_m(place, self.waypoints[-1].place) <= _SAME_PLACE_M:
            return
        height = self._before()
        if height is None:
            item.refuse(
                "lands at a place, and the plan says nothing of an altitude to fly there: add a take-off"
            )
        self._tell(
            item, "flown as a waypoint above its place, at the altitude before it, and a landing there"
        )
        self._fly_to(item, place, height)

    def _is_on_the_ground(self, item: Item) -> bool:
        """Whether the item is at home's altitude, as far as the plan can know."""
        if item.frame in ABOVE_SEA_LEVEL and (self._home is None or self._home.altitude_m is None):
            return True
        return item.frame in ABOVE_TERRAIN or abs(self._height_as_written(item).altitude_m) <= _SAME_PLACE_M

    def _before(self) -> Height | None:
        """The altitude of the flight before this item; None before a take-off."""
        if self.waypoints:
            last = self.waypoints[-1]
            return Height(last.place.altitude_m, last.above_sea_m)
        return self.takeoff

    def _height(self, item: Item) -> Height:
        height = self._height_as_written(item)
        if not 0 < height.altitude_m <= HIGHEST_M:
            above = ""
            if height.above_sea_m is not None:
                home_m = self.reference_above_sea_m
                above = f" ({height.above_sea_m:g} m above the sea, and home at {home_m:g} m)"
            item.refuse(
                f"lies {height.altitude_m:g} m above home{above}: expected more than 0 and up to {HIGHEST_M:g} m"
            )
        return height

    def _height_as_written(self, item: Item) -> Height:
        altitude_m = item.number_of(7, "altitude")
        if item.frame in ABOVE_SEA_LEVEL:
            self.above_sea_level = self.above_sea_level or item.number
            return Height(altitude_m - self.reference_above_sea_m, altitude_m)
        if item.frame in ABOVE_TERRAIN:
            item.refuse(
                f"has frame {item.frame}, which counts its altitude of {altitude_m:g} m from the terrain, and upwash "
                "knows no terrain: choose altitudes relative to home (QGroundControl: altitude mode Relative To "
                "Launch; Mission Planner: Relative instead of Terrain)"
            )
        if item.frame not in ABOVE_HOME:
            item.refuse(
                f"has frame {item.frame}, which is not understood: give its altitude above home or sea level"
            )
        return Height(altitude_m)
