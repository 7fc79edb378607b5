"""Why each call of a flight ran where it ran, read from its events, in words."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from upwash.core.servers import Event
from upwash.narration import ran_on
from upwash.results import Beginning, last_run

_TOLD = {Event.SELECTED, Event.CHECK_FAILED, Event.CALL_FAILED_IN_RANGE, Event.CALL_FAILED_OUT_OF_RANGE}
_FELL_BACK = {
    "": "no usable answer came, so the drone did it itself",
    "confirmed": "the server said that it raised, so the drone did it itself, and it raised there too",
    "denied": "the server said that it raised, so the drone did it itself, and nothing was wrong with it",
}
_LEFT = {Event.DESELECTED, Event.DESELECTED_AFTER_START}


@dataclass(frozen=True, slots=True)
class ExplainedCall:
    """One call, the decisions made for it, and what happened to the selection since the call before."""

    waypoint: int | None
    outcome: Mapping[str, Any]
    decisions: Sequence[Mapping[str, Any]]
    changes: Sequence[Mapping[str, Any]]


class Reasons:
    """Gathers, event by event, why each call of a run ran where it ran; times become seconds of the mission."""

    def __init__(self) -> None:
        self._began = Beginning()
        self._waypoint: int | None = None
        self._decisions: list[Mapping[str, Any]] = []
        self._changes: list[Mapping[str, Any]] = []

    def take(self, event: Mapping[str, Any]) -> ExplainedCall | None:
        """Takes in the next event; the call, where it ends one."""
        self._began.take(event)
        now_s = event["t"] - (self._began.at_s or 0.0)
        match event["event"]:
            case "arrived":
                self._waypoint = event["waypoint"]
            case "decided":
                self._decisions.append(event)
            case "call":
                return self._explain({**event, "t": now_s, "at_s": now_s - event["delay_s"]})
            case name if name in _TOLD or name in _LEFT:
                self._changes.append({**event, "t": now_s})
        return None

    def _explain(self, outcome: Mapping[str, Any]) -> ExplainedCall:
        decisions, changes = self._decisions, self._changes
        later = [change for change in changes if change["t"] >= outcome["t"]]
        self._decisions, self._changes = [], later
        return ExplainedCall(self._waypoint, outcome, decisions, changes[: len(changes) - len(later)])


def explained_calls(events: Sequence[Mapping[str, Any]]) -> Iterator[ExplainedCall]:
    """The calls of a log in their order."""
    reasons = Reasons()
    for event in last_run(events):
        if (call := reasons.take(event)) is not None:
            yield call


def told(call: ExplainedCall) -> Iterator[str]:
    """The call and its reasons, a line each."""
    outcome = call.outcome
    where = "" if call.waypoint is None else f"waypoint {call.waypoint}, "
    yield (
        f"{where}{outcome['at_s']:.1f} s: {outcome['operation']} {ran_on(outcome['place'])}, "
        f"{outcome['delay_s']:.2f} s"
    )
    for change in call.changes:
        verb = {Event.SELECTED: "selected"}.get(change["event"], change["event"].replace("_", " "))
        yield f"at {change['t']:.1f} s {change['server']} was {verb}: {change['why']}"
    for decision in call.decisions:
        yield from told_decision(decision)
    if "hedged_s" in outcome:
        yield f"    no answer had come after {outcome['hedged_s']:.2f} s, so the drone began on it too"
    if outcome.get("queued_s"):
        yield f"    the drone was busy with an earlier call for {outcome['queued_s']:.2f} s"
    if outcome["fell_back"]:
        yield _FELL_BACK.get(outcome.get("remote_fault", ""), _FELL_BACK[""])


def told_decision(decision: Mapping[str, Any]) -> Iterator[str]:
    """What was believed when it was made, and what it came to."""
    yield _beliefs(decision)
    yield f"so it was to {_verdict(decision)}: {decision['why']}"


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
        case "remote" if decision.get("raced"):
            return f"run on {decision['server']} too, for at most {decision['deadline_s']:.1f} s, and on the drone"
        case "remote":
            return f"run on {decision['server']}, for at most {decision['deadline_s']:.1f} s"
        case "wait":
            return f"wait for {decision['server']}, for at most {decision['at_most_s']:.1f} s"
        case _:
            return "run on the drone"
