"""Images between a packager and a daemon's container engine."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path

from upwash.config import DaemonConfig, RuntimeConfig
from upwash.errors import UsageError
from upwash.launch.containers import engine_of
from upwash.missions.bundled import LoadedService, bundled_service, load_service_alone, load_services
from upwash.real.lxd.engine import Engine
from upwash.real.lxd.image import newest_images

_HASH_SHOWN = 12


@dataclass(frozen=True, slots=True)
class Offer:
    """What a daemon has of a service, in words; `image` is empty for one that runs as a process."""

    service: str
    program: str
    image: str = ""
    made_with: str = ""
    can_run: bool = True


def find_service(name: str, daemon: DaemonConfig | None) -> LoadedService:
    """The service as the daemon's configuration has it, or the bundled one; raises UsageError."""
    if daemon is None:
        return load_service_alone(name)
    wanted = [image for image in daemon.images if image.name == name]
    if not wanted:
        known = ", ".join(image.name for image in daemon.images)
        raise UsageError(f"the configuration has no service {name}: it has {known}")
    return load_services(wanted)[name]


async def import_image(file: Path, daemon: DaemonConfig | None) -> None:
    """Has the daemon's engine, or the one of this machine, take in the image."""
    async with _connected(daemon) as engine:
        await engine.import_image(file)


async def list_images(daemon: DaemonConfig) -> list[Offer]:
    """What the daemon has of each of its services."""
    if daemon.runtime.kind == "process":
        return [Offer(image.name, image.program or bundled_service(image.name)) for image in daemon.images]
    async with _connected(daemon) as engine:
        newest = newest_images(await engine.images())
    offers = []
    for service in (image.name for image in daemon.images):
        if image := newest.get(service):
            made_with = f"{image.base}, Python {image.python}, upwash {image.release}"
            offers.append(Offer(service, image.program.path, image.fingerprint[:_HASH_SHOWN], made_with))
        else:
            offers.append(Offer(service, "", "missing", can_run=False))
    return offers


@contextlib.asynccontextmanager
async def _connected(daemon: DaemonConfig | None) -> AsyncIterator[Engine]:
    engine = engine_of(daemon.runtime if daemon else RuntimeConfig())
    try:
        await engine.connect()
        yield engine
    finally:
        await engine.close()
