"""What system tests share: a browser, and the engines in which services run in containers."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from tests.doors import led
from tests.engines import OwnEngine
from tests.podman import OwnPodman
from tests.system.browser import Browser, browser
from tests.system.container_site import (
    DISK_BYTES,
    MEMORY_BYTES,
    PROCESSES,
    Host,
    Site,
    image_of,
)
from tests.system.daemons import MAX_MESSAGE_BYTES

from upwash.config.runtime import ContainerNetworkConfig, EngineConfig, RuntimeConfig
from upwash.core.admission.limits import Limits
from upwash.real.instances.containers import reference_of
from upwash.real.instances.docker.container import DockerSettings
from upwash.real.instances.docker.engine import DockerEngine
from upwash.real.instances.docker.runtime import DockerRuntime
from upwash.real.instances.lxd.engine import Engine
from upwash.real.instances.lxd.runtime import LxdRuntime
from upwash.real.instances.runtime import sockets_in
from upwash.real.link.link import GrpcDialer
from upwash.real.trust.credentials import Credentials, fingerprint

SERVICES = ("workbench", "vandal")
LIMITS = Limits(memory_bytes=MEMORY_BYTES, processes=PROCESSES, disk_bytes=DISK_BYTES)
ReadCredentials = Callable[[str], Credentials]


@pytest.fixture(scope="session")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """A browser for pages."""
    with browser(tmp_path_factory.mktemp("chromium")) as opened:
        yield opened


@pytest.fixture(scope="session")
def vandal_image(services: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The image of the vandal, as LXD takes it."""
    return image_of(f"{services}:Vandal", tmp_path_factory.mktemp("images"))


@pytest.fixture(scope="session")
def images_held(podman: OwnPodman, docker_images: list[Path]) -> None:
    """Podman holds the images."""
    for image in docker_images:
        podman.command("load", "--input", str(image))


@pytest.fixture
def docker_host(
    podman: OwnPodman, services: Path, credentials: ReadCredentials, images_held: None, tmp_path: Path
) -> Host:
    """Podman, by Docker's API."""

    @asynccontextmanager
    async def open_site(
        *, freezes: bool = False, devices: Sequence[str] = (), images: dict[str, str] | None = None
    ) -> AsyncIterator[Site]:
        engine = DockerEngine(f"unix://{podman.socket}")
        async with led(credentials("s1")) as lead:
            runtime = DockerRuntime(
                engine,
                DockerSettings(
                    tmp_path, limits=dict.fromkeys(SERVICES, LIMITS), devices=dict.fromkeys(SERVICES, devices)
                ),
                images or {service: reference_of(service) for service in SERVICES},
                listen=sockets_in(tmp_path),
                freezes=freezes,
                lead=lead,
                max_message_bytes=MAX_MESSAGE_BYTES,
            )
            try:
                await engine.connect()
                await runtime.prepare({"s1": list(images or SERVICES), "s2": []})
                yield site_of(runtime, credentials("heron"), services)
            finally:
                await runtime.close()

    return Host(
        podman,
        open_site,
        keeps=False,
        runtime={"kind": "docker", "engine": {"addresses": [f"unix://{podman.socket}"]}},
        seen_of_a_kill=".*killed by SIGKILL.*",
        writable=3,  # /tmp, /var/tmp and /dev/shm
    )


@pytest.fixture
def lxd_host(
    lxd: OwnEngine,
    services: Path,
    credentials: ReadCredentials,
    workbench_image: Path,
    vandal_image: Path,
) -> Host:
    """LXD."""

    @asynccontextmanager
    async def open_site(*, freezes: bool = False) -> AsyncIterator[Site]:
        config = RuntimeConfig(
            kind="lxd",
            idle="freeze" if freezes else "stop",
            engine=EngineConfig(addresses=(f"unix:{lxd.socket}",)),
            network=ContainerNetworkConfig(subnet=lxd.subnet),
        )
        engine = Engine(config)
        async with led(credentials("s1")) as lead:
            runtime = LxdRuntime(
                engine,
                config,
                dict.fromkeys(SERVICES, LIMITS),
                lead=lead,
                max_message_bytes=MAX_MESSAGE_BYTES,
            )
            await engine.connect()
            try:
                await engine.import_image(workbench_image)
                await engine.import_image(vandal_image)
                await runtime.prepare({"s1": ["workbench", "vandal"], "s2": ["workbench"]})
                yield site_of(runtime, credentials("heron"), services)
            finally:
                await runtime.close()

    return Host(
        lxd,
        open_site,
        keeps=True,
        runtime={
            "kind": "lxd",
            "network": {"subnet": lxd.subnet},
            "engine": {"addresses": [f"unix:{lxd.socket}"]},
        },
        seen_of_a_kill="the container is gone, or cannot be reached",
        writable=2,
    )


def site_of(runtime: DockerRuntime | LxdRuntime, heron: Credentials, services: Path) -> Site:
    """The runtime's, with heron to call."""
    dialer = GrpcDialer("heron", heron, max_message_bytes=MAX_MESSAGE_BYTES)
    return Site(runtime, dialer, services, frozenset({fingerprint(heron.certificate)}))
