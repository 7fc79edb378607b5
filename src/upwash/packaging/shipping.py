"""Images between a packager and a daemon's container engine."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from upwash.config.daemon import DaemonConfig
from upwash.config.runtime import RuntimeConfig
from upwash.errors import UsageError
from upwash.launch.containers import docker_engine, docker_images
from upwash.missions.bundled import LoadedService, installed_service, load_service_alone, load_services
from upwash.packaging.image import Format
from upwash.real.instances.containers import ServiceImage, labelled_image, newest_images
from upwash.real.instances.docker.engine import DockerEngine
from upwash.real.instances.lxd.engine import Engine

_HASH_SHOWN = 12
E = TypeVar("E", bound=Engine | DockerEngine)


@dataclass(frozen=True, slots=True)
class HeldService:
    """The program and the image of a daemon's service, for people; `image` is empty for a process."""

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


async def import_image(file: Path, kind: Format, daemon: DaemonConfig | None) -> None:
    """Has the daemon's engine, or the one of this machine, take in the image."""
    runtime = daemon.runtime if daemon and daemon.runtime.kind == kind else RuntimeConfig(kind=kind)
    async with _connected(docker_engine(runtime) if kind == "docker" else Engine(runtime)) as engine:
        await engine.import_image(file)


async def list_images(daemon: DaemonConfig) -> list[HeldService]:
    """What the daemon has of each of its services."""
    if not daemon.runtime.has_images:
        return [
            HeldService(image.name, image.program or installed_service(image.name)) for image in daemon.images
        ]
    if daemon.runtime.kind == "lxd":
        async with _connected(Engine(daemon.runtime)) as lxd:
            newest = newest_images(await lxd.images())
        return [_offer(image.name, newest.get(image.name)) for image in daemon.images]
    offers = []
    async with _connected(docker_engine(daemon.runtime)) as docker:
        for service, reference in docker_images(daemon).items():
            held = await docker.image(reference)
            offers.append(_offer(service, labelled_image(held) if held else None, reference))
    return offers


def _offer(service: str, image: ServiceImage | None, reference: str = "") -> HeldService:
    if image is None:
        return HeldService(service, "", f"{reference} missing".strip(), can_run=False)
    made_with = (
        f"{image.base}, Python {image.python}, upwash {image.release}" if image.release else "a Dockerfile"
    )
    return HeldService(service, image.program.path, reference or image.fingerprint[:_HASH_SHOWN], made_with)


@contextlib.asynccontextmanager
async def _connected(engine: E) -> AsyncIterator[E]:
    try:
        await engine.connect()
        yield engine
    finally:
        await engine.close()
