"""Puts a drone's camera on what its configuration names."""

from __future__ import annotations

import contextlib

from upwash.config import CameraConfig
from upwash.errors import UsageError
from upwash.ports import Camera
from upwash.real.camera import FolderCamera
from upwash.real.video import VideoCamera
from upwash.sim.camera import RenderedCamera
from upwash.support.loading import extra


def camera_without_device(config: CameraConfig) -> Camera | None:
    """The configured camera that needs no device, None where it needs one; raises UsageError for one that cannot be.

    A device is not opened, and what reads it is there.
    """
    if config.folder is not None:
        return FolderCamera(config.folder, photo_s=config.photo_s)
    if config.park_seed is not None:
        return RenderedCamera(config.park_seed, photo_s=config.photo_s, in_thread=True)
    if config.device is None:
        raise UsageError(
            "no camera: say in [camera] where photos come from: folder, device, or park_seed for rendered ones"
        )
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
