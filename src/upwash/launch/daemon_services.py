"""The services that an edge daemon can start, as they lie on the disk, looked at again at each reload.

The daemon imports no code of services: a process of its own does, `python -m upwash.launch.daemon_services`, for each
service. A Python process keeps the modules that it has imported, and an import may hang or end its process.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import signal
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeAlias

import msgspec

from upwash.config.daemon import DaemonConfig, ImageConfig
from upwash.config.values import SettingsTable
from upwash.errors import UpwashError, UsageError
from upwash.launch.confinement import Confinement
from upwash.missions.bundled import load_configured
from upwash.ports import Program
from upwash.real.instances.versions import version_of, version_of_upwash
from upwash.rpc.service import spec_of
from upwash.server.instances import Image
from upwash.support.background import in_thread
from upwash.support.loading import look_here, module_command

_log = logging.getLogger("upwash.serving")
_UPGRADED = (
    "upwash itself has changed on the disk, so services stay as they are: have the new program take this daemon's "
    "place by SIGUSR2, or restart it"
)
_REAPED_S = 0.2  # a killed process may wait in the kernel for a disk that does not answer
Looked: TypeAlias = Image | str  # a service, or why it cannot be loaded


@dataclass(frozen=True, slots=True)
class Services:
    """The services of a configuration, and of those that stay in their former version why."""

    images: Mapping[str, Image]
    stay: Mapping[str, str] = field(default_factory=dict)


class DaemonServices:
    """What the daemon can start now."""

    def __init__(self, confinement: Confinement) -> None:
        self.upwash = version_of_upwash()
        self._confinement = confinement
        self._lanes: Mapping[str, int] = {}
        self._named: dict[str, tuple[object, ...]] = {}
        self.images: dict[str, Image] = {}
        self.looking = set[str]()  # services whose code is loaded just now

    @classmethod
    async def found(cls, config: DaemonConfig, confinement: Confinement) -> DaemonServices:
        """The services of the configuration; raises UsageError for a service that cannot be loaded."""
        services = cls(confinement)
        services.take(config, await services.anew(config))
        return services

    def know_lanes(self, lanes: Mapping[str, int]) -> None:
        """Takes in the lanes of those services whose programs only their runtime knows."""
        self._lanes = lanes
        self.images = self._with_lanes(self.images)

    async def anew(self, config: DaemonConfig) -> Services:
        """The services of another configuration, and of what lies on the disk now, within `start_timeout_s`.

        The former version of a service stays where another cannot be loaded. Raises UsageError where the
        configuration names another program or other settings that do not fit, for a limit that would not hold, and
        for a device that is not here.
        """
        limits, devices = self._confinement.limits(config), self._confinement.devices(config)
        is_loaded = not config.runtime.has_images
        if not is_loaded:
            _log.info("images of containers are looked at when the daemon starts: restart it to use others")
        looks = range(len(config.images))
        found: list[Looked] = [_UPGRADED for _ in looks]
        if not is_loaded:
            found = [
                Image(Program("", each.settings.values if each.settings else {}))  # the image checks them
                for each in config.images
            ]
        elif await in_thread(version_of_upwash, name="the version of upwash") == self.upwash:
            found = await asyncio.gather(*(self._looked_at_elsewhere(config, index) for index in looks))
        images, stay = dict[str, Image](), dict[str, str]()
        for service, looked in zip(config.images, found, strict=True):
            name = service.name
            if isinstance(looked, Image):
                images[name] = replace(
                    looked,
                    pace_s=service.pace_s,
                    start_pace_s=service.start_pace_s,
                    limits=limits[name],
                    devices=devices[name],
                )
            elif self._named.get(name) != _named(service):
                raise UsageError(looked)
            else:
                images[name], stay[name] = self.images[name], looked
        return Services(self._with_lanes(images), stay)

    def take(self, config: DaemonConfig, services: Services) -> list[str]:
        """From now on these are the services of this configuration; returns the names of those that changed."""
        changed = [name for name, image in services.images.items() if self.images.get(name) != image]
        self._named = {service.name: _named(service) for service in config.images}
        self.images = dict(services.images)
        return changed

    async def _looked_at_elsewhere(self, config: DaemonConfig, index: int) -> Looked:
        name = config.images[index].name
        self.looking.add(name)
        try:
            return await _looked_at_elsewhere(config, index)
        finally:
            self.looking.discard(name)

    def _with_lanes(self, images: Mapping[str, Image]) -> dict[str, Image]:
        return {
            name: replace(image, lanes=self._lanes.get(name, image.lanes)) for name, image in images.items()
        }


def _named(service: ImageConfig) -> tuple[object, ...]:
    return service.program, service.command, service.settings and service.settings.values


async def _looked_at_elsewhere(config: DaemonConfig, index: int) -> Looked:
    process = await asyncio.create_subprocess_exec(
        *module_command(__spec__.name), stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True
    )
    try:
        async with asyncio.timeout(config.start_timeout_s):
            said, _ = await process.communicate(_question(config, index))
        looked: Looked = msgspec.msgpack.decode(said, type=Looked)
    except TimeoutError:
        looked = (
            f"{config.images[index].name} is not loaded within {config.start_timeout_s:g} s: raise "
            "start_timeout_s in the daemon's configuration, or see what its import waits for"
        )
    except msgspec.MsgspecError:
        looked = f"the process that loads it ended with code {await process.wait()}"
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_REAPED_S):
                await process.wait()
    return looked


class _Question(msgspec.Struct):
    """A service of a configuration, whose key there is `key`, for the process that loads it."""

    key: str
    name: str
    program: str | None
    command: tuple[str, ...]
    settings: dict[str, Any] | None
    file: str  # of the settings
    readable: tuple[str, ...]


def _question(config: DaemonConfig, index: int) -> bytes:
    service = config.images[index]
    table = service.settings
    return msgspec.msgpack.encode(
        _Question(
            f"service[{index}]",
            service.name,
            service.program,
            tuple(service.command),
            None if table is None else dict(table.values),
            "" if table is None else str(table.file),
            tuple(map(str, config.runtime.readable)),
        )
    )


def _look_at(asked: _Question) -> Looked:
    settings = None if asked.settings is None else SettingsTable(Path(asked.file), asked.settings)
    service = ImageConfig(name=asked.name, program=asked.program, command=asked.command, settings=settings)
    try:
        loaded = load_configured(service, asked.key)
    except UpwashError as error:
        return str(error)
    spec = spec_of(loaded.cls)
    return Image(
        loaded.program,
        methods=frozenset(spec.methods),
        lanes=spec.concurrency,
        version=version_of(loaded.program, tuple(map(Path, asked.readable))),
    )


def main() -> None:
    """Looks at the service that comes over standard input, and says what there is."""
    answer = os.dup(1)
    os.dup2(2, 1)  # for what the services print
    look_here()
    looked = _look_at(msgspec.msgpack.decode(sys.stdin.buffer.read(), type=_Question))
    with (
        contextlib.suppress(BrokenPipeError),
        os.fdopen(answer, "wb") as opened,
    ):  # a killed daemon wants no answer
        opened.write(msgspec.msgpack.encode(looked))


if __name__ == "__main__":
    main()
