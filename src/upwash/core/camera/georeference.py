"""From a box in a photo to a place on the ground, with how far from there the object may be.

    pixel --lens--> direction --mount, attitude--> line of sight --ground--> place

The ground near the photo is a plane. Each input has an error: the vehicle's position, its altitude above the ground,
its tilt and heading, the focal length, and the box. The error of a place adds up their variances, carried to the
ground to first order. Vectors are east, north and up.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Annotated

import msgspec

from upwash.core.camera.lens import Lens, Vector
from upwash.core.geo import FARTHEST_M, Metres, Position
from upwash.core.vehicle.telemetry import Attitude

_Sigma = Annotated[float, msgspec.Meta(ge=0, le=1e6)]
_Pixels = Annotated[int, msgspec.Meta(ge=1, le=1_000_000)]
_Slope = Annotated[float, msgspec.Meta(ge=-100, le=100)]
_LOWEST_SIGHT_DEG = 5.0  # below the ground's own plane: what lies nearer to its horizon has no place
_UNKNOWN_HEADING_DEG = 60.0  # north is taken for up: as far as linear errors reach
_LEVEL_ASSUMED_DEG = 6.0  # a multicopter in wind leans that far
_LOWEST_M = 0.1
_BOX_PX = 1.0
_BOX_SHARE = 0.05  # of a box's size
_CUT_SHARE = 0.3  # where the photo's edge cuts the object off
_EDGE_PX = 2.0


class Ground(msgspec.Struct, frozen=True, omit_defaults=True):
    """The ground near a photo: its altitude above home below the drone, its slopes, and its standard error.

    `assumes` names an assumption, "" without one.
    """

    altitude_m: Metres = 0.0
    slope_east: _Slope = 0.0
    slope_north: _Slope = 0.0
    error_m: _Sigma = 0.5
    assumes: str = ""


def level_ground(_at: Position) -> Ground:
    """Ground that is level with home, as without any terrain."""
    return Ground()


class Accuracy(msgspec.Struct, frozen=True, omit_defaults=True):
    """Standard errors of a photo's pose: of its position to each side, its altitude, its tilt and its heading."""

    position_m: _Sigma = 1.5
    altitude_m: _Sigma = 1.0
    tilt_deg: _Sigma = 1.5
    heading_deg: _Sigma = 3.0


@dataclass(frozen=True, slots=True)
class Place:
    """Where an object lies on the ground; with 95 % probability within `error_m` of there.

    `variance` is east's, east with north's, and north's, in square metres; `apart_m` the standard error against
    the other places of the photo. `assumes` names an assumption, "" without one.
    """

    position: Position
    error_m: float
    variance: tuple[float, float, float]
    apart_m: float
    assumes: str = ""

    def moved(self, east_m: float, north_m: float) -> Place:
        """The place with these metres added to its position."""
        at = self.position
        return replace(self, position=Position(at.east_m + east_m, at.north_m + north_m, at.altitude_m))


@dataclass(frozen=True, slots=True)
class Unplaced:
    """An object without a place, and why."""

    why: str


