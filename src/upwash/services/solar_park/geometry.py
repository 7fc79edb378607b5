"""What a solar park is made of, in metres, and where all of it stands: the same for ever by its seed.

Tables of modules stand in rows that run east. A table is known by its row, counted northwards, and its
column, counted eastwards; what is true of it follows from the park's seed and these two numbers alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

CELL_M = 0.156
FRAME_M = 0.022
CELLS_ACROSS, CELLS_DOWN = 6, 10
MODULE_WIDTH_M = CELLS_ACROSS * CELL_M + 2 * FRAME_M
MODULE_HEIGHT_M = CELLS_DOWN * CELL_M + 2 * FRAME_M
MODULE_GAP_M = 0.03
MODULES_ACROSS, MODULES_DOWN = 7, 2
TABLE_WIDTH_M = MODULES_ACROSS * (MODULE_WIDTH_M + MODULE_GAP_M) - MODULE_GAP_M
TABLE_HEIGHT_M = MODULES_DOWN * (MODULE_HEIGHT_M + MODULE_GAP_M) - MODULE_GAP_M

_TABLE_GAP_M = 0.27
_FAR = 2**24  # tables are counted from here, since a seed has no negative parts

HEAT_POWER = 2.5  # between a circle's 2 and a square's many: heat spreads from square cells
_SMALL_HALF_M = (0.05, 0.085)  # within one cell
_LARGE_HALF_M = (0.17, 0.34)  # a group of cells


@dataclass(frozen=True, slots=True)
class Area:
    """An upright rectangle on the ground."""

    west_m: float
    north_m: float
    width_m: float
    height_m: float

    @property
    def east_m(self) -> float:
        """Its right border."""
        return self.west_m + self.width_m

    @property
    def south_m(self) -> float:
        """Its lower border."""
        return self.north_m - self.height_m

    @property
    def corners(self) -> list[tuple[float, float]]:
        """East and north of its corners, clockwise from the north-west."""
        west, north, east, south = self.west_m, self.north_m, self.east_m, self.south_m
        return [(west, north), (east, north), (east, south), (west, south)]


@dataclass(frozen=True, slots=True)
class HotSpot:
    """Warm cells of a module: what of the ellipse lies on the module; `peak` is 1 at the hottest."""

    east_m: float
    north_m: float
    half_width_m: float
    half_height_m: float
    peak: float

    def outline(self, module: Area) -> list[tuple[float, float]]:
        """East and north of places around where it has half the warmth of its middle, on the module."""
        turns = np.linspace(0, 2 * np.pi, 24, endpoint=False)
        across, down = np.cos(turns), np.sin(turns)
        reach = (np.abs(across) ** HEAT_POWER + np.abs(down) ** HEAT_POWER) ** (-1 / HEAT_POWER)
        east = (self.east_m + self.half_width_m * reach * across).clip(module.west_m, module.east_m)
        north = (self.north_m + self.half_height_m * reach * down).clip(module.south_m, module.north_m)
        return [(float(x), float(y)) for x, y in zip(east, north, strict=True)]


@dataclass(frozen=True, slots=True)
class Breakage:
    """Shattered glass: where it was hit, and how milky it has become, 0 to 1."""

    east_m: float
    north_m: float
    haze: float

    def outline(self, module: Area) -> list[tuple[float, float]]:
        """East and north of the whole module's corners: that is what has to be replaced."""
        return module.corners


Fault = HotSpot | Breakage


@dataclass(frozen=True, slots=True)
class Module:
    """A module's place, its tint by colour (BGR, around 1) and its fault, if it has one."""

    area: Area
    tint_bgr: tuple[float, float, float]
    fault: Fault | None


@dataclass(frozen=True, slots=True)
class Table:
    """A table of modules; `chance` is the random stream for its surroundings."""

    area: Area
    modules: tuple[Module, ...]
    chance: Generator


@dataclass(frozen=True, slots=True)
class Rates:
    """How many of the modules have a fault, as shares."""

    hot_spot: float = 0.012
    broken: float = 0.006


