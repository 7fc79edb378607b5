"""The thesis's experiments flown again (its section 4.4): the missions, and the result of each.

There is one parameter set per set-up, `thesis/hitl.toml` and `thesis/simulation.toml`; the experiments differ from
it in the detector's mode, the policy and the load on s2, and in nothing else.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache
from importlib.resources import as_file, files
from statistics import fmean
from typing import Literal, NamedTuple

import msgspec

from upwash.config.drone import DroneConfig, ServerConfig
from upwash.config.drone_file import drone_config
from upwash.config.reading import read_document
from upwash.errors import UpwashError
from upwash.eventlog import schema
from upwash.lab import processes
from upwash.lab.bounds import bound_of
from upwash.lab.run import Run, simulate
from upwash.lab.scenario import value_at, with_policy, with_value

Mode = Literal["light", "heavy"]
PolicyName = Literal["local-only", "location-aware", "opportunistic"]

SETUPS = {"hitl": "HITL/SITL set-up, 54 Mbit/s", "simulation": "simulation set-up, 12 Mbit/s"}
_SLOWER_S = {"light": 1.0, "heavy": 7.0}  # what a call takes longer on the loaded s2
_LOADED = "s2"


class Experiment(NamedTuple):
    """One of the thesis's four experiments."""

    mode: Mode
    slow_s2: bool

    @property
    def name(self) -> str:
        """Its name in printed.csv."""
        return f"{'slow-s2' if self.slow_s2 else 'equal-servers'}-{self.mode}"


EXPERIMENTS = tuple(Experiment(mode, slow_s2) for slow_s2 in (False, True) for mode in ("light", "heavy"))
NAIVE = Experiment("heavy", slow_s2=True)  # where the thesis estimates what its naive selection would cost


class ThesisCell(NamedTuple):
    """What is flown once per seed. Without offloading s2's load makes no difference, so it is flown without."""

    setup: str
    experiment: Experiment
    policy: PolicyName


class By(NamedTuple):
    """What is added to the set-up's value of a parameter."""

    more: float


Changes = Mapping[str, float | By]  # of a set-up's parameters, by their keys


class CellFlight(NamedTuple):
    """One mission: a cell, with a seed, and changes of its set-up."""

    cell: ThesisCell
    seed: int
    changes: Changes | None = None


class CellResult(NamedTuple):
    """The result of one mission; `s2_calls` ran on s2 and took `s2_call_s` on average, without waits."""

    mission_min: float
    bound_min: float
    service_delay_s: float
    local_call_s: float
    waited_calls_s: Sequence[float]
    waits_in_vain: int
    s2_calls: int
    s2_call_s: float

    @property
    def saved_s(self) -> float:
        """Seconds by which the calls that waited were shorter than as many local calls."""
        return self.local_call_s * len(self.waited_calls_s) - sum(self.waited_calls_s)


def cells() -> tuple[ThesisCell, ...]:
    """Everything that has to be flown, in each set-up."""
    return tuple(
        cell for setup in SETUPS for cell in (*timed_cells(setup), ThesisCell(setup, NAIVE, "opportunistic"))
    )


def timed_cells(setup: str) -> Iterator[ThesisCell]:
    """The cells of a set-up whose mission times Table 4.1 prints."""
    for experiment in EXPERIMENTS:
        if not experiment.slow_s2:
            yield ThesisCell(setup, experiment, "local-only")
    for experiment in EXPERIMENTS:
        yield ThesisCell(setup, experiment, "location-aware")


def local_only(setup: str, experiment: Experiment) -> ThesisCell:
    """The cell without offloading that an experiment is compared with."""
    return ThesisCell(setup, Experiment(experiment.mode, slow_s2=False), "local-only")


def scenario(cell: ThesisCell, *, seed: int, changes: Changes | None = None) -> DroneConfig:
    """The cell's scenario: its set-up's parameters, with the cell's mode, policy and load on s2."""
    config = with_policy(parameters(cell.setup, tuple((changes or {}).items())), cell.policy)
    mode, slow_s2 = cell.experiment
    servers = tuple(
        _loaded(server) if slow_s2 and server.name == _LOADED else server for server in config.servers
    )
    mission = msgspec.structs.replace(config.mission, mode=mode)
    return msgspec.structs.replace(config, seed=seed, mission=mission, servers=servers)


@lru_cache
def parameters(setup: str, changes: tuple[tuple[str, float | By], ...] = ()) -> DroneConfig:
    """What all cells of a set-up share, with changes."""
    with as_file(files("upwash.lab.reproduction") / "thesis" / f"{setup}.toml") as file:
        document = read_document(file)
        for key, change in changes:
            value = value_at(document, file, key) + change.more if isinstance(change, By) else change
            document = with_value(document, file, key, value)
        return drone_config(document, file)


def fly(cell: ThesisCell, seed: int) -> Run:
    """Simulates the cell's mission; raises UpwashError where it was not completed."""
    return _fly(CellFlight(cell, seed), scenario(cell, seed=seed))


def fly_all(
    flights: Sequence[CellFlight], *, workers: int | None = None, progress: Callable[[], None] = lambda: None
) -> list[CellResult]:
    """The result of each flight, in their order; calls `progress` after each."""
    return processes.in_order(_flown, flights, workers=workers, done=progress)


def _loaded(server: ServerConfig) -> ServerConfig:
    """The server under load: its true calls are slower than the drone believes."""
    slower = {
        service: {key: call_s + _SLOWER_S[key] for key, call_s in calls_s.items()}
        for service, calls_s in server.remote_call_s.items()
    }
    truth = msgspec.structs.replace(server.truth, remote_call_s=slower)
    return msgspec.structs.replace(server, truth=truth)


def _fly(flight: CellFlight, config: DroneConfig) -> Run:
    run = simulate(config)
    if not run.result.completed:
        cell = flight.cell
        name = f"{cell.experiment.name}, {cell.setup}, {cell.policy}, seed {flight.seed}"
        raise UpwashError(f"{name}: the mission was not completed: {run.failure}")
    return run


def _flown(flight: CellFlight) -> CellResult:
    config = scenario(flight.cell, seed=flight.seed, changes=flight.changes)
    run = _fly(flight, config)
    result, bound = run.result, bound_of(run, config)
    assert bound is not None  # noqa: S101 - _fly() saw it completed
    on_s2_s = [call.delay_s - call.waited_s for call in result.calls if call.server == _LOADED]
    return CellResult(
        mission_min=result.mission_time_s / 60,
        bound_min=bound.free_s / 60,
        service_delay_s=result.totals.service_delay_s,
        local_call_s=fmean(
            call.delay_s for call in result.calls if call.server is None and not call.waited_s
        ),
        waited_calls_s=[
            event.delay_s for event in run.events if isinstance(event, schema.Call) and event.wait
        ],
        waits_in_vain=result.totals.waits_failed,
        s2_calls=len(on_s2_s),
        s2_call_s=fmean(on_s2_s) if on_s2_s else 0.0,
    )
