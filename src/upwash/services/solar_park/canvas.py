"""A drawing of a piece of ground, seen from straight above."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from cv2.typing import MatLike
from numpy.random import Generator

from upwash.services.solar_park.geometry import Area

Bgr = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Canvas:
    """Pixels of an area, north up; the verbs paint on them."""

    pixels: MatLike
    area: Area
    px_per_m: float

    def at(self, east_m: float, north_m: float) -> tuple[float, float]:
        """The pixel, right and down, of a place."""
        return (east_m - self.area.west_m) * self.px_per_m, (self.area.north_m - north_m) * self.px_per_m

    def length_px(self, length_m: float) -> int:
        """A length in whole pixels, at least one."""
        return max(1, round(length_m * self.px_per_m))

    def window(self, area: Area) -> MatLike:
        """A view of what of the area lies on the canvas."""
        (left, top), (right, bottom) = self.at(area.west_m, area.north_m), self.at(area.east_m, area.south_m)
        window: MatLike = self.pixels[
            max(0, round(top)) : max(0, round(bottom)), max(0, round(left)) : max(0, round(right))
        ]
        return window

    def around(self, east_m: float, north_m: float, half_width_m: float, half_height_m: float) -> MatLike:
        """A view of what lies around a place."""
        return self.window(
            Area(east_m - half_width_m, north_m + half_height_m, 2 * half_width_m, 2 * half_height_m)
        )

    def paste(self, picture: MatLike, east_m: float, north_m: float) -> MatLike:
        """Puts the picture's upper left corner at a place; returns what of the canvas it covers."""
        x, y = self.at(east_m, north_m)
        left, top = round(x), round(y)
        shown = picture[max(0, -top) :, max(0, -left) :]
        place: MatLike = self.pixels[max(0, top) :, max(0, left) :][: shown.shape[0], : shown.shape[1]]
        place[:] = shown[: place.shape[0], : place.shape[1]]
        return place

    def dot(self, east_m: float, north_m: float, radius_m: float, colour: Bgr) -> None:
        """Fills a circle."""
        # Four more bits of position and radius: a dot of half a pixel is fainter than one of a whole.
        x, y = self.at(east_m, north_m)
        centre = (round(16 * x), round(16 * y))
        radius_px = max(8, round(16 * radius_m * self.px_per_m))
        cv2.circle(self.pixels, centre, radius_px, colour, -1, cv2.LINE_AA, 4)

    def line(self, places_m: Sequence[tuple[float, float]], width_m: float, colour: Bgr) -> None:
        """Draws a line through the places, given as east and north."""
        points = np.array([self.at(*place) for place in places_m])
        cv2.polylines(
            self.pixels,
            [np.round(16 * points).astype(np.int32)],
            isClosed=False,
            color=colour,
            thickness=self.length_px(width_m),
            lineType=cv2.LINE_AA,
            shift=4,
        )

    def polygon(self, places_m: Sequence[tuple[float, float]], colour: Bgr) -> None:
        """Fills a polygon."""
        points = np.array([self.at(*place) for place in places_m])
        cv2.fillPoly(self.pixels, [np.round(16 * points).astype(np.int32)], colour, cv2.LINE_AA, 4)


def blend(window: MatLike, colour: MatLike, share: MatLike) -> None:
    """Mixes a colour into a view of an image, in place; `share` says how much of it, pixel by pixel."""
    opacity = share[..., np.newaxis].astype(np.float32)
    window[:] = np.clip(window + opacity * (colour - window.astype(np.float32)), 0, 255).astype(np.uint8)


def colour_of(levels: MatLike, stops: Sequence[tuple[float, tuple[int, int, int]]]) -> MatLike:
    """Levels of 0 to 255 as colours, along the gradient through the given stops."""
    at = [position * 255 for position, _ in stops]
    channels = [np.interp(range(256), at, [colour[i] for _, colour in stops]) for i in range(3)]
    table = np.stack(channels, axis=1).astype(np.uint8).reshape(1, 256, 3)
    return cv2.LUT(cv2.merge([np.clip(levels, 0, 255).astype(np.uint8)] * 3), table)


def cloud(rng: Generator, shape: tuple[int, int], grain_px: float, amplitude: float) -> MatLike:
    """Smooth noise around 0 whose bumps are `grain_px` wide."""
    height_px, width_px = shape
    bumps = (int(height_px / grain_px) + 3, int(width_px / grain_px) + 3)
    coarse = rng.normal(0, amplitude / 2, bumps).astype(np.float32)
    return cv2.resize(coarse, (width_px, height_px), interpolation=cv2.INTER_CUBIC)


def eccentricity(window: MatLike) -> MatLike:
    """How far off the middle each pixel is: 0 there, 1 at the nearest points of the border."""
    height_px, width_px = window.shape[:2]
    down, across = np.mgrid[-1 : 1 : height_px * 1j, -1 : 1 : width_px * 1j].astype(np.float32)
    distance: MatLike = np.hypot(across, down)
    return distance
