"""Simulates one scenario for the command line: prints what it came to, writes the event log and the figures."""

from __future__ import annotations

import sys
from pathlib import Path

import msgspec
from rich.console import Console

from upwash.config import DroneConfig, read_drone_config
from upwash.core.bound import Bound
from upwash.errors import UpwashError
from upwash.lab.bounds import bound_of
from upwash.lab.run import Run, simulate
from upwash.output import write_file
from upwash.results import CallResult, Totals
from upwash.terminal import print_result


class Report(msgspec.Struct, frozen=True):
    """The one object that `upwash simulate --json` prints; without a completed mission there is no bound."""

    scenario: str
    policy: str
    seed: int
    mission_time_s: float
    completed: bool
    calls: list[CallResult]
    totals: Totals
    bound: Bound | None


def read_scenario(file: Path, *, policy: str | None = None, seed: int | None = None) -> DroneConfig:
    """The scenario of the file, with another policy or seed if given; raises ConfigError."""
    config = read_drone_config(file)
    if policy is not None:
        config = with_policy(config, policy)
    return config if seed is None else msgspec.structs.replace(config, seed=seed)


def with_policy(config: DroneConfig, name: str) -> DroneConfig:
    """The same scenario under another policy, which must be one of PolicyConfig's."""
    policy = msgspec.convert({**msgspec.structs.asdict(config.policy), "name": name}, type(config.policy))
    return msgspec.structs.replace(config, policy=policy)


def simulate_scenario(
    file: Path,
    *,
    policy: str | None = None,
    seed: int | None = None,
    as_json: bool = False,
    log: Path | None = None,
    figures: Path | None = None,
) -> None:
    """Simulates the scenario and prints its result; raises UpwashError afterwards if it was not completed."""
    config = read_scenario(file, policy=policy, seed=seed)
    run = simulate(config)
    _print(run, config, file.stem, as_json=as_json)
    if log is not None:
        named = {"t": 0.0, "event": "simulated", "scenario": str(file.resolve()), "seed": config.seed}
        write_file(log, msgspec.json.encode(named) + b"\n" + run.log())
    if figures is not None:
        _draw(run, config, figures)
    if run.failure:
        raise UpwashError(f"the mission was not completed: {run.failure}")


def _print(run: Run, config: DroneConfig, scenario: str, *, as_json: bool) -> None:
    result, bound = run.result, bound_of(run, config)
    if not as_json:
        console = Console(markup=False)
        print_result(result, console, paced=False)
        if bound is not None:
            _print_bound(result.mission_time_s, bound, console)
        return
    report = Report(
        scenario=scenario,
        policy=config.policy.name,
        seed=config.seed,
        mission_time_s=result.mission_time_s,
        completed=result.completed,
        calls=result.calls,
        totals=result.totals,
        bound=bound,
    )
    sys.stdout.write(msgspec.json.encode(report).decode() + "\n")


def _print_bound(mission_time_s: float, bound: Bound, console: Console) -> None:
    console.print(
        f"an all-knowing drone needs at least {bound.free_s:.1f} s with every server ready at once: this is "
        f"{100 * (mission_time_s / bound.free_s - 1):.1f} % more; joining one network after the other it needs "
        f"{bound.with_joins_s:.1f} s: {100 * (mission_time_s / bound.with_joins_s - 1):.1f} % more",
        soft_wrap=True,
    )


def _draw(run: Run, config: DroneConfig, folder: Path) -> None:
    from upwash.lab.figures import draw_call_delays, draw_map

    draw_map(config, folder / "map.png")
    draw_call_delays(
        run, reference=simulate(with_policy(config, "local-only")), file=folder / "call_delay.png"
    )
