"""Profiles a service with progress in the terminal; prints a table and the part of a configuration."""

from __future__ import annotations

import asyncio
import os
import platform
from collections.abc import Callable, Coroutine, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from rich.console import Console
from rich.markup import escape
from rich.progress import MofNCompleteColumn, Progress, TimeRemainingColumn
from rich.table import Table

from upwash.config import DroneConfig, ServerConfig
from upwash.errors import InstanceError, NotWritten, UsageError
from upwash.launch.profile import profile_at, profile_on_this_computer
from upwash.missions.bundled import LoadedService
from upwash.profiling.profiler import CallSample, OnboardProfile, Watch, calls_to_make, samples, values_of
from upwash.profiling.report import call_table, chosen_setting, fastest, server_table, service_table
from upwash.rpc.service import spec_of
from upwash.support.output_files import write_file

T = TypeVar("T")


def measure_onboard(
    service: LoadedService,
    photos: Mapping[str, bytes],
    *,
    program: str | None,
    calls: int,
    start_timeout_s: float,
    out: Path | None,
) -> None:
    """Measures the service on this computer; the [[service]] table goes to `out`, or to standard output."""
    found = samples(spec_of(service.cls), photos)
    profile = _watched(found, calls, partial(_onboard, service, found, calls, start_timeout_s))
    table = service_table(profile, program=program, computer=_computer(), settings=_settings(service))
    _tell(call_table(profile.calls), table, out)


def measure_each(
    service: LoadedService,
    photos: Mapping[str, bytes],
    *,
    setting: str,
    program: str | None,
    calls: int,
    start_timeout_s: float,
    out: Path | None,
) -> None:
    """Measures the service with each value of the setting; the [[service]] table is that of the fastest."""
    spec = spec_of(service.cls)
    found = samples(spec, photos)
    profiles: dict[str, OnboardProfile] = {}
    for value in values_of(spec, setting):
        settings = {**service.program.settings, setting: value}
        with_value = replace(service, program=replace(service.program, settings=settings))
        Console(stderr=True, markup=False).print(f"{setting} = {value}", highlight=False)
        try:
            profiles[value] = _watched(
                found, calls, partial(_onboard, with_value, found, calls, start_timeout_s)
            )
        except InstanceError as error:
            Console(stderr=True, markup=False).print(f"  left out: {error}", highlight=False)
            continue
        Console(stderr=True).print(call_table(profiles[value].calls))
    if not profiles:
        raise UsageError(f"service {spec.name!r} starts with no value of {setting}")
    best = profiles[fastest(profiles)]
    others = _settings(service, but=setting)
    table = service_table(best, program=program, computer=_computer(), settings=others)
    _tell(None, table + chosen_setting(setting, profiles), out)


def _onboard(
    service: LoadedService, found: Sequence[CallSample], calls: int, start_timeout_s: float, watch: Watch
) -> Coroutine[Any, Any, OnboardProfile]:
    return profile_on_this_computer(service, found, calls=calls, start_timeout_s=start_timeout_s, watch=watch)


def _settings(service: LoadedService, *, but: str | None = None) -> str:
    """With which settings it runs, without one that is told elsewhere; "" for a service that has no others."""
    names = [name for name in spec_of(service.cls).settings.__struct_fields__ if name != but]
    if not names:
        return ""
    if given := [name for name in names if name in service.program.settings]:
        return f"With the configured settings: {', '.join(given)}."
    return f"With the defaults of its settings ({', '.join(names)}): --config FILE takes those of a configuration."


def measure_server(
    server: ServerConfig,
    config: DroneConfig,
    service: LoadedService,
    photos: Mapping[str, bytes],
    *,
    calls: int,
    out: Path | None,
) -> None:
    """Measures the service at the server; the keys for its [[server]] table go to `out`, or to standard output."""
    found = samples(spec_of(service.cls), photos)
    profile = _watched(
        found, calls, lambda watch: profile_at(server, config, found, calls=calls, watch=watch)
    )
    _tell(call_table(profile.calls), server_table(profile, server=server.name, computer=_computer()), out)


def find_server(config: DroneConfig, wanted: str) -> ServerConfig:
    """The server of that name or address; raises UsageError."""
    for server in config.servers:
        if wanted in (server.name, server.address):
            return server
    names = ", ".join(server.name for server in config.servers) or "none"
    raise UsageError(f"the configuration has no server {wanted!r}; it has {names}")


def _watched(
    found: Sequence[CallSample], calls: int, profile: Callable[[Watch], Coroutine[Any, Any, T]]
) -> T:
    columns = (*Progress.get_default_columns()[:-1], MofNCompleteColumn(), TimeRemainingColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console, disable=not console.is_terminal) as progress:
        bar = progress.add_task("starting", total=calls_to_make(found, calls))

        def watch(what: str) -> None:
            progress.update(bar, advance=1, description=escape(what))

        return asyncio.run(profile(watch))


def _tell(table: Table | None, text: str, out: Path | None) -> None:
    console = Console(markup=False)
    if table is not None:
        Console(stderr=True).print(table)
    if out is None:
        console.print(text, end="", soft_wrap=True, highlight=False)
    else:
        try:
            write_file(out, text.encode())
        except NotWritten:  # what took minutes to measure is not lost for that
            console.print(text, end="", soft_wrap=True, highlight=False)
            raise
        console.print(f"written: {out}", soft_wrap=True)


def _computer() -> str:
    return f"{platform.node()} ({platform.machine()}, {os.cpu_count()} cores)"