class PhotoGeometry(msgspec.Struct, frozen=True, omit_defaults=True):
    """What decides where the pixels of a photo lie: where it was taken from, how it was held, lens and ground.

    `attitude` is the vehicle's, or the gimbal's that carries the camera; without it `heading_deg` alone may be known.
    """

    position: Position
    size_px: tuple[_Pixels, _Pixels]
    lens: Lens
    attitude: Attitude | None = None
    heading_deg: float | None = None
    ground: Ground = Ground()
    accuracy: Accuracy = Accuracy()

    @property
    def sight(self) -> Sight | Unplaced:
        """The photo's geometry made ready for its boxes, or why nothing on it has a place."""
        ground, lens, accuracy = self.ground, self.lens, self.accuracy
        height_m = self.position.altitude_m - ground.altitude_m
        if not height_m > _LOWEST_M:
            return Unplaced("the drone was not above the ground")
        if lens.fov_deg is None and lens.focal_px is None:
            return Unplaced("the camera's lens is unknown")
        if not lens.fits(self.size_px):
            return Unplaced("the calibration is of pictures with another ratio of width to height")
        tilt_deg, heading_deg, assumes = accuracy.tilt_deg, accuracy.heading_deg, ""
        if lens.up_deg is not None:
            attitude = Attitude(0.0, 0.0, lens.up_deg)
        elif self.attitude is not None:
            attitude = self.attitude
        elif self.heading_deg is not None:
            attitude = Attitude(0.0, 0.0, self.heading_deg)
            tilt_deg, assumes = max(tilt_deg, _LEVEL_ASSUMED_DEG), "that the drone was level"
        else:
            attitude = Attitude(0.0, 0.0, 0.0)
            tilt_deg, heading_deg = max(tilt_deg, _LEVEL_ASSUMED_DEG), _UNKNOWN_HEADING_DEG
            assumes = "that the drone was level and its nose pointed north"
        assumes = " and ".join(filter(None, (assumes, ground.assumes)))
        right, down, ahead = (_turned(axis, attitude) for axis in lens.axes)
        return Sight(self, (right, down, ahead), height_m, tilt_deg, heading_deg, assumes)

    def footprint_m(self) -> list[tuple[float, float]] | None:
        """The photo's corners on the ground, east and north of home, clockwise from its upper left.

        None if they are unknown, or one of them does not lie on the ground.
        """
        sight = self.sight
        if isinstance(sight, Unplaced) or sight.heading_deg >= _UNKNOWN_HEADING_DEG:
            return None
        width, height = self.size_px
        here, found = self.position, list[tuple[float, float]]()
        for corner in ((0, 0), (width, 0), (width, height), (0, height)):
            if (line := sight.line_to(*corner)) is None:
                return None
            found.append((here.east_m + line[0], here.north_m + line[1]))
        return found


@dataclass(frozen=True, slots=True)
class Sight:
    """A photo's geometry made ready: `axes` are right, down and ahead in the photo, east, north and up."""

    photo: PhotoGeometry
    axes: tuple[Vector, Vector, Vector]
    height_m: float
    tilt_deg: float
    heading_deg: float
    assumes: str

    @property
    def angles_deg(self) -> tuple[float, float, float]:
        """Yaw, pitch and roll of the photo, as mapping programs count them.

        Up in the photo points along the yaw, clockwise from north; a pitch of 0 looks straight down, of 90 ahead.
        """
        right, down, ahead = self.axes
        pitch = math.asin(max(-1.0, min(1.0, -down[2])))
        yaw, roll = math.atan2(-down[0], -down[1]), math.atan2(-right[2], -ahead[2])
        return math.degrees(yaw) % 360, math.degrees(pitch), math.degrees(roll)

    def line_to(self, x_px: float, y_px: float) -> Vector | None:
        """The line from the camera to the pixel's place on the ground; None if the ground is not seen there."""
        seen = self.photo.lens.direction(x_px, y_px, self.photo.size_px)
        return None if seen is None else self._line_along(*seen)

    def _line_along(self, x: float, y: float) -> Vector | None:
        ground = self.photo.ground
        east, north, up = (
            x * right + y * down + ahead for right, down, ahead in zip(*self.axes, strict=True)
        )
        sinks = ground.slope_east * east + ground.slope_north * north - up
        if not sinks > math.sin(math.radians(_LOWEST_SIGHT_DEG)) * math.hypot(east, north, up):
            return None
        length = self.height_m / sinks
        return length * east, length * north, length * up

    def place_of(
        self, x_px: float, y_px: float, width_px: float = 0.0, height_px: float = 0.0
    ) -> Place | Unplaced:
        """Where the middle of a box lies on the ground, given its middle and size; a point has no size."""
        wide_px, high_px = self.photo.size_px
        if not (0 <= x_px <= wide_px and 0 <= y_px <= high_px):
            return Unplaced("the box lies beside the photo")
        seen = self.photo.lens.direction(x_px, y_px, self.photo.size_px)
        if seen is None:
            return Unplaced("the lens's distortion does not fit that part of the photo")
        line = self._line_along(*seen)
        if line is None:
            return Unplaced("the box is too near the horizon to lie on the ground")
        here = self.photo.position
        east_m, north_m = here.east_m + line[0], here.north_m + line[1]
        if not max(abs(east_m), abs(north_m)) <= FARTHEST_M:
            return Unplaced("the place is too far from home")
        shared = _sum(self._shared_errors(line))
        own = _sum(self._own_errors(line, (x_px, width_px), (y_px, height_px)))
        variance = (shared[0] + own[0], shared[1] + own[1], shared[2] + own[2])
        bend_m = math.radians(self.tilt_deg) * (line[0] ** 2 + line[1] ** 2) / self.height_m
        error_m = radius_of_95(variance)
        if not error_m <= FARTHEST_M:
            return Unplaced("the place is too unsure")
        return Place(
            Position(east_m, north_m, here.altitude_m + line[2]),
            error_m=error_m,
            variance=variance,
            apart_m=math.sqrt((own[0] + own[2] + bend_m**2) / 2),
            assumes=self.assumes,
        )

    def _shared_errors(self, line: Vector) -> Iterator[complex]:
        """How far the standard errors of position and tilt move the place, east and north: about all places alike."""
        accuracy = self.photo.accuracy
        east, north, up = line
        tilt = math.radians(self.tilt_deg)
        yield complex(accuracy.position_m, 0.0)
        yield complex(0.0, accuracy.position_m)
        yield self._moved(line, 0.0, -tilt * up, tilt * north)
        yield self._moved(line, tilt * up, 0.0, -tilt * east)

    def _own_errors(self, line: Vector, *sides: tuple[float, float]) -> Iterator[complex]:
        """The same of what moves each place otherwise; a box by its middle and size to each side."""
        altitude_m = math.hypot(self.photo.accuracy.altitude_m, self.photo.ground.error_m)
        yield self._moved(line, 0.0, 0.0, altitude_m)
        turn = math.radians(self.heading_deg)
        yield complex(-turn * line[1], turn * line[0])
        right, down, ahead = self.axes
        depth_m = sum(part * along for part, along in zip(line, ahead, strict=True))
        lens = self.photo.lens
        across = [part - depth_m * along for part, along in zip(line, ahead, strict=True)]
        yield self._moved(line, *(lens.scale_error * part for part in across))
        m_per_px = depth_m / lens.focal_in(self.photo.size_px)
        for axis, (middle_px, size_px), end_px in zip((right, down), sides, self.photo.size_px, strict=True):
            to_edge_px = min(middle_px, end_px - middle_px) - size_px / 2
            share = _BOX_SHARE if to_edge_px > _EDGE_PX else _CUT_SHARE
            error_m = m_per_px * math.hypot(_BOX_PX, share * size_px)
            yield self._moved(line, *(error_m * part for part in axis))

    def _moved(self, line: Vector, east: float, north: float, up: float) -> complex:
        """How far the place moves, east and north, where the end of the line moves so."""
        ground = self.photo.ground
        rises = up - ground.slope_east * east - ground.slope_north * north
        share = rises / self.height_m  # the line itself sinks by this height, over the ground's plane
        return complex(east + share * line[0], north + share * line[1])


