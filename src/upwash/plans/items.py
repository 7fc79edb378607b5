"""Mission items, as MAVLink numbers them, become a plan: each is understood to the last number, or refused."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import NoReturn

from upwash.core.geo import GeoPosition, LocalFrame, ground_distance_m
from upwash.plans.plan import Ending, Plan, PlannedCircle, PlannedPolygon, PlannedWaypoint

MOST_ITEMS = 10_000
HIGHEST_M = 10_000.0
FASTEST_M_S = 100.0

ABOVE_SEA_LEVEL = (0, 5)  # MAV_FRAME
_ABOVE_HOME = (3, 6)
_GROUND_SPEED = 1
_SAME_PLACE_M = 1.0
_ASSUMED_LOWEST_M = 20.0  # above home, of what counts from the sea where home's altitude is unknown


class Command(IntEnum):
    """The commands that are understood, as MAV_CMD numbers them."""

    WAYPOINT = 16
    RETURN = 20
    LAND = 21
    TAKEOFF = 22
    CHANGE_SPEED = 178


_CLIMBING = (Command.WAYPOINT, Command.TAKEOFF)


class Refusal(Exception):
    """Part of a plan that is not understood: where, and what is wrong with it."""

    def __init__(self, where: str, problem: str) -> None:
        self.where = where
        self.problem = problem
        super().__init__(f"{where}: {problem}")


@dataclass(frozen=True, slots=True)
class Home:
    """The plan's home; its altitude is above sea level, None where the ground station did not know it."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float | None

    @property
    def place(self) -> GeoPosition:
        """The place on the ground."""
        return GeoPosition(self.latitude_deg, self.longitude_deg)


@dataclass(frozen=True, slots=True)
class Item:
    """One mission item; a parameter that is left open is None."""

    number: int
    command: int
    frame: int
    parameters: tuple[float | None, ...]
    goes_on: bool = True  # to the next item by itself

    def refuse(self, problem: str) -> NoReturn:
        """Raises the refusal of this item; the problem goes on from the command's name."""
        raise Refusal(f"item {self.number}", f"{command_name(self.command)} ({self.command}) {problem}")

    def number_of(self, index: int, what: str) -> float:
        """A parameter, counted from 1, that has to be there and to be a number."""
        value = self.parameters[index - 1]
        if value is None or not math.isfinite(value):
            self.refuse(f"has {what} {'nothing' if value is None else value}: expected a number")
        return value

    def require_unset(self, *indexes: int, **named: int) -> None:
        """Refuses a parameter that is neither left open nor 0."""
        for what, index in [*((f"parameter {index}", index) for index in indexes), *named.items()]:
            value = self.parameters[index - 1]
            if value is not None and value != 0 and not (math.isnan(value) and what == "yaw"):
                self.refuse(f"has {what.replace('_', ' ')} {value:g}, which is not understood: set it to 0")


def make_plan(
    home: Home | None,
    items: list[Item],
    *,
    fences: tuple[PlannedPolygon | PlannedCircle, ...] = (),
    ground_speed_m_s: float | None = None,
) -> Plan:
    """The plan that the items come to; raises Refusal for the first that is not understood."""
    course = _Course(home, _reference_above_sea_m(home, items))
    for item in items:
        course.take(item)
    course.finish()
    return Plan(
        home=home.place if home else None,
        waypoints=tuple(course.waypoints),
        fences=fences,
        takeoff_altitude_m=course.takeoff_altitude_m,
        ground_speed_m_s=ground_speed_m_s,
        ending=course.ending or "return",
        takeoff_above_sea_m=course.climb_above_sea_m,
        above_sea_level=course.above_sea_level,
        home_above_sea_m=home.altitude_m if home else None,
        reference_above_sea_m=course.reference_above_sea_m,
    )


def checked_place(where: str, latitude_deg: float, longitude_deg: float) -> GeoPosition:
    """A place on the Earth; raises Refusal for what is none."""
    if not abs(latitude_deg) <= 90:
        raise Refusal(where, f"latitude {latitude_deg:g}: latitudes go from -90 to 90 degrees")
    if not abs(longitude_deg) <= 180:
        raise Refusal(where, f"longitude {longitude_deg:g}: longitudes go from -180 to 180 degrees")
    return GeoPosition(latitude_deg, longitude_deg)


