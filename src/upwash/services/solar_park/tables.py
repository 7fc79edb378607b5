"""Tables of modules, what lies on their glass, and what is wrong with them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import cv2
import numpy as np
from cv2.typing import MatLike
from numpy.random import Generator

from upwash.services.solar_park.canvas import Bgr, Canvas, blend, cloud, colour_of
from upwash.services.solar_park.geometry import (
    CELL_M,
    CELLS_ACROSS,
    CELLS_DOWN,
    FRAME_M,
    HEAT_POWER,
    MODULES_ACROSS,
    MODULES_DOWN,
    TABLE_HEIGHT_M,
    TABLE_WIDTH_M,
    Area,
    Breakage,
    HotSpot,
    Table,
)

_CELL_PX = 20  # of the tile that all modules are scaled from
_PX_PER_M = _CELL_PX / CELL_M
_RED_DUST_BGR = (62, 92, 150)
_DUST_BGR = (98, 132, 164)
_LEAVES_BGR: tuple[Bgr, ...] = ((30, 110, 190), (40, 90, 140), (40, 150, 190), (50, 120, 100))
_HEAT_BGR = (
    (0.0, (70, 10, 70)),
    (0.3, (40, 10, 150)),
    (0.5, (18, 40, 225)),
    (0.75, (10, 140, 255)),
    (1.0, (110, 240, 255)),
)


def draw_tables(canvas: Canvas, tables: Sequence[Table]) -> None:
    """Draws the tables with all that lies on them and is wrong with them."""
    size_px = canvas.length_px(TABLE_WIDTH_M), canvas.length_px(TABLE_HEIGHT_M)
    blank = cv2.resize(_table_tile(), size_px, interpolation=cv2.INTER_AREA).astype(np.float32)
    for table in tables:
        tints = np.array([module.tint_bgr for module in table.modules], np.float32)
        tints = tints.reshape(MODULES_DOWN, MODULES_ACROSS, 3)
        tinted = cv2.multiply(blank, cv2.resize(tints, size_px, interpolation=cv2.INTER_NEAREST))
        canvas.paste(cv2.convertScaleAbs(tinted), table.area.west_m, table.area.north_m)
    for table in tables:
        rng = table.chance.spawn(1)[0]
        for module in table.modules:
            _soil(canvas, rng.spawn(1)[0], module.area)
            own, fault = rng.spawn(1)[0], module.fault
            if isinstance(fault, HotSpot):
                _draw_glow(canvas, own, module.area, fault)
            elif fault is not None:
                _draw_breakage(canvas, own, module.area, fault)


@cache
def _table_tile() -> MatLike:
    gap_px = round(0.03 * _PX_PER_M)
    module = _module_tile()
    height_px, width_px = module.shape[:2]
    table = np.full(
        (
            MODULES_DOWN * (height_px + gap_px) - gap_px,
            MODULES_ACROSS * (width_px + gap_px) - gap_px,
            3,
        ),
        (70, 66, 62),
        np.uint8,
    )
    for row in range(MODULES_DOWN):
        for column in range(MODULES_ACROSS):
            top, left = row * (height_px + gap_px), column * (width_px + gap_px)
            table[top : top + height_px, left : left + width_px] = module
    return table


def _module_tile() -> MatLike:
    frame_px = round(FRAME_M * _PX_PER_M)
    shape = (CELLS_DOWN * _CELL_PX + 2 * frame_px, CELLS_ACROSS * _CELL_PX + 2 * frame_px, 3)
    tile = np.full(shape, (168, 164, 160), np.uint8)
    cell = np.full((_CELL_PX, _CELL_PX, 3), (138, 116, 100), np.uint8)
    far = _CELL_PX - 1
    octagon = [(4, 1), (far - 3, 1), (far, 4), (far, far - 3), (far - 3, far), (4, far), (1, far - 3), (1, 4)]
    cv2.fillPoly(cell, [np.array(octagon, np.int32)], (92, 50, 24))
    for busbar in (6, 13):
        cv2.line(cell, (busbar, 1), (busbar, far), (112, 74, 48), 1)
    tile[frame_px:-frame_px, frame_px:-frame_px] = np.tile(cell, (CELLS_DOWN, CELLS_ACROSS, 1))
    return tile


# --- what lies on the glass ------------------------------------------------------------------------


def _soil(canvas: Canvas, rng: Generator, module: Area) -> None:
    """Bird droppings and leaves on some, and on some the dust that rain has left along the lower frame."""
    has = rng.random(3)
    if has[0] < 0.07:
        _draw_dropping(canvas, rng, *_somewhere_on(rng, module))
    if has[1] < 0.06:
        _draw_leaf(canvas, rng, *_somewhere_on(rng, module))
    if has[2] < 0.3:
        _draw_dust(canvas, rng, module)


def _somewhere_on(rng: Generator, module: Area) -> tuple[float, float]:
    east_m = module.west_m + rng.uniform(0.15, 0.85) * module.width_m
    return float(east_m), float(module.north_m - rng.uniform(0.15, 0.85) * module.height_m)


def _draw_dropping(canvas: Canvas, rng: Generator, east_m: float, north_m: float) -> None:
    for _ in range(int(rng.integers(2, 7))):
        dx, dy = rng.normal(0, 0.05, 2)
        canvas.dot(east_m + dx, north_m + dy, rng.uniform(0.01, 0.045), (214, 226, 228))
    canvas.dot(east_m, north_m, 0.01, (96, 112, 116))
    run = (east_m + rng.normal(0, 0.02), north_m - rng.uniform(0.06, 0.24))
    canvas.line([(east_m, north_m), run], 0.01, (186, 192, 190))


def _draw_leaf(canvas: Canvas, rng: Generator, east_m: float, north_m: float) -> None:
    """Warm in colour and no hot-spot: narrow, with a sharp edge and no halo."""
    length_m, width_m = rng.uniform(0.05, 0.1), rng.uniform(0.015, 0.03)
    turn = rng.uniform(0, np.pi)
    along = np.array([np.cos(turn), np.sin(turn)])
    across = np.array([-along[1], along[0]])
    middle = np.array([east_m, north_m])
    outline = [
        middle + a * length_m * along + b * width_m * across
        for a, b in ((-1, 0), (-0.3, 1), (0.4, 0.8), (1, 0), (0.4, -0.8), (-0.3, -1))
    ]
    colour = _LEAVES_BGR[int(rng.integers(len(_LEAVES_BGR)))]
    canvas.polygon([(float(x), float(y)) for x, y in outline], colour)


def _draw_dust(canvas: Canvas, rng: Generator, module: Area) -> None:
    height_m = rng.uniform(0.1, 0.4)
    strip = canvas.window(
        Area(
            module.west_m + FRAME_M,
            module.south_m + FRAME_M + height_m,
            module.width_m - 2 * FRAME_M,
            height_m,
        )
    )
    thickest = rng.uniform(0.2, 0.65)
    colour = _RED_DUST_BGR if rng.random() < 0.25 else _DUST_BGR
    thickness = np.linspace(0, thickest, strip.shape[0], dtype=np.float32)[:, np.newaxis]
    blend(strip, np.array(colour), np.repeat(thickness, strip.shape[1], axis=1))


# --- what is wrong ---------------------------------------------------------------------------------


def _draw_glow(canvas: Canvas, rng: Generator, module: Area, spot: HotSpot) -> None:
    """Lays the thermal overlay's colours over the module, in place: opaque where hot, clear where cold."""
    glass = canvas.window(module)
    if glass.size == 0:
        return
    left, top = (max(0, round(number)) for number in canvas.at(module.west_m, module.north_m))
    x, y = canvas.at(spot.east_m, spot.north_m)
    height_px, width_px = glass.shape[:2]
    down, across = np.mgrid[0:height_px, 0:width_px].astype(np.float32) + 0.5
    dx = (across - (x - left)) / (spot.half_width_m * canvas.px_per_m)
    dy = (down - (y - top)) / (spot.half_height_m * canvas.px_per_m)
    distance = (np.abs(dx) ** HEAT_POWER + np.abs(dy) ** HEAT_POWER) ** (1 / HEAT_POWER)
    heat = spot.peak * np.exp2(-(distance**2))
    if spot.half_width_m > CELL_M:
        heat *= 1 + cloud(rng, (height_px, width_px), canvas.length_px(0.06), 0.06)
        blur_px = canvas.length_px(0.03)
        heat = cv2.blur(heat, (blur_px, blur_px))  # the thermal camera sees less sharply than the photo's
    blend(glass, colour_of(255 * heat, _HEAT_BGR), np.clip((heat - 0.15) / 0.4, 0, 0.92))


