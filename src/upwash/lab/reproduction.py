"""The thesis's experiments flown again (its section 4.4), beside the figures that it prints.

There is one parameter set per set-up, `thesis/hitl.toml` and `thesis/simulation.toml`; the experiments differ from
it in the detector's mode, the policy and the load on s2, and in nothing else.
"""

from __future__ import annotations

import csv
import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import as_file, files
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Literal, NamedTuple

import msgspec

from upwash.config import DroneConfig, ServerConfig, read_drone_config
from upwash.errors import UpwashError
from upwash.lab.bounds import bound_of
from upwash.lab.confidence import Mean, mean_of
from upwash.lab.run import Run, simulate
from upwash.lab.simulation import with_policy

if TYPE_CHECKING:
    from rich.console import Console

Mode = Literal["light", "heavy"]
PolicyName = Literal["local-only", "location-aware", "opportunistic"]

SETUPS = {"hitl": "HITL/SITL set-up, 54 Mbit/s", "simulation": "simulation set-up, 12 Mbit/s"}
_SLOWER_S = {"light": 1.0, "heavy": 7.0}  # what a call takes longer on the loaded s2


class Experiment(NamedTuple):
    """One of the thesis's four experiments."""

    mode: Mode
    slow_s2: bool

    @property
    def name(self) -> str:
        """Its name in printed.csv."""
        return f"{'slow-s2' if self.slow_s2 else 'equal-servers'}-{self.mode}"


EXPERIMENTS = tuple(Experiment(mode, slow_s2) for slow_s2 in (False, True) for mode in ("light", "heavy"))
_NAIVE = Experiment("heavy", slow_s2=True)  # where the thesis estimates what its naive selection would cost


class Cell(NamedTuple):
    """What is flown once per seed. Without offloading s2's load makes no difference, so it is flown without."""

    setup: str
    experiment: Experiment
    policy: PolicyName


class Flown(NamedTuple):
    """What one mission came to."""

    mission_min: float
    bound_min: float
    service_delay_s: float
    local_call_s: float
    waited_calls_s: Sequence[float]

    @property
    def saved_s(self) -> float:
        """How much less time the calls that waited took than as many local ones."""
        return self.local_call_s * len(self.waited_calls_s) - sum(self.waited_calls_s)


class Quantity(NamedTuple):
    """A figure that the thesis gives, under its name in printed.csv."""

    name: str
    label: str
    unit: str


_LOCAL_ONLY = Quantity("mission_time_local_only", "mission time, no offloading", "min")
_OFFLOADING = Quantity("mission_time_offloading", "mission time, offloading", "min")
_BOUND = Quantity("mission_time_over_the_bound", "  above the bound of an all-knowing drone", "percent")
_RATIO = Quantity("total_service_delay_local_over_offloading", "service delay, local / offloading", "ratio")
_WAITS = Quantity("waits_decided", "decisions to wait", "count")
_SAVED = Quantity(
    "saving_of_waiting_over_local_at_those_waypoints", "service delay saved by waiting", "percent"
)
_SAVED_THERE = Quantity("saving_of_waiting_at_those_waypoints_alone", "  of the calls that waited", "percent")
_NAIVE_DELAY = Quantity("naive_selection_extra_service_delay", "naive: more service delay", "percent")
_NAIVE_MIN = Quantity("naive_selection_extra_mission_time", "naive: longer mission", "min")
_NAIVE_SHARE = Quantity("naive_selection_extra_mission_time_share", "naive: longer mission", "percent")

_FORMS = {"min": "{:.2f} min", "ratio": "{:.2f} x", "count": "{:.1f}", "percent": "{:.1f} %"}


@dataclass(frozen=True)
class Comparison:
    """One figure as flown, a value per seed, and as printed in the thesis, where it is."""

    setup: str
    experiment: Experiment
    quantity: Quantity
    values: Sequence[float]
    printed: float | None

    @property
    def mean(self) -> Mean:
        """The mean over the seeds, with its 95 % confidence."""
        return mean_of(self.values)

    @property
    def deviation_percent(self) -> float | None:
        """How far the mean is from the printed figure; None where there is none, or where it is 0."""
        return 100 * (self.mean.value / self.printed - 1) if self.printed else None


def cells() -> tuple[Cell, ...]:
    """Everything that has to be flown, in each set-up."""
    flown: list[Cell] = []
    for setup in SETUPS:
        flown += [
            Cell(setup, experiment, "local-only") for experiment in EXPERIMENTS if not experiment.slow_s2
        ]
        flown += [Cell(setup, experiment, "location-aware") for experiment in EXPERIMENTS]
        flown.append(Cell(setup, _NAIVE, "opportunistic"))
    return tuple(flown)


