"""Photos of the park as a drone's camera takes them, with the truth about what is on them.

The camera is a Raspberry Pi's Camera Module 2: 62.2 degrees wide. It looks straight down, less a few degrees
in wind. The ground in its view is drawn on a canvas, which is then seen through the lens.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from cv2.typing import MatLike
from numpy.random import Generator

from upwash.services import Box
from upwash.services.solar_park.canvas import Canvas
from upwash.services.solar_park.geometry import Area, HotSpot, Park, Rates, Table
from upwash.services.solar_park.ground import draw_ground
from upwash.services.solar_park.tables import draw_tables

WIDTH_PX, HEIGHT_PX = 1440, 1080
LABELS = ("hot-spot", "broken-module")
LOWEST_M, HIGHEST_M = 3.0, 120.0  # where photos can be rendered from

_WIDTH_OF_ALTITUDE = 2 * math.tan(math.radians(62.2 / 2))
_TARGET_BYTES, _CLOSE_BYTES = 425_000, 15_000
_QUALITY_OF_SIZE = 14.0  # steps of quality for a file e times as large
_LEAST_VISIBLE = 0.25  # share of a fault's area that makes it part of the truth
_TILT_PX = 24.0
_MODULES_PER_M2 = 0.35


class TrueBox(Box, frozen=True, kw_only=True):
    """What truly is in a photo, and where."""

    label: str


@dataclass(frozen=True, slots=True)
class RenderedPhoto:
    """A JPEG of 1440 x 1080 pixels and 400 to 450 KB, and what is on it."""

    jpeg: bytes
    truth: tuple[TrueBox, ...]


@dataclass(frozen=True, slots=True)
class View:
    """Where the camera is, above ground; `heading_deg`, clockwise from north, is up in the photo."""

    east_m: float
    north_m: float
    altitude_m: float
    heading_deg: float = 0.0


def photograph(park: Park, view: View, *, shot: int = 0) -> RenderedPhoto:
    """The photo from there; below 3 m and above 120 m as from the nearest of these.

    The park, its light and its faults follow from its seed, what the wind and the sensor add from `shot` too.
    """
    rng = np.random.default_rng([park.seed, 4, shot])
    width_m = _WIDTH_OF_ALTITUDE * min(max(view.altitude_m, LOWEST_M), HIGHEST_M)
    footprint_m = _footprint(rng, view, width_m)
    canvas = _canvas(footprint_m, px_per_m=WIDTH_PX / width_m)
    tables = list(park.tables(canvas.area))
    draw_ground(canvas, park, tables)
    draw_tables(canvas, tables)
    _reflect_sky(canvas, np.random.default_rng([park.seed, 5, shot]), tables)
    _shade(canvas, np.random.default_rng([park.seed, 6, shot]))
    lens = _lens(canvas, footprint_m)
    seen = cv2.warpPerspective(canvas.pixels, lens, (WIDTH_PX, HEIGHT_PX), borderMode=cv2.BORDER_REFLECT)
    return RenderedPhoto(_encode(_expose(seen, rng)), _truth(canvas, tables, lens))


def render_photo(seed: int, *, altitude_m: float | None = None) -> RenderedPhoto:
    """A photo of a park of its own, in any light, from `altitude_m` or, as in training and tests, from 9 to 20 m.

    The expected number of faults on it is the same at every altitude.
    """
    rng = np.random.default_rng([seed, 7])
    usual_m = rng.uniform(9, 20)  # drawn in any case: all else of a seed stays the same
    altitude_m = usual_m if altitude_m is None else min(max(altitude_m, LOWEST_M), HIGHEST_M)
    modules = _MODULES_PER_M2 * 0.75 * (_WIDTH_OF_ALTITUDE * altitude_m) ** 2
    rates = Rates(hot_spot=rng.uniform(0, 6) / modules, broken=rng.uniform(0, 3) / modules)
    heading_deg = rng.choice([0, 90, 180, 270]) + rng.uniform(-10, 10)
    east_m, north_m = rng.uniform(-1000, 1000, 2)
    return photograph(Park(seed, rates), View(east_m, north_m, altitude_m, heading_deg))


# --- from the ground to the lens -------------------------------------------------------------------


def _footprint(rng: Generator, view: View, width_m: float) -> MatLike:
    """The places, east and north, that the photo's corners show, clockwise from the upper left."""
    half = np.array([width_m, width_m * HEIGHT_PX / WIDTH_PX]) / 2
    tilt_m = rng.uniform(-_TILT_PX, _TILT_PX, (4, 2)) * width_m / WIDTH_PX
    corners = np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]]) * half + tilt_m
    turn = math.radians(view.heading_deg)
    turned = corners @ np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    footprint: MatLike = turned + np.array([view.east_m, view.north_m])
    return footprint


