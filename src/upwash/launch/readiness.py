"""What prevents a configured drone from flying: `upwash fly` refuses it, and `upwash check` warns of it.

All checks are of this computer: they connect to no vehicle, camera or server.
"""

from __future__ import annotations

import functools
import importlib
from collections.abc import Callable, Iterable, Iterator
from datetime import UTC, datetime, timedelta
from typing import NamedTuple

from upwash.config.drone import CameraConfig, DroneConfig
from upwash.config.user import UserConfig
from upwash.errors import UpwashError
from upwash.launch.cameras import camera_without_device, lens_of, needs_camera
from upwash.launch.drone import (
    connection_of,
    drone_credentials,
    home_of,
    require_address,
    require_certificates,
    signing_of,
)
from upwash.real.camera.album import require_room_for
from upwash.real.camera.terrain import Terrain
from upwash.support.loading import extra

_A_DAY = timedelta(days=1)  # longer than any flight


class FlightRefusal(NamedTuple):
    """Why a flight would not begin; its kind stays the same from version to version."""

    kind: str
    error: UpwashError


def require_ready(config: DroneConfig) -> None:
    """Raises the first reason why a flight would not begin; the clock need not be right yet."""
    for refusal in refusals(config, valid_now=False):
        raise refusal.error


def refusals(config: DroneConfig, *, valid_now: bool = True) -> Iterator[FlightRefusal]:
    """Each reason why a flight would not begin.

    With `valid_now` the drone's certificate must be valid by this computer's clock.
    """
    return _refused(_steps(config, valid_now=valid_now))


def file_refusals(config: DroneConfig) -> Iterator[FlightRefusal]:
    """Each reason why a flight would not begin that is in a file, or a folder, of the configuration's camera."""
    return _refused(_file_steps(config))


def _refused(steps: Iterable[tuple[str, Callable[[], object]]]) -> Iterator[FlightRefusal]:
    told = set()
    for kind, step in steps:
        try:
            step()
        except UpwashError as error:
            if str(error) not in told:  # a camera opens its calibration too
                yield FlightRefusal(kind, error)
            told.add(str(error))


def _steps(config: DroneConfig, *, valid_now: bool) -> Iterator[tuple[str, Callable[[], object]]]:
    yield "no-home", functools.partial(home_of, config)
    yield "no-connection", functools.partial(connection_of, config)
    yield "signing-key", functools.partial(signing_of, config)
    for server in config.servers:
        yield "no-address", functools.partial(require_address, server)
        yield "no-keys", functools.partial(require_certificates, server, config)
    yield "certificate", functools.partial(drone_credentials, config, valid_now=valid_now)
    yield from _file_steps(config)
    if not _is_of_files(config.camera) and needs_camera(config):
        yield "no-camera", functools.partial(camera_without_device, config.camera)
    if config.network.kind == "networkmanager":
        yield "extra", functools.partial(_require, "network", "upwash.real.network.network")
    if config.user != UserConfig():
        yield "handover", functools.partial(_recipients, config.user)
    if config.metrics is not None:
        yield "extra", functools.partial(_require, "metrics", "upwash.metrics.exposition")


def _file_steps(config: DroneConfig) -> Iterator[tuple[str, Callable[[], object]]]:
    camera = config.camera
    if camera.calibration is not None:
        yield "no-calibration", functools.partial(lens_of, camera)
    if camera.terrain is not None and config.mission.home is not None:
        yield "no-terrain", functools.partial(_terrain, config)
    if camera.keep is not None:
        yield "no-folder", functools.partial(require_room_for, camera.keep)
    if _is_of_files(camera):
        yield "no-camera", functools.partial(camera_without_device, camera)


def _is_of_files(camera: CameraConfig) -> bool:
    return camera.folder is not None or camera.bag is not None


def _terrain(config: DroneConfig) -> None:
    if config.camera.terrain is not None:
        Terrain(config.camera.terrain, home_of(config)).close()


def expiry_trouble(config: DroneConfig) -> str:
    """A warning if the drone's certificate, or its authority's, ends within a day; else ""."""
    try:
        credentials = drone_credentials(config)
    except UpwashError:  # which is a refusal of its own
        return ""
    ends = credentials.expiries if credentials is not None else {}
    soon = [
        f"{holder} ({at:%Y-%m-%d %H:%M} UTC)"
        for holder, at in ends.items()
        if at - datetime.now(UTC) < _A_DAY
    ]
    return (
        f"certificates end within a day: {', '.join(soon)}; make new ones before the flight" if soon else ""
    )


def _recipients(user: UserConfig) -> None:
    from upwash.launch.recipients import recipients_of

    recipients_of(user)


def _require(name: str, module: str) -> None:
    with extra(name):
        importlib.import_module(module)
