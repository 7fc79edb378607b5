"""upwash package: makes the image of a service."""

from __future__ import annotations

import argparse
import asyncio

from upwash.cli.arguments import announce, fills, option, read_path, reads, repeated
from upwash.config.daemon import read_daemon_config
from upwash.packaging.contents import extra_of
from upwash.packaging.image import Format, Recipe, package
from upwash.packaging.shipping import find_service, import_image
from upwash.support.progress import work

_KIND = "for Docker and Podman, or for LXD and Incus; default: as the configuration's runtime.kind, or lxd"
_BASE = "the system: the /usr of the machine that runs it (default), or a Debian of the image's own"
ARGUMENTS = {
    "service": "one of the configuration's services, or a bundled one",
    "--output DIR": fills("where the file goes", required=True),
    "--config": reads("a daemon's configuration: its services, its container engine"),
    "--requires DISTRIBUTION": repeated(
        "an installed Python distribution that the service imports; repeatable"
    ),
    "--include PATH": repeated(
        "a file or folder to lie beside the service's program; repeatable", type=read_path
    ),
    "--format": option(_KIND, choices=("docker", "lxd")),
    "--base": option(_BASE, choices=("host", "debootstrap"), default="host"),
    "--import": option("import it into the container engine, too", action="store_true", dest="imports"),
}


def run(options: argparse.Namespace) -> None:
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
    with work("making the image") as done:
        file = package(recipe, options.output, report=lambda step: done(0, what=step))
    if options.imports:
        with work("importing the image"):
            asyncio.run(import_image(file, chosen, daemon))
    announce(str(file))