def scenario(cell: Cell, *, seed: int) -> DroneConfig:
    """The cell's scenario: its set-up's parameters, with the cell's mode, policy and load on s2."""
    config = with_policy(_parameters(cell.setup), cell.policy)
    mode, slow_s2 = cell.experiment
    servers = tuple(
        _loaded(server) if slow_s2 and server.name == "s2" else server for server in config.servers
    )
    mission = msgspec.structs.replace(config.mission, mode=mode)
    return msgspec.structs.replace(config, seed=seed, mission=mission, servers=servers)


def fly(cell: Cell, seed: int) -> Run:
    """Simulates the cell's mission; raises UpwashError where it was not completed."""
    run = simulate(scenario(cell, seed=seed))
    if not run.result.completed:
        name = f"{cell.experiment.name}, {cell.setup}, {cell.policy}, seed {seed}"
        raise UpwashError(f"{name}: the mission was not completed: {run.failure}")
    return run


def reproduce(
    *, seeds: int, workers: int | None = None, progress: Callable[[], None] = lambda: None
) -> list[Comparison]:
    """Flies every cell with seeds 1 to `seeds`, calling `progress` after each of `missions(seeds)` missions."""
    flights = [(cell, seed) for cell in cells() for seed in range(1, seeds + 1)]
    flown: dict[Cell, list[Flown]] = {cell: [] for cell in cells()}
    # Spawned, not forked: the process that shows the progress has threads.
    with ProcessPoolExecutor(
        workers or os.cpu_count(),
        mp_context=multiprocessing.get_context("spawn"),
        initializer=signal.signal,
        initargs=(signal.SIGINT, signal.SIG_IGN),  # an interrupt is this process's to handle
    ) as pool:
        for (cell, _), result in zip(flights, pool.map(_fly, flights, chunksize=5), strict=True):
            flown[cell].append(result)
            progress()
    return list(_compare(flown))


def missions(seeds: int) -> int:
    """How many missions a reproduction with so many seeds flies."""
    return len(cells()) * seeds


def show_reproduction(*, seeds: int, figures: Path | None = None) -> None:
    """Reproduces with a progress bar, prints the comparison, and draws the figures into a folder if given."""
    from rich.console import Console
    from rich.progress import Progress

    if figures is not None:
        import upwash.lab.figures  # noqa: F401 - so that a missing matplotlib is reported before, not after

    console = Console()
    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("missions", total=missions(seeds))
        comparisons = reproduce(seeds=seeds, progress=lambda: bar.advance(task))
    print_comparison(comparisons, console)
    if figures is not None:
        for file in draw_figures(figures):
            console.print(f"drawn: {file}", soft_wrap=True)


def print_comparison(comparisons: Sequence[Comparison], console: Console) -> None:
    """Prints a table per set-up, ours beside the printed figures."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    seeds = max(len(each.values) for each in comparisons)
    for setup, title in SETUPS.items():
        table = Table(
            title=f"{title}: means of {seeds} missions ± 95 %", title_justify="left", box=SIMPLE_HEAD
        )
        table.add_column("")
        for column in ("ours", "thesis", "deviation"):
            table.add_column(column, justify="right", no_wrap=True)
        for experiment in EXPERIMENTS:
            table.add_row(f"[bold]{experiment.name}")
            for each in comparisons:
                if (each.setup, each.experiment) == (setup, experiment):
                    table.add_row(f"  {each.quantity.label}", *_printed_values(each))
        console.print(table)


def draw_figures(folder: Path) -> list[Path]:
    """Draws the thesis's figures 4.4 to 4.12, from the missions of seed 1; returns the files."""
    from upwash.lab.figures import draw_call_delays, draw_map

    first = folder / "figure_4.4.png"
    draw_map(_parameters("hitl"), first, "Figure 4.4: waypoints, server coverage and flight direction")
    drawn = [first]
    shown = [(setup, experiment) for setup in SETUPS for experiment in EXPERIMENTS]
    for number, (setup, experiment) in enumerate(shown, start=5):
        file = folder / f"figure_4.{number}.png"
        speed = "s2 is slower than s1" if experiment.slow_s2 else "s2 is equally fast to s1"
        place = "HITL/SITL" if setup == "hitl" else "simulation"
        draw_call_delays(
            fly(Cell(setup, experiment, "location-aware"), 1),
            reference=fly(_local_only(setup, experiment), 1),
            file=file,
            title=f"Figure 4.{number}: call delay in the {experiment.mode} processing mode, {speed} ({place})",
        )
        drawn.append(file)
    return drawn