def _canvas(footprint_m: MatLike, px_per_m: float) -> Canvas:
    west_m, south_m = (float(number) - 4 / px_per_m for number in footprint_m.min(axis=0))
    east_m, north_m = (float(number) + 4 / px_per_m for number in footprint_m.max(axis=0))
    area = Area(west_m, north_m, east_m - west_m, north_m - south_m)
    shape = (math.ceil(area.height_m * px_per_m), math.ceil(area.width_m * px_per_m), 3)
    return Canvas(np.zeros(shape, np.uint8), area, px_per_m)


def _lens(canvas: Canvas, footprint_m: MatLike) -> MatLike:
    seen = np.array([canvas.at(*place) for place in footprint_m], np.float32)
    photo = np.array([[0, 0], [WIDTH_PX, 0], [WIDTH_PX, HEIGHT_PX], [0, HEIGHT_PX]], np.float32)
    return cv2.getPerspectiveTransform(seen, photo)


def _truth(canvas: Canvas, tables: list[Table], lens: MatLike) -> tuple[TrueBox, ...]:
    found = []
    for table in tables:
        for module in table.modules:
            if module.fault is not None:
                label = LABELS[0] if isinstance(module.fault, HotSpot) else LABELS[1]
                outline = np.array([[canvas.at(*place) for place in module.fault.outline(module.area)]])
                found.append(_visible_box(cv2.perspectiveTransform(outline, lens)[0], label))
    return tuple(box for box in found if box is not None)


def _visible_box(outline: MatLike, label: str) -> TrueBox | None:
    size = np.array([WIDTH_PX, HEIGHT_PX])
    low, high = outline.min(axis=0), outline.max(axis=0)
    seen_low, seen_high = low.clip(0, size), high.clip(0, size)
    if np.prod(seen_high - seen_low) < _LEAST_VISIBLE * np.prod(high - low):
        return None
    left, top, width, height = (round(float(number), 2) for number in (*seen_low, *(seen_high - seen_low)))
    return TrueBox(left_px=left, top_px=top, width_px=width, height_px=height, label=label)


# --- light ------------------------------------------------------------------------------------------


