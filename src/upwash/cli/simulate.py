"""upwash simulate: simulates one mission, or those of several drones at the same time."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from upwash.cli.arguments import add_figures, add_policy, figures_of
from upwash.cli.plans import tell_of_plans
from upwash.errors import UpwashError, UsageError

if TYPE_CHECKING:
    from upwash import FleetSimulation, Simulation
    from upwash.cli.arguments import Commands
    from upwash.lab.figures import FigureFiles


def add(commands: Commands) -> None:
    """Adds the command."""
    simulate = commands.add_parser("simulate", help="simulate a mission, or several drones', on virtual time")
    simulate.add_argument("scenario", type=Path, help="the scenario, a TOML file")
    add_policy(simulate, instead_of="the scenario's")
    simulate.add_argument("--seed", type=int, metavar="N", help="instead of the scenario's")
    simulate.add_argument("--json", action="store_true", help="print the result as one JSON object")
    simulate.add_argument(
        "--log", type=Path, metavar="FILE",
        help="where the event log goes, or those of several drones as FILE-NAME (default: nowhere)",
    )  # fmt: skip
    simulate.add_argument(
        "--keep-coverage", action="store_true",
        help="write what was measured of servers without a range to network.coverage_map, as a flight does",
    )  # fmt: skip
    add_figures(simulate, "the map and the call delays")
    simulate.set_defaults(run=run)


def run(options: argparse.Namespace) -> bool:
    """Simulates it and prints what it came to."""
    from upwash.lab.scenario import read_scenario

    config = read_scenario(options.scenario, policy=options.policy, seed=options.seed)
    tell_of_plans(config)
    return _run_fleet(options) if config.drones else _run_one(options)


def _run_one(options: argparse.Namespace) -> bool:
    from upwash import simulate
    from upwash.cli.simulated import print_json, print_simulation, write_log

    figures = figures_of(options)
    simulation = simulate(
        options.scenario, policy=options.policy, seed=options.seed, keep_coverage=options.keep_coverage
    )
    if options.json:
        print_json(simulation)
    else:
        print_simulation(simulation)
    if options.log is not None:
        write_log(options.log, simulation.events, options.scenario, seed=simulation.seed)
    if figures is not None:
        _draw(simulation, options.scenario, figures)
    if simulation.failure:
        raise UpwashError(f"the mission was not completed: {simulation.failure}")
    return True


def _run_fleet(options: argparse.Namespace) -> bool:
    from upwash import simulate_fleet
    from upwash.cli.simulated import print_fleet, print_fleet_json

    if options.keep_coverage:
        raise UsageError("--keep-coverage keeps one drone's map, and this scenario has several drones")
    if options.figures is not None:
        raise UsageError(
            "--figures draws one mission, and this scenario has several drones: --log keeps their logs, "
            "and upwash report makes a page of them"
        )
    fleet = simulate_fleet(options.scenario, policy=options.policy, seed=options.seed)
    if options.json:
        print_fleet_json(fleet)
    else:
        print_fleet(fleet)
    if options.log is not None:
        _write_logs(fleet, options.scenario, options.log)
    for name, failure in fleet.failures.items():
        raise UpwashError(f"{name} did not complete its mission: {failure}")
    return True


def _write_logs(fleet: FleetSimulation, scenario: Path, log: Path) -> None:
    """A log for each drone, named after it; each names the scenario and the seed of all."""
    from upwash.cli.simulated import write_log

    for name, simulation in fleet.drones.items():
        write_log(
            log.with_name(f"{log.stem}-{name}{log.suffix}"), simulation.events, scenario, seed=fleet.seed
        )


def _draw(simulation: Simulation, scenario: Path, figures: FigureFiles) -> None:
    from upwash import simulate
    from upwash.lab.figures.calls import draw_call_delays
    from upwash.lab.figures.coverage import draw_coverage
    from upwash.lab.scenario import read_scenario

    draw_coverage(read_scenario(scenario, policy=simulation.policy), figures.files("map"))
    reference = simulate(scenario, policy="local-only", seed=simulation.seed)
    draw_call_delays(simulation.events, reference=reference.events, files=figures.files("call_delay"))
