"""Mission items as MAVLink has them; their commands are flown, left out with a notice, or refused with a remedy."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import NoReturn

from upwash.core.geo import GeoPosition, LocalFrame, ground_distance_m

MOST_ITEMS = 10_000
HIGHEST_M = 10_000.0
FASTEST_M_S = 100.0

ABOVE_SEA_LEVEL = (0, 5)  # MAV_FRAME
ABOVE_HOME = (3, 6)
ABOVE_TERRAIN = (10, 11)


class Command(IntEnum):
    """The commands that are flown."""

    WAYPOINT = 16
    LOITER_TIME = 19
    RETURN = 20
    LAND = 21
    TAKEOFF = 22
    LOITER_TO_ALT = 31
    SPLINE_WAYPOINT = 82
    DELAY = 93
    CONDITION_DELAY = 112
    CHANGE_SPEED = 178
    CONDITION_GATE = 4501


SET_HOME = 179
FENCE_ENABLE = 207

_PHOTOS = "left out: the mission takes its photos itself"
TRIGGERED = f"{_PHOTOS}, at each waypoint; with mission.photos = {{}} the plan's triggers take them in flight"
_FILM = "left out: it films, and the mission takes photos"
_AIM = "left out: the flight points no camera; a mission does with drone.payload"
_NOSE = "left out: the vehicle turns its nose as its own settings say"
_MARK = "left out: it marks a place in the plan, and commands nothing"

OF_CAMERA = frozenset({202, 203, 206, 214, 260, 530, 531, 532, 534, 2000, 2001, 2003, 2500, 2501})
LEFT_OUT: Mapping[int, str] = {
    **dict.fromkeys((202, 530, 531, 532, 534), _PHOTOS),
    **dict.fromkeys((2500, 2501), _FILM),
    **dict.fromkeys((80, 195, 196, 197, 201, 204, 205, 1000, 1001), _AIM),
    115: _NOSE,
    **dict.fromkeys((189, 600), _MARK),
    114: "left out: a command that it delays takes effect at once",
}

_MOVES = (
    "moves something on the vehicle: remove it from the plan, and have the mission send it where that is safe "
    "(drone.payload)"
)
_REPEATS = "repeats a part of the plan: remove it, and plan the waypoints as often as they are flown"
_VTOL = "is for a VTOL: plan the flight for a multicopter, with Takeoff (22) and Land (21)"

_REFUSED: Mapping[int, str] = {
    17: "hovers until a person acts: remove it, and end the plan with Return To Launch or Land",
    18: "circles a place, where an obstacle may stand: remove it, and plan the circle as waypoints",
    **dict.fromkeys((84, 85, 3000), _VTOL),
    92: "hands the vehicle to another program: remove it",
    **dict.fromkeys((177, 601), _REPEATS),
    179: "moves the place of the return: remove it, and plan the flight from where the vehicle takes off",
    **dict.fromkeys((94, 181, 182, 183, 184, 208, 211, 216, 218, 42600), _MOVES),
    207: "switches the vehicle's own fence on: switch it on at the vehicle before the flight (FENCE_ENABLE 1 of an "
    "ArduPilot), and remove the item",
}


def why_refused(command: int) -> str:
    """What to do about a command that cannot be flown; continues the command's name."""
    return _REFUSED.get(
        command,
        "is not understood: remove it; a plan may have waypoints, a take-off, hold times, changes of the ground "
        "speed, and a return or a landing at its end",
    )


class PlanRefusal(Exception):
    """Part of a plan that is not understood: where, and what is wrong with it."""

    def __init__(self, where: str, problem: str) -> None:
        self.where = where
        self.problem = problem
        super().__init__(f"{where}: {problem}")


@dataclass(frozen=True, slots=True)
class PlanHome:
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

    @property
    def name(self) -> str:
        """The MAVLink name of the command, and its number."""
        from pymavlink.dialects.v20 import ardupilotmega as mavlink  # only needed for refusals and notices

        entry = mavlink.enums["MAV_CMD"].get(self.command)
        return f"{entry.name if entry else 'an unknown command'} ({self.command})"

    @property
    def is_open(self) -> bool:
        """Whether it names no place: ground stations write nothing, or 0 and 0."""
        return not any(self.value(index) for index in (5, 6))

    def refuse(self, problem: str) -> NoReturn:
        """Raise the refusal of this item; the problem continues the command's name."""
        raise PlanRefusal(f"item {self.number}", f"{self.name} {problem}")

    def value(self, index: int) -> float | None:
        """A parameter, counted from 1; None where it is left open, which ground stations write as nothing or NaN."""
        value = self.parameters[index - 1]
        return None if value is None or math.isnan(value) else value

    def number_of(self, index: int, what: str) -> float:
        """A parameter, counted from 1, that has to be there and to be a number."""
        value = self.parameters[index - 1]
        if value is None or not math.isfinite(value):
            self.refuse(f"has {what} {'nothing' if value is None else value}: expected a number")
        return value

    def require_unset(self, *indexes: int, **named: int) -> None:
        """Refuse a parameter that is set to another number than 0."""
        for what, index in [*((f"parameter {index}", index) for index in indexes), *named.items()]:
            if value := self.value(index):
                self.refuse(f"has {what.replace('_', ' ')} {value:g}, which is not understood: set it to 0")

    def place(self) -> GeoPosition:
        """The place on the ground; raises PlanRefusal for what is none."""
        latitude_deg, longitude_deg = self.number_of(5, "latitude"), self.number_of(6, "longitude")
        try:
            return checked_place("", latitude_deg, longitude_deg)
        except PlanRefusal as refusal:
            self.refuse(f"has {refusal.problem}")


def checked_place(where: str, latitude_deg: float, longitude_deg: float) -> GeoPosition:
    """A place on the Earth; raises PlanRefusal for what is none."""
    if not abs(latitude_deg) <= 90:
        raise PlanRefusal(where, f"latitude {latitude_deg:g}: latitudes go from -90 to 90 degrees")
    if not abs(longitude_deg) <= 180:
        raise PlanRefusal(where, f"longitude {longitude_deg:g}: longitudes go from -180 to 180 degrees")
    return GeoPosition(latitude_deg, longitude_deg)


def home_at(
    where: str, latitude_deg: float | None, longitude_deg: float | None, altitude_m: float | None = None
) -> PlanHome | None:
    """A plan's home; raises PlanRefusal for what is no place.

    A ground station writes nothing, or 0, where it knew no home or no altitude of the terrain: None for either.
    """
    latitude_deg, longitude_deg, altitude_m = latitude_deg or 0.0, longitude_deg or 0.0, altitude_m or 0.0
    place = checked_place(where, latitude_deg, longitude_deg)
    if not abs(altitude_m) <= HIGHEST_M:
        raise PlanRefusal(
            where, f"altitude {altitude_m:g} m: expected up to {HIGHEST_M:g} metres above sea level"
        )
    if (latitude_deg, longitude_deg) == (0, 0):
        return None
    return PlanHome(place.latitude_deg, place.longitude_deg, altitude_m or None)


def distance_m(place: GeoPosition, other: GeoPosition) -> float:
    """The distance between two places on the ground, in metres."""
    frame = LocalFrame(other)
    return ground_distance_m(frame.position(place), frame.position(other))
