"""upwash fly: flies a mission."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from upwash.cli.arguments import add_live, flown_by, new_run_folder
from upwash.cli.exit_codes import MEANINGS
from upwash.cli.plans import tell_of_plans

if TYPE_CHECKING:
    from upwash.cli.arguments import Commands


def add(commands: Commands) -> None:
    """Adds the command."""
    fly = commands.add_parser(
        "fly",
        help="fly a mission",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog="\n".join(("exit codes:", *(f"  {code:<4}{meaning}" for code, meaning in MEANINGS.items()))),
    )
    fly.add_argument(
        "mission", nargs="?", help="survey, or path/to/file.py:function (default: as configured)"
    )
    fly.add_argument("--config", type=Path, required=True, help="the drone's configuration, a TOML file")
    fly.add_argument("--autopilot", metavar="CONNECTION", help="instead of the configured one")
    log = fly.add_mutually_exclusive_group()
    log.add_argument("--log", type=Path, help="where the event log goes (default: runs/TIME/events.jsonl)")
    log.add_argument(
        "--resume",
        type=Path,
        metavar="LOG",
        help="take up the mission that this event log is of, where it broke off",
    )
    shown = fly.add_mutually_exclusive_group()
    shown.add_argument("--quiet", action="store_true", help="print nothing but what goes wrong")
    shown.add_argument(
        "--json", action="store_true", help="print the result as one JSON object at the end, and nothing else"
    )
    add_live(fly)
    fly.set_defaults(run=run)


def run(options: argparse.Namespace) -> bool:
    """Flies; returns when the mission is over."""
    from upwash.cli.flying import Show, fly_with_progress
    from upwash.config import never_offloaded, read_drone_config, refuse_several

    config = flown_by(read_drone_config(options.config), options.autopilot)
    refuse_several(config, options.config, what="a flight")
    tell_of_plans(config)
    for problem in never_offloaded(config):
        sys.stderr.write(f"upwash: warning: {problem}\n")
    log = options.resume or options.log or new_run_folder() / "events.jsonl"
    fly_with_progress(
        config,
        program=options.mission,
        log=log,
        resumes=options.resume is not None,
        show=Show.JSON if options.json else Show.NOTHING if options.quiet else Show.PROGRESS,
        live_port=options.live,
    )
    return True
