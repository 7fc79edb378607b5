"""Arguments that several commands take, and where a run's files go."""

from __future__ import annotations

import argparse
import contextlib
import itertools
import os
import sys
from collections.abc import Iterator, Mapping
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from msgspec.structs import replace

from upwash.config.drone import DroneConfig
from upwash.config.places import file_notices
from upwash.core.policies.names import POLICIES, is_own
from upwash.errors import UsageError
from upwash.mavlink.connection import parse_connection
from upwash.support.loading import extra
from upwash.support.spared import Output
from upwash.support.text import number_of

if TYPE_CHECKING:  # a flight does without the room of simulations
    from upwash.lab.figures import FigureFiles

LIVE_PORT = 8720
PRINTED = Path("-")  # as an output: standard output
_PATHS = {"FILE", "FOLDER", "DIR", "LOG", "PATH"}  # metavars
_FORMATS = ("png", "pdf", "svg")


def count(text: str) -> int:
    """A whole number from 1 on."""
    if not (text.isascii() and text.isdecimal()) or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 1 on")
    return int(text)


def whole(text: str) -> int:
    """A whole number."""
    if not (text.isascii() and text.removeprefix("-").isdecimal()):
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number")
    return int(text)


def number(text: str) -> float:
    """A number."""
    try:
        return number_of(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def seeds(text: str) -> range:
    """Whole numbers from 1 to N, or from A to B where they are written A..B."""
    first, dots, last = text.partition("..") if ".." in text else ("1", "..", text)
    if not (dots and first.isdecimal() and last.isdecimal() and 1 <= int(first) <= int(last)):
        raise argparse.ArgumentTypeError(f"{text!r} is not N or A..B, such as 200 or 1..2000")
    return range(int(first), int(last) + 1)


def port(text: str) -> int:
    """A TCP port, or 0."""
    if not text.isdecimal() or int(text) > 65_535:
        raise argparse.ArgumentTypeError(
            f"{text!r} is no port: give a number up to 65535, or 0 for any that is free"
        )
    return int(text)


def add_options(
    parser: argparse._ActionsContainer, arguments: Mapping[str, Any]
) -> Iterator[argparse.Action]:
    """Add arguments: a name with its metavar leads to its help, or to an `option` with more than that.

    The metavar N says the type, those of paths need `reads`, `writes` or `fills`, and an option without a metavar is
    a switch. The arguments of a `OneOf` exclude each other.
    """
    for words, said in arguments.items():
        if isinstance(said, OneOf):
            yield from add_options(
                parser.add_mutually_exclusive_group(required=said.required), said.arguments
            )
            continue
        names = [word for word in words.split() if word == words.split()[0] or word.startswith("-")]
        given = dict(said) if isinstance(said, dict) else {"help": said}
        if metavar := words.removeprefix(" ".join(names)).strip():
            given = {"metavar": metavar, "type": count if metavar == "N" else None} | given
            if metavar in _PATHS and given["type"] is None:
                raise TypeError(f"{words}: say by reads, writes or fills what becomes of the path")
        elif names[0].startswith("-") and not {"choices", "type"} & given.keys():
            given["action"] = "store_true"
        yield parser.add_argument(*names, **given)


class OneOf(NamedTuple):
    """Arguments that exclude each other."""

    arguments: Mapping[str, Any]
    required: bool = False


def option(help_: str, **more: Any) -> dict[str, Any]:
    """The help of an argument, with more keywords of argparse."""
    return {"help": help_, **more}


def repeated(help_: str, dest: str | None = None, **more: Any) -> dict[str, Any]:
    """The help of an option that may be given several times."""
    return option(help_, action="append", default=[], dest=dest, **more)


def read_path(text: str) -> Path:
    """A file or folder that the command reads."""
    return Path(text)


def read_map(text: str) -> Path | str:
    """A map of this machine that the command reads, or the URL of another machine's tiles."""
    return text if text.startswith(("http://", "https://")) else Path(text)


def written_path(text: str) -> Path:
    """A file, or a new folder, that the command writes or continues."""
    return Path(text)


def filled_path(text: str) -> Path:
    """A folder that the command writes files into."""
    return Path(text)


def reads(help_: str, **more: Any) -> dict[str, Any]:
    """The help of an argument that names files or folders to read."""
    return option(help_, type=read_path, **more)


def writes(help_: str, **more: Any) -> dict[str, Any]:
    """The help of an argument that names a file, or a new folder, to write or continue."""
    return option(help_, type=written_path, **more)


def fills(help_: str, **more: Any) -> dict[str, Any]:
    """The help of an argument that names a folder to write files into."""
    return option(help_, type=filled_path, **more)


def inputs_of(options: argparse.Namespace) -> Iterator[tuple[str, Path]]:
    """What names each input among the options, and its path."""
    return ((name, path) for name, path, action in _paths(options) if action.type in (read_path, read_map))


def outputs_of(options: argparse.Namespace) -> Iterator[Output]:
    """The outputs among the options; `-` is standard output."""
    return (
        Output(name, path, action.type is filled_path)
        for name, path, action in _paths(options)
        if action.type in (written_path, filled_path) and path != PRINTED
    )


def _paths(options: argparse.Namespace) -> Iterator[tuple[str, Path, argparse.Action]]:
    for action in options.named:
        value = getattr(options, action.dest)
        name = action.option_strings[-1] if action.option_strings else action.metavar or action.dest
        for given in value if isinstance(value, list) else [value]:
            path = given[-1] if isinstance(given, list) else given  # of a kind and a path
            if isinstance(path, Path):
                yield name, path, action


def config_of(whose: str) -> dict[str, Any]:
    """The option that names a configuration."""
    return {"--config": reads(f"the {whose}'s configuration, a TOML file", required=True)}


def policy_instead_of(other: str) -> dict[str, Any]:
    """The option that flies by another policy."""
    return {"--policy": option(f"instead of {other}", type=_policy, metavar="NAME")}


def _policy(name: str) -> str:
    if name not in POLICIES and not is_own(name):
        raise argparse.ArgumentTypeError(
            f"{name!r} is no policy: choose of {', '.join(POLICIES)}, or name your own, such as mine.py:Class"
        )
    return name


def seeds_of(what: str, default: int | None = None) -> dict[str, Any]:
    """The option that flies the seeds 1 to N."""
    said = f"{what} with each of the seeds 1 to N" + (f" (default: {default})" if default else "")
    return {"--seeds N": option(said, default=default, required=default is None)}


def figures_with(what: str) -> dict[str, Any]:
    """The options that draw `what` into a folder."""
    formats = option("formats of the figures: png, pdf, svg (default: png)", type=_formats, dest="formats")
    return {"--figures DIR": fills(f"draw {what} there"), "--format F1,F2": formats | {"default": ("png",)}}


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


CALLS = {"--calls": "print a row for each call at the end (default: of up to 20 calls)"}
FOLDER = {"--folder": fills("where everything of the run goes (default: runs/TIME)")}
MAP = {
    "--tiles MAP": option(
        "lay map tiles beneath: a folder with ZOOM/X/Y.png, a file .mbtiles or .pmtiles, or "
        "https://HOST/{z}/{x}/{y}.png (default: none)",
        type=read_map,
    ),
    "--credit TEXT": option("the credit to show for the tiles (default: what the file says)", default=""),
}
LIVE = {
    "--live PORT": option(
        f"show it on a page on this machine meanwhile (default: {LIVE_PORT}; 0: any port)",
        type=port,
        nargs="?",
        const=LIVE_PORT,
    ),
    **MAP,
}


class Live(NamedTuple):
    """A page that shows a flight meanwhile: its port on this machine, and the map beneath."""

    port: int
    tiles: Path | str | None = None
    credit: str = ""


def live_of(options: argparse.Namespace) -> Live | None:
    """What --live and --tiles ask for; raises UsageError."""
    if options.live is None:
        if options.tiles:
            raise UsageError("--tiles lies beneath the map of a page: give --live too")
        return None
    return Live(options.live, options.tiles, options.credit)


def flown_by(config: DroneConfig, connection: str | None) -> DroneConfig:
    """The configuration with the vehicle of --autopilot, if given; raises UsageError."""
    if connection is None:
        return config
    try:
        parse_connection(connection)
    except ValueError as error:
        raise UsageError(f"--autopilot: {error}") from None
    return replace(config, autopilot=replace(config.autopilot, connection=connection))


def warn_of_files(config: DroneConfig) -> None:
    """Print to standard error what of the plans is flown differently, or not at all, and which maps are damaged."""
    for notice in file_notices(config):
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
