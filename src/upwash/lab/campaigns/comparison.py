"""Every policy in the same scenarios: how long its missions take, beside the theoretical minimum."""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from statistics import fmean
from typing import NamedTuple

from msgspec.structs import replace

from upwash.config.drone import DroneConfig, ServerConfig
from upwash.config.plan_photos import photo_legs
from upwash.config.problems import repeated, unknown
from upwash.config.world import NoiseConfig
from upwash.core.policies.names import POLICIES, is_own
from upwash.errors import UpwashError, UsageError
from upwash.lab import processes
from upwash.lab.outcome import FlightOutcome, fly
from upwash.lab.reproduction.cells import EXPERIMENTS, SETUPS, ThesisCell, scenario
from upwash.lab.scenario import name_of, read_scenario, with_policy
from upwash.lab.worlds import draw_world
from upwash.support.confidence import Mean, mean_of, mean_saving

_NOISE = NoiseConfig(call=0.03, leg=0.02)  # of a scenario without any: else all seeds are the same mission


class NamedScenario(NamedTuple):
    """A scenario by its name in the comparison."""

    name: str
    config: DroneConfig

    def flown(self, seed: int) -> DroneConfig:
        """The scenario with that seed."""
        return replace(self.config, seed=seed)


class DrawnWorlds(NamedTuple):
    """Worlds by their common name in the comparison, each flown with the seed that it was drawn from."""

    name: str
    overrides: Mapping[str, object]
    survey: bool = False

    def flown(self, seed: int) -> DroneConfig:
        """The world of that seed."""
        return read_scenario(draw_world(seed, survey=self.survey), overrides=self.overrides)

    def kind(self, seed: int) -> str:
        """How photos are taken there, and whether the drone alone computes a photo before it takes the next one."""
        config = self.flown(seed)
        legs = photo_legs(config.mission)
        if not legs:
            return "stops"
        local_s = config.services[0].local_call_s[config.mission.mode]
        keeps_up = local_s * legs[0].ground_speed_m_s < legs[0].step_m
        return "rows, load below 1" if keeps_up else "rows, load from 1"


class Entrant(NamedTuple):
    """A policy that is compared, by its name in the comparison, and what it is given besides."""

    name: str
    policy: str
    left_alone_s: float | None = None  # after a failure; None as the policy does by default
    hedges: bool | None = None  # None as the policy does by default
    among_peers: bool = False  # every server is a peer of every other

    def enters(self, config: DroneConfig) -> DroneConfig:
        """The scenario as it flies there."""
        config = with_policy(config, self.policy)
        if self.among_peers:
            config = replace(config, servers=_all_peers(config.servers))
        policy = config.policy
        if self.left_alone_s is not None:
            policy = replace(policy, blacklist_s=self.left_alone_s, probe=None)
        if self.hedges is not None:
            policy = replace(policy, hedge=self.hedges)
        return replace(config, policy=policy)


ENTRANTS = (
    *(Entrant(policy, policy) for policy in POLICIES),
    Entrant("look-ahead, prepare", "look-ahead", among_peers=True),
    Entrant("look-ahead, left alone", "look-ahead", left_alone_s=60.0, hedges=False),
)


class ComparedFlight(NamedTuple):
    """One mission to be flown."""

    scenario: NamedScenario | DrawnWorlds
    entrant: Entrant
    seed: int


Results = Sequence[tuple[ComparedFlight, FlightOutcome]]


@dataclass(frozen=True, slots=True)
class ComparedPolicy:
    """One policy's missions in one scenario, each with a seed of its own; times in seconds.

    The true mean lies within `half_width_s` of `mean_s` with a probability of 95 %; it is infinite for one mission.
    `bound_s` is the theoretical minimum of the mean time, with every server ready at once. `energy_wh` is the mean
    energy of a mission from the battery, with its own half width; None without `[energy]` in the scenario.

    Only `completed` missions count, which a battery may prevent; without any, means are NaN.

    With several drones a mission stands for those of all of them. Times and energy are means over the drones, the
    bound is `FleetBound.shared_s`, and `worst_s` and `jain` are the means of the slowest drone's time and of Jain's
    index; with one drone they are None.

    `turned_back` is the mean number of times that a drone turned back for an answer, and `hidden_s` the mean time of
    calls during which it did other things; None if no drone went on before an answer.

    `saved_s` is the mean time that a mission is shorter than with the first policy and the same seed, with its own
    half width; None for the first policy, and without two of these missions. `saved_shares` are these differences in
    drawn worlds, ascending, as shares of the first policy's time: a negative share is a loss. `saved_by_kind` has
    them apart for worlds with "stops", "rows, load below 1" and "rows, load from 1"; the load is the drone's seconds
    for a photo by the seconds from one photo to the next.
    """

    scenario: str
    policy: str
    missions: int
    completed: int
    mean_s: float
    half_width_s: float
    bound_s: float
    energy_wh: float | None
    energy_half_width_wh: float | None
    worst_s: float | None = None
    jain: float | None = None
    turned_back: float | None = None
    hidden_s: float | None = None
    saved_s: float | None = None
    saved_half_width_s: float | None = None
    saved_shares: tuple[float, ...] = ()
    saved_by_kind: Mapping[str, tuple[float, ...]] = field(default_factory=dict)


