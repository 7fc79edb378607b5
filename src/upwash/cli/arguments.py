"""Arguments that several commands take, and where a run's files go."""

from __future__ import annotations

import argparse
import contextlib
import itertools
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from upwash.config import DroneConfig
    from upwash.lab.figures import FigureFiles

    Commands = argparse._SubParsersAction[argparse.ArgumentParser]  # what `add` adds its command to

LIVE_PORT = 8720
_FORMATS = ("png", "pdf", "svg")


def place(text: str) -> tuple[float, float]:
    """A latitude and a longitude in degrees, written LAT,LON."""
    try:
        latitude_deg, longitude_deg = (float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text!r} is not LAT,LON in degrees, such as 39.3666,22.9507"
        ) from None
    if not (abs(latitude_deg) <= 90 and abs(longitude_deg) <= 180):
        raise argparse.ArgumentTypeError(
            f"{text!r} is no place: latitudes go from -90 to 90, longitudes to 180 degrees"
        )
    return latitude_deg, longitude_deg


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


def add_policy(parser: argparse.ArgumentParser, *, instead_of: str) -> None:
    """Adds the option that flies by another policy."""
    parser.add_argument(
        "--policy",
        choices=("local-only", "opportunistic", "location-aware", "look-ahead"),
        help=f"instead of {instead_of}",
    )


def add_stay_or_go(parser: argparse.ArgumentParser) -> None:
    """Adds the option that flies on before answers are there, or does not."""
    parser.add_argument(
        "--stay-or-go",
        choices=("stay", "go", "learn"),
        help="whether to fly on before an answer is there, instead of policy.stay_or_go",
    )


def add_seeds(parser: argparse.ArgumentParser, what: str, *, default: int | None = None) -> None:
    """Adds the option by which every command flies the seeds 1 to N."""
    parser.add_argument(
        "--seeds",
        type=count,
        default=default,
        required=default is None,
        metavar="N",
        help=f"{what} with each of the seeds 1 to N" + (f" (default: {default})" if default else ""),
    )


def add_figures(parser: argparse.ArgumentParser, what: str) -> None:
    """Adds the options that draw `what` into a folder."""
    parser.add_argument("--figures", type=Path, metavar="DIR", help=f"draw {what} there")
    parser.add_argument(
        "--format", type=_formats, default=("png",), dest="formats", metavar="F1,F2",
        help="of the figures: png, pdf and svg, or several of them (default: png)",
    )  # fmt: skip


def figures_of(options: argparse.Namespace) -> FigureFiles | None:
    """Those that --figures and --format ask for; raises UsageError at once where nothing can draw them."""
    from upwash.lab.figures import FigureFiles
    from upwash.support.loading import extra

    if options.figures is None:
        return None
    with extra("figures"):
        import matplotlib as mpl  # noqa: F401
    return FigureFiles(options.figures, options.formats)


def _formats(text: str) -> tuple[str, ...]:
    wanted = tuple(dict.fromkeys(text.split(",")))
    for each in wanted:
        if each not in _FORMATS:
            raise argparse.ArgumentTypeError(
                f"{each!r} is no format of figures: choose of {', '.join(_FORMATS)}"
            )
    return wanted


def add_live(parser: argparse.ArgumentParser) -> None:
    """Adds the option that shows a flight on a page while it lasts."""
    parser.add_argument(
        "--live",
        type=port,
        nargs="?",
        const=LIVE_PORT,
        metavar="PORT",
        help=f"show it on a page on this machine meanwhile (default: {LIVE_PORT}; 0: any port)",
    )


def flown_by(config: DroneConfig, connection: str | None) -> DroneConfig:
    """The configuration with another connection to the vehicle, where one is given; raises UsageError."""
    import msgspec

    from upwash.errors import UsageError
    from upwash.mavlink.connection import parse_connection

    if connection is None:
        return config
    try:
        parse_connection(connection)
    except ValueError as error:
        raise UsageError(f"--autopilot: {error}") from None
    autopilot = msgspec.structs.replace(config.autopilot, connection=connection)
    return msgspec.structs.replace(config, autopilot=autopilot)


def new_run_folder() -> Path:
    """A folder in runs/ that is named after the time and was not there before."""
    from datetime import datetime

    name = datetime.now().astimezone().strftime("%Y-%m-%d_%H-%M-%S")
    for number in itertools.count(1):
        folder = Path("runs") / (name if number == 1 else f"{name}_{number}")
        with contextlib.suppress(FileExistsError):
            folder.mkdir(parents=True)
            break
    return folder


def announce(text: str) -> None:
    """Prints a line at once, also where standard output is a pipe that someone waits at."""
    print(text, flush=True)