def _draw_breakage(canvas: Canvas, rng: Generator, module: Area, breakage: Breakage) -> None:
    """Glass that has gone milky, and cracks that run from where it was hit to the frame."""
    glass = canvas.window(module)
    if glass.size == 0:
        return
    shape = (glass.shape[0], glass.shape[1])
    patches = cloud(rng, shape, canvas.length_px(0.2), 0.3) + cloud(rng, shape, canvas.length_px(0.04), 0.3)
    blend(glass, np.array((206, 210, 204)), np.clip(breakage.haze + 0.6 * patches, 0.05, 0.8))
    cracks = Canvas(glass, _seen_part(canvas, module), canvas.px_per_m)
    reach_m = rng.uniform(0.5, 1.2)
    count = int(rng.integers(9, 16))
    bearings = (np.arange(count) + rng.uniform(-0.4, 0.4, count)) * 2 * np.pi / count
    ends = [_crack(rng, breakage, bearing, reach_m * rng.uniform(0.5, 1)) for bearing in bearings]
    for places in ends:
        cracks.line(places, 0.012, (226, 228, 222))
    for ring in (1, 2, 3):
        cracks.line([places[ring] for places in ends], 0.008, (208, 212, 206))
    cracks.dot(breakage.east_m, breakage.north_m, 0.03, (236, 238, 232))


def _seen_part(canvas: Canvas, area: Area) -> Area:
    """Where the window of an area truly begins: on whole pixels, and on the canvas."""
    left, top = (max(0, round(number)) for number in canvas.at(area.west_m, area.north_m))
    west_m, north_m = canvas.area.west_m + left / canvas.px_per_m, canvas.area.north_m - top / canvas.px_per_m
    return Area(west_m, north_m, area.east_m - west_m, north_m - area.south_m)


def _crack(rng: Generator, breakage: Breakage, bearing: float, length_m: float) -> list[tuple[float, float]]:
    steps = np.linspace(0, length_m, 6)
    bearings = bearing + np.cumsum(rng.normal(0, 0.09, 6))
    return [
        (float(breakage.east_m + step * np.cos(turn)), float(breakage.north_m + step * np.sin(turn)))
        for step, turn in zip(steps, bearings, strict=True)
    ]