class Park:
    """An endless solar park; the same seed and place always have the same modules with the same faults."""

    def __init__(self, seed: int, rates: Rates = Rates()) -> None:
        rng = np.random.default_rng([seed, 0])
        self.seed = seed
        self.lane_m = float(rng.uniform(1.7, 3.2))
        self.shadow_m = (float(rng.uniform(-0.45, 0.45)), float(rng.uniform(0.35, 0.75)))  # east, north
        self.dryness = float(rng.uniform(84, 118))
        self._rates = rates
        self._shift_m = (float(rng.uniform(0, 100)), float(rng.uniform(0, 100)))

    @property
    def row_pitch_m(self) -> float:
        """From one row to the next."""
        return TABLE_HEIGHT_M + self.lane_m

    def tables(self, seen: Area) -> Iterator[Table]:
        """The tables of which something lies in the area or in a lane's width around it, from the north."""
        pitch_m = TABLE_WIDTH_M + _TABLE_GAP_M
        east_m, north_m = self._shift_m
        last_row = int((seen.north_m + self.lane_m - north_m) // self.row_pitch_m) + 1
        first_row = int((seen.south_m - self.lane_m - north_m) // self.row_pitch_m)
        for row in range(last_row, first_row - 1, -1):
            stagger_m = float(np.random.default_rng([self.seed, 1, _FAR + row]).uniform(0, pitch_m))
            first = int((seen.west_m - self.lane_m - east_m - stagger_m) // pitch_m)
            last = int((seen.east_m + self.lane_m - east_m - stagger_m) // pitch_m)
            for column in range(first, last + 1):
                place = (east_m + stagger_m + column * pitch_m, north_m + row * self.row_pitch_m)
                yield self._table(row, column, place)

    def _table(self, row: int, column: int, place_m: tuple[float, float]) -> Table:
        build, decay, rest = np.random.default_rng([self.seed, 2, _FAR + row, _FAR + column]).spawn(3)
        area = Area(place_m[0], place_m[1] + build.uniform(-0.04, 0.04), TABLE_WIDTH_M, TABLE_HEIGHT_M)
        modules = tuple(self._module(build, decay, place) for place in _module_areas(area))
        return Table(area, modules, rest)

    def _module(self, build: Generator, decay: Generator, area: Area) -> Module:
        # No two modules come from the same batch, and each hangs at its own angle to the sky.
        tone = build.uniform(0.9, 1.1)
        tint = (tone, tone * build.uniform(0.96, 1.04), tone * build.uniform(0.94, 1.06))
        luck = decay.random()
        own = decay.spawn(1)[0]
        if luck < self._rates.hot_spot:
            return Module(area, tint, _hot_spot(own, area))
        if luck < self._rates.hot_spot + self._rates.broken:
            return Module(area, tint, _breakage(own, area))
        return Module(area, tint, None)


def _module_areas(table: Area) -> Iterator[Area]:
    for row in range(MODULES_DOWN):
        for column in range(MODULES_ACROSS):
            yield Area(
                table.west_m + column * (MODULE_WIDTH_M + MODULE_GAP_M),
                table.north_m - row * (MODULE_HEIGHT_M + MODULE_GAP_M),
                MODULE_WIDTH_M,
                MODULE_HEIGHT_M,
            )


def _hot_spot(rng: Generator, module: Area) -> HotSpot:
    """Either one cell or a group of cells; the middle of a cell is its centre."""
    column, row = int(rng.integers(0, CELLS_ACROSS)), int(rng.integers(0, CELLS_DOWN))
    large = rng.random() < 0.5
    if large:
        column = min(max(column, 1), CELLS_ACROSS - 2)
    half_m = rng.uniform(*(_LARGE_HALF_M if large else _SMALL_HALF_M))
    stretch = rng.uniform(0.9, 1.12)
    return HotSpot(
        east_m=module.west_m + FRAME_M + (column + 0.5) * CELL_M,
        north_m=module.north_m - FRAME_M - (row + 0.5) * CELL_M,
        half_width_m=half_m * stretch,
        half_height_m=half_m / stretch,
        peak=rng.uniform(0.75, 1.0),
    )


def _breakage(rng: Generator, module: Area) -> Breakage:
    return Breakage(
        east_m=module.west_m + rng.uniform(0.15, 0.85) * module.width_m,
        north_m=module.north_m - rng.uniform(0.15, 0.85) * module.height_m,
        haze=rng.uniform(0.15, 0.45),
    )
