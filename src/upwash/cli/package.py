"""upwash package: makes the image of a service."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from upwash.cli.arguments import announce

if TYPE_CHECKING:
    from upwash.cli.arguments import Commands
    from upwash.config import DaemonConfig
    from upwash.packaging.image import Format


def add(commands: Commands) -> None:
    """Adds the command."""
    package = commands.add_parser("package", help="make the image of a service, to run in containers")
    package.add_argument("service", help="one of the configuration's services, or a bundled one")
    package.add_argument("--output", type=Path, required=True, metavar="DIR", help="where the file goes")
    package.add_argument(
        "--config", type=Path, help="a daemon's configuration: its services, its container engine"
    )
    package.add_argument(
        "--requires", action="append", default=[], metavar="DISTRIBUTION",
        help="an installed Python distribution that the service imports; repeatable",
    )  # fmt: skip
    package.add_argument(
        "--include", action="append", default=[], type=Path, metavar="PATH",
        help="a file or folder to lie beside the service's program; repeatable",
    )  # fmt: skip
    package.add_argument(
        "--format", choices=("docker", "lxd"),
        help="for Docker and Podman, or for LXD and Incus; default: as the configuration's runtime.kind, or lxd",
    )  # fmt: skip
    package.add_argument(
        "--base", choices=("host", "debootstrap"), default="host",
        help="the system: the /usr of the machine that runs it (default), or a Debian of the image's own",
    )  # fmt: skip
    package.add_argument(
        "--import", dest="imports", action="store_true", help="take it into the container engine, too"
    )
    package.set_defaults(run=run)


def run(options: argparse.Namespace) -> bool:
    """Makes the image and prints its file's path."""
    import asyncio

    from rich.console import Console

    from upwash.config import read_daemon_config
    from upwash.packaging.contents import extra_of
    from upwash.packaging.image import Recipe, package
    from upwash.packaging.shipping import find_service, import_image

    daemon = read_daemon_config(options.config) if options.config else None
    chosen: Format = options.format or _format_of(daemon)
    recipe = Recipe(
        service=find_service(options.service, daemon),
        requirements=(*extra_of(options.service, chosen), *options.requires),
        beside=tuple(options.include),
        base=options.base,
        format=chosen,
    )
    with Console(stderr=True).status("packaging") as status:
        file = package(recipe, options.output, report=status.update)
        if options.imports:
            status.update("importing")
            asyncio.run(import_image(file, chosen, daemon))
    announce(str(file))
    return True


def _format_of(daemon: DaemonConfig | None) -> Format:
    return "docker" if daemon and daemon.runtime.kind == "docker" else "lxd"
