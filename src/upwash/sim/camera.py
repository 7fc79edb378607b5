"""Cameras without a lens, and the waypoints whose photos show an event."""

from __future__ import annotations

import asyncio
import functools
import itertools
import random
from collections.abc import Sequence
from typing import TYPE_CHECKING

from upwash.config.drone import CameraConfig
from upwash.config.world import EventConfig, ObjectConfig
from upwash.core.camera.lens import Lens
from upwash.core.geo import Position, Waypoint, ground_distance_m
from upwash.ports import Photo
from upwash.sim.chance import Chance
from upwash.sim.drawn import ShownObject, drawn
from upwash.sim.runtime import EVENT, mistake_of
from upwash.support.loading import extra

if TYPE_CHECKING:
    from upwash.services.solar_park import RenderedPhoto


_LENS = Lens(fov_deg=62.2, up_deg=0.0)  # of the photos of the solar park
_PARK_PHOTO_BYTES = 430_000  # a usual rendered photo
_JPEG = b"\xff\xd8\xff"
_SAME_PLACE_M = 1.0
_PLACE_DIGITS = 6  # after the point: a micrometre shows nothing new, and rendering takes 0.1 s
_PHOTO_PX = 640, 480
_OBJECT_M, _OFF_M, _LOWEST_M = 1.0, 1.0, 0.5


class ModelCamera:
    """Returns the same few bytes after `photo_s`: the radio model knows the size of a photo.

    At the places of `events` the photo shows an event, which modelled services detect, except those that are
    `mistaken` there: pairs of a place and a profile key. The shutter opens when the photo is there, or `in_flight`
    at once.
    """

    def __init__(
        self,
        *,
        photo_s: float,
        events: Sequence[Position] = (),
        mistaken: Sequence[tuple[Position, str]] = (),
        in_flight: bool = False,
    ) -> None:
        self._photo_s = photo_s
        self._events = events
        self._mistaken = mistaken
        self._in_flight = in_flight

    async def take_photo(self, at: Position) -> Photo:
        """The first bytes of a JPEG, after `photo_s`."""
        asked_s = asyncio.get_running_loop().time()
        await asyncio.sleep(self._photo_s)
        captured_s = asked_s if self._in_flight else asyncio.get_running_loop().time()
        shows_event = any(ground_distance_m(at, place) < _SAME_PLACE_M for place in self._events)
        photo = _JPEG + EVENT if shows_event else _JPEG
        for place, key in self._mistaken:
            if ground_distance_m(at, place) < _SAME_PLACE_M:
                photo += mistake_of(key)
        return Photo(photo, captured_s, source="model")


class ObjectCamera:
    """Takes photos, straight down and north up, of objects on level ground: bytes that name them, with a true size.

    Each photo is off by an error of its own, as of a GPS. The shutter opens when the photo is there, or `in_flight`
    at once.
    """

    def __init__(
        self, objects: Sequence[ObjectConfig], camera: CameraConfig, *, in_flight: bool, chance: random.Random
    ) -> None:
        self._objects = objects
        self._photo_s = camera.photo_s
        self._size_px = camera.photo_px or _PHOTO_PX
        self._lens = Lens(fov_deg=camera.fov_deg or _LENS.fov_deg, up_deg=0.0)
        self._in_flight = in_flight
        self._chance = chance

    async def take_photo(self, at: Position) -> Photo:
        """The photo from that position, after `photo_s`."""
        asked_s = asyncio.get_running_loop().time()
        await asyncio.sleep(self._photo_s)
        captured_s = asked_s if self._in_flight else asyncio.get_running_loop().time()
        off_m = self._chance.gauss(0.0, _OFF_M), self._chance.gauss(0.0, _OFF_M)
        shown = [each for there in self._objects if (each := self._shown(there, at, off_m)) is not None]
        width, height = (size.to_bytes(2) for size in self._size_px)
        jpeg = b"\xff\xd8\xff\xc0\x00\x0b\x08" + height + width + b"\x01\x01\x11\x00\xff\xd9"
        jpeg += (EVENT if shown else b"") + drawn(shown)
        return Photo(jpeg, captured_s, source="model", lens=self._lens)

    def _shown(self, there: ObjectConfig, at: Position, off_m: tuple[float, float]) -> ShownObject | None:
        """The object in a photo from there; None beside it."""
        if at.altitude_m < _LOWEST_M:
            return None
        width, height = self._size_px
        px_per_m = self._lens.focal_in(self._size_px) / at.altitude_m
        x_px = width / 2 + px_per_m * (there.east_m - at.east_m + off_m[0])
        y_px = height / 2 - px_per_m * (there.north_m - at.north_m + off_m[1])
        if not (0 <= x_px <= width and 0 <= y_px <= height):
            return None
        side_px = min(px_per_m * _OBJECT_M, width / 4)
        score = round(self._chance.uniform(0.4, 0.95), 2)
        return ShownObject(
            there.label,
            round(x_px - side_px / 2, 2),
            round(y_px - side_px / 2, 2),
            round(side_px, 2),
            round(side_px, 2),
            score,
        )


