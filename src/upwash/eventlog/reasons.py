"""Why each call of a flight ran where it ran, read from its events, in words."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import msgspec

from upwash.core.servers import State
from upwash.eventlog import schema
from upwash.eventlog.narration import ran_on
from upwash.eventlog.results import Beginning, last_run
from upwash.eventlog.schema import Event
from upwash.eventlog.whereabouts import Whereabouts

_TOLD = (
    schema.Selected,
    schema.CheckFailed,
    schema.CallFailedInRange,
    schema.CallFailedOutOfRange,
    schema.Deselected,
    schema.DeselectedAfterStart,
)
_FELL_BACK = {
    "": "no usable answer came, so the drone did it itself",
    "confirmed": "the server said that it raised, so the drone did it itself, and it raised there too",
    "denied": "the server said that it raised, so the drone did it itself, and nothing was wrong with it",
}


@dataclass(frozen=True, slots=True)
class ExplainedCall:
    """One call, the decisions made for it, and what happened to the selection since the call before.

    All times are seconds of the mission; the call began at `at_s`.
    """

    waypoint: int | None
    at_s: float
    outcome: schema.Call
    decisions: Sequence[schema.Decided]
    changes: Sequence[schema.Step]


class Reasons:
    """Gathers, event by event, why each call of a run ran where it ran; times become seconds of the mission."""

    def __init__(self) -> None:
        self._began = Beginning()
        self._whereabouts = Whereabouts()
        self._decisions: list[schema.Decided] = []
        self._changes: list[schema.Step] = []

    def take(self, event: Event) -> ExplainedCall | None:
        """Takes in the next event; the call, where it ends one."""
        self._began.take(event)
        self._whereabouts.take(event)
        now_s = event.t - (self._began.at_s or 0.0)
        match event:
            case schema.Decided():
                self._decisions.append(event)
            case schema.Call():
                return self._explain(msgspec.structs.replace(event, t=now_s))
            case schema.Step() if isinstance(event, _TOLD):
                self._changes.append(msgspec.structs.replace(event, t=now_s))
        return None

    def _explain(self, outcome: schema.Call) -> ExplainedCall:
        decisions, changes = self._decisions, self._changes
        later = [change for change in changes if change.t >= outcome.t]
        self._decisions, self._changes = [], later
        began_s = outcome.t - outcome.delay_s
        return ExplainedCall(
            self._whereabouts.of_call, began_s, outcome, decisions, changes[: len(changes) - len(later)]
        )


def explained_calls(events: Sequence[Event]) -> Iterator[ExplainedCall]:
    """The calls of a log in their order."""
    reasons = Reasons()
    for event in last_run(events):
        if (call := reasons.take(event)) is not None:
            yield call


def told(call: ExplainedCall) -> Iterator[str]:
    """The call and its reasons, a line each."""
    outcome = call.outcome
    where = "" if call.waypoint is None else f"waypoint {call.waypoint}, "
    yield f"{where}{call.at_s:.1f} s: {outcome.operation} {ran_on(outcome.server)}, {outcome.delay_s:.2f} s"
    for change in call.changes:
        yield f"at {change.t:.1f} s {change.server} was {change.kind.replace('_', ' ')}: {change.why}"
    for decision in call.decisions:
        yield from told_decision(decision)
    if outcome.asked and outcome.forecast_s is not None and outcome.finish_by_s is not None:
        yield (
            f"{outcome.asked} was asked for: so the mission would have ended at {outcome.forecast_s:.0f} s, "
            f"{outcome.forecast_s - outcome.finish_by_s:.1f} s later than it was to"
        )
    if outcome.hedged_s is not None:
        yield f"    no answer had come after {outcome.hedged_s:.2f} s, so the drone began on it too"
    if outcome.queued_s:
        yield f"    the drone was busy with an earlier call for {outcome.queued_s:.2f} s"
    if outcome.fell_back:
        yield _FELL_BACK[outcome.remote_fault]


def told_decision(decision: schema.Decided) -> Iterator[str]:
    """What was believed when it was made, and what it came to."""
    yield _beliefs(decision)
    yield f"so it was to {_verdict(decision)}: {decision.why}"


def _beliefs(decision: schema.Decided) -> str:
    local_s, remote_s = decision.local_s, decision.remote_s
    drone = (
        "nothing is known of a call on the drone" if local_s is None else f"the drone needs {local_s:.2f} s"
    )
    if decision.selected is None:
        return f"{drone}, it was believed, and no server was selected"
    there = "an unknown time" if remote_s is None else f"{remote_s:.2f} s"
    checked = ""
    if decision.state != State.READY and decision.check_s is not None:
        over_s = decision.check_elapsed_s or 0.0
        checked = f", its check having taken {over_s:.1f} of {decision.check_s:.1f} s"
    return f"{drone}, it was believed, and {decision.selected}, in state {decision.state}, {there}{checked}"


def _verdict(decision: schema.Decided) -> str:
    match decision:
        case schema.Decided(decision="remote", raced=True, server=server, deadline_s=float(deadline_s)):
            return f"run on {server} too, for at most {deadline_s:.1f} s, and on the drone"
        case schema.Decided(decision="remote", server=server, deadline_s=float(deadline_s)):
            return f"run on {server}, for at most {deadline_s:.1f} s"
        case schema.Decided(decision="wait", server=server, at_most_s=float(at_most_s)):
            return f"wait for {server}, for at most {at_most_s:.1f} s"
    return "run on the drone"
