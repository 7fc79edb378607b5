"""Cameras without a lens: one renders what lies below the drone, one returns nothing worth looking at."""

from __future__ import annotations

import asyncio
import functools
import itertools
from typing import TYPE_CHECKING

from upwash.core.geo import Position
from upwash.ports import Photo
from upwash.support.loading import extra

if TYPE_CHECKING:
    from upwash.services.solar_park import RenderedPhoto


class ModelCamera:
    """Returns the same few bytes after `photo_s`: how large a photo is, the radio model knows."""

    def __init__(self, *, photo_s: float) -> None:
        self._photo_s = photo_s

    async def take_photo(self, at: Position) -> Photo:
        """Waits, and returns the beginning of a JPEG."""
        await asyncio.sleep(self._photo_s)
        return Photo(b"\xff\xd8\xff", asyncio.get_running_loop().time(), source="model")


class RenderedCamera:
    """Renders a photo of the solar park of that seed, straight down from where the drone is, north up.

    The same place always shows the same modules with the same faults, which are the photo's truth. A photo takes
    `photo_s`, or as long as rendering does; that happens in a thread on a real clock, and on virtual time at once.
    """

    def __init__(self, park_seed: int, *, photo_s: float, in_thread: bool) -> None:
        with extra("detector"):
            from upwash.services import solar_park
        self._source = f"park {park_seed}"
        self._render = functools.partial(solar_park.photograph, solar_park.Park(park_seed))
        self._view = solar_park.View
        self._shots = itertools.count()
        self._photo_s = photo_s
        self._in_thread = in_thread

    async def take_photo(self, at: Position) -> Photo:
        """Returns what the park looks like from there."""
        captured_s = asyncio.get_running_loop().time()
        rendered, _ = await asyncio.gather(self._rendered(at), asyncio.sleep(self._photo_s))
        return Photo(rendered.jpeg, captured_s, self._source, rendered.truth)

    async def _rendered(self, at: Position) -> RenderedPhoto:
        view = self._view(at.east_m, at.north_m, at.altitude_m)
        render = functools.partial(self._render, view, shot=next(self._shots))
        return await asyncio.to_thread(render) if self._in_thread else render()
