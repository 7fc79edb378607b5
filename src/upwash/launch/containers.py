"""Puts a daemon's services in containers: what [runtime] says, as the container runtime wants it."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator
from ipaddress import IPv4Network

from upwash.config import DaemonConfig, RuntimeConfig
from upwash.real.door import Lead
from upwash.real.lxd.container import ContainerSettings
from upwash.real.lxd.engine import Engine, EngineAddress
from upwash.real.lxd.runtime import ContainerRuntime


@contextlib.asynccontextmanager
async def container_runtime(config: DaemonConfig, lead: Lead) -> AsyncIterator[ContainerRuntime]:
    """The containers of the daemon's services, made if they are not there; none runs after the block."""
    runtime = ContainerRuntime(
        engine_of(config.runtime),
        ContainerSettings(
            subnet=IPv4Network(config.runtime.network.subnet),
            interface=config.runtime.network.interface or "",
            pool=config.runtime.engine.pool,
            profiles=config.runtime.engine.profiles,
            memory_bytes=config.runtime.memory_bytes,
            processes=config.runtime.processes,
            disk_bytes=config.runtime.disk_bytes,
            cpus=config.runtime.cpus,
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


def engine_of(config: RuntimeConfig) -> Engine:
    """The configured container engine."""
    engine = config.engine
    return Engine(
        [
            EngineAddress(url, engine.certificate, engine.key, engine.engine_certificate)
            for url in engine.addresses
        ],
        project=engine.project,
    )
