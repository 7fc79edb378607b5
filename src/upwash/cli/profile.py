"""upwash profile: measures what a service's calls cost, and prints that part of a configuration."""

from __future__ import annotations

import argparse
import asyncio
import os
import platform
from collections.abc import Callable, Coroutine, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from rich.console import Console
from rich.table import Table

from upwash.cli.arguments import option, reads, writes
from upwash.config.drone import DroneConfig, ServerConfig
from upwash.config.drone_file import drone_config
from upwash.config.reading import read_document
from upwash.config.values import START_TIMEOUT_S
from upwash.errors import InstanceError, NotWritten, UsageError
from upwash.launch.heard import heard
from upwash.launch.profile import profile_at, profile_on_this_computer, profile_part_on_this_computer
from upwash.missions.bundled import LoadedService, load_service_alone, load_services
from upwash.profiling.agreement import read_labels
from upwash.profiling.profiler import CallSample, OnboardProfile, Watch, calls_to_make, samples, values_of
from upwash.profiling.report import (
    call_table,
    chosen_setting,
    fastest,
    part_table,
    server_table,
    service_table,
)
from upwash.real.camera.camera import read_photos
from upwash.real.camera.video import read_frames
from upwash.rpc.service import spec_of
from upwash.services.photo import photo_size
from upwash.support.output_files import write_file
from upwash.support.progress import work
from upwash.support.sentences import say
from upwash.support.tables import show_table
from upwash.support.text import counted

T = TypeVar("T")

_UNMEASURED = {"local_call_s": 1.0}

ARGUMENTS = {
    "service": "a service of the configuration, a bundled one, or path/to/file.py:Class",
    "--photos PATH": reads("a folder of photos, or a film, to call it with, in turn", required=True),
    "--config FILE": reads("the drone's configuration"),
    "--server ADDRESS": "measure it there: a name or an address of the configuration",
    "--calls N": option("calls of each operation (default: 20)", default=20),
    "--each SETTING": "measure it with each value of a setting, such as the detector's engine, and name the fastest",
    "--labels FOLDER": reads("labels of the photos, as YOLO has them, for the loss of less to send"),
    "--out FILE": writes("where the result goes (default: standard output)"),
}


def run(options: argparse.Namespace) -> bool:
    """Measure the service and print the part of a configuration."""
    if options.server and not options.config:
        raise UsageError(
            "--server needs --config: it has the server's name and address, and the drone's keys"
        )
    if options.server and options.each:
        raise UsageError("--each is for this computer: run it on the server for the server's own settings")
    if options.labels and (options.server or options.each):
        raise UsageError("--labels is for the part before sending: leave --server and --each out")
    config = _read(options.config) if options.config else None
    start_timeout_s = config.start_timeout_s if config else START_TIMEOUT_S
    service, program = _service(options.service, config)
    read = read_frames if options.photos.is_file() else read_photos
    photos = read(options.photos, most=options.calls + 1)
    found = samples(spec_of(service.cls), photos)

    def here(service: LoadedService) -> OnboardProfile:
        def measure(watch: Watch) -> Coroutine[Any, Any, OnboardProfile]:
            return profile_on_this_computer(
                service, found, calls=options.calls, start_timeout_s=start_timeout_s, watch=watch
            )

        return _watched(found, options.calls, measure)

    if config is not None and options.server:
        table, text = _at_server(_find_server(config, options.server), config, found, options.calls)
    elif options.each:
        table, text = None, _with_each_value(service, options.each, here, program=program)
    else:
        with heard() as found_out:
            profile = here(service)
        table = call_table(profile.calls)
        warned = [f"warning: {line.partition(': ')[2]}" for line in found_out.warnings]
        for line in warned:
            say(line, Console(stderr=True, markup=False, highlight=False))
        words = [line.partition(": ")[2] for line in found_out.lines]
        said = "".join(f"# It says: {line}\n" for line in (*words, *warned))
        text = said + service_table(
            profile,
            program=program,
            computer=_computer(),
            settings=_settings(service),
            on_drone=spec_of(service.cls).on_drone,
        )
        if service.part is not None:
            text += _of_part(service, found, photos, start_timeout_s, labels=options.labels)
    _print(table, text, options.out)
    return True