class UnseenCamera:
    """Returns one grey photo in place of the photos of a solar park, for missions that do not look at photos.

    Size and lens are those of the rendered photos.
    """

    def __init__(self, park_seed: int, *, photo_s: float) -> None:
        with extra("detector"):
            from upwash.services.solar_park import grey_photo
        self._jpeg = grey_photo().ljust(_PARK_PHOTO_BYTES, b"\0")  # decoders stop at the end of the picture
        self._source = f"park {park_seed}"
        self._photo_s = photo_s

    async def take_photo(self, at: Position) -> Photo:
        """The grey photo, after `photo_s`."""
        captured_s = asyncio.get_running_loop().time()
        await asyncio.sleep(self._photo_s)
        return Photo(self._jpeg, captured_s, self._source, lens=_LENS)


class RenderedCamera:
    """Renders photos of the solar park of a seed, straight down from the drone's position, north up.

    The same place always shows the same modules with the same faults, which are the photo's truth. A photo takes
    `photo_s`, or longer if rendering does. Rendering runs in a thread on a real clock, and at once on virtual time.
    """

    def __init__(self, park_seed: int, *, photo_s: float, in_thread: bool) -> None:
        with extra("detector"):
            import upwash.services.solar_park  # noqa: F401
        self._source = f"park {park_seed}"
        self._park_seed = park_seed
        self._shots = itertools.count()
        self._photo_s = photo_s
        self._in_thread = in_thread

    async def take_photo(self, at: Position) -> Photo:
        """The rendered photo of the park from that position, with its truth."""
        captured_s = asyncio.get_running_loop().time()
        rendered, _ = await asyncio.gather(self._rendered(at), asyncio.sleep(self._photo_s))
        return Photo(rendered.jpeg, captured_s, self._source, rendered.truth, _LENS)

    async def _rendered(self, at: Position) -> RenderedPhoto:
        east_m, north_m, altitude_m = (
            round(metres, _PLACE_DIGITS) for metres in (at.east_m, at.north_m, at.altitude_m)
        )
        photo = (self._park_seed, east_m, north_m, altitude_m, next(self._shots))
        return await asyncio.to_thread(_rendered, *photo) if self._in_thread else _rendered_once(*photo)


def _rendered(park_seed: int, east_m: float, north_m: float, altitude_m: float, shot: int) -> RenderedPhoto:
    from upwash.services.solar_park import Park, View, photograph

    return photograph(Park(park_seed), View(east_m, north_m, altitude_m), shot=shot)


# A check flies its mission many times, and each flight takes the same photos, of 430 KB each.
_rendered_once = functools.lru_cache(maxsize=256)(_rendered)


def eventful(event: EventConfig | None, waypoints: Sequence[Waypoint], chance: Chance) -> list[Waypoint]:
    """The waypoints with an event; with a probability, each draws from its own stream, whatever the order."""
    if event is None:
        return []
    if event.every is not None:
        return [waypoint for waypoint in waypoints if waypoint.index % event.every == event.offset]
    return [
        waypoint
        for waypoint in waypoints
        if chance.stream(f"event/{waypoint.index}").random() < event.chance(waypoint.position)
    ]


def mistaken(
    event: EventConfig | None, waypoints: Sequence[Waypoint], eventful: Sequence[Waypoint], chance: Chance
) -> list[tuple[Position, str]]:
    """The waypoints, and the profile keys of calls that are mistaken about an event there; each draws alone."""
    if event is None:
        return []
    demanding = {waypoint.index for waypoint in eventful}
    return [
        (waypoint.position, key)
        for waypoint in waypoints
        for key, share in event.mistakes(demands=waypoint.index in demanding).items()
        if chance.stream(f"mistake/{waypoint.index}/{key}").random() < share
    ]
