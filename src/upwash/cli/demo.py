"""upwash demo: flies the demonstration."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from upwash.cli.arguments import add_live, add_policy, add_stay_or_go, count, new_run_folder

if TYPE_CHECKING:
    from upwash.cli.arguments import Commands

_MOST_RUNTIME_BYTES = 100_000
_MOST_DRONES = 8  # more than that are more than most computers can render photos for


def add(commands: Commands) -> None:
    """Adds the command."""
    demo = commands.add_parser("demo", help="fly the demonstration: a survey over two edge servers, all here")
    demo.add_argument(
        "--drones",
        type=_drones,
        default=1,
        metavar="N",
        help=f"fly it with so many at once, each a program of its own (default: 1; at most {_MOST_DRONES})",
    )
    demo.add_argument("--folder", type=Path, help="where everything of the run goes (default: runs/TIME)")
    demo.add_argument(
        "--runtime", type=Path, metavar="FILE", help="a table [runtime] for both daemons, such as containers"
    )
    add_policy(demo, instead_of="the demonstration's")
    add_stay_or_go(demo)
    add_live(demo)
    demo.set_defaults(run=run)


def run(options: argparse.Namespace) -> bool:
    """Flies it; returns whether every flight was completed."""
    from upwash.support.loading import extra

    with extra("detector"):
        from upwash.cli.demonstration.configuration import read_demonstration
        from upwash.cli.demonstration.flight import fly_demonstration
    config = read_demonstration(policy=options.policy, stay_or_go=options.stay_or_go)
    folder = options.folder or new_run_folder()
    runtime = _read(options.runtime) if options.runtime else ""
    if options.drones == 1:
        fly_demonstration(folder, config, runtime=runtime, live_port=options.live)
        return True
    with extra("emulation"):
        from upwash.cli.demonstration.fleet import fly_fleet
    return fly_fleet(folder, config, options.drones, runtime=runtime, live_port=options.live)


def _drones(text: str) -> int:
    """A number of drones."""
    number = count(text)
    if number > _MOST_DRONES:
        raise argparse.ArgumentTypeError(f"{number} drones are too many: give a number up to {_MOST_DRONES}")
    return number


def _read(file: Path) -> str:
    from upwash.errors import UsageError
    from upwash.support.input_files import read_file, text_of

    try:
        return text_of(read_file(file, most_bytes=_MOST_RUNTIME_BYTES))
    except (OSError, ValueError) as error:
        raise UsageError(f"--runtime {file} cannot be read: {error}") from None