# --- flying ---------------------------------------------------------------------------------------------------


@lru_cache
def _parameters(setup: str) -> DroneConfig:
    with as_file(files("upwash.lab") / "thesis" / f"{setup}.toml") as file:
        return read_drone_config(file)


def _loaded(server: ServerConfig) -> ServerConfig:
    """The server under load: calls take longer in truth, and the drone has to find out."""
    slower = {
        service: {key: call_s + _SLOWER_S[key] for key, call_s in calls_s.items()}
        for service, calls_s in server.remote_call_s.items()
    }
    truth = msgspec.structs.replace(server.truth, remote_call_s=slower)
    return msgspec.structs.replace(server, truth=truth)


def _local_only(setup: str, experiment: Experiment) -> Cell:
    return Cell(setup, Experiment(experiment.mode, slow_s2=False), "local-only")


def _fly(flight: tuple[Cell, int]) -> Flown:
    run = fly(*flight)
    result, bound = run.result, bound_of(run, scenario(flight[0], seed=flight[1]))
    assert bound is not None  # noqa: S101 - fly() saw it completed
    local_s = [call.delay_s for call in result.calls if call.place == "local" and not call.waited_s]
    return Flown(
        mission_min=result.mission_time_s / 60,
        bound_min=bound.free_s / 60,
        service_delay_s=result.totals.service_delay_s,
        local_call_s=fmean(local_s),
        waited_calls_s=[
            event["delay_s"] for event in run.events if event["event"] == "call" and event["wait"]
        ],
    )


# --- comparing ------------------------------------------------------------------------------------------------


def _compare(flown: Mapping[Cell, Sequence[Flown]]) -> Iterator[Comparison]:
    printed = _printed()
    for setup in SETUPS:
        for experiment in EXPERIMENTS:
            for quantity, values in _quantities(flown, setup, experiment):
                yield Comparison(
                    setup, experiment, quantity, values, printed.get((experiment.name, setup, quantity.name))
                )


def _quantities(
    flown: Mapping[Cell, Sequence[Flown]], setup: str, experiment: Experiment
) -> Iterator[tuple[Quantity, list[float]]]:
    local = flown[_local_only(setup, experiment)]
    aware = flown[Cell(setup, experiment, "location-aware")]
    if not experiment.slow_s2:
        yield _LOCAL_ONLY, [each.mission_min for each in local]
    yield _OFFLOADING, [each.mission_min for each in aware]
    yield _BOUND, [100 * (each.mission_min / each.bound_min - 1) for each in aware]
    yield _RATIO, [ours.service_delay_s / its.service_delay_s for ours, its in zip(local, aware, strict=True)]
    yield _WAITS, [len(each.waited_calls_s) for each in aware]
    waiting = [each for each in aware if each.waited_calls_s]
    if waiting:
        yield _SAVED, [100 * each.saved_s / (each.service_delay_s + each.saved_s) for each in waiting]
        yield (
            _SAVED_THERE,
            [100 * each.saved_s / (each.local_call_s * len(each.waited_calls_s)) for each in waiting],
        )
    if experiment == _NAIVE:
        pairs = list(zip(flown[Cell(setup, experiment, "opportunistic")], aware, strict=True))
        yield (
            _NAIVE_DELAY,
            [100 * (naive.service_delay_s / its.service_delay_s - 1) for naive, its in pairs],
        )
        yield _NAIVE_MIN, [naive.mission_min - its.mission_min for naive, its in pairs]
        yield _NAIVE_SHARE, [100 * (naive.mission_min / its.mission_min - 1) for naive, its in pairs]


def _printed() -> dict[tuple[str, str, str], float]:
    """The thesis's figures by experiment, set-up and quantity."""
    text = (files("upwash.lab") / "thesis" / "printed.csv").read_text(encoding="utf-8")
    return {
        (row["experiment"], row["setup"], row["quantity"]): float(row["value"])
        for row in csv.DictReader(text.splitlines())
    }


def _printed_values(comparison: Comparison) -> tuple[str, str, str]:
    mean, deviation = comparison.mean, comparison.deviation_percent
    margin = f" ± {mean.margin:.2f}" if mean.count > 1 else ""
    return (
        _FORMS[comparison.quantity.unit].format(mean.value) + margin,
        "" if comparison.printed is None else f"{comparison.printed:g}",
        "" if deviation is None else f"{deviation:+.1f} %",
    )
