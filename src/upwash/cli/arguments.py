"""Arguments that several commands take, and where a run's files go."""

from __future__ import annotations

import argparse
import contextlib
import itertools
import os
import sys
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec.structs import replace

from upwash.config import DroneConfig, plan_notices
from upwash.core.policies.names import POLICIES
from upwash.errors import UsageError
from upwash.mavlink.connection import parse_connection
from upwash.support.loading import extra

if TYPE_CHECKING:  # a flight does without the room of simulations
    from upwash.lab.figures import FigureFiles

LIVE_PORT = 8720
_FORMATS = ("png", "pdf", "svg")


def count(text: str) -> int:
    """A whole number from 1 on."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 1 on")
    return int(text)


def port(text: str) -> int:
    """A TCP port, or 0."""
    if not text.isdecimal() or int(text) > 65_535:
        raise argparse.ArgumentTypeError(
            f"{text!r} is no port: give a number up to 65535, or 0 for any that is free"
        )
    return int(text)


def add_config(parser: argparse.ArgumentParser, whose: str) -> None:
    """Add the option that names a configuration."""
    parser.add_argument(
        "--config", type=Path, required=True, help=f"the {whose}'s configuration, a TOML file"
    )


def add_policy(parser: argparse.ArgumentParser, *, instead_of: str) -> None:
    """Add the option that flies by another policy."""
    parser.add_argument(
        "--policy",
        choices=POLICIES,
        help=f"instead of {instead_of}",
    )


def add_seeds(parser: argparse.ArgumentParser, what: str, *, default: int | None = None) -> None:
    """Add the option that flies the seeds 1 to N."""
    parser.add_argument(
        "--seeds",
        type=count,
        default=default,
        required=default is None,
        metavar="N",
        help=f"{what} with each of the seeds 1 to N" + (f" (default: {default})" if default else ""),
    )


def add_figures(parser: argparse.ArgumentParser, what: str) -> None:
    """Add the options that draw `what` into a folder."""
    parser.add_argument("--figures", type=Path, metavar="DIR", help=f"draw {what} there")
    parser.add_argument(
        "--format", type=_formats, default=("png",), dest="formats", metavar="F1,F2",
        help="formats of the figures: png, pdf, svg (default: png)",
    )  # fmt: skip


def figures_of(options: argparse.Namespace) -> FigureFiles | None:
    """What --figures and --format ask for; raises UsageError at once where matplotlib is missing."""
    from upwash.lab.figures import FigureFiles

    if options.figures is None:
        return None
    with extra("figures"):
        import matplotlib as mpl  # noqa: F401
    return FigureFiles(options.figures, options.formats)


def _formats(text: str) -> tuple[str, ...]:
    wanted = tuple(dict.fromkeys(text.split(",")))
    for name in wanted:
        if name not in _FORMATS:
            raise argparse.ArgumentTypeError(
                f"{name!r} is no format of figures: choose of {', '.join(_FORMATS)}"
            )
    return wanted


def add_folder(parser: argparse.ArgumentParser) -> None:
    """Add the option that names the folder of a run."""
    parser.add_argument("--folder", type=Path, help="where everything of the run goes (default: runs/TIME)")


def add_live(parser: argparse.ArgumentParser) -> None:
    """Add the option that shows a flight on a page while it lasts."""
    parser.add_argument(
        "--live",
        type=port,
        nargs="?",
        const=LIVE_PORT,
        metavar="PORT",
        help=f"show it on a page on this machine meanwhile (default: {LIVE_PORT}; 0: any port)",
    )


def flown_by(config: DroneConfig, connection: str | None) -> DroneConfig:
    """The configuration with the vehicle of --autopilot, if given; raises UsageError."""
    if connection is None:
        return config
    try:
        parse_connection(connection)
    except ValueError as error:
        raise UsageError(f"--autopilot: {error}") from None
    return replace(config, autopilot=replace(config.autopilot, connection=connection))


def warn_of_plans(config: DroneConfig) -> None:
    """Print to standard error what of the plans is flown differently, or not at all."""
    for notice in plan_notices(config):
        sys.stderr.write(f"upwash: notice: {notice}\n")


def require_linux(command: str) -> None:
    """Raise UsageError on a system that lacks Linux's calls."""
    if not hasattr(os, "memfd_create"):
        raise UsageError(f"{command} needs Linux: run it on a Linux computer or virtual machine")


def new_run_folder() -> Path:
    """Make a new folder in runs/, named after the time."""
    name = datetime.now().astimezone().strftime("%Y-%m-%d_%H-%M-%S")
    for number in itertools.count(1):
        folder = Path("runs") / (name if number == 1 else f"{name}_{number}")
        with contextlib.suppress(FileExistsError):
            folder.mkdir(parents=True)
            break
    return folder


def announce(text: str) -> None:
    """Print a line at once, also into a pipe."""
    print(text, flush=True)
