"""Services in containers of some engine, and a drone that calls them."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.doors import reached
from tests.engines import OwnEngine
from tests.podman import OwnPodman
from tests.system.daemons import config

from upwash.packaging.image import Format
from upwash.ports import Instance, InstanceSpec, Program, Runtime
from upwash.real.link.link import GrpcDialer
from upwash.rpc.protocol import service_path
from upwash.rpc.service import load_service, spec_of

MEMORY_BYTES = 2**28
PROCESSES = 100
DISK_BYTES = 2**26
_OF_VANDALS = {"identity", "reach", "eat_memory", "fork_without_end", "fill_disk"}


def image_of(program: str, folder: Path, image_format: Format = "lxd") -> Path:
    """The image of a service, in a folder."""
    from upwash.missions.bundled import load_service_alone
    from upwash.packaging.image import Recipe, package

    return package(Recipe(load_service_alone(program), format=image_format), folder, report=lambda _: None)


@dataclass(frozen=True)
class Site:
    """A runtime with containers for two servers, and a drone that calls what runs in them."""

    runtime: Runtime
    dialer: GrpcDialer
    services: Path
    heron: frozenset[str]  # what instances know the drone by

    async def start(self, server: str, service: str) -> Instance:
        instance = await self.runtime.start(self.spec(server, service), called=lambda _: None)
        await instance.admit(self.heron)
        return instance

    def spec(self, server: str, service: str) -> InstanceSpec:
        return InstanceSpec(server, service, Program(""))

    async def call(
        self, instance: Instance, server: str, name: str, *arguments: object, timeout_s: float = 20.0
    ) -> Any:
        cls = "Vandal" if name in _OF_VANDALS else "Workbench"
        method = spec_of(load_service(f"{self.services}:{cls}")).methods[name]
        _, request = method.encode(arguments, {})
        link = self.dialer.dial(reached(instance.endpoint), server=server)
        try:
            reply = await link.request(service_path(cls.lower(), name), request, timeout_s=timeout_s)
        finally:
            await link.close()
        return method.result(method.decode(reply))


@dataclass(frozen=True)
class Host:
    """An engine of the tests' own, and how sites with its containers are opened."""

    engine: OwnPodman | OwnEngine
    open_site: Callable[..., AbstractAsyncContextManager[Site]]
    keeps: bool  # what was made, to use it again
    runtime: dict[str, Any]  # the table of that name for a daemon's configuration
    seen_of_a_kill: str  # what is said of a container that is killed from outside: a pattern
    writable: int  # folders of a container, each of which takes so many bytes

    def left(self) -> list[str]:
        """What there still is of instances; nothing once all have ended."""
        return self.engine.running() if self.keeps else self.engine.there()

    def configured(self, folder: Path, keys: Path | None, idle: str | None = None, **tables: Any) -> Path:
        """The configuration of a daemon that soon finds containers idle; a table changes or adds to what there is."""
        limits = {"memory_bytes": MEMORY_BYTES, "processes": PROCESSES, "disk_bytes": DISK_BYTES}
        of_processes = {"sandbox": None, "sandbox_as_root": None}
        fixed = {
            "runtime": {**self.runtime, **limits, **of_processes, "idle": idle},
            "lease_s": 2.0,
            "idle_stop_s": 0.5,
            "service": [{"name": "workbench"}, {"name": "vandal"}],
            "server": [{"name": "s1"}, {"name": "s2", "images": ["workbench"]}],
        }
        file = folder / "server.toml"
        file.write_text(config(keys, **fixed | tables))
        return file
