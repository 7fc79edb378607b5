"""The outcome of simulated flights in a few numbers: of one drone, or of several at the same time."""

from __future__ import annotations

import contextlib
import dataclasses
import logging
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean

from msgspec.structs import replace

from upwash.config.drone import DroneConfig, PolicyConfig
from upwash.config.drone_file import Presence, fleet_of, presences
from upwash.eventlog.results import EnergyTotals, Totals
from upwash.lab.bounds import bound_of, bounds_of
from upwash.lab.least_time import Bound, FleetBound
from upwash.lab.run import Run, flown_alone, simulate, simulate_drones
from upwash.sim.chance import plays_a_part
from upwash.support.text import by_name


@dataclass(frozen=True, slots=True)
class FleetOutcome:
    """The completed missions of several drones; the fields are those of `FleetSimulation`."""

    completed: int
    mean_s: float | None
    worst_s: float | None
    saved_s: Mapping[str, float]
    jain: float | None
    bound: FleetBound | None

    @property
    def fairness(self) -> float:
        """Jain's index; 1 if no drone's savings are known."""
        return 1.0 if self.jain is None else self.jain


@dataclass(frozen=True, slots=True)
class FlightOutcome:
    """One flight, or one of several drones: then times, bounds and energy are means over the completed missions.

    The counts of `totals` are of all calls of all drones. `failure` says why the flight was not completed; drones
    that vanish by the scenario do not count. `bound` is None without a completed mission.
    """

    policy: str
    completed: bool
    failure: str
    mission_time_s: float | None
    totals: Totals
    bound: Bound | FleetBound | None
    energy: EnergyTotals | None
    fleet: FleetOutcome | None = None

    @property
    def least_s(self) -> float | None:
        """The bound to compare with: among several drones servers compute a limited number of calls at a time."""
        if self.bound is None:
            return None
        return self.bound.shared_s if isinstance(self.bound, FleetBound) else self.bound.free_s


def fly(config: DroneConfig, *, bounded: bool = True) -> FlightOutcome:
    """Flies the scenario, without the bounds of one drone unless `bounded`; raises what `simulate` raises."""
    with quiet_daemons():
        return _fly_fleet(config) if config.drones else _fly_one(config, bounded=bounded)


@contextlib.contextmanager
def quiet_daemons() -> Iterator[None]:
    """Suppress the daemons' reports of thousands of intended crashes."""
    daemons = logging.getLogger("upwash.server")
    before, daemons.disabled = daemons.disabled, True
    try:
        yield
    finally:
        daemons.disabled = before


def _fly_one(config: DroneConfig, *, bounded: bool) -> FlightOutcome:
    run = simulate(config)
    return outcome_of(run, bound_of(run, config) if bounded else None)


def outcome_of(run: Run, bound: Bound | None = None) -> FlightOutcome:
    """The outcome of one drone's mission."""
    failure = failure_of(run)
    return FlightOutcome(
        policy=run.result.policy,
        completed=run.result.completed and not failure,
        failure=failure,
        mission_time_s=run.result.mission_time_s,
        totals=run.result.totals,
        bound=bound,
        energy=run.result.energy,
    )


def _fly_fleet(config: DroneConfig) -> FlightOutcome:
    fleet, runs = fleet_of(config), simulate_drones(config)
    _, bound = bounds_of(list(runs.values()), fleet)
    found = fleet_outcome(runs, config, bound)
    failure = _failure(runs)
    drawn = [run.result.energy for run in runs.values() if run.result.completed and run.result.energy]
    return FlightOutcome(
        policy=" ".join(dict.fromkeys(drone.policy.label for drone in fleet)),
        completed=bound is not None and not failure,
        failure=failure,
        mission_time_s=found.mean_s,
        totals=_sums([run.result.totals for run in runs.values()]),
        bound=bound,
        energy=_means(drawn),
        fleet=found if bound else None,
    )


