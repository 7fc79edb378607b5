"""The vehicle's fence: a greatest height, a circle around home, and areas to keep to or to keep out of."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import IntEnum

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import Position, ground_distance_m
from upwash.vehicle.boot import NOTICE, Text
from upwash.vehicle.parameters import Parameters

_HEIGHT, _CIRCLE, _AREAS = 1, 2, 4  # FENCE_TYPE's bits


class Breach(IntEnum):
    """FENCE_BREACH."""

    NONE = 0
    HEIGHT = 2
    BOUNDARY = 3


@dataclass(frozen=True, slots=True)
class Area:
    """A polygon, or a circle around its only corner; to be kept to, or out of."""

    corners: tuple[Position, ...]
    radius_m: float | None
    inclusion: bool

    def allows(self, position: Position) -> bool:
        """Whether the vehicle may be there."""
        return self._holds(position) is self.inclusion

    def _holds(self, position: Position) -> bool:
        if self.radius_m is not None:
            return ground_distance_m(position, self.corners[0]) <= self.radius_m
        inside = False
        for one, other in itertools.pairwise((*self.corners, self.corners[0])):
            if (one.north_m > position.north_m) is not (other.north_m > position.north_m):
                share = (position.north_m - one.north_m) / (other.north_m - one.north_m)
                if position.east_m < one.east_m + share * (other.east_m - one.east_m):
                    inside = not inside
        return inside


_POLYGONS = {
    mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION: True,
    mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION: False,
}
_CIRCLES = {
    mavlink.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION: True,
    mavlink.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION: False,
}
_FEWEST_CORNERS = 3


@dataclass(frozen=True, slots=True)
class FenceItem:
    """One item of the fence as it was uploaded: a circle, or a corner of a polygon with `number` corners."""

    command: int
    number: float
    place: Position
    latitude_e7: int
    longitude_e7: int


def read_areas(items: Sequence[FenceItem]) -> tuple[Area, ...]:
    """The areas that the items describe; ValueError where they describe none."""
    return tuple(_areas(items))


def _areas(items: Sequence[FenceItem]) -> Iterator[Area]:
    left = list(items)
    while left:
        first = left[0]
        if first.command in _CIRCLES and first.number > 0:
            yield Area((first.place,), first.number, _CIRCLES[first.command])
            left = left[1:]
            continue
        count = int(first.number)
        corners = left[:count]
        alike = all((item.command, item.number) == (first.command, first.number) for item in corners)
        if first.command not in _POLYGONS or not _FEWEST_CORNERS <= count == len(corners) or not alike:
            raise ValueError(f"Invalid vertex count ({count})")
        yield Area(tuple(item.place for item in corners), None, _POLYGONS[first.command])
        left = left[count:]


def breach(parameters: Parameters, areas: Sequence[Area], position: Position) -> Breach:
    """Which part of the fence is not kept to at the place; home is at its origin."""
    kinds = int(parameters["FENCE_TYPE"]) if parameters["FENCE_ENABLE"] else 0
    if kinds & _HEIGHT and position.altitude_m > parameters["FENCE_ALT_MAX"]:
        return Breach.HEIGHT
    home = Position(0.0, 0.0)
    if kinds & _CIRCLE and ground_distance_m(position, home) > parameters["FENCE_RADIUS"]:
        return Breach.BOUNDARY
    if kinds & _AREAS and not all(area.allows(position) for area in areas):
        return Breach.BOUNDARY
    return Breach.NONE


class FenceWatch:
    """The fence that it has, and whether it is kept to."""

    def __init__(self, parameters: Parameters, now_s: float) -> None:
        self.items: tuple[FenceItem, ...] = ()
        self.breach = Breach.NONE
        self.breaches = 0  # so far
        self.breached_s = now_s  # the last time
        self._areas: tuple[Area, ...] = ()
        self._parameters = parameters

    def set(self, items: tuple[FenceItem, ...]) -> None:
        """Takes the areas of a new fence; ValueError where the items describe none."""
        self._areas = read_areas(items)
        self.items = items
        self._parameters.set("FENCE_TOTAL", len(items))

    def allows(self, position: Position) -> bool:
        """Whether the fence lets it fly there."""
        return breach(self._parameters, self._areas, position) is Breach.NONE

    def selects_nothing(self) -> bool:
        """Whether it is switched on and has nothing to keep to."""
        kinds = int(self._parameters["FENCE_TYPE"]) if self._parameters["FENCE_ENABLE"] else -1
        return kinds == 0 or (kinds == _AREAS and not self._areas)

    def needs_place(self) -> bool:
        """Whether the fence cannot be watched without knowing the place."""
        kinds = int(self._parameters["FENCE_TYPE"]) if self._parameters["FENCE_ENABLE"] else 0
        return bool(kinds & _CIRCLE) or bool(kinds & _AREAS and self._areas)

    def watch(self, position: Position | None, now_s: float) -> Sequence[Text]:
        """What it says about the place where it flies; None where it does not fly."""
        found = Breach.NONE if position is None else breach(self._parameters, self._areas, position)
        if found is self.breach:
            return ()
        self.breach = found
        if found is Breach.NONE:
            return (Text("Fence breach cleared", NOTICE),)
        self.breaches += 1
        self.breached_s = now_s
        return (Text(f"{'Max Alt' if found is Breach.HEIGHT else 'Circle'} fence breached", NOTICE),)
