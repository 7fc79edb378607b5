"""upwash package: makes the image of a service."""

from __future__ import annotations

import argparse
import asyncio
from pathlib import Path

from rich.console import Console

from upwash.cli.arguments import announce
from upwash.config import read_daemon_config
from upwash.packaging.contents import extra_of
from upwash.packaging.image import Format, Recipe, package
from upwash.packaging.shipping import find_service, import_image


def add(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("service", help="one of the configuration's services, or a bundled one")
    parser.add_argument("--output", type=Path, required=True, metavar="DIR", help="where the file goes")
    parser.add_argument(
        "--config", type=Path, help="a daemon's configuration: its services, its container engine"
    )
    parser.add_argument(
        "--requires", action="append", default=[], metavar="DISTRIBUTION",
        help="an installed Python distribution that the service imports; repeatable",
    )  # fmt: skip
    parser.add_argument(
        "--include", action="append", default=[], type=Path, metavar="PATH",
        help="a file or folder to lie beside the service's program; repeatable",
    )  # fmt: skip
    parser.add_argument(
        "--format", choices=("docker", "lxd"),
        help="for Docker and Podman, or for LXD and Incus; default: as the configuration's runtime.kind, or lxd",
    )  # fmt: skip
    parser.add_argument(
        "--base", choices=("host", "debootstrap"), default="host",
        help="the system: the /usr of the machine that runs it (default), or a Debian of the image's own",
    )  # fmt: skip
    parser.add_argument(
        "--import", dest="imports", action="store_true", help="import it into the container engine, too"
    )


def run(options: argparse.Namespace) -> bool:
    """Make the image and print its file's path."""
    daemon = read_daemon_config(options.config) if options.config else None
    configured: Format = "docker" if daemon and daemon.runtime.kind == "docker" else "lxd"
    chosen: Format = options.format or configured
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