def _turned(vector: Vector, attitude: Attitude) -> Vector:
    """A vector forward, right and down from a vehicle with that attitude: east, north and up."""
    forward, right, down = vector
    roll, pitch, yaw = (
        math.radians(angle) for angle in (attitude.roll_deg, attitude.pitch_deg, attitude.yaw_deg)
    )
    right, down = (
        right * math.cos(roll) - down * math.sin(roll),
        right * math.sin(roll) + down * math.cos(roll),
    )
    forward, down = (
        forward * math.cos(pitch) + down * math.sin(pitch),
        down * math.cos(pitch) - forward * math.sin(pitch),
    )
    return (
        forward * math.sin(yaw) + right * math.cos(yaw),
        forward * math.cos(yaw) - right * math.sin(yaw),
        -down,
    )


def _sum(errors: Iterable[complex]) -> tuple[float, float, float]:
    """The variances of independent errors together."""
    known = list(errors)
    easts, norths = (sum(error.real**2 for error in known), sum(error.imag**2 for error in known))
    return easts, sum(error.real * error.imag for error in known), norths


def radius_of_95(variance: tuple[float, float, float]) -> float:
    """The radius around the mean that holds 95 % of a normal distribution of the plane with these variances.

    Within 0.5 % of the exact radius, which has no closed form: 1.96 standard errors on a line, 2.448 on a circle.
    """
    easts, mixed, norths = variance
    middle, half = (easts + norths) / 2, math.hypot((easts - norths) / 2, mixed)
    longest = math.sqrt(middle + half)
    ratio = math.sqrt(max(0.0, middle - half)) / longest if longest > 0 else 0.0
    return longest * (1.960 + ratio**2 * (0.114 + 0.374 * ratio))
