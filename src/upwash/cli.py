"""The command line: which commands there are, and how each of them ends."""

from __future__ import annotations

import argparse
import asyncio
import sys
from collections.abc import Sequence
from pathlib import Path

from upwash.commands import (
    campaign,
    chaos,
    check,
    compare,
    demo,
    emulate,
    explain,
    fly,
    goodput,
    images,
    keys,
    package,
    profile,
    report,
    reproduce,
    serve,
    simulate,
    status,
    vehicle,
    view,
)
from upwash.errors import MissionFailed, MissionStopped, UpwashError, UsageError

_OK, _FAILURE, _USAGE, _INTERRUPTED = 0, 1, 2, 130
_COMMANDS = (
    fly,
    check,
    serve,
    status,
    keys,
    package,
    images,
    profile,
    vehicle,
    demo,
    simulate,
    view,
    report,
    reproduce,
    campaign,
    compare,
    explain,
    chaos,
    emulate,
    goodput,
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs one command; returns 0 when it did what it should, 2 for bad usage, 1 for any other failure."""
    parser = _parser()
    options = parser.parse_args(arguments)
    if "run" not in options:
        parser.print_help(sys.stderr)
        return _USAGE
    sys.path.append(str(Path.cwd()))  # so that `my_mission:fly` is found, as `python -m` would find it
    try:
        return _OK if options.run(options) else _FAILURE
    except UsageError as error:
        return _complain(error, _USAGE)
    except MissionStopped as error:
        print(f"upwash: the mission was ended early: {error}", file=sys.stderr)
        return _INTERRUPTED
    except MissionFailed as error:
        print(error.trace, file=sys.stderr)
        return _complain(error, _FAILURE)
    except UpwashError as error:
        return _complain(error, _FAILURE)
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        return _complain(UpwashError(f"{place}{error.strerror or error}"), _FAILURE)
    except (KeyboardInterrupt, asyncio.CancelledError):
        return _INTERRUPTED


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="upwash",
        description="Runs a drone's heavy computations on the drone or on an edge server in reach.",
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="print the version and end")
    commands = parser.add_subparsers(metavar="COMMAND")
    for command in _COMMANDS:
        command.add(commands)
    return parser


class _Version(argparse.Action):
    """Looks the version up only when it is asked for: that takes longer than everything else here."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from importlib.metadata import version

        print(f"upwash {version('upwash')}")
        parser.exit()


def _complain(error: UpwashError, code: int) -> int:
    print(f"upwash: {error}", file=sys.stderr)
    return code