def compare(
    scenarios: Sequence[str | os.PathLike[str]]
    | Mapping[str, str | os.PathLike[str] | Mapping[str, object]] = (),
    *,
    policies: Sequence[str] | None = None,
    seeds: int = 30,
    worlds: range | None = None,
    surveys: range | None = None,
    overrides: Mapping[str, object] | None = None,
    workers: int | None = None,
    thesis: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> list[ComparedPolicy]:
    """Flies every policy in every scenario with the seeds 1 to `seeds`; returns a row for each scenario and policy.

    Scenarios are TOML files, or a dict of files or tables by the scenarios' names, with `overrides` as `simulate`
    takes them; without noise all seeds are the same mission, so a scenario without noise gets some. With `thesis` the
    eight cells of the thesis's experiments come first. The drawn `worlds` of these seeds come last, in one row for
    each policy, and after them the drawn `surveys`: each of them is flown once.
    `progress` is called with the number of missions flown and of all. Work of more than some seconds is spread over
    `workers` processes, one for each core by default. A script calls this under `if __name__ == "__main__":`, or with
    one worker, which is the calling process itself.

    ConfigError for a scenario that cannot be flown, UsageError for an unknown policy, and UpwashError for a mission
    that is not completed though its battery is endless.
    """
    entrants = _entrants(policies)
    named = [*(thesis_scenarios() if thesis else []), *read_scenarios(scenarios, overrides=overrides)]
    if seeds < 1:
        raise UsageError(f"{seeds} seeds are none: give a number from 1 on")
    cases: list[tuple[NamedScenario | DrawnWorlds, range]] = [(case, range(1, seeds + 1)) for case in named]
    for kind, drawn in (("worlds", worlds), ("surveys", surveys)):
        if drawn:
            name = f"{kind} {drawn[0]}..{drawn[-1]}"
            cases.append((DrawnWorlds(name, overrides or {}, survey=kind == "surveys"), drawn))
    # What policies have in common is computed once, where one process flies all of them in turn.
    parts = [
        [ComparedFlight(scenario, entrant, seed) for entrant in entrants]
        for scenario, of_case in cases
        for seed in of_case
    ]
    flown = itertools.count(1)

    def done() -> None:
        for number in itertools.islice(flown, len(entrants)):
            if progress is not None:
                progress(number, len(entrants) * len(parts))

    outcomes = processes.in_order(_fly_all, parts, workers=workers, done=done)
    results = list(zip(itertools.chain(*parts), itertools.chain(*outcomes), strict=True))
    return [row for scenario, _ in cases for row in _rows(scenario, entrants, results)]


def read_scenarios(
    scenarios: Sequence[str | os.PathLike[str]] | Mapping[str, str | os.PathLike[str] | Mapping[str, object]],
    *,
    overrides: Mapping[str, object] | None = None,
) -> list[NamedScenario]:
    """The scenarios by their names, with some noise where they have none."""
    named = list(
        scenarios.items()
        if isinstance(scenarios, Mapping)
        else ((name_of(scenario), scenario) for scenario in scenarios)
    )
    for _, name in repeated([name for name, _ in named]):
        raise UsageError(f"two scenarios are called {name}: give them different names")
    found = []
    for name, scenario_of in named:
        config = read_scenario(scenario_of, overrides=overrides)
        noise = _NOISE if config.noise == NoiseConfig() else config.noise
        found.append(NamedScenario(name, replace(config, noise=noise)))
    return found


def thesis_scenarios() -> list[NamedScenario]:
    """The eight cells of the thesis's experiments."""
    cells = (
        ThesisCell(setup, experiment, "location-aware") for setup, experiment in product(SETUPS, EXPERIMENTS)
    )
    return [
        NamedScenario(f"thesis, {cell.experiment.name}, {cell.setup}", scenario(cell, seed=1))
        for cell in cells
    ]


def _entrants(policies: Sequence[str] | None) -> Sequence[Entrant]:
    if policies is None:
        return ENTRANTS
    own = {policy: Entrant(policy, str(Path(policy).absolute())) for policy in policies if is_own(policy)}
    known = {entrant.name: entrant for entrant in ENTRANTS} | own
    for policy in policies:
        if policy not in known:
            raise UsageError(unknown("policy", policy, known))
    return [known[policy] for policy in policies]


def _fly_all(flights: Sequence[ComparedFlight]) -> list[FlightOutcome]:
    outcomes = []
    for case, entrant, seed in flights:
        config = entrant.enters(case.flown(seed))
        outcomes.append(outcome := fly(config))
        if not outcome.completed and (config.energy is None or config.energy.battery_wh is None):
            raise UpwashError(f"{case.name}, {entrant.name}, seed {seed}: {outcome.failure}")
    return outcomes


def _all_peers(servers: Sequence[ServerConfig]) -> tuple[ServerConfig, ...]:
    def among(server: ServerConfig) -> ServerConfig:
        others = tuple(other.name for other in servers if other.name != server.name)
        return replace(server, truth=replace(server.truth, peers=others))

    return tuple(map(among, servers))


def _rows(
    scenario: NamedScenario | DrawnWorlds, entrants: Sequence[Entrant], results: Results
) -> Iterator[ComparedPolicy]:
    own = [(flight, outcome) for flight, outcome in results if flight.scenario is scenario]
    bounds_s = sorted(
        outcome.least_s for _, outcome in own if outcome.completed and outcome.least_s is not None
    )
    first_s = _times_s(own, entrants[0])
    kinds = {seed: scenario.kind(seed) for seed in first_s} if isinstance(scenario, DrawnWorlds) else {}
    for entrant in entrants:
        flown = [outcome for flight, outcome in own if flight.entrant is entrant]
        own_s = _times_s(own, entrant)
        saved = None if entrant is entrants[0] else mean_saving(first_s, own_s)
        shares = sorted((1 - time_s / first_s[seed], seed) for seed, time_s in own_s.items() if seed in kinds)
        completed = [outcome for outcome in flown if outcome.completed]
        times_s = [flight.mission_time_s for flight in completed if flight.mission_time_s is not None]
        time_s = _mean(times_s)
        drawn_wh = [outcome.energy.total_wh for outcome in completed if outcome.energy is not None]
        metered = any(outcome.energy is not None for outcome in flown)
        energy_wh = _mean(drawn_wh) if metered else None
        fleets = [outcome.fleet for outcome in completed if outcome.fleet is not None]
        went_on = any(outcome.totals.went_on for outcome in completed)
        yield ComparedPolicy(
            scenario=scenario.name,
            policy=entrant.name,
            missions=len(flown),
            completed=len(completed),
            mean_s=time_s.value,
            half_width_s=time_s.margin,
            bound_s=fmean(bounds_s) if bounds_s else math.nan,
            energy_wh=energy_wh.value if energy_wh else None,
            energy_half_width_wh=energy_wh.margin if energy_wh else None,
            worst_s=fmean(fleet.worst_s or 0.0 for fleet in fleets) if fleets else None,
            jain=fmean(fleet.fairness for fleet in fleets) if fleets else None,
            turned_back=fmean(flight.totals.turns_back for flight in completed) if went_on else None,
            hidden_s=fmean(flight.totals.hidden_s for flight in completed) if went_on else None,
            saved_s=saved.value if saved else None,
            saved_half_width_s=saved.margin if saved else None,
            saved_shares=tuple(share for share, _ in shares) if saved else (),
            saved_by_kind={
                kind: tuple(share for share, seed in shares if kinds[seed] == kind)
                for kind in sorted(set(kinds.values()) if saved else ())
            },
        )


def _times_s(results: Results, entrant: Entrant) -> dict[int, float]:
    """The times (s) of the entrant's completed missions, by seed."""
    return {
        flight.seed: outcome.mission_time_s
        for flight, outcome in results
        if flight.entrant is entrant and outcome.completed and outcome.mission_time_s is not None
    }


def _mean(observations: Sequence[float]) -> Mean:
    return mean_of(sorted(observations)) if observations else Mean(0, math.nan, math.nan)