def home_at(where: str, latitude_deg: float, longitude_deg: float, altitude_m: float) -> Home | None:
    """A plan's home; raises Refusal for what is no place.

    A ground station writes 0, 0 where it knew no home, and an altitude of 0 where it knew no terrain: both are None.
    """
    place = checked_place(where, latitude_deg, longitude_deg)
    if not abs(altitude_m) <= HIGHEST_M:
        raise Refusal(
            where, f"altitude {altitude_m:g} m: expected up to {HIGHEST_M:g} metres above sea level"
        )
    if (latitude_deg, longitude_deg) == (0, 0):
        return None
    return Home(place.latitude_deg, place.longitude_deg, altitude_m or None)


def command_name(command: int) -> str:
    """The MAVLink name of a command."""
    from pymavlink.dialects.v20 import ardupilotmega as mavlink  # only needed once something is wrong

    entry = mavlink.enums["MAV_CMD"].get(command)
    return entry.name if entry else "an unknown command"


def _reference_above_sea_m(home: Home | None, items: list[Item]) -> float:
    """Home's altitude above the sea.

    An unknown one is assumed to be such that the lowest altitude that counts from the sea lies as high above home as
    the take-off does, or 20 m where the take-off does not say.
    """
    if home is not None and home.altitude_m is not None:
        return home.altitude_m
    heights = [(item, item.parameters[6] or 0.0) for item in items if item.command in _CLIMBING]
    from_sea_m = [height_m for item, height_m in heights if item.frame in ABOVE_SEA_LEVEL]
    climb_m = next(
        (
            height_m
            for item, height_m in heights
            if item.command == Command.TAKEOFF and item.frame in _ABOVE_HOME
        ),
        _ASSUMED_LOWEST_M,
    )
    return min(filter(math.isfinite, from_sea_m), default=climb_m) - climb_m


