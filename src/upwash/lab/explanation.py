"""Why each call of a flight ran where it ran, and where other policies would have run it in the same world."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from upwash import event_log
from upwash.core.policies import POLICIES
from upwash.errors import UsageError
from upwash.lab.bounds import bound_of
from upwash.lab.run import Run, simulate
from upwash.lab.simulation import read_scenario
from upwash.narration import ran_on
from upwash.reasons import explained_calls, told
from upwash.results import CallResult, read_result
from upwash.text import escaped_lines


@dataclass(frozen=True, slots=True)
class Replay:
    """The same mission in the same world, by policy."""

    runs: Mapping[str, Run] = field(default_factory=dict)
    bound_s: float | None = None


def show_explanation(log: Path, *, scenario: Path | None = None) -> None:
    """Prints why each call of the log ran where it ran, and what other policies would have done.

    These are flown in the scenario that is given, or else in the one that the log names, if it does.
    """
    from rich.console import Console

    events = read_log(log)
    console = Console(markup=False, highlight=False)
    for line in explain(events, replay(events, scenario)):
        console.print(escaped_lines(line), soft_wrap=True)


def read_log(log: Path) -> list[dict[str, Any]]:
    """The events of a log with calls; raises UsageError for any other file."""
    events = event_log.read(log)
    if not any(event["event"] == "call" for event in events):
        raise UsageError(f"{log} has no service call to explain")
    return events


def replay(events: Sequence[Mapping[str, Any]], scenario: Path | None) -> Replay:
    """Flies every policy in the world of the log: that of the scenario, or of the one that the log names, if any."""
    named = next((event for event in events if event["event"] == "simulated"), None)
    seed = named["seed"] if named else None
    if scenario is None and named is not None:
        scenario = Path(named["scenario"])
    if scenario is None:
        return Replay()
    configs = {policy: read_scenario(scenario, policy=policy, seed=seed) for policy in POLICIES}
    runs = {policy: simulate(config) for policy, config in configs.items()}
    first = POLICIES[0]
    bound = bound_of(runs[first], configs[first])
    return Replay(runs, bound.free_s if bound else None)


def explain(events: Sequence[Mapping[str, Any]], replayed: Replay) -> Iterator[str]:
    """The explanation, line by line."""
    result = read_result(events)
    for number, call in enumerate(explained_calls(events)):
        heading, *reasons = told(call)
        yield heading
        yield from (f"    {reason}" for reason in reasons)
        if replayed.runs:
            yield f"    {_elsewhere(number, len(result.calls), replayed, result.policy)}"
        yield ""
    took = f"{result.policy} took {result.mission_time_s:.1f} s"
    if not replayed.runs:
        yield f"{took}; give --scenario FILE to see what other policies would have done"
        return
    yield f"{took}; in the same world, simulated:"
    for policy, run in replayed.runs.items():
        ended = "" if run.result.completed else ", not completed"
        yield f"    {policy}: {run.result.mission_time_s:.1f} s{ended}"
    if replayed.bound_s is not None:
        yield f"    an all-knowing drone: at least {replayed.bound_s:.1f} s"


def _elsewhere(number: int, count: int, replayed: Replay, own: str) -> str:
    """What the other policies did with the same call; a mission that made other calls has no same one."""
    others = []
    for policy, run in replayed.runs.items():
        if policy != own:
            calls = run.result.calls
            same: CallResult | None = calls[number] if len(calls) == count else None
            others.append(
                f"{policy}: {ran_on(same.place)}, {same.delay_s:.2f} s" if same else f"{policy}: other calls"
            )
    return "; ".join(others)
