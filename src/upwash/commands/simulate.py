"""upwash simulate: simulates one mission."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from upwash.commands.arguments import add_policy

if TYPE_CHECKING:
    from upwash.commands.arguments import Commands


def add(commands: Commands) -> None:
    """Adds the command."""
    simulate = commands.add_parser("simulate", help="simulate one mission on virtual time")
    simulate.add_argument("scenario", type=Path, help="the scenario, a TOML file")
    add_policy(simulate, instead_of="the scenario's")
    simulate.add_argument("--seed", type=int, metavar="N", help="instead of the scenario's")
    simulate.add_argument("--json", action="store_true", help="print the result as one JSON object")
    simulate.add_argument(
        "--log", type=Path, metavar="FILE", help="where the event log goes (default: nowhere)"
    )
    simulate.add_argument(
        "--figures", type=Path, metavar="DIR", help="draw the map and the call delays there"
    )
    simulate.set_defaults(run=run)


def run(options: argparse.Namespace) -> bool:
    """Simulates it and prints what it came to."""
    from upwash.lab.simulation import simulate_scenario

    simulate_scenario(
        options.scenario,
        policy=options.policy,
        seed=options.seed,
        as_json=options.json,
        log=options.log,
        figures=options.figures,
    )
    return True
