"""Grass and soil, what grows, stands and lies between the rows, and the shadows on it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np
from cv2.typing import MatLike
from numpy.random import Generator

from upwash.services.solar_park.canvas import Bgr, Canvas, blend, cloud, colour_of, eccentricity
from upwash.services.solar_park.geometry import TABLE_HEIGHT_M, TABLE_WIDTH_M, Area, Park, Table

_COLOURS_BGR = (
    (0.00, (34, 58, 46)),  # shrubs
    (0.30, (52, 92, 76)),
    (0.50, (74, 118, 108)),  # grass
    (0.68, (104, 142, 146)),  # dry grass
    (0.82, (112, 146, 164)),  # bare soil
    (1.00, (140, 172, 192)),
)
_RED_SOIL_BGR = (62, 92, 150)
_VEHICLES_BGR: tuple[Bgr, ...] = ((236, 236, 232), (40, 40, 180), (150, 80, 30), (30, 140, 235), (60, 60, 60))
_CABLES_BGR: tuple[Bgr, ...] = ((28, 26, 24), (20, 90, 220), (30, 30, 30))

_BUMPS = ((3.0, 60.0), (0.7, 36.0), (0.14, 34.0), (0.03, 60.0), (0.012, 30.0))  # width in metres, height
_COARSER = 4  # canvas pixels in a pixel of the wide bumps
_LATTICE = 256  # bumps until the ground repeats itself


def draw_ground(canvas: Canvas, park: Park, tables: Sequence[Table]) -> None:
    """Paints the whole canvas, except the tables."""
    canvas.pixels[:] = colour_of(_dryness(canvas, park), _COLOURS_BGR)
    for table in tables:
        _draw_lane(canvas, table, park.lane_m)
    _cast_shadows(canvas, park, tables)


def _dryness(canvas: Canvas, park: Park) -> MatLike:
    """From 0, lush, to 255, bare: bumps of several widths, of which the wide ones are drawn coarsely."""
    height_px, width_px = canvas.pixels.shape[:2]
    coarse = np.full((height_px // _COARSER + 1, width_px // _COARSER + 1), park.dryness, np.float32)
    fine = np.zeros((height_px, width_px), np.float32)
    for layer, (grain_m, amplitude) in enumerate(_BUMPS):
        rng = np.random.default_rng([park.seed, 3, layer])
        lattice = rng.normal(0, amplitude / 2, (_LATTICE, _LATTICE)).astype(np.float32)
        if grain_m * canvas.px_per_m >= 4 * _COARSER:
            coarse += _bumps(canvas, lattice, grain_m, shape=coarse.shape, pixel=_COARSER)
        elif grain_m * canvas.px_per_m >= 1:
            fine += _bumps(canvas, lattice, grain_m, shape=fine.shape, pixel=1)
    full_size = (coarse.shape[1] * _COARSER, coarse.shape[0] * _COARSER)
    return cv2.add(fine, cv2.resize(coarse, full_size)[:height_px, :width_px])


def _bumps(
    canvas: Canvas, lattice: MatLike, grain_m: float, *, shape: tuple[int, ...], pixel: int
) -> MatLike:
    """Smooth noise that belongs to the place: the bumps of a lattice that is fixed to the ground and repeats.

    Each of its pixels stands for `pixel` pixels of the canvas, across and down.
    """
    area = canvas.area
    first_x, first_y = math.floor(area.west_m / grain_m) - 1, math.floor(-area.north_m / grain_m) - 1
    columns = (first_x + np.arange(int(area.width_m / grain_m) + 5)) % _LATTICE
    rows = (first_y + np.arange(int(area.height_m / grain_m) + 5)) % _LATTICE
    step = pixel / (grain_m * canvas.px_per_m)
    to_lattice = np.array(
        [
            [step, 0, area.west_m / grain_m - first_x],
            [0, step, -area.north_m / grain_m - first_y],
        ]
    )
    return cv2.warpAffine(
        lattice[np.ix_(rows, columns)],
        to_lattice,
        (shape[1], shape[0]),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )


def _draw_lane(canvas: Canvas, table: Table, lane_m: float) -> None:
    rng = table.chance.spawn(1)[0]
    lane = Area(table.area.west_m, table.area.north_m + lane_m, table.area.width_m, lane_m)
    for track_m in (0.33 * lane_m, 0.67 * lane_m):  # wheel tracks of the mower
        track = canvas.window(Area(lane.west_m, lane.north_m - track_m + 0.09, lane.width_m + 0.3, 0.18))
        if track.size:
            track[:] = cv2.addWeighted(track, 0.75, np.full_like(track, (112, 146, 164)), 0.25, 0)
    if rng.random() < 0.25:
        _draw_red_soil(canvas, rng, *_somewhere(rng, lane, 0.35), lane_m)
    for _ in range(int(rng.integers(0, 3))):
        _draw_bush(canvas, rng, *_somewhere(rng, lane, 0.3))
    if rng.random() < 0.04:
        _draw_vehicle(canvas, rng, *_somewhere(rng, lane, 0.45))
    if rng.random() < 0.08:
        _draw_cable(canvas, rng, lane)


def _somewhere(rng: Generator, lane: Area, margin: float) -> tuple[float, float]:
    east_m = lane.west_m + rng.uniform(0, 1) * lane.width_m
    return float(east_m), float(lane.north_m - rng.uniform(margin, 1 - margin) * lane.height_m)


def _draw_red_soil(canvas: Canvas, rng: Generator, east_m: float, north_m: float, lane_m: float) -> None:
    patch = canvas.around(east_m, north_m, 0.75 * lane_m, 0.5 * lane_m)
    if patch.size == 0:
        return
    shape = (patch.shape[0], patch.shape[1])
    bare = 1.1 - 1.3 * eccentricity(patch) ** 2 + cloud(rng, shape, canvas.length_px(0.12), 0.5)
    colour = np.array(_RED_SOIL_BGR) + cloud(rng, shape, canvas.length_px(0.03), 22)[..., np.newaxis]
    blend(patch, colour, 0.85 * np.clip(bare, 0, 1))


def _draw_bush(canvas: Canvas, rng: Generator, east_m: float, north_m: float) -> None:
    """A bush in its own shadow, one in four in yellow flower."""
    radius_m = rng.uniform(0.12, 0.35)
    flowers = rng.random() < 0.25
    shadow = canvas.around(east_m + 0.5 * radius_m, north_m + 0.5 * radius_m, radius_m, radius_m)
    if shadow.size == 0:
        return
    blend(shadow, np.array((24, 34, 30)), 0.6 * np.clip(2 - 2 * eccentricity(shadow), 0, 1))
    leaves = int(4000 * radius_m**2)
    spread_m = rng.normal(0, 0.42, (leaves, 2)).clip(-1, 1) * radius_m
    for leaf, (dx, dy) in enumerate(spread_m):
        light = 0.55 + 0.5 * leaf / leaves + 0.2 * (-dy - dx) / radius_m
        colour: Bgr = (46 * light, (88 + 20 * rng.random()) * light, 66 * light)
        if flowers and rng.random() < 0.3:
            colour = (40, 205, 225)
        canvas.dot(east_m + dx, north_m + dy, rng.uniform(0.01, 0.03), colour)


def _draw_vehicle(canvas: Canvas, rng: Generator, east_m: float, north_m: float) -> None:
    """A cart of the maintenance crew, parked along the lane."""
    half_m, wide_m = rng.uniform(1.0, 1.3), rng.uniform(0.5, 0.65)
    turn = rng.uniform(-0.15, 0.15)

    def part(front: float, back: float, half_wide: float, colour: Bgr, away_m: float = 0.0) -> None:
        outline = [(front, -half_wide), (front, half_wide), (back, half_wide), (back, -half_wide)]
        canvas.polygon(
            [
                (
                    east_m + away_m + x * math.cos(turn) - y * math.sin(turn),
                    north_m + away_m + x * math.sin(turn) + y * math.cos(turn),
                )
                for x, y in outline
            ],
            colour,
        )

    part(half_m, -half_m, wide_m, (30, 38, 36), away_m=0.15)
    body = _VEHICLES_BGR[int(rng.integers(len(_VEHICLES_BGR)))]
    part(half_m, -half_m, wide_m, body)
    part(0.55 * half_m, 0.25 * half_m, 0.85 * wide_m, (70, 62, 56))
    part(-0.45 * half_m, -0.65 * half_m, 0.85 * wide_m, (70, 62, 56))


def _draw_cable(canvas: Canvas, rng: Generator, lane: Area) -> None:
    colour = _CABLES_BGR[int(rng.integers(len(_CABLES_BGR)))]
    sway_m = np.cumsum(rng.normal(0, 0.05, 12))
    north_m = lane.north_m - rng.uniform(0.2, 0.8) * lane.height_m
    places = [(lane.west_m + i / 11 * lane.width_m, north_m + sway) for i, sway in enumerate(sway_m)]
    canvas.line(places, 0.025, colour)


def _cast_shadows(canvas: Canvas, park: Park, tables: Sequence[Table]) -> None:
    """Darkens the ground beside the tables, in place; all shadows fall the same way."""
    shade = Canvas(np.full(canvas.pixels.shape[:2], 255, np.uint8), canvas.area, canvas.px_per_m)
    east_m, north_m = park.shadow_m
    for table in tables:
        place = table.area
        shade.window(Area(place.west_m + east_m, place.north_m + north_m, TABLE_WIDTH_M, TABLE_HEIGHT_M))[
            :
        ] = 105
    blur_px = canvas.length_px(0.07)
    light = cv2.blur(shade.pixels, (blur_px, blur_px))
    cv2.multiply(canvas.pixels, cv2.merge([light] * 3), canvas.pixels, scale=1 / 255)
