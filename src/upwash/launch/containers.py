"""The daemon's container engine and the containers of its services, as configured."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Callable, Mapping
from pathlib import Path

from upwash.config.daemon import DaemonConfig
from upwash.config.runtime import RuntimeConfig
from upwash.core.admission.limits import Limits
from upwash.ports import InstanceSpec
from upwash.real.instances.containers import ContainerRuntime, reference_of
from upwash.real.instances.docker.container import DockerSettings
from upwash.real.instances.docker.engine import DockerEngine
from upwash.real.instances.docker.runtime import DockerRuntime
from upwash.real.instances.lxd.engine import Engine
from upwash.real.instances.lxd.runtime import LxdRuntime
from upwash.real.link.door import Lead


@contextlib.asynccontextmanager
async def containers(
    config: DaemonConfig,
    limits: Mapping[str, Limits],
    devices: Mapping[str, tuple[str, ...]],
    lead: Lead | None,
    *,
    sockets: Path,
    listen: Callable[[InstanceSpec], str],
) -> AsyncIterator[ContainerRuntime]:
    """The runtime of the daemon's containers, prepared; no container runs after the block."""
    runtime: ContainerRuntime
    if config.runtime.kind == "lxd":
        assert lead is not None  # noqa: S101 - the configuration was checked for certificates
        engine = Engine(config.runtime)
        runtime = LxdRuntime(
            engine, config.runtime, limits, lead=lead, max_message_bytes=config.max_message_bytes
        )
    else:
        runtime = DockerRuntime(
            docker_engine(config.runtime),
            DockerSettings(folder=sockets, limits=limits, devices=devices),
            docker_images(config),
            listen=listen,
            freezes=config.runtime.idle == "freeze",
            lead=lead,
            max_message_bytes=config.max_message_bytes,
        )
    try:
        await runtime.prepare({identity.name: identity.images for identity in config.identities})
        yield runtime
    finally:
        await runtime.close()


def docker_images(config: DaemonConfig) -> dict[str, str]:
    """The name of each service's image."""
    return {image.name: image.image or reference_of(image.name) for image in config.images}


def docker_engine(config: RuntimeConfig) -> DockerEngine:
    """The configured Docker or Podman."""
    return DockerEngine(config.engine_addresses[0])
