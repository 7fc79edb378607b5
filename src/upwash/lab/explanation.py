"""Why each call of a flight ran where it ran, and where other policies would have run it in the same world."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from upwash.config.drone import DroneConfig
from upwash.config.problems import unknown
from upwash.core.policies.names import POLICIES
from upwash.errors import UsageError
from upwash.eventlog import schema
from upwash.eventlog.causes import ran_on
from upwash.eventlog.log import EventLog
from upwash.eventlog.reasons import CallText, explained_calls, worst_of
from upwash.eventlog.results import RunResult, read_result
from upwash.eventlog.schema import Event
from upwash.lab.scenario import read_scenario
from upwash.lab.simulation import Simulation, simulate, simulate_fleet
from upwash.support.progress import work
from upwash.support.sentences import say
from upwash.support.text import escaped_lines, lasting, printable

Kind = TypeVar("Kind", bound=Event)


@dataclass(frozen=True, slots=True)
class Replay:
    """The same mission in the same world, by policy; whether there were `others` that flew as the scenario says."""

    runs: Mapping[str, Simulation] = field(default_factory=dict)
    bound_s: float | None = None
    others: bool = False


@dataclass(frozen=True, slots=True)
class CallChoice:
    """Which calls are explained: all, the calls of a waypoint, or the number `worst` of the worst calls.

    The worst took longest beyond what was expected of the best place for them; calls that lost nothing are not among
    them.
    """

    waypoint: int | None = None
    worst: int | None = None

    def of(self, calls: Sequence[CallText]) -> Sequence[CallText]:
        """The wanted calls; UsageError where there is none."""
        wanted = [call for call in calls if self.waypoint in (None, call.call.waypoint)]
        if not wanted:
            raise UsageError(f"--waypoint {self.waypoint}: no call was made there")
        return wanted if self.worst is None else worst_of(wanted, self.worst)


def show_explanation(
    log: Path, *, scenario: Path | None = None, drone: str | None = None, wanted: CallChoice | None = None
) -> None:
    """Prints why each chosen call of the log ran where it ran, and what other policies would have done.

    Other policies fly only in a scenario that is given: a log may come from a stranger, and a scenario runs its
    author's program. In a scenario of several drones, `drone` flies by them, or else the log's drone.
    """
    from rich.console import Console

    events = EventLog(log)
    console = Console(markup=False, highlight=False)
    wanted = wanted or CallChoice()
    with work("reading the log"):
        calls = explained_calls(events)
    if not calls:
        raise UsageError(f"{log} has no service call to explain")
    wanted.of(calls)  # before other policies are flown for none
    if scenario is None and drone is not None:
        raise UsageError(f"--drone {drone} goes with --scenario FILE: without one no drone is flown")
    replayed = Replay() if scenario is None else replay(events, scenario, drone)
    for line in explain(events, replayed, wanted):
        words = line.lstrip(" ")
        say(escaped_lines(words), console, indent=len(line) - len(words))


def replay(events: Iterable[Event], scenario: Path, drone: str | None = None) -> Replay:
    """Flies every policy in the world of that scenario, with the log's seed where it has one."""
    named = _first(schema.Simulated, events)
    seed = named.seed if named else None
    config = read_scenario(scenario)
    policies = {policy: policy for policy in POLICIES} | {config.policy.label: config.policy.name}
    if config.drones:
        name = _drone_of(events, config, scenario, drone)
        runs = {label: _among_others(scenario, name, policy, seed) for label, policy in policies.items()}
    elif drone is not None:
        raise UsageError(f"--drone {drone}: {scenario} has no [[drone]] tables: leave it out")
    else:
        runs = {}
        with work("policies flown", len(policies)) as done:
            for label, policy in policies.items():
                runs[label] = simulate(scenario, policy=policy, seed=seed)
                done()
    bound = next((run.bound for run in runs.values() if run.bound), None)  # whatever policy flew
    return Replay(runs, bound.free_s if bound else None, others=len(config.drones) > 1)


def _first(kind: type[Kind], events: Iterable[Event]) -> Kind | None:
    return next((event for event in events if isinstance(event, kind)), None)


def _drone_of(events: Iterable[Event], config: DroneConfig, scenario: Path, drone: str | None) -> str:
    started = _first(schema.MissionStarted, events)
    name = drone or (started.drone if started else "")
    names = [drone.name for drone in config.drones]
    if name not in names:
        raise UsageError(
            f"{scenario} has several drones: name one with --drone; {unknown('drone', name, names)}"
        )
    return name


def _among_others(scenario: Path, drone: str, policy: str, seed: int | None) -> Simulation:
    fleet = simulate_fleet(scenario, seed=seed, overrides={f"drone.{drone}.policy": policy})
    return fleet.drones[drone]


def explain(events: Iterable[Event], replayed: Replay, wanted: CallChoice) -> Iterator[str]:
    """The explanation of the wanted calls, line by line."""
    if chosen_speed := _first(schema.SpeedChosen, events):
        yield f"the ground speed was chosen: {chosen_speed.why}"
        yield ""
    result = read_result(events)
    chosen = wanted.of(explained_calls(events))
    for text in chosen:
        yield text.heading
        yield from (f"    {reason}" for reason in text.reasons)
        if replayed.runs:
            yield f"    {_elsewhere(text.call.number, result, replayed)}"
        yield ""
    if not chosen:
        yield "no call took longer than was expected of the best place for it"
    took = f"{result.policy} took {lasting(result.mission_time_s)}"
    if not replayed.runs:
        yield f"{took}; give --scenario FILE to see what other policies would have done{_in_its_world(events)}"
        return
    others = ", among drones that fly as the scenario says" if replayed.others else ""
    yield f"{took}; in the same world{others}, simulated:"
    for policy, run in replayed.runs.items():
        ended = "" if run.completed else ", not completed"
        yield f"    {policy}: {lasting(run.mission_time_s)}{ended}"
    if replayed.bound_s is not None:
        yield f"    theoretical minimum: {lasting(replayed.bound_s)}"


def _in_its_world(events: Iterable[Event]) -> str:
    """The scenario that the log names, for a person to look at before its programs run."""
    named = _first(schema.Simulated, events)
    return f" (the log names {printable(named.scenario)}, whose programs run then)" if named else ""


def _elsewhere(number: int, own: RunResult, replayed: Replay) -> str:
    """A text on the other policies' decisions for this call, if their missions made the same calls."""
    others = []
    for policy, run in replayed.runs.items():
        if policy != own.policy:
            same = run.calls[number] if run.made_the_calls_of(own) else None
            others.append(
                f"{policy}: {ran_on(same.server)}, {same.delay_s:.2f} s" if same else f"{policy}: other calls"
            )
    return "; ".join(others)