def failure_of(run: Run) -> str:
    """Why the mission failed; a mission whose offloading failed says nothing of its policy."""
    defect = run.result.offloading_failed
    return run.failure or (f"every call ran on the drone after a defect: {defect}" if defect else "")


def _failure(runs: Mapping[str, Run]) -> str:
    """Why drones failed, without those that the scenario has vanish; or that none is left."""
    failures = {name: failure_of(run) for name, run in runs.items() if not run.vanished}
    failed = [f"{name}: {failure}" for name, failure in failures.items() if failure]
    if not failed and all(run.vanished for run in runs.values()):
        return "every drone vanished"
    return "; ".join(failed)


def _sums(totals: Sequence[Totals]) -> Totals:
    remote = Counter[str]()
    for total in totals:
        remote.update(total.remote)
    counts = {
        field.name: sum(getattr(total, field.name) for total in totals)
        for field in dataclasses.fields(Totals)
        if field.name != "remote"
    }
    return Totals(remote={server: remote[server] for server in sorted(remote, key=by_name)}, **counts)


def _means(drawn: Sequence[EnergyTotals]) -> EnergyTotals | None:
    if not drawn:
        return None
    names = [field.name for field in dataclasses.fields(EnergyTotals) if field.name != "battery_wh"]
    return EnergyTotals(
        battery_wh=drawn[0].battery_wh,
        **{name: fmean(getattr(energy, name) for energy in drawn) for name in names},
    )


def fleet_outcome(
    runs: Mapping[str, Run], config: DroneConfig, bound: FleetBound | None = None
) -> FleetOutcome:
    """The outcome of the runs of the scenario's drones."""
    times_s = [run.result.mission_time_s for run in runs.values() if run.result.completed]
    saved = saved_s(runs, fleet_of(config), presences(config))
    return FleetOutcome(
        completed=len(times_s),
        mean_s=fmean(times_s) if times_s else None,
        worst_s=max(times_s, default=None),
        saved_s=saved,
        jain=jain(saved.values()),
        bound=bound,
    )


_NEVER_S = 1e6  # a period of looking around for a drone without servers
_LEAST_S = 1e-3  # shorter savings are rounding


def saved_s(
    runs: Mapping[str, Run], fleet: Sequence[DroneConfig], there: Sequence[Presence]
) -> dict[str, float]:
    """By name, the seconds that each drone saved which completed its mission here and would have completed it alone.

    Alone every call of a drone runs on it, and its battery is endless. Drones that fly the same mission with the same
    computer and chance are flown alone once.
    """
    saved: dict[str, float] = {}
    for config, presence in zip(fleet, there, strict=True):
        run = runs[config.name]
        struck = any(fault.target == "autopilot" for fault in config.faults)
        when = Presence(presence.departs_s) if struck else Presence()
        if run.result.completed and (alone := flown_alone(_by_itself(config), when)) is not None:
            saved[config.name] = alone.time_s - run.result.mission_time_s
    return saved


def jain(saved: Iterable[float]) -> float | None:
    """Jain's index: 1 if all saved the same, 1/n if one of n saved all; None without drones.

    A loss counts as no saving; if no drone saved, the index is 1.
    """
    shares = [share if share > _LEAST_S else 0.0 for share in saved]
    if not shares:
        return None
    squares = sum(share**2 for share in shares)
    return sum(shares) ** 2 / (len(shares) * squares) if squares else 1.0


def _by_itself(config: DroneConfig) -> DroneConfig:
    """The same mission without servers, and without settings that do not change its time then."""
    return replace(
        config,
        name="alone",
        seed=config.seed if plays_a_part(config) else 0,
        policy=PolicyConfig(name="local-only", period_s=_NEVER_S, stay_or_go=config.policy.stay_or_go),
        servers=(),
        faults=tuple(fault for fault in config.faults if fault.target == "autopilot"),
        energy=None,
        mission=replace(config.mission, reserve_percent=None, reserve_s=None),
        vehicle=replace(config.vehicle, endurance_s=None),
    )
