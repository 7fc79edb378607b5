"""The altitude of the ground by a grid that the user has."""

from __future__ import annotations

import contextlib
import math
import stat
from collections.abc import Iterator, Sequence
from pathlib import Path

from upwash.core.camera.georeference import Ground
from upwash.core.geo import GeoPosition, LocalFrame, Position
from upwash.errors import UsageError
from upwash.support.loading import extra
from upwash.support.text import printable, words_of

_ERROR_M = 1.0  # of a grid, beside its roughness
_LONGEST_REASON = 300  # characters
_UNKNOWN_M = 5.0  # of level ground where the grid has none


class _Unreadable(Exception):
    """Why a grid cannot be read."""


@contextlib.contextmanager
def _reading() -> Iterator[None]:
    """Any error that GDAL and its libraries raise for a damaged grid is raised as _Unreadable."""
    try:
        yield
    except Exception as error:
        raise _Unreadable(printable(words_of(str(error) or type(error).__name__), _LONGEST_REASON)) from error


def _require_file(file: Path) -> None:
    """Raise UsageError for a pipe or a device, which GDAL would wait for."""
    with contextlib.suppress(OSError):
        mode = file.stat().st_mode
        if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):  # some grids are folders
            raise UsageError(f"camera.terrain: {file} is no file: check the path")


class Terrain:
    """The ground around a place, by a raster that GDAL reads; raises UsageError for a file that is none.

    The grid's altitudes are above the sea. Home's own altitude is the grid's there.
    """

    def __init__(self, file: Path, home: GeoPosition) -> None:
        with extra("terrain"):
            import rasterio
            from rasterio.warp import transform
        self._transform = transform
        _require_file(file)
        try:
            with _reading():
                self._grid = rasterio.open(file)
        except _Unreadable as error:
            raise UsageError(f"camera.terrain: {file} is no grid that GDAL reads: {error}") from error
        self._frame = LocalFrame(home)
        try:
            self._home_m = self._altitude_of_home(file)
        except UsageError:
            self.close()
            raise

    def _altitude_of_home(self, file: Path) -> float:
        if self._grid.crs is None:
            raise UsageError(f"camera.terrain: {file} does not say where on the Earth it lies (its CRS)")
        try:
            (home_m,) = self._altitudes([Position(0.0, 0.0)])
        except _Unreadable as error:
            raise UsageError(
                f"camera.terrain: {file} cannot be read at mission.home ({error}): copy it again, or name another"
            ) from error
        if home_m is None:
            raise UsageError(f"camera.terrain: {file} does not reach mission.home: name a grid that does")
        return home_m

    def ground(self, at: Position) -> Ground:
        """The plane that fits the ground as far around the place as the place is high; level where no grid is."""
        reach_m = max(5.0, at.altitude_m)
        steps = [(east, north) for north in (1, 0, -1) for east in (-1, 0, 1)]
        places = [Position(at.east_m + reach_m * east, at.north_m + reach_m * north) for east, north in steps]
        try:
            altitudes = [altitude for altitude in self._altitudes(places) if altitude is not None]
        except _Unreadable:
            altitudes = []
        if len(altitudes) < len(steps):
            return Ground(
                error_m=_UNKNOWN_M, assumes="that the ground is level, as the terrain does not reach there"
            )
        middle = sum(altitudes) / len(steps)
        east, north = (
            sum(step[axis] * altitude for step, altitude in zip(steps, altitudes, strict=True)) / 6
            for axis in (0, 1)
        )
        rough = math.sqrt(
            sum(
                (altitude - middle - east * step[0] - north * step[1]) ** 2
                for step, altitude in zip(steps, altitudes, strict=True)
            )
            / len(steps)
        )
        return Ground(
            altitude_m=round(middle - self._home_m, 2),
            slope_east=round(east / reach_m, 4),
            slope_north=round(north / reach_m, 4),
            error_m=round(math.hypot(rough, _ERROR_M), 2),
        )

    def _altitudes(self, places: Sequence[Position]) -> list[float | None]:
        """The altitude of each place above the sea; None where the grid has none; raises _Unreadable."""
        import numpy as np

        geo = [self._frame.geo(place) for place in places]
        with _reading(), np.errstate(all="ignore"):
            xs, ys = self._transform(
                "EPSG:4326",
                self._grid.crs,
                [place.longitude_deg for place in geo],
                [place.latitude_deg for place in geo],
            )
            return [
                float(sample[0]) if not np.ma.getmaskarray(sample)[0] and math.isfinite(sample[0]) else None
                for sample in self._grid.sample(zip(xs, ys, strict=True), indexes=1, masked=True)
            ]

    def close(self) -> None:
        """Closes the file."""
        with contextlib.suppress(Exception):
            self._grid.close()