class _Course:
    """What the items come to, taken in one after the other."""

    def __init__(self, home: Home | None, reference_above_sea_m: float) -> None:
        self.reference_above_sea_m = reference_above_sea_m
        self._takeoff_above_sea_m: float | None = None
        self.waypoints: list[PlannedWaypoint] = []
        self.takeoff_altitude_m: float | None = None
        self.ending: Ending | None = None
        self.above_sea_level: int | None = None
        self._home = home
        self._ground_speed_m_s: float | None = None
        self._unused_speed: Item | None = None

    def take(self, item: Item) -> None:
        if not item.goes_on:
            item.refuse("does not continue by itself (autoContinue): nobody would tell the vehicle to go on")
        if self.ending:
            item.refuse("comes after the plan's return or landing: remove what comes after the end")
        match item.command:
            case Command.WAYPOINT:
                self._take_waypoint(item)
            case Command.TAKEOFF:
                self._take_takeoff(item)
            case Command.CHANGE_SPEED:
                self._take_speed(item)
            case Command.RETURN:
                item.require_unset(1, 2, 3, 4, 5, 6, 7)
                self.ending = "return"
            case Command.LAND:
                self._take_landing(item)
            case _:
                item.refuse(
                    "is not understood: a plan may have waypoints, a take-off, changes of the ground speed, "
                    "and a return or a landing at its end"
                )

    def finish(self) -> None:
        if not self.waypoints:
            raise Refusal("", "no waypoint in it: add at least one")
        if self._unused_speed is not None:
            self._unused_speed.refuse("has no waypoint after it, and a return has the vehicle's own speed")

    @property
    def climb_above_sea_m(self) -> float | None:
        """Of the take-off or, without one, of the first waypoint, where that counts from the sea."""
        return self.waypoints[0].above_sea_m if self.takeoff_altitude_m is None else self._takeoff_above_sea_m

    def _take_waypoint(self, item: Item) -> None:
        item.require_unset(hold_time=1, acceptance_radius=2, pass_radius=3, yaw=4)
        place = self._place(item)
        above_sea_m = _above_sea_m(item)
        self.waypoints.append(PlannedWaypoint(item.number, place, self._ground_speed_m_s, above_sea_m))
        self._unused_speed = None

    def _take_takeoff(self, item: Item) -> None:
        if self.waypoints or self.takeoff_altitude_m is not None:
            item.refuse("comes too late: only the first thing in a flight can be its take-off")
        item.require_unset(2, 3, yaw=4)  # the first is the pitch of a plane
        if not _is_open(item):
            ground = self._on_the_ground(item)
            if self._home is not None and not _is_near(ground, self._home.place):
                item.refuse("lies away from home, where the vehicle takes off: move one to the other")
        self.takeoff_altitude_m = self._altitude_m(item)
        self._takeoff_above_sea_m = _above_sea_m(item)

    def _take_speed(self, item: Item) -> None:
        kind = item.parameters[0]
        if kind != _GROUND_SPEED:
            item.refuse(f"changes speed type {kind}: only the ground speed (type 1) can be changed")
        speed_m_s = item.number_of(2, "speed")
        if not 0 < speed_m_s <= FASTEST_M_S:
            item.refuse(f"sets {speed_m_s:g} m/s: expected a speed above 0 and up to {FASTEST_M_S:g} m/s")
        if item.parameters[2] != -1:  # -1: the throttle stays as it is
            item.require_unset(throttle=3)
        item.require_unset(4, 5, 6, 7)
        self._ground_speed_m_s = speed_m_s
        self._unused_speed = item

    def _take_landing(self, item: Item) -> None:
        item.require_unset(abort_altitude=1, precision_landing=2, yaw=4)
        item.require_unset(3)
        if _is_open(item):
            item.require_unset(altitude=7)
        else:
            ground = self._on_the_ground(item)
            if not self._is_at_home_altitude(item):
                item.refuse("lands at an altitude: set it to home's, where a landing ends on the ground")
            if not self.waypoints or not _is_near(ground, self.waypoints[-1].place):
                item.refuse("lands away from the last waypoint: add a waypoint above the place")
        self.ending = "land"

    def _is_at_home_altitude(self, item: Item) -> bool:
        """Whether it is, as far as the plan can know."""
        if item.frame in ABOVE_SEA_LEVEL and (self._home is None or self._home.altitude_m is None):
            return True
        return abs(self._height_m(item)) <= _SAME_PLACE_M

    def _place(self, item: Item) -> GeoPosition:
        if _is_open(item):
            item.refuse("has no place: latitude and longitude are left open, or 0")
        ground = self._on_the_ground(item)
        return GeoPosition(ground.latitude_deg, ground.longitude_deg, self._altitude_m(item))

    def _on_the_ground(self, item: Item) -> GeoPosition:
        latitude_deg, longitude_deg = item.number_of(5, "latitude"), item.number_of(6, "longitude")
        try:
            return checked_place("", latitude_deg, longitude_deg)
        except Refusal as refusal:
            item.refuse(f"has {refusal.problem}")

    def _altitude_m(self, item: Item) -> float:
        altitude_m = self._height_m(item)
        if not 0 < altitude_m <= HIGHEST_M:
            item.refuse(f"lies {altitude_m:g} m above home: expected more than 0 and up to {HIGHEST_M:g} m")
        return altitude_m

    def _height_m(self, item: Item) -> float:
        """Metres above home, whatever the item measures from."""
        altitude_m = item.number_of(7, "altitude")
        if item.frame in ABOVE_SEA_LEVEL:
            self.above_sea_level = self.above_sea_level or item.number
            altitude_m -= self.reference_above_sea_m
        elif item.frame not in _ABOVE_HOME:
            item.refuse(
                f"has frame {item.frame}, which is not understood: give its altitude above home or sea level"
            )
        return altitude_m


def _above_sea_m(item: Item) -> float | None:
    """The item's altitude where it counts from the sea."""
    return item.number_of(7, "altitude") if item.frame in ABOVE_SEA_LEVEL else None


def _is_open(item: Item) -> bool:
    """Whether the item names no place: ground stations write nothing, or 0 and 0."""
    return all(value is None or value == 0 for value in item.parameters[4:6])


def _is_near(place: GeoPosition, other: GeoPosition) -> bool:
    frame = LocalFrame(other)
    return ground_distance_m(frame.position(place), frame.position(other)) <= _SAME_PLACE_M
