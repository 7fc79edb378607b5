"""A plan of any format, and the notices of what is flown differently; altitudes are metres above home."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from upwash.core.geo import Circle, GeoPosition, LocalFrame
from upwash.core.vehicle.geofence import Fence, Polygon

Ending = Literal["return", "land"]

_MOST_STRETCHES = 6  # that a person reads


@dataclass(frozen=True, slots=True)
class PlanNotice:
    """What is done about items, by the numbers that the ground station shows, and why; no items: the whole plan.

    With `only_without_photos` it is so for a mission that does not take the plan's photos. `of_camera`: the items are
    commands to a camera.
    """

    items: tuple[int, ...]
    what: str
    only_without_photos: bool = False
    of_camera: bool = False

    def __str__(self) -> str:
        if not self.items:
            return self.what
        from upwash.eventlog.narration import spans  # only needed for notices

        which = spans(self.items)
        if which.count(",") >= _MOST_STRETCHES:
            which = f"{self.items[0]} to {self.items[-1]} ({len(self.items)} of them)"
        return f"{'item' if len(self.items) == 1 else 'items'} {which}: {self.what}"


class PlanNotices:
    """Collects notices, in the order of their first items; the same words about several items are one notice."""

    def __init__(self) -> None:
        self._items: dict[tuple[str, bool, bool], list[int]] = {}

    def add(self, what: str, *items: int, only_without_photos: bool = False, of_camera: bool = False) -> None:
        """Add the words about the items."""
        self._items.setdefault((what, only_without_photos, of_camera), []).extend(items)

    def all(self) -> tuple[PlanNotice, ...]:
        """All notices."""
        return tuple(PlanNotice(tuple(items), *what) for what, items in self._items.items())


@dataclass(frozen=True, slots=True)
class PhotoTrigger:
    """A command to the camera, by its item, as the file has it: numbers may make no sense.

    Photos each `every_m` metres or each `every_s` seconds of flight begin at the waypoint before it, `most` of them
    at most. They end at the waypoint before the next command, unless that `leaves_on`. `now` is a photo at once.
    `command` is the command's name, and `problem` says why it cannot be flown, as a continuation of the name.
    """

    item: int
    command: str = ""
    every_m: float | None = None
    every_s: float | None = None
    most: int | None = None
    now: bool = False
    leaves_on: bool = False
    problem: str = ""


@dataclass(frozen=True, slots=True)
class PlannedWaypoint:
    """A waypoint, the number of its item, and the speed of the way to it where the plan changes it.

    `above_sea_m` is its altitude where the plan counts it from the sea; None where it counts from home. `hold_s` is
    how long the drone hovers there. `triggers` are the commands to the camera there, in their order.
    """

    item: int
    place: GeoPosition
    ground_speed_m_s: float | None = None
    above_sea_m: float | None = None
    hold_s: float = 0.0
    triggers: tuple[PhotoTrigger, ...] = ()


@dataclass(frozen=True, slots=True)
class PlannedPolygon:
    """A geofence by its corners."""

    name: str
    inclusion: bool
    corners: tuple[GeoPosition, ...]

    def fence(self, frame: LocalFrame) -> Fence:
        """The fence in metres around home."""
        corners = tuple(frame.position(corner) for corner in self.corners)
        return Fence(self.name, Polygon(corners), self.inclusion)


@dataclass(frozen=True, slots=True)
class PlannedCircle:
    """A geofence around a place."""

    name: str
    inclusion: bool
    centre: GeoPosition
    radius_m: float

    def fence(self, frame: LocalFrame) -> Fence:
        """The fence in metres around home."""
        return Fence(self.name, Circle(frame.position(self.centre), self.radius_m), self.inclusion)


@dataclass(frozen=True, slots=True)
class FlightPlan:
    """A flight: take-off, waypoints, and the end; `home` is None where the plan leaves it open.

    `home_above_sea_m` is None where the plan does not know it. `reference_above_sea_m` is the altitude of home from
    which the altitudes above the sea were converted: that of the plan's home, or else an assumed one. `notices` say
    what of the file is flown otherwise than it says, or not at all. A photo takes `photo_s`.
    """

    home: GeoPosition | None
    waypoints: tuple[PlannedWaypoint, ...]
    fences: tuple[PlannedPolygon | PlannedCircle, ...] = ()
    takeoff_altitude_m: float | None = None
    ground_speed_m_s: float | None = None
    ending: Ending = "return"
    takeoff_above_sea_m: float | None = None  # or of the first waypoint without a take-off; None from home
    above_sea_level: int | None = None  # the first item whose altitude counts from the sea
    home_above_sea_m: float | None = None
    reference_above_sea_m: float = 0.0
    photo_s: float = 0.0
    notices: tuple[PlanNotice, ...] = ()
