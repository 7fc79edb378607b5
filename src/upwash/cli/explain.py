"""upwash explain: says why each call of a flight ran where it ran."""

from __future__ import annotations

import argparse
from pathlib import Path

from upwash.cli.arguments import count
from upwash.lab.explanation import CallChoice, show_explanation


def add(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("log", type=Path, metavar="LOG", help="an event log, of `fly`, `demo` or `simulate`")
    parser.add_argument(
        "--scenario", type=Path, metavar="FILE",
        help="fly other policies in this world to compare; its programs run (default: none)",
    )  # fmt: skip
    parser.add_argument(
        "--drone", metavar="NAME",
        help="the drone of that world whose policy changes (default: the log's)",
    )  # fmt: skip
    calls = parser.add_mutually_exclusive_group()
    calls.add_argument("--waypoint", type=int, metavar="N", help="the calls of that waypoint alone")
    calls.add_argument("--worst", type=count, metavar="N", help="only the N longest calls")


def run(options: argparse.Namespace) -> bool:
    """Explain the calls."""
    wanted = CallChoice(options.waypoint, options.worst)
    show_explanation(options.log, scenario=options.scenario, drone=options.drone, wanted=wanted)
    return True
