"""The drone's configured camera: opened for a flight, and tried before it."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import inspect
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from types import ModuleType

import msgspec

from upwash.config.drone import CameraConfig, DroneConfig
from upwash.core.camera.lens import Lens
from upwash.core.geo import Position
from upwash.errors import CameraError, UsageError
from upwash.eventlog.schema import Event, LogOpened, PhotoTaken
from upwash.missions.program import load_mission
from upwash.ports import Camera, Photo
from upwash.real.camera.album import FolderAlbum
from upwash.real.camera.calibration import read_calibration
from upwash.real.camera.camera import FolderCamera, photo_files, read_photo_file, shown_name
from upwash.real.camera.video import VideoCamera
from upwash.services.photo import other_format
from upwash.sim.camera import RenderedCamera
from upwash.support.entry_points import CAMERAS, made, plug_in
from upwash.support.jpeg import EOI, segments_of, size_of
from upwash.support.loading import extra
from upwash.support.text import counted, worded

NO_CAMERA = (
    "no camera: say in [camera] where photos come from: folder, device, topic, bag, plug_in, or park_seed "
    "for rendered ones"
)
_TAKES = ("take_photo", ".frames(")
_MOST_FILES = 2000  # of a folder: a card may hold more than a person waits for
_MOST_S = 60.0
_MOST_NAMED = 5
_APART_S = 1.0  # between two photos that cannot be the same
_LEAST_AGE_S = 1.0  # that a device's photo may have: a large frame takes some time to become a JPEG
_PHOTO_S = 20.0  # of a plug-in's camera
_DARKEST = 16  # of 255: what a sensor shows behind its cap


class NoCamera:
    """The camera of a drone without one."""

    async def take_photo(self, at: Position) -> Photo:
        """Raises CameraError."""
        raise CameraError("of the mission", NO_CAMERA)


class PlugInCamera:
    """The camera of a plug-in: it fails as a camera fails, and its photos have the configured lens."""

    def __init__(self, name: str, camera: Camera, *, lens: Lens | None) -> None:
        self._name, self._camera, self._lens = name, camera, lens

    async def take_photo(self, at: Position) -> Photo:
        """One photo; raises CameraError, at the latest after 20 s."""
        limit = asyncio.timeout(_PHOTO_S)
        try:
            async with limit:
                photo = await self._camera.take_photo(at)
            return photo if photo.lens is not None else replace(photo, lens=self._lens)
        except CameraError:
            raise
        except Exception as error:
            failed = f"its plug-in failed: {worded(error)}"
            silent = f"it gave no photo within {_PHOTO_S:g} s"
            raise CameraError(self._name, silent if limit.expired() else failed) from error


def needs_camera(config: DroneConfig) -> bool:
    """Whether a camera is configured, or the source of the mission or its imports takes photos."""
    camera = config.camera
    if any(
        source is not None
        for source in (
            camera.folder,
            camera.device,
            camera.topic,
            camera.bag,
            camera.park_seed,
            camera.plug_in,
        )
    ):
        return True
    mission = load_mission(config.mission.program, mode=config.mission.mode)
    program = mission.func if isinstance(mission, functools.partial) else mission
    module = sys.modules.get(program.__module__)
    return module is None or any(
        verb in _source(imported) for imported in _with_imported(module) for verb in _TAKES
    )


def _with_imported(module: ModuleType) -> Iterator[ModuleType]:
    """The module, and the modules outside upwash whose functions and classes it imports."""
    yield module
    for value in list(vars(module).values()):
        name = value.__name__ if isinstance(value, ModuleType) else getattr(value, "__module__", None)
        if isinstance(name, str) and name.partition(".")[0] != "upwash" and name in sys.modules:
            yield sys.modules[name]


def _source(module: ModuleType) -> str:
    try:
        return inspect.getsource(module)
    except (OSError, TypeError):  # the module is not written in Python
        return ""


def camera_without_device(config: CameraConfig, *, in_flight: bool = False) -> Camera | None:
    """The configured camera, or None for a camera that must be opened; raises UsageError."""
    if config.folder is not None:
        return FolderCamera(config.folder, photo_s=config.photo_s, lens=lens_of(config), in_flight=in_flight)
    if config.park_seed is not None:
        return RenderedCamera(config.park_seed, photo_s=config.photo_s, in_thread=True)
    if config.bag is not None:
        with extra("bag"):
            from upwash.real.camera.bag import BagCamera
        return BagCamera(config.bag, config.topic, photo_s=config.photo_s, lens=lens_of(config))
    if config.topic is not None:
        from upwash.ros.camera import require_ros

        require_ros()
        return None
    if config.plug_in is not None:
        plug_in(CAMERAS, config.plug_in)
        return None
    if config.device is None:
        raise UsageError(NO_CAMERA)
    with extra("detector"):
        import cv2  # noqa: F401
    return None


def lens_of(config: CameraConfig) -> Lens | None:
    """The configured lens as it is mounted, None without one; raises UsageError for a calibration that is none."""
    if config.calibration is not None:
        lens = read_calibration(config.calibration)
    elif config.fov_deg is not None or config.focal_px is not None:
        lens = Lens(fov_deg=config.fov_deg, focal_px=config.focal_px)
    else:
        return None
    return msgspec.structs.replace(
        lens, tilt_deg=config.tilt_deg, turned_deg=config.yaw_deg, on_gimbal=config.gimbal
    )


async def opened_camera(
    config: CameraConfig, stack: contextlib.AsyncExitStack, *, in_flight: bool = False
) -> Camera:
    """The configured camera, until the stack is closed; raises UsageError, or CameraError for a silent device.

    `in_flight` is whether photos are taken without a stop.
    """
    camera = camera_without_device(config, in_flight=in_flight)
    if camera is None and config.topic is not None:
        from upwash.ros.camera import topic_camera

        return stack.enter_context(topic_camera(config.topic, lens=lens_of(config)))
    if camera is None and config.plug_in is not None:
        camera = made(CAMERAS, config.plug_in, config.settings)
        stack.callback(getattr(camera, "close", lambda: None))
        return PlugInCamera(config.plug_in, camera, lens=lens_of(config))
    if camera is None:
        assert config.device is not None  # noqa: S101
        camera = stack.enter_context(
            contextlib.closing(
                await VideoCamera.open(
                    config.device,
                    latency_s=config.latency_s,
                    oldest_s=max(_LEAST_AGE_S, config.photo_s),
                    lens=lens_of(config),
                )
            )
        )
    return camera


def followers_of(camera: Camera) -> tuple[Callable[[Event], None], ...]:
    """What publishes the events of a flight where the camera's photos come from: in ROS 2, or nowhere."""
    follow = getattr(camera, "follow", None)
    return () if follow is None else (follow,)


