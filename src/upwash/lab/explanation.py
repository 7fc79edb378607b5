"""Why each call of a flight ran where it ran, and where other policies would have run it in the same world."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec

from upwash.core.policies import POLICIES
from upwash.core.servers import Event
from upwash.errors import UsageError
from upwash.lab.bounds import bound_of
from upwash.lab.run import Run, simulate
from upwash.lab.simulation import read_scenario
from upwash.results import CallResult, last_run, read_result

_TOLD = {Event.SELECTED, Event.CHECK_FAILED, Event.CALL_FAILED_IN_RANGE, Event.CALL_FAILED_OUT_OF_RANGE}
_LEFT = {Event.DESELECTED, Event.DESELECTED_AFTER_START}


@dataclass(frozen=True, slots=True)
class ExplainedCall:
    """One call, the decisions made for it, and what happened to the selection since the call before."""

    waypoint: int | None
    outcome: Mapping[str, Any]
    decisions: Sequence[Mapping[str, Any]]
    changes: Sequence[Mapping[str, Any]]


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
        console.print(line, soft_wrap=True)


def read_log(log: Path) -> list[dict[str, Any]]:
    """The events of a log; raises UsageError for a file that is none."""
    try:
        lines = log.read_bytes().splitlines()
    except OSError as error:
        raise UsageError(f"{log} cannot be read: {error.strerror}") from error
    try:
        events = [msgspec.json.decode(line, type=dict[str, Any]) for line in lines]
    except msgspec.MsgspecError as error:
        raise UsageError(f"{log} is no event log: {error}") from error
    if not all("event" in event and "t" in event for event in events):
        raise UsageError(f"{log} is no event log: each line of one has an event and its time")
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
        yield from _call_lines(call)
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


def explained_calls(events: Sequence[Mapping[str, Any]]) -> Iterator[ExplainedCall]:
    """The calls of a log in their order."""
    waypoint: int | None = None
    decisions: list[Mapping[str, Any]] = []
    changes: list[Mapping[str, Any]] = []
    for event in last_run(events):
        match event["event"]:
            case "arrived":
                waypoint = event["waypoint"]
            case "decided":
                decisions.append(event)
            case "call":
                later = [change for change in changes if change["t"] >= event["t"]]
                yield ExplainedCall(waypoint, event, decisions, changes[: len(changes) - len(later)])
                decisions, changes = [], later
            case name if name in _TOLD or name in _LEFT:
                changes.append(event)


def _call_lines(call: ExplainedCall) -> Iterator[str]:
    outcome = call.outcome
    where = "" if call.waypoint is None else f"waypoint {call.waypoint}, "
    yield (
        f"{where}{outcome['at_s']:.1f} s: {outcome['operation']} {_place(outcome['place'])}, "
        f"{outcome['delay_s']:.2f} s"
    )
    for change in call.changes:
        verb = {Event.SELECTED: "selected"}.get(change["event"], change["event"].replace("_", " "))
        yield f"    at {change['t']:.1f} s {change['server']} was {verb}: {change['why']}"
    for decision in call.decisions:
        yield f"    {_beliefs(decision)}"
        yield f"    so it was to {_verdict(decision)}: {decision['why']}"
    if outcome["fell_back"]:
        yield "    no usable answer came, so the drone did it itself"


def _beliefs(decision: Mapping[str, Any]) -> str:
    local_s, remote_s, server = decision["local_s"], decision["remote_s"], decision["selected"]
    drone = (
        "nothing is known of a call on the drone" if local_s is None else f"the drone needs {local_s:.2f} s"
    )
    if server is None:
        return f"{drone}, it was believed, and no server was selected"
    there = "an unknown time" if remote_s is None else f"{remote_s:.2f} s"
    state = decision["state"]
    checked = (
        ""
        if state == "READY"
        else f", its check having taken {decision['check_elapsed_s']:.1f} of {decision['check_s']:.1f} s"
    )
    return f"{drone}, it was believed, and {server}, in state {state}, {there}{checked}"


def _verdict(decision: Mapping[str, Any]) -> str:
    match decision["decision"]:
        case "remote":
            return f"run on {decision['server']}, for at most {decision['deadline_s']:.1f} s"
        case "wait":
            return f"wait for {decision['server']}, for at most {decision['at_most_s']:.1f} s"
        case _:
            return "run on the drone"


def _elsewhere(number: int, count: int, replayed: Replay, own: str) -> str:
    """What the other policies did with the same call; a mission that made other calls has no same one."""
    told = []
    for policy, run in replayed.runs.items():
        if policy != own:
            calls = run.result.calls
            same: CallResult | None = calls[number] if len(calls) == count else None
            told.append(
                f"{policy}: {_place(same.place)}, {same.delay_s:.2f} s" if same else f"{policy}: other calls"
            )
    return "; ".join(told)


def _place(place: str) -> str:
    return "on the drone" if place == "local" else f"on {place}"
