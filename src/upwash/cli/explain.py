"""upwash explain: says why each call of a flight ran where it ran."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from upwash.cli.arguments import count

if TYPE_CHECKING:
    from upwash.cli.arguments import Commands


def add(commands: Commands) -> None:
    """Adds the command."""
    explain = commands.add_parser("explain", help="say why each call of a flight ran where it ran")
    explain.add_argument("log", type=Path, metavar="LOG", help="an event log, of `fly`, `demo` or `simulate`")
    explain.add_argument(
        "--scenario", type=Path, metavar="FILE",
        help="the world in which other policies are flown to compare; its programs run (default: none)",
    )  # fmt: skip
    explain.add_argument(
        "--drone", metavar="NAME",
        help="of several drones in that world, the one that flies by other policies (default: the log's)",
    )  # fmt: skip
    calls = explain.add_mutually_exclusive_group()
    calls.add_argument("--waypoint", type=int, metavar="N", help="the calls of that waypoint alone")
    calls.add_argument("--worst", type=count, metavar="N", help="the calls that took longest alone, so many")
    explain.set_defaults(run=run)


def run(options: argparse.Namespace) -> bool:
    """Explains them."""
    from upwash.lab.explanation import CallChoice, show_explanation

    wanted = CallChoice(options.waypoint, options.worst)
    show_explanation(options.log, scenario=options.scenario, drone=options.drone, wanted=wanted)
    return True
