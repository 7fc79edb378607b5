"""Mission items, as MAVLink has them, and what of them no plan can do without."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NoReturn

from upwash.core.geo import GeoPosition, LocalFrame, ground_distance_m
from upwash.plans.commands import command_name

MOST_ITEMS = 10_000
HIGHEST_M = 10_000.0
FASTEST_M_S = 100.0

ABOVE_SEA_LEVEL = (0, 5)  # MAV_FRAME
ABOVE_HOME = (3, 6)
ABOVE_TERRAIN = (10, 11)


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

    @property
    def name(self) -> str:
        """The command's name and number."""
        return f"{command_name(self.command)} ({self.command})"

    @property
    def is_open(self) -> bool:
        """Whether it names no place: ground stations write nothing, or 0 and 0."""
        return not any(self.value(index) for index in (5, 6))

    def refuse(self, problem: str) -> NoReturn:
        """Raises the refusal of this item; the problem goes on from the command's name."""
        raise Refusal(f"item {self.number}", f"{self.name} {problem}")

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
        """Refuses a parameter that is neither left open nor 0."""
        for what, index in [*((f"parameter {index}", index) for index in indexes), *named.items()]:
            if value := self.value(index):
                self.refuse(f"has {what.replace('_', ' ')} {value:g}, which is not understood: set it to 0")

    def place(self) -> GeoPosition:
        """The place on the ground; raises Refusal for what is none."""
        latitude_deg, longitude_deg = self.number_of(5, "latitude"), self.number_of(6, "longitude")
        try:
            return checked_place("", latitude_deg, longitude_deg)
        except Refusal as refusal:
            self.refuse(f"has {refusal.problem}")


def checked_place(where: str, latitude_deg: float, longitude_deg: float) -> GeoPosition:
    """A place on the Earth; raises Refusal for what is none."""
    if not abs(latitude_deg) <= 90:
        raise Refusal(where, f"latitude {latitude_deg:g}: latitudes go from -90 to 90 degrees")
    if not abs(longitude_deg) <= 180:
        raise Refusal(where, f"longitude {longitude_deg:g}: longitudes go from -180 to 180 degrees")
    return GeoPosition(latitude_deg, longitude_deg)


def home_at(
    where: str, latitude_deg: float | None, longitude_deg: float | None, altitude_m: float | None = None
) -> Home | None:
    """A plan's home; raises Refusal for what is no place.

    A ground station writes nothing, or 0, where it knew no home or no altitude of the terrain: None for either.
    """
    latitude_deg, longitude_deg, altitude_m = latitude_deg or 0.0, longitude_deg or 0.0, altitude_m or 0.0
    place = checked_place(where, latitude_deg, longitude_deg)
    if not abs(altitude_m) <= HIGHEST_M:
        raise Refusal(
            where, f"altitude {altitude_m:g} m: expected up to {HIGHEST_M:g} metres above sea level"
        )
    if (latitude_deg, longitude_deg) == (0, 0):
        return None
    return Home(place.latitude_deg, place.longitude_deg, altitude_m or None)


def distance_m(place: GeoPosition, other: GeoPosition) -> float:
    """Between two places on the ground."""
    frame = LocalFrame(other)
    return ground_distance_m(frame.position(place), frame.position(other))
