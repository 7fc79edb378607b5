"""Puts a daemon's services in containers: what [runtime] says, as each engine's runtime wants it."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Callable, Mapping
from ipaddress import IPv4Network
from pathlib import Path

from upwash.config import DaemonConfig, RuntimeConfig
from upwash.core.admission.limits import Limits
from upwash.ports import InstanceSpec
from upwash.real.instances.docker.container import ContainerSettings as DockerSettings
from upwash.real.instances.docker.engine import DockerEngine
from upwash.real.instances.docker.runtime import ContainerRuntime as DockerRuntime
from upwash.real.instances.lxd.container import ContainerSettings as LxdSettings
from upwash.real.instances.lxd.engine import Engine, EngineAddress
from upwash.real.instances.lxd.runtime import ContainerRuntime as LxdRuntime
from upwash.real.instances.service_image import reference_of
from upwash.real.link.door import Lead


@contextlib.asynccontextmanager
async def lxd_containers(
    config: DaemonConfig, limits: Mapping[str, Limits], lead: Lead
) -> AsyncIterator[LxdRuntime]:
    """The containers of the daemon's services, made if they are not there; none runs after the block."""
    runtime = LxdRuntime(
        lxd_engine(config.runtime),
        LxdSettings(
            subnet=IPv4Network(config.runtime.network.subnet),
            interface=config.runtime.network.interface or "",
            pool=config.runtime.engine.pool,
            profiles=config.runtime.engine.profiles,
            limits=limits,
        ),
        freezes=config.runtime.idle == "freeze",
        lead=lead,
        max_message_bytes=config.max_message_bytes,
    )
    try:
        await runtime.prepare(
            [identity.name for identity in config.identities],
            [(identity.name, image) for identity in config.identities for image in identity.images],
        )
        yield runtime
    finally:
        await runtime.close()


@contextlib.asynccontextmanager
async def docker_containers(
    config: DaemonConfig,
    limits: Mapping[str, Limits],
    lead: Lead | None,
    sockets: Path,
    listen: Callable[[InstanceSpec], str],
) -> AsyncIterator[DockerRuntime]:
    """What makes the containers of the daemon's services, of images that are there; none runs after the block."""
    runtime = DockerRuntime(
        docker_engine(config.runtime),
        DockerSettings(
            folder=sockets,
            limits=limits,
            devices=config.runtime.devices,
        ),
        docker_images(config),
        listen=listen,
        freezes=config.runtime.idle == "freeze",
        lead=lead,
        max_message_bytes=config.max_message_bytes,
    )
    try:
        await runtime.prepare(
            [identity.name for identity in config.identities], [image.name for image in config.images]
        )
        yield runtime
    finally:
        await runtime.close()


def docker_images(config: DaemonConfig) -> dict[str, str]:
    """The name of each service's image."""
    return {image.name: image.image or reference_of(image.name) for image in config.images}


def docker_engine(config: RuntimeConfig) -> DockerEngine:
    """The configured engine, Docker or Podman."""
    return DockerEngine(config.engine_addresses[0])


def lxd_engine(config: RuntimeConfig) -> Engine:
    """The configured engine, LXD or Incus."""
    engine = config.engine
    return Engine(
        [
            EngineAddress(url, engine.certificate, engine.key, engine.engine_certificate)
            for url in config.engine_addresses
        ],
        project=engine.project,
    )
