"""Puts a drone's camera on what its configuration names."""

from __future__ import annotations

import contextlib
import functools
import inspect
import sys
from collections.abc import Iterator
from types import ModuleType

from upwash.config import CameraConfig, DroneConfig
from upwash.core.geo import Position
from upwash.errors import CameraError, UsageError
from upwash.missions.bundled import load_mission
from upwash.ports import Camera, Photo
from upwash.real.camera.camera import FolderCamera
from upwash.real.camera.video import VideoCamera
from upwash.sim.camera import RenderedCamera
from upwash.support.loading import extra

NO_CAMERA = (
    "no camera: say in [camera] where photos come from: folder, device, or park_seed for rendered ones"
)
_TAKES_ONE = "take_photo"


class NoCamera:
    """The camera of a drone without one."""

    async def take_photo(self, at: Position) -> Photo:
        """Raises CameraError."""
        raise CameraError("of the mission", NO_CAMERA)


def needs_camera(config: DroneConfig) -> bool:
    """Whether a camera is configured, or the mission takes photos, by its own source and that of what it imports."""
    camera = config.camera
    if camera.folder is not None or camera.device is not None or camera.park_seed is not None:
        return True
    mission = load_mission(config.mission.program, mode=config.mission.mode)
    program = mission.func if isinstance(mission, functools.partial) else mission
    module = sys.modules.get(program.__module__)
    return module is None or any(_TAKES_ONE in _source(each) for each in _with_imported(module))


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


def camera_without_device(config: CameraConfig) -> Camera | None:
    """The configured camera that needs no device, None where it needs one; raises UsageError for one that cannot be.

    A device is not opened, and what reads it is there.
    """
    if config.folder is not None:
        return FolderCamera(config.folder, photo_s=config.photo_s)
    if config.park_seed is not None:
        return RenderedCamera(config.park_seed, photo_s=config.photo_s, in_thread=True)
    if config.device is None:
        raise UsageError(NO_CAMERA)
    with extra("detector"):
        import cv2  # noqa: F401
    return None


async def opened_camera(config: CameraConfig, stack: contextlib.AsyncExitStack) -> Camera:
    """The configured camera, until the stack is closed; raises UsageError, or CameraError for a silent device."""
    camera = camera_without_device(config)
    if camera is None:
        assert config.device is not None  # noqa: S101
        camera = stack.enter_context(
            contextlib.closing(await VideoCamera.open(config.device, latency_s=config.latency_s))
        )
    return camera
