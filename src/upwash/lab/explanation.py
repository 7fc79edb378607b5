"""Why each call of a flight ran where it ran, and where other policies would have run it in the same world."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from upwash.config import DroneConfig
from upwash.config.problems import unknown
from upwash.core.policies import POLICIES
from upwash.errors import UsageError
from upwash.eventlog import log as event_log
from upwash.eventlog import schema
from upwash.eventlog.narration import ran_on
from upwash.eventlog.reasons import told_calls
from upwash.eventlog.results import CallResult, last_run, read_result
from upwash.eventlog.schema import Event
from upwash.lab.fleet import simulate_fleet
from upwash.lab.simulation import Simulation, read_scenario, simulate
from upwash.support.sentences import say
from upwash.support.text import escaped_lines


@dataclass(frozen=True, slots=True)
class Replay:
    """The same mission in the same world, by policy; whether there were `others` that flew as the scenario says."""

    runs: Mapping[str, Simulation] = field(default_factory=dict)
    bound_s: float | None = None
    others: bool = False


@dataclass(frozen=True, slots=True)
class Wanted:
    """Which calls are explained: all, those of a waypoint, or so many that took longest, the longest first."""

    waypoint: int | None = None
    worst: int | None = None

    def of(self, calls: Sequence[CallResult]) -> list[int]:
        """The numbers of the wanted calls; UsageError where there is none."""
        numbers = [
            number
            for number, call in enumerate(calls)
            if self.waypoint is None or call.waypoint == self.waypoint
        ]
        if not numbers:
            raise UsageError(f"--waypoint {self.waypoint}: no call was made there")
        if self.worst is None:
            return numbers
        return sorted(numbers, key=lambda number: -calls[number].delay_s)[: self.worst]


def show_explanation(
    log: Path, *, scenario: Path | None = None, drone: str | None = None, wanted: Wanted | None = None
) -> None:
    """Prints why each call of the log, or each wanted one, ran where it ran, and what other policies would have done.

    These are flown in the scenario that is given, or else in the one that the log names, if it does. Where that has
    several drones they are flown by the one that is named, or else by the one that the log names.
    """
    from rich.console import Console

    events = _with_calls(log)
    console = Console(markup=False, highlight=False)
    wanted = wanted or Wanted()
    wanted.of(read_result(events).calls)  # before other policies are flown for none
    for line in explain(events, replay(events, scenario, drone), wanted):
        words = line.lstrip(" ")
        say(escaped_lines(words), console, indent=len(line) - len(words))


def _with_calls(log: Path) -> list[Event]:
    """The events of a log with calls; raises UsageError for any other file."""
    events = event_log.read(log)
    if not any(isinstance(event, schema.Call) for event in events):
        raise UsageError(f"{log} has no service call to explain")
    return events


def replay(events: Sequence[Event], scenario: Path | None, drone: str | None = None) -> Replay:
    """Flies every policy in the world of the log: that of the scenario, or of the one that the log names, if any."""
    named = next((event for event in events if isinstance(event, schema.Simulated)), None)
    seed = named.seed if named else None
    if scenario is None and named is not None:
        scenario = Path(named.scenario)
    if scenario is None:
        return Replay()
    config = read_scenario(scenario)
    if config.drones:
        name = _drone_of(events, config, scenario, drone)
        runs = {policy: _among_others(scenario, name, policy, seed) for policy in POLICIES}
    elif drone is not None:
        raise UsageError(f"--drone {drone}: {scenario} has no [[drone]] tables: leave it out")
    else:
        runs = {policy: simulate(scenario, policy=policy, seed=seed) for policy in POLICIES}
    bound = next((run.bound for run in runs.values() if run.bound), None)  # whatever policy flew
    return Replay(runs, bound.free_s if bound else None, others=len(config.drones) > 1)


def _drone_of(events: Sequence[Event], config: DroneConfig, scenario: Path, drone: str | None) -> str:
    """The scenario's drone that is given, or else the one that left the log."""
    started = next((event for event in events if isinstance(event, schema.MissionStarted)), None)
    name = drone or (started.drone if started else "")
    names = [each.name for each in config.drones]
    if name not in names:
        raise UsageError(
            f"{scenario} has several drones: name one with --drone; {unknown('drone', name, names)}"
        )
    return name


def _among_others(scenario: Path, drone: str, policy: str, seed: int | None) -> Simulation:
    """The drone under that policy, the others as the scenario has them."""
    fleet = simulate_fleet(scenario, seed=seed, overrides={f"drone.{drone}.policy": policy})
    return fleet.drones[drone]


def explain(events: Sequence[Event], replayed: Replay, wanted: Wanted) -> Iterator[str]:
    """The explanation of the wanted calls, line by line."""
    result = read_result(events)
    calls = told_calls(last_run(events))
    for number in wanted.of(result.calls):
        heading, *reasons = calls[number]
        yield heading
        yield from (f"    {reason}" for reason in reasons)
        if replayed.runs:
            yield f"    {_elsewhere(number, len(result.calls), replayed, result.policy)}"
        yield ""
    took = f"{result.policy} took {result.mission_time_s:.1f} s"
    if not replayed.runs:
        yield f"{took}; give --scenario FILE to see what other policies would have done"
        return
    others = ", among drones that fly as the scenario says" if replayed.others else ""
    yield f"{took}; in the same world{others}, simulated:"
    for policy, run in replayed.runs.items():
        ended = "" if run.completed else ", not completed"
        yield f"    {policy}: {run.mission_time_s:.1f} s{ended}"
    if replayed.bound_s is not None:
        yield f"    theoretical minimum: {replayed.bound_s:.1f} s"


def _elsewhere(number: int, count: int, replayed: Replay, own: str) -> str:
    """What the other policies did with the same call; a mission that made other calls has no same one."""
    others = []
    for policy, run in replayed.runs.items():
        if policy != own:
            same: CallResult | None = run.calls[number] if len(run.calls) == count else None
            others.append(
                f"{policy}: {ran_on(same.server)}, {same.delay_s:.2f} s" if same else f"{policy}: other calls"
            )
    return "; ".join(others)
