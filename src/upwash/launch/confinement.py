"""What the daemon's services may see and use: the sandbox for processes, and limits and devices of each service.

A limit that the configuration names holds, or the daemon does not start. A default that cannot hold is left out.
"""

from __future__ import annotations

import asyncio
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path

from upwash.config.daemon import DaemonConfig, ImageConfig
from upwash.config.runtime import RuntimeConfig
from upwash.core.admission.limits import CUDA_MEMORY_BYTES, DEFAULT_LIMITS, Limits
from upwash.errors import UsageError
from upwash.real.instances.cards import device_files, has_card
from upwash.real.instances.sandbox import Sandbox, find_sandbox
from upwash.support.entry_points import INSTANCES, failing, made

_ROOT = (
    "the daemon is root, and so is whatever breaks out of a sandbox that root made: "
    "run it as a user of its own (docs/servers.md), or say runtime.sandbox_as_root = true"
)
_NAMES = tuple(limit.name for limit in fields(Limits))


@dataclass(frozen=True, slots=True)
class Confinement:
    """The sandbox or None, its `warning`, and by the name of each limit that cannot hold why (`unenforced`)."""

    sandbox: Sandbox | None = None
    warning: str = ""
    unenforced: Mapping[str, str] = field(default_factory=dict)

    def kind(self, config: DaemonConfig) -> str:
        """What keeps services in, in a word or two."""
        if config.runtime.kind != "process":
            return config.runtime.kind
        return "none" if self.sandbox is None else "bubblewrap"

    def limits(self, config: DaemonConfig) -> dict[str, Limits]:
        """The limits of each service; raises UsageError for a limit of the configuration that would not hold."""
        return {
            service.name: Limits(**{name: self._limit(name, service, config.runtime) for name in _NAMES})
            for service in config.images
        }

    def devices(self, config: DaemonConfig) -> dict[str, tuple[str, ...]]:
        """The devices of each service; raises UsageError for a device that is not here."""
        runtime = config.runtime
        named = {service.name: _devices_of(service, runtime) for service in config.images}
        if runtime.kind != "process":
            return named
        if self.sandbox is None:  # all are there
            return dict.fromkeys(named, ())
        found = {service: device_files(devices) for service, devices in named.items()}
        _refuse_missing([device for devices in found.values() for device in devices])
        return found

    def _limit(self, name: str, service: ImageConfig, runtime: RuntimeConfig) -> int | None:
        unenforced = self.unenforced.get(name, "")
        for table, where in ((service, f'service "{service.name}"'), (runtime, "[runtime]")):
            most: int | None = getattr(table, name)
            if most is None:
                continue
            if unenforced:
                raise UsageError(f"{name} of {where} would have no effect: {unenforced}; or leave {name} out")
            if name == "cpus" and self.sandbox and most > (there := len(os.sched_getaffinity(0))):
                raise UsageError(
                    f"cpus = {most} of {where} would have no effect: the daemon may use {there}, so give fewer"
                )
            return most
        if unenforced:
            return None
        if name == "memory_bytes" and has_card(device_files(_devices_of(service, runtime))):
            return CUDA_MEMORY_BYTES
        default: int | None = getattr(DEFAULT_LIMITS, name)
        return default


async def find_confinement(config: DaemonConfig) -> Confinement:
    """What this machine offers; raises UsageError where a required sandbox cannot be made."""
    runtime = config.runtime
    if runtime.kind == "docker":
        return Confinement(unenforced=await _unenforced_by_docker(runtime))
    if runtime.kind == "lxd":
        return Confinement()
    if runtime.is_of_plug_in:
        why = f'the engine of runtime.kind = "{runtime.kind}" does not enforce it'
        with failing(INSTANCES, runtime.kind, "does not say what it enforces", UsageError):
            enforces = made(INSTANCES, runtime.kind, runtime.engine.settings).enforces
        return Confinement(unenforced={name: why for name in _NAMES if name not in enforces})
    if runtime.sandbox == "off":
        return _without_sandbox(
            "services run without a sandbox, as runtime.sandbox says",
            'processes have limits in a sandbox alone, and runtime.sandbox is "off": say "required"',
        )
    is_root = os.geteuid() == 0
    if is_root and not runtime.sandbox_as_root:
        raise UsageError(_ROOT)
    try:
        sandbox = await asyncio.to_thread(find_sandbox, readable=runtime.readable)
    except UsageError as error:
        if runtime.sandbox == "required":
            raise
        return _without_sandbox(
            f"services run without a sandbox: {error}",
            f"processes have limits in a sandbox alone, and there is none: {error}",
        )
    warning = "the daemon is root: services in their sandbox may start processes without limit"
    return Confinement(sandbox, warning if is_root else "", sandbox.unenforced)


def _devices_of(service: ImageConfig, runtime: RuntimeConfig) -> tuple[str, ...]:
    return runtime.devices if service.devices is None else service.devices


def _refuse_missing(devices: Sequence[str]) -> None:
    if missing := sorted({device for device in devices if not Path(device).exists()}):
        raise UsageError(
            f"devices: {', '.join(missing)} cannot be seen here: load the driver, and under systemd let the "
            "unit use devices (docs/small-computers.md)"
        )


async def _unenforced_by_docker(runtime: RuntimeConfig) -> Mapping[str, str]:
    from upwash.launch.containers import docker_engine

    engine = docker_engine(runtime)
    try:
        return await engine.unenforced_limits()
    finally:
        await engine.close()


def _without_sandbox(warning: str, why: str) -> Confinement:
    return Confinement(warning=warning, unenforced=dict.fromkeys(_NAMES, why))
