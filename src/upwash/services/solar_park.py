"""Rendered aerial photos of a solar park, with the truth about their hot-spots.

The park is drawn flat, in *plan* pixels: ground, tables of modules, what lies on and between them, the
thermal overlay. The camera then looks at it a little turned and tilted. All chance comes from the seed; one
version of OpenCV makes the same bytes of it every time.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import cv2
import msgspec
import numpy as np
from cv2.typing import MatLike
from numpy.random import Generator

from upwash.services.hotspots import Box

WIDTH_PX, HEIGHT_PX = 1440, 1080
LARGE_FROM_PX = 26.0  # the longer side of a large hot-spot; small ones stay well below

_PLAN_WIDTH_PX, _PLAN_HEIGHT_PX = 1800, 1480
_TARGET_BYTES = 425_000
_SHARE_WITHOUT = 0.4
_MOST_HOT_SPOTS = 4

_CELL_PX = 15
_CELLS_ACROSS, _CELLS_DOWN = 6, 10
_FRAME_PX = 2
_MODULE_WIDTH_PX = _CELLS_ACROSS * _CELL_PX + 2 * _FRAME_PX
_MODULE_HEIGHT_PX = _CELLS_DOWN * _CELL_PX + 2 * _FRAME_PX
_MODULE_GAP_PX = 3
_MODULES_IN_TABLE = 7  # across; a table is two modules high
_TABLE_WIDTH_PX = _MODULES_IN_TABLE * (_MODULE_WIDTH_PX + _MODULE_GAP_PX)
_TABLE_HEIGHT_PX = 2 * _MODULE_HEIGHT_PX + _MODULE_GAP_PX


@dataclass(frozen=True, slots=True)
class RenderedPhoto:
    """A JPEG of 1440 x 1080 pixels and 400 to 450 KB, and where its hot-spots are."""

    jpeg: bytes
    hot_spots: tuple[Box, ...]


def render_photo(seed: int, *, hot_spots: int | None = None) -> RenderedPhoto:
    """A photo of the park; without `hot_spots`, four photos in ten have none and the others up to four.

    The same seed shows the same place whatever the number of hot-spots.
    """
    place, heat = np.random.default_rng(seed).spawn(2)
    if hot_spots is None:
        hot_spots = 0 if heat.random() < _SHARE_WITHOUT else int(heat.integers(1, _MOST_HOT_SPOTS + 1))
    camera = _camera(place)
    plan, modules = _park(place)
    visible = [module for module in modules if _in_photo(_project(module.corners, camera))]
    if not 0 <= hot_spots <= len(visible):
        raise ValueError(
            f"this photo shows {len(visible)} whole modules, which cannot have {hot_spots} hot-spots"
        )
    truth = []
    for index in heat.choice(len(visible), size=hot_spots, replace=False):
        glow = _random_glow(heat, visible[index])
        _draw_glow(plan, heat, glow)
        truth.append(_bounding_box(_project(glow.corners, camera)))
    photo = cv2.warpPerspective(plan, camera, (WIDTH_PX, HEIGHT_PX), borderMode=cv2.BORDER_REFLECT)
    return RenderedPhoto(_encode(_expose(photo, place)), tuple(truth))


def render_folder(folder: Path, count: int, seed: int) -> None:
    """Writes photo-000.jpg and so on, rendered from `seed`, `seed + 1`..., and truth.json: boxes by file."""
    folder.mkdir(parents=True, exist_ok=True)
    truth: dict[str, tuple[Box, ...]] = {}
    for index in range(count):
        name = f"photo-{index:03}.jpg"
        photo = render_photo(seed + index)
        (folder / name).write_bytes(photo.jpeg)
        truth[name] = photo.hot_spots
    (folder / "truth.json").write_bytes(msgspec.json.format(msgspec.json.encode(truth)))


def read_truth(folder: Path) -> dict[str, tuple[Box, ...]]:
    """The hot-spots of each photo of a rendered folder, by file, in the order of the photos."""
    return msgspec.json.decode((folder / "truth.json").read_bytes(), type=dict[str, tuple[Box, ...]])


# --- the camera ------------------------------------------------------------------------------------


def _camera(rng: Generator) -> MatLike:
    """The homography from plan to photo: a few degrees of heading, some tilt, some height."""
    zoom = rng.uniform(0.97, 1.1)
    angle = math.radians(rng.uniform(-8, 8))
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    half = np.array([WIDTH_PX, HEIGHT_PX]) / 2 / zoom
    seen = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half + rng.uniform(-28, 28, (4, 2))
    seen = seen @ turn.T + np.array([_PLAN_WIDTH_PX, _PLAN_HEIGHT_PX]) / 2
    photo = np.array([[0, 0], [WIDTH_PX, 0], [WIDTH_PX, HEIGHT_PX], [0, HEIGHT_PX]])
    return cv2.getPerspectiveTransform(seen.astype(np.float32), photo.astype(np.float32))


def _project(corners: MatLike, camera: MatLike) -> MatLike:
    projected: MatLike = cv2.perspectiveTransform(corners[np.newaxis], camera)[0]
    return projected


def _in_photo(corners: MatLike) -> bool:
    box = _bounding_box(corners)
    return (
        box.left_px >= 0
        and box.top_px >= 0
        and box.left_px + box.width_px <= WIDTH_PX
        and box.top_px + box.height_px <= HEIGHT_PX
    )


def _bounding_box(corners: MatLike) -> Box:
    left, top = (float(number) for number in corners.min(axis=0))
    right, bottom = (float(number) for number in corners.max(axis=0))
    return Box(left_px=left, top_px=top, width_px=right - left, height_px=bottom - top)


def _expose(photo: MatLike, rng: Generator) -> MatLike:
    """Lens and sensor: a vignette and noise."""
    across = np.linspace(-1, 1, WIDTH_PX, dtype=np.float32) ** 2
    down = np.linspace(-1, 1, HEIGHT_PX, dtype=np.float32)[:, np.newaxis] ** 2
    shade = (255 * (1 - 0.09 * (across + down))).astype(np.uint8)
    shaded = cv2.multiply(photo, cv2.merge([shade] * 3), scale=1 / 255)
    return _add_noise(shaded, rng, amplitude=5)


def _add_noise(image: MatLike, rng: Generator, amplitude: int) -> MatLike:
    """Brightness noise of up to `amplitude` either way; the same for the three colours."""
    height_px, width_px = image.shape[:2]
    noise = rng.integers(0, 2 * amplitude + 1, (height_px, width_px), np.uint8)
    brighter = cv2.add(image, cv2.merge([noise] * 3))
    return cv2.subtract(brighter, np.full_like(brighter, amplitude))


def _encode(photo: MatLike) -> bytes:
    """The JPEG of the quality whose size comes nearest to the target; size grows with quality."""
    below, above = 30, 99
    while above - below > 1:
        quality = (below + above) // 2
        if len(_jpeg(photo, quality)) < _TARGET_BYTES:
            below = quality
        else:
            above = quality
    return min(
        (_jpeg(photo, quality) for quality in (below, above)), key=lambda jpeg: abs(len(jpeg) - _TARGET_BYTES)
    )


def _jpeg(photo: MatLike, quality: int) -> bytes:
    _, jpeg = cv2.imencode(".jpg", photo, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return jpeg.tobytes()


# --- the park --------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Module:
    left_px: int
    top_px: int

    @property
    def corners(self) -> MatLike:
        return _corners(self.left_px, self.top_px, _MODULE_WIDTH_PX, _MODULE_HEIGHT_PX)


def _corners(left: float, top: float, width: float, height: float) -> MatLike:
    unit = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
    return unit * np.array([width, height], np.float32) + np.array([left, top], np.float32)


def _park(rng: Generator) -> tuple[MatLike, list[_Module]]:
    """The plan without heat, and its modules."""
    lane_height_px = int(rng.integers(150, 210))
    pitch_px = _TABLE_HEIGHT_PX + lane_height_px
    lane_tops_px = range(int(rng.integers(-pitch_px, 0)), _PLAN_HEIGHT_PX, pitch_px)
    tables = list(_table_places(rng, [top + lane_height_px for top in lane_tops_px]))
    plan = _ground(rng, lane_middles_px=[top + lane_height_px // 2 for top in lane_tops_px])
    for top in lane_tops_px:
        _draw_lane(plan, rng, top, lane_height_px)
    _cast_shadows(plan, rng, tables)
    modules = [module for left, top in tables for module in _draw_table(plan, rng, left, top)]
    for module in modules:
        _soil_module(plan, rng, module)
    _reflect_sky(plan, rng, tables)
    return plan, modules


def _table_places(rng: Generator, row_tops_px: Sequence[int]) -> Iterator[tuple[int, int]]:
    for top in row_tops_px:
        first = -int(rng.integers(0, _TABLE_WIDTH_PX))
        for left in range(first, _PLAN_WIDTH_PX, _TABLE_WIDTH_PX + 26):
            yield left, top + int(rng.integers(-4, 5))


# --- ground ----------------------------------------------------------------------------------------

_GROUND_COLOURS_BGR = (
    (0.00, (34, 58, 46)),  # shrubs
    (0.30, (52, 92, 76)),
    (0.50, (74, 118, 108)),  # grass
    (0.68, (104, 142, 146)),  # dry grass
    (0.82, (112, 146, 164)),  # bare soil
    (1.00, (140, 172, 192)),
)
_RED_SOIL_BGR = (62, 92, 150)
_DUST_BGR = (98, 132, 164)


def _ground(rng: Generator, lane_middles_px: Sequence[int]) -> MatLike:
    """Grass and soil, with the wheel tracks of the mower along the lanes between the rows."""
    shape = (_PLAN_HEIGHT_PX, _PLAN_WIDTH_PX)
    bumps = ((300, 60), (70, 36), (14, 34), (3, 60))
    dryness: MatLike = np.full(shape, rng.uniform(84, 118), np.float32)
    for grain_px, amplitude in bumps:
        dryness += _cloud(rng, shape, grain_px, amplitude)
    for middle in lane_middles_px:
        for track in (middle - 34, middle + 34):
            dryness[max(0, track - 9) : max(0, track + 9)] += 34
    dryness = cv2.GaussianBlur(dryness, (0, 0), 0.8)
    return _add_noise(_colour(dryness, _GROUND_COLOURS_BGR), rng, amplitude=14)


def _cloud(rng: Generator, shape: tuple[int, int], grain_px: int, amplitude: float) -> MatLike:
    """Smooth noise around 0 whose bumps are `grain_px` wide."""
    height_px, width_px = shape
    coarse = rng.normal(0, amplitude / 2, (height_px // grain_px + 3, width_px // grain_px + 3))
    return cv2.resize(coarse.astype(np.float32), (width_px, height_px), interpolation=cv2.INTER_CUBIC)


def _colour(levels: MatLike, stops: Sequence[tuple[float, tuple[int, int, int]]]) -> MatLike:
    """Levels of 0 to 255 as colours, along the gradient through the given stops."""
    at = [position * 255 for position, _ in stops]
    channels = [np.interp(range(256), at, [colour[i] for _, colour in stops]) for i in range(3)]
    table = np.stack(channels, axis=1).astype(np.uint8).reshape(1, 256, 3)
    return cv2.LUT(cv2.merge([np.clip(levels, 0, 255).astype(np.uint8)] * 3), table)


def _draw_lane(plan: MatLike, rng: Generator, top_px: int, height_px: int) -> None:
    """What lies and grows between two rows: bushes, some in yellow flower, and patches of red soil."""
    for _ in range(int(rng.integers(0, 3))):
        x, y = rng.uniform(0, _PLAN_WIDTH_PX), top_px + rng.uniform(0.35, 0.65) * height_px
        _draw_red_soil(plan, rng, x, y, height_px)
    for _ in range(int(rng.integers(0, 5))):
        x, y = rng.uniform(0, _PLAN_WIDTH_PX), top_px + rng.uniform(0.3, 0.7) * height_px
        _draw_bush(plan, rng, x, y, radius_px=rng.uniform(12, 34), flowers=rng.random() < 0.25)


def _draw_red_soil(plan: MatLike, rng: Generator, x: float, y: float, lane_px: int) -> None:
    patch = _window(plan, x, y, 3 * lane_px // 4, lane_px // 2)
    if patch.size == 0:
        return
    shape = (patch.shape[0], patch.shape[1])
    bare = 1.1 - 1.3 * _eccentricity(patch) ** 2 + _cloud(rng, shape, 12, 0.5)
    colour = np.array(_RED_SOIL_BGR) + _cloud(rng, shape, 3, 22)[..., np.newaxis]
    _blend(patch, colour, 0.85 * np.clip(bare, 0, 1))


def _draw_bush(plan: MatLike, rng: Generator, x: float, y: float, *, radius_px: float, flowers: bool) -> None:
    shadow = _window(plan, x + 0.5 * radius_px, y - 0.5 * radius_px, radius_px, radius_px)
    _blend(shadow, np.array((24, 34, 30)), 0.6 * np.clip(2 - 2 * _eccentricity(shadow), 0, 1))
    leaves = int(radius_px**2 / 2)
    spread_px = rng.normal(0, 0.42, (leaves, 2)).clip(-1, 1) * radius_px
    for leaf, (dx, dy) in enumerate(spread_px):
        light = 0.55 + 0.5 * leaf / leaves + 0.2 * (dy - dx) / radius_px
        colour = (46 * light, (88 + 20 * rng.random()) * light, 66 * light)
        if flowers and rng.random() < 0.3:
            colour = (40, 205, 225)
        cv2.circle(plan, (int(x + dx), int(y + dy)), int(rng.integers(1, 4)), colour, -1, cv2.LINE_AA)


def _cast_shadows(plan: MatLike, rng: Generator, tables: Sequence[tuple[int, int]]) -> None:
    """Darkens the ground beside the tables, in place; all shadows fall the same way."""
    dx, dy = int(rng.integers(-40, 41)), -int(rng.integers(35, 70))
    shade = np.zeros(plan.shape[:2], np.uint8)
    for left, top in tables:
        _window_at(shade, left + dx, top + dy, _TABLE_WIDTH_PX, _TABLE_HEIGHT_PX)[:] = 150
    light = cv2.merge([255 - cv2.blur(shade, (7, 7))] * 3)
    cv2.multiply(plan, light, plan, scale=1 / 255)


# --- tables of modules -----------------------------------------------------------------------------


@cache
def _module_tile() -> MatLike:
    """One module of square cells with cut corners, in an aluminium frame."""
    tile = np.full((_MODULE_HEIGHT_PX, _MODULE_WIDTH_PX, 3), (168, 164, 160), np.uint8)
    inside = tile[_FRAME_PX:-_FRAME_PX, _FRAME_PX:-_FRAME_PX]
    inside[:] = (138, 116, 100)
    cell = np.full((_CELL_PX, _CELL_PX, 3), (138, 116, 100), np.uint8)
    far = _CELL_PX - 1
    octagon = [(3, 1), (far - 2, 1), (far, 3), (far, far - 2), (far - 2, far), (3, far), (1, far - 2), (1, 3)]
    cv2.fillPoly(cell, [np.array(octagon, np.int32)], (92, 50, 24))
    for busbar in (5, 10):
        cv2.line(cell, (busbar, 1), (busbar, far), (112, 74, 48), 1)
    inside[:] = np.tile(cell, (_CELLS_DOWN, _CELLS_ACROSS, 1))
    return tile


def _draw_table(plan: MatLike, rng: Generator, left_px: int, top_px: int) -> list[_Module]:
    """Draws one table, and returns those of its modules that lie wholly on the plan."""
    base = _window_at(plan, left_px - 2, top_px - 2, _TABLE_WIDTH_PX + 2, _TABLE_HEIGHT_PX + 4)
    base[:] = (70, 66, 62)
    modules = []
    for row in range(2):
        for column in range(_MODULES_IN_TABLE):
            module = _Module(
                left_px + column * (_MODULE_WIDTH_PX + _MODULE_GAP_PX),
                top_px + row * (_MODULE_HEIGHT_PX + _MODULE_GAP_PX),
            )
            # No two modules come from the same batch, and each hangs at its own angle to the sky.
            tone = rng.uniform(0.9, 1.1)
            tints = (tone, tone * rng.uniform(0.96, 1.04), tone * rng.uniform(0.94, 1.06))
            tile = (_module_tile() * np.array(tints, np.float32)).clip(max=255).astype(np.uint8)
            place = _window_at(plan, module.left_px, module.top_px, _MODULE_WIDTH_PX, _MODULE_HEIGHT_PX)
            if place.shape == tile.shape:
                place[:] = tile
                modules.append(module)
            elif place.size:
                skip_x, skip_y = max(0, -module.left_px), max(0, -module.top_px)
                place[:] = tile[skip_y:, skip_x:][: place.shape[0], : place.shape[1]]
    return modules


def _soil_module(plan: MatLike, rng: Generator, module: _Module) -> None:
    """Bird droppings on some, and on some the dust that rain has left along the lower frame."""
    if rng.random() < 0.07:
        _draw_dropping(plan, rng, module)
    if rng.random() < 0.3:
        _draw_dust(plan, rng, module)


def _draw_dropping(plan: MatLike, rng: Generator, module: _Module) -> None:
    x = module.left_px + rng.uniform(0.15, 0.85) * _MODULE_WIDTH_PX
    y = module.top_px + rng.uniform(0.15, 0.8) * _MODULE_HEIGHT_PX
    for _ in range(int(rng.integers(2, 7))):
        place = (int(x + rng.normal(0, 5)), int(y + rng.normal(0, 5)))
        cv2.circle(plan, place, int(rng.integers(1, 5)), (214, 226, 228), -1, cv2.LINE_AA)
    cv2.circle(plan, (int(x), int(y)), 1, (96, 112, 116), -1, cv2.LINE_AA)
    run = (int(x + rng.normal(0, 2)), int(y + rng.uniform(6, 24)))
    cv2.line(plan, (int(x), int(y)), run, (186, 192, 190), 1, cv2.LINE_AA)


def _draw_dust(plan: MatLike, rng: Generator, module: _Module) -> None:
    height_px = int(rng.integers(10, 40))
    strip = _window_at(
        plan,
        module.left_px + _FRAME_PX,
        module.top_px + _MODULE_HEIGHT_PX - _FRAME_PX - height_px,
        _MODULE_WIDTH_PX - 2 * _FRAME_PX,
        height_px,
    )
    thickness = np.linspace(0, rng.uniform(0.2, 0.65), height_px)[:, np.newaxis]
    colour = _RED_SOIL_BGR if rng.random() < 0.25 else _DUST_BGR
    _blend(strip, np.array(colour), np.repeat(thickness, strip.shape[1], axis=1))


def _reflect_sky(plan: MatLike, rng: Generator, tables: Sequence[tuple[int, int]]) -> None:
    """White sheen where the glass mirrors a bright part of the sky, in place."""
    glass = np.zeros(plan.shape[:2], np.uint8)
    for left, top in tables:
        _window_at(glass, left, top, _TABLE_WIDTH_PX - _MODULE_GAP_PX, _TABLE_HEIGHT_PX)[:] = 255
    sky = np.zeros((_PLAN_HEIGHT_PX // 10, _PLAN_WIDTH_PX // 10), np.uint8)
    for _ in range(int(rng.integers(1, 4))):
        centre = (int(rng.integers(0, sky.shape[1])), int(rng.integers(0, sky.shape[0])))
        axes = (int(rng.integers(6, 30)), int(rng.integers(4, 12)))
        cv2.ellipse(sky, centre, axes, rng.uniform(0, 180), 0, 360, int(rng.integers(40, 150)), -1)
    bright = cv2.resize(cv2.GaussianBlur(sky, (0, 0), 5), (_PLAN_WIDTH_PX, _PLAN_HEIGHT_PX))
    sheen = cv2.merge([cv2.bitwise_and(bright, glass)] * 3)
    # Light adds to what is there, up to white: out = in + sheen * (1 - in).
    cv2.add(plan, cv2.multiply(255 - plan, sheen, scale=1 / 255), plan)


# --- the thermal overlay ---------------------------------------------------------------------------

_HEAT_COLOURS_BGR = (
    (0.0, (70, 10, 70)),
    (0.3, (40, 10, 150)),
    (0.5, (18, 40, 225)),
    (0.75, (10, 140, 255)),
    (1.0, (110, 240, 255)),
)


@dataclass(frozen=True, slots=True)
class _HotSpot:
    """Warm cells of one module: what of the ellipse lies on the module."""

    module: _Module
    x_px: float
    y_px: float
    half_width_px: float
    half_height_px: float

    @property
    def corners(self) -> MatLike:
        left = max(self.x_px - self.half_width_px, self.module.left_px)
        top = max(self.y_px - self.half_height_px, self.module.top_px)
        right = min(self.x_px + self.half_width_px, self.module.left_px + _MODULE_WIDTH_PX)
        bottom = min(self.y_px + self.half_height_px, self.module.top_px + _MODULE_HEIGHT_PX)
        return _corners(left, top, right - left, bottom - top)


def _random_glow(rng: Generator, module: _Module) -> _HotSpot:
    """Either one cell or a group of cells; the middle of a cell is its centre."""
    column, row = int(rng.integers(0, _CELLS_ACROSS)), int(rng.integers(0, _CELLS_DOWN))
    large = rng.random() < 0.5
    if large:
        column = min(max(column, 1), _CELLS_ACROSS - 2)
    half_px = rng.uniform(18, 32) if large else rng.uniform(5, 7.5)
    stretch = rng.uniform(0.9, 1.12)
    return _HotSpot(
        module,
        x_px=module.left_px + _FRAME_PX + (column + 0.5) * _CELL_PX,
        y_px=module.top_px + _FRAME_PX + (row + 0.5) * _CELL_PX,
        half_width_px=half_px * stretch,
        half_height_px=half_px / stretch,
    )


def _draw_glow(plan: MatLike, rng: Generator, spot: _HotSpot) -> None:
    """Lays the overlay's colours over the module, in place: opaque where hot, clear where cold."""
    module = _window_at(plan, spot.module.left_px, spot.module.top_px, _MODULE_WIDTH_PX, _MODULE_HEIGHT_PX)
    down, across = np.mgrid[0:_MODULE_HEIGHT_PX, 0:_MODULE_WIDTH_PX].astype(np.float32)
    dx = (across - (spot.x_px - spot.module.left_px)) / spot.half_width_px
    dy = (down - (spot.y_px - spot.module.top_px)) / spot.half_height_px
    # Between a circle and a square, as heat spreads from square cells; a half-way glow ends the hot-spot.
    distance = (np.abs(dx) ** 2.5 + np.abs(dy) ** 2.5) ** 0.4
    heat = rng.uniform(0.75, 1.0) * np.exp2(-(distance**2))
    if spot.half_width_px > _CELL_PX:
        heat *= 1 + _cloud(rng, (_MODULE_HEIGHT_PX, _MODULE_WIDTH_PX), 6, 0.06)
        heat = cv2.blur(heat, (3, 3))  # the thermal camera sees less sharply than the photo's
    _blend(module, _colour(255 * heat, _HEAT_COLOURS_BGR), np.clip((heat - 0.15) / 0.4, 0, 0.92))


# --- drawing ---------------------------------------------------------------------------------------


def _window(image: MatLike, x: float, y: float, half_width: float, half_height: float) -> MatLike:
    """A view of the image around a point, cut at its border."""
    return _window_at(
        image, int(x - half_width), int(y - half_height), int(2 * half_width), int(2 * half_height)
    )


def _window_at(image: MatLike, left: int, top: int, width: int, height: int) -> MatLike:
    window: MatLike = image[max(0, top) : max(0, top + height), max(0, left) : max(0, left + width)]
    return window


def _eccentricity(window: MatLike) -> MatLike:
    """How far off the middle each pixel is: 0 there, 1 at the nearest points of the border."""
    height_px, width_px = window.shape[:2]
    down, across = np.mgrid[-1 : 1 : height_px * 1j, -1 : 1 : width_px * 1j]
    distance: MatLike = np.hypot(across, down)
    return distance


def _blend(window: MatLike, colour: MatLike, share: MatLike) -> None:
    """Mixes a colour into a view of an image, in place; `share` says how much of it, pixel by pixel."""
    opacity = share[..., np.newaxis]
    window[:] = np.clip((1 - opacity) * window + opacity * colour, 0, 255).astype(np.uint8)
