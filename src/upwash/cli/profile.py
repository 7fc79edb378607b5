"""upwash profile: measures what a service's calls cost."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from upwash.cli.arguments import count
from upwash.errors import UsageError

if TYPE_CHECKING:
    from upwash.cli.arguments import Commands
    from upwash.config import DroneConfig
    from upwash.missions.bundled import LoadedService


def add(commands: Commands) -> None:
    """Adds the command."""
    profile = commands.add_parser(
        "profile", help="measure what a service's calls cost, here or at a server, for a configuration"
    )
    profile.add_argument(
        "service", help="a service of the configuration, a bundled one, or path/to/file.py:Class"
    )
    profile.add_argument(
        "--photos", type=Path, required=True, metavar="DIR", help="JPEG files to call it with, in turn"
    )
    profile.add_argument("--config", type=Path, metavar="FILE", help="the drone's configuration")
    profile.add_argument(
        "--server", metavar="ADDRESS", help="measure it there: a name or an address of the configuration"
    )
    profile.add_argument(
        "--calls", type=count, default=20, metavar="N", help="calls of each operation (default: 20)"
    )
    profile.add_argument(
        "--each",
        metavar="SETTING",
        help="measure it with each value of a setting, such as the detector's engine, and name the fastest",
    )
    profile.add_argument(
        "--out", type=Path, metavar="FILE", help="where the result goes (default: standard output)"
    )
    profile.set_defaults(run=run)


def run(options: argparse.Namespace) -> bool:
    """Measures it and prints the part of a configuration."""
    from upwash.cli.measuring import find_server, measure_each, measure_onboard, measure_server
    from upwash.config import read_drone_config
    from upwash.config.values import START_TIMEOUT_S
    from upwash.real.camera.camera import read_photos

    if options.server and not options.config:
        raise UsageError(
            "--server needs --config: it has the server's name and address, and the drone's keys"
        )
    if options.server and options.each:
        raise UsageError("--each is for this computer: run it on the server for the server's own settings")
    config = read_drone_config(options.config) if options.config else None
    start_timeout_s = config.start_timeout_s if config else START_TIMEOUT_S
    service, program = _service(options.service, config)
    photos = read_photos(options.photos, most=options.calls + 1)
    if config is not None and options.server:
        server = find_server(config, options.server)
        measure_server(server, config, service, photos, calls=options.calls, out=options.out)
    elif options.each:
        measure_each(
            service,
            photos,
            setting=options.each,
            program=program,
            calls=options.calls,
            start_timeout_s=start_timeout_s,
            out=options.out,
        )
    else:
        measure_onboard(
            service,
            photos,
            program=program,
            calls=options.calls,
            start_timeout_s=start_timeout_s,
            out=options.out,
        )
    return True


def _service(name: str, config: DroneConfig | None) -> tuple[LoadedService, str | None]:
    """The service, and the program that a configuration has to name for it."""
    from upwash.missions.bundled import load_service_alone, load_services

    configured = [each for each in config.services if each.name == name] if config is not None else []
    if configured:
        return load_services(configured)[name], configured[0].program
    program = str(Path.cwd() / name) if ".py:" in name else name  # the result may be read from anywhere
    return load_service_alone(name), program if ":" in name else None