def opened_album(keep: Path, events: Iterable[Event]) -> FolderAlbum:
    """Keeps the photos of the flight whose log has these events; `{time}` of the folder is when the log was opened.

    Raises UsageError if the folder cannot be made.
    """
    began, has_photos = datetime.fromtimestamp(0, UTC), False
    for event in events:
        match event:
            case LogOpened(time=time_of_day):  # perhaps of a later flight in the same log
                began, has_photos = time_of_day.astimezone(UTC), False
            case PhotoTaken():
                has_photos = True
    folder = Path(str(keep).replace("{time}", f"{began:%Y-%m-%dT%H-%M-%SZ}"))
    return FolderAlbum(folder, resumes=has_photos)


@dataclass(frozen=True, slots=True)
class Look:
    """Photos by their names, for calls of services, and the troubles of the camera or its photos."""

    photos: Mapping[str, bytes]
    troubles: tuple[str, ...] = ()


async def look(config: DroneConfig) -> Look:
    """The camera's photos: the first and the largest of a folder; none if the mission takes none.

    Raises UsageError for an impossible camera, and CameraError if it gives no photo.
    """
    if not needs_camera(config):
        return Look({})
    lens = lens_of(config.camera)
    if config.camera.folder is not None:
        seen = await asyncio.to_thread(_look_at_files, config.camera.folder)
        return Look(seen.photos, (*seen.troubles, *_misfits(lens, seen.photos)))
    async with contextlib.AsyncExitStack() as stack:
        camera = await opened_camera(config.camera, stack)
        here = Position(0.0, 0.0, config.mission.altitude_m)
        first = await camera.take_photo(here)
        photos = {first.source: first.jpeg}
        if config.camera.device is None and (config.camera.topic is None or config.camera.bag is not None):
            return Look(photos, tuple(_misfits(lens, photos)))
        await asyncio.sleep(_APART_S)
        second = await camera.take_photo(here)
    return Look(photos, (*_device_troubles(first.source, first.jpeg, second.jpeg), *_misfits(lens, photos)))


def _misfits(lens: Lens | None, photos: Mapping[str, bytes]) -> Iterator[str]:
    """The first photo that the calibration does not fit."""
    for name, jpeg in photos.items():
        size_px = size_of(jpeg)
        if lens is not None and size_px is not None and min(size_px) > 0 and not lens.fits(size_px):
            yield (
                f"camera.calibration is of pictures with another ratio of width to height than {name}, which has "
                f"{size_px[0]} x {size_px[1]} pixels: findings have no places; calibrate with photos of that size"
            )
            return


def _look_at_files(folder: Path) -> Look:
    files, until_s = photo_files(folder), time.monotonic() + _MOST_S
    chosen: dict[str, bytes] = {}
    bad: list[str] = []
    for looked_at, file in enumerate(files):
        if looked_at == _MOST_FILES or time.monotonic() > until_s:
            bad.append(
                f"only the first {looked_at} of {counted(len(files), 'photo')} of {folder} were looked at"
            )
            break
        try:
            jpeg = read_photo_file(file)
        except CameraError as error:
            bad.append(str(error))
            continue
        name = shown_name(file)
        if not any(segment.marker == EOI for segment in segments_of(jpeg)):
            kind = other_format(jpeg)
            problem = f"is {kind}: save it as a JPEG" if kind else "is no whole JPEG: copy it again"
            bad.append(f"camera {folder}: {name} {problem}, or take it out of the folder")
        elif len(chosen) < 2 or len(jpeg) > max(map(len, chosen.values())):
            if len(chosen) == 2:
                del chosen[list(chosen)[1]]
            chosen[name] = jpeg
    more = len(bad) - _MOST_NAMED
    others = [f"and {counted(more, 'more photo')} like these"] if more > 0 else []
    return Look(chosen, (*bad[:_MOST_NAMED], *others))


def _device_troubles(camera: str, first: bytes, second: bytes) -> list[str]:
    import cv2
    import numpy as np

    if first == second:
        return [
            f"camera {camera}: two photos, taken {_APART_S:g} s apart, are the same: its picture stands still"
        ]
    picture = cv2.imdecode(np.frombuffer(second, np.uint8), cv2.IMREAD_GRAYSCALE)
    if picture is None or picture.max() < _DARKEST:
        return [f"camera {camera}: its photo is black: take the cap off, or give it light"]
    return []
