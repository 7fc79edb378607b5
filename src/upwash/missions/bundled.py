"""Services by name: the bundled one, those of plug-ins, and the user's own by their path."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

from upwash.config.daemon import ImageConfig
from upwash.config.reading import convert
from upwash.config.values import SettingsTable
from upwash.errors import UsageError
from upwash.ports import Program
from upwash.rpc.service import ServiceSpec, load_service, spec_of
from upwash.rpc.settings import construct, plain, required_settings
from upwash.support.entry_points import SERVICES, find, names

if TYPE_CHECKING:  # which a daemon does not load
    from upwash.config.drone import ServiceConfig

_BUNDLED = {"detector": "upwash.services:Detector"}

ConfiguredService: TypeAlias = "ServiceConfig | ImageConfig"


@dataclass(frozen=True, slots=True)
class LoadedService:
    """A service's class, and what its instances run."""

    cls: type
    program: Program
    part: Program | None = None  # before sending

    def made(self) -> object:
        """An object of the class, made as an instance makes its own."""
        return construct(self.cls, spec_of(self.cls).settings, self.program.settings)


def load_services(configured: Sequence[ConfiguredService]) -> dict[str, LoadedService]:
    """The services of a configuration, by name; raises UsageError if a service does not fit its class."""
    return {
        service.name: load_configured(service, f"service[{index}]")
        for index, service in enumerate(configured)
    }


def load_specs(configured: Sequence[ConfiguredService]) -> dict[str, ServiceSpec]:
    """The declarations of a configuration's services, by name; raises UsageError."""
    return {name: spec_of(loaded.cls) for name, loaded in load_services(configured).items()}


def load_service_alone(name: str) -> LoadedService:
    """A service without a configuration, by its name or its class's path; raises UsageError."""
    path = name if ":" in name else installed_service(name)
    part = spec_of(cls := load_service(path)).before_sending
    return LoadedService(cls, Program(path), Program(_path_beside(path, part)) if part else None)


def load_configured(configured: ConfiguredService, key: str) -> LoadedService:
    """The service at that key of a configuration; raises UsageError if it does not fit its class."""
    path = configured.program or installed_service(configured.name)
    cls = load_service(path)
    spec = spec_of(cls)
    if spec.name != configured.name:
        raise UsageError(
            f"service {configured.name!r} runs {cls.__name__}, which is declared as {spec.name!r}: use that name"
        )
    table = configured.settings
    runs = spec.on_drone or isinstance(configured, ImageConfig)  # an instance of it
    program = Program(path, _settings(spec, table, key, "service.settings", runs=runs), configured.command)
    before = None if isinstance(configured, ImageConfig) else configured.before_sending
    if spec.before_sending is None:
        if before is not None:
            raise UsageError(
                f"service {spec.name!r} has no part before sending: leave its before_sending out, or name one in "
                "@service(before_sending=...)"
            )
        return LoadedService(cls, program)
    key, shown, part = f"{key}.before_sending", "service.before_sending.settings", spec.before_sending
    settings = _settings(spec_of(part), before.settings if before else None, key, shown) if before else {}
    return LoadedService(cls, program, Program(_path_beside(path, part), settings))


def _settings(
    spec: ServiceSpec, table: SettingsTable | None, key: str, shown: str, *, runs: bool = True
) -> dict[str, object]:
    if table is not None:
        given = convert(
            table.values, spec.settings, file=table.file, as_written=table.values, at=f"{key}.settings"
        )
        return plain(given)
    if runs and (needed := required_settings(spec.settings)):
        raise UsageError(f"service {spec.name!r} needs {', '.join(needed)}: add them in [{shown}]")
    return {}


def _path_beside(path: str, part: type) -> str:
    """The path of a part's class, of a service of that path: in the same file, or in a module."""
    file = getattr(sys.modules[part.__module__], "__file__", None)
    is_alone = path.rpartition(":")[0].endswith(".py") and "." not in part.__module__
    return f"{file if is_alone and file else part.__module__}:{part.__qualname__}"


def installed_service(name: str) -> str:
    """The path of the class that upwash or a plug-in brings under that name; raises UsageError."""
    if name in _BUNDLED:
        return _BUNDLED[name]
    found = find(SERVICES, name)
    if found is None:
        raise UsageError(
            f"service {name!r} needs a program, path/to/file.py:Class or package.module:Class; bundled or of a "
            f"plug-in, and without one, there is only: {', '.join((*_BUNDLED, *names(SERVICES)))}"
        )
    return found.value