def _of_part(
    service: LoadedService,
    found: Sequence[CallSample],
    photos: Mapping[str, bytes],
    start_timeout_s: float,
    *,
    labels: Path | None,
) -> str:
    """Measure the part before sending; returns its table."""
    assert service.part is not None  # noqa: S101 - the caller has looked
    its = None
    if labels is not None:
        its = read_labels(labels, {name: photo_size(photo) for name, photo in photos.items()})
    profile = asyncio.run(
        profile_part_on_this_computer(service, found, labels=its, start_timeout_s=start_timeout_s)
    )
    return part_table(profile, photos=len(photos), settings=service.part.settings)


def _read(file: Path) -> DroneConfig:
    """The configuration, which may lack the times that are measured here."""
    document = read_document(file)
    services = document.get("service")
    if isinstance(services, list):
        services = [_UNMEASURED | table if isinstance(table, dict) else table for table in services]
        document = document | {"service": services}
    return drone_config(document, file)


def _service(name: str, config: DroneConfig | None) -> tuple[LoadedService, str | None]:
    """The service, and the program that a configuration has to name for it."""
    configured = [service for service in config.services if service.name == name] if config else []
    if configured:
        return load_services(configured)[name], configured[0].program
    program = str(Path.cwd() / name) if ".py:" in name else name  # the result may be read from anywhere
    return load_service_alone(name), program if ":" in name else None


def _find_server(config: DroneConfig, wanted: str) -> ServerConfig:
    for server in config.servers:
        if wanted in (server.name, server.address):
            return server
    names = ", ".join(server.name for server in config.servers) or "none"
    raise UsageError(f"the configuration has no server {wanted!r}; it has {names}")


def _at_server(
    server: ServerConfig, config: DroneConfig, found: Sequence[CallSample], calls: int
) -> tuple[Table, str]:
    """The table of the calls at the server, and the keys of its [[server]] table."""
    profile = _watched(
        found, calls, lambda watch: profile_at(server, config, found, calls=calls, watch=watch)
    )
    return call_table(profile.calls), server_table(profile, server=server.name, computer=_computer())


def _with_each_value(
    service: LoadedService,
    setting: str,
    measure: Callable[[LoadedService], OnboardProfile],
    *,
    program: str | None,
) -> str:
    """Measure the service with each value of the setting; returns the [[service]] table of the fastest."""
    spec = spec_of(service.cls)
    profiles: dict[str, OnboardProfile] = {}
    console = Console(stderr=True, markup=False, highlight=False)
    for value in values_of(spec, setting):
        settings = {**service.program.settings, setting: value}
        console.print(f"{setting} = {value}")
        try:
            profiles[value] = measure(replace(service, program=replace(service.program, settings=settings)))
        except InstanceError as error:
            console.print(f"  left out: {error}")
            continue
        Console(stderr=True).print(call_table(profiles[value].calls))
    if not profiles:
        raise UsageError(f"service {spec.name!r} starts with no value of {setting}")
    best = profiles[fastest(profiles)]
    others = _settings(service, but=setting)
    table = service_table(best, program=program, computer=_computer(), settings=others)
    return table + chosen_setting(setting, profiles)


def _settings(service: LoadedService, *, but: str | None = None) -> str:
    """The settings of the measured service, except `but`; "" for a service that has none."""
    names = [name for name in spec_of(service.cls).settings.__struct_fields__ if name != but]
    if not names:
        return ""
    if given := [name for name in names if name in service.program.settings]:
        return f"With the configured settings: {', '.join(given)}."
    return f"With the defaults of its settings ({', '.join(names)}): a file of --config may have others."


def _watched(
    found: Sequence[CallSample], calls: int, profile: Callable[[Watch], Coroutine[Any, Any, T]]
) -> T:
    """Profile, and say how far it has come."""
    with work("calls measured", calls_to_make(found, calls)) as done:
        return asyncio.run(profile(lambda _: done()))


def _print(table: Table | None, text: str, out: Path | None) -> None:
    console = Console(markup=False)
    if table is not None:
        show_table(table, Console(stderr=True))
    if out is not None:
        try:
            write_file(out, text.encode())
        except NotWritten:  # the measurement took minutes: show it
            console.print(text, end="", soft_wrap=True, highlight=False)
            raise
        console.print(f"written: {out}", soft_wrap=True)
    else:
        console.print(text, end="", soft_wrap=True, highlight=False)


def _computer() -> str:
    return f"{platform.node()} ({platform.machine()}, {counted(os.cpu_count() or 1, 'core')})"
