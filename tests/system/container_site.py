"""Services in containers of some engine, and a drone that calls them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.doors import reached

from upwash.ports import Instance, InstanceSpec, Program, Runtime
from upwash.real.link import GrpcDialer
from upwash.rpc.protocol import service_path
from upwash.rpc.service import load_service, spec_of

MAX_MESSAGE_BYTES = 1_000_000
MEMORY_BYTES = 2**28
PROCESSES = 100
DISK_BYTES = 2**26
_OF_VANDALS = {"identity", "reach", "eat_memory", "fork_without_end", "fill_disk"}


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