def _reflect_sky(canvas: Canvas, rng: Generator, tables: list[Table]) -> None:
    """White sheen where the glass mirrors a bright part of the sky, in place."""
    height_px, width_px = canvas.pixels.shape[:2]
    glass = Canvas(np.zeros((height_px, width_px), np.uint8), canvas.area, canvas.px_per_m)
    for table in tables:
        glass.window(table.area)[:] = 255
    sky = np.zeros((height_px // 10 + 1, width_px // 10 + 1), np.uint8)
    for _ in range(int(rng.integers(0, 4))):
        centre = (int(rng.integers(0, sky.shape[1])), int(rng.integers(0, sky.shape[0])))
        axes = (int(rng.integers(6, 30)), int(rng.integers(4, 12)))
        cv2.ellipse(sky, centre, axes, rng.uniform(0, 180), 0, 360, int(rng.integers(40, 150)), -1)
    bright = cv2.resize(cv2.GaussianBlur(sky, (0, 0), 5), (width_px, height_px))
    sheen = cv2.merge([cv2.bitwise_and(bright, glass.pixels)] * 3)
    # Light adds to what is there, up to white: out = in + sheen * (1 - in).
    cv2.add(canvas.pixels, cv2.multiply(255 - canvas.pixels, sheen, scale=1 / 255), canvas.pixels)


def _shade(canvas: Canvas, rng: Generator) -> None:
    """Now and then the shadow of a cloud, and of a mast or a wire, in place."""
    height_px, width_px = canvas.pixels.shape[:2]
    light = np.full((height_px // 8 + 1, width_px // 8 + 1), 255, np.uint8)
    if rng.random() < 0.3:
        centre = (int(rng.integers(0, light.shape[1])), int(rng.integers(0, light.shape[0])))
        axes = (int(rng.integers(30, 120)), int(rng.integers(30, 80)))
        cv2.ellipse(light, centre, axes, rng.uniform(0, 180), 0, 360, int(rng.integers(140, 200)), -1)
        light = cv2.GaussianBlur(light, (0, 0), 6)
    full = cv2.resize(light, (width_px, height_px))
    if rng.random() < 0.3:
        ends = [(int(rng.integers(0, width_px)), 0), (int(rng.integers(0, width_px)), height_px)]
        cv2.line(full, ends[0], ends[1], 120, canvas.length_px(rng.uniform(0.02, 0.1)), cv2.LINE_AA)
    cv2.multiply(canvas.pixels, cv2.merge([full] * 3), canvas.pixels, scale=1 / 255)


def _expose(photo: MatLike, rng: Generator) -> MatLike:
    """Lens and sensor: focus, the day's light and colour, a vignette, noise."""
    blur_px = rng.uniform(0.0, 1.1)
    if blur_px > 0.3:
        photo = cv2.GaussianBlur(photo, (0, 0), blur_px)
    across = np.linspace(-1, 1, WIDTH_PX, dtype=np.float32) ** 2
    down = np.linspace(-1, 1, HEIGHT_PX, dtype=np.float32)[:, np.newaxis] ** 2
    brightness = rng.uniform(0.72, 1.15)
    vignette = brightness * (1 - 0.09 * (across + down))
    warmth = rng.uniform(-0.06, 0.06)
    shade = cv2.merge([vignette * (1 - warmth), vignette, vignette * (1 + warmth)])
    shaded = cv2.multiply(photo, shade, dtype=cv2.CV_8U)
    amplitude = int(rng.integers(3, 10))
    noise = rng.integers(-amplitude, amplitude + 1, shaded.shape[:2], np.int8).astype(np.int16)
    return cv2.add(shaded, cv2.merge([noise] * 3), dtype=cv2.CV_8U)  # the same for the three colours


def grey_photo() -> bytes:
    """A grey JPEG of the photos' width and height that shows nothing."""
    grey = np.full((HEIGHT_PX, WIDTH_PX, 3), 128, np.uint8)
    return cv2.imencode(".jpg", grey)[1].tobytes()


def _encode(photo: MatLike) -> bytes:
    """A JPEG of about the target size, found by a few trials: its logarithm grows steadily with quality."""
    tried: dict[int, bytes] = {}
    below, above, quality = 30, 99, 85
    while quality not in tried:
        tried[quality] = jpeg = cv2.imencode(".jpg", photo, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()
        if abs(len(jpeg) - _TARGET_BYTES) < _CLOSE_BYTES:
            return jpeg
        below, above = (quality, above) if len(jpeg) < _TARGET_BYTES else (below, quality)
        step = round(_QUALITY_OF_SIZE * math.log(_TARGET_BYTES / len(jpeg))) or 1
        quality = min(max(quality + step, below), above)
    return min(tried.values(), key=lambda jpeg: abs(len(jpeg) - _TARGET_BYTES))
