"""Why each call of a flight ran at its place, and whether the drone waited for the answer, from the log, as text."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import msgspec

from upwash.core.geo import Position, ground_distance_m
from upwash.core.knowledge.servers import State
from upwash.eventlog import schema
from upwash.eventlog.narration import ran_on
from upwash.eventlog.progress import CallPlaces, MissionTime
from upwash.eventlog.schema import Event

_SELECTION_CHANGES = (
    schema.Selected,
    schema.CheckFailed,
    schema.CallFailedInRange,
    schema.CallFailedOutOfRange,
    schema.Deselected,
    schema.DeselectedAfterStart,
)
_SHORTEST_S = 0.005  # less is printed as 0.00 s
_FELL_BACK = {
    "": "no usable answer came, so the drone did it itself",
    "confirmed": "the server said that it raised, so the drone did it itself, and it raised there too",
    "denied": "the server said that it raised, so the drone did it itself, and nothing was wrong with it",
}


@dataclass(frozen=True, slots=True)
class ExplainedCall:
    """One call, its decisions, and the changes of the selection since the call before.

    Times are seconds of the mission; the call began at `at_s`. `going` is the decision to wait for the answer or to
    fly on, if the mission asked for that decision.
    """

    waypoint: int | None
    at_s: float
    outcome: schema.Call
    decisions: Sequence[schema.Decided]
    changes: Sequence[schema.ServerStep]
    going: schema.StayOrGo | None = None

    @property
    def position(self) -> Position | None:
        """The position of the drone at the begin of the call; None without a decision."""
        return self.decisions[0].position if self.decisions else None


@dataclass(frozen=True, slots=True)
class ExplainedAnswer:
    """The result of flying on before the answer of call `number` of the run, counted from 0.

    The mission flew or did other work during `hidden_s` of the call. `back_m` is the distance that the drone flew
    back for the answer; None if it did not turn back.
    """

    number: int
    taken: schema.AnswerTaken
    hidden_s: float
    back_m: float | None


class Reasons:
    """Gathers the reasons of each call of a run, event by event; times become seconds of the mission."""

    def __init__(self) -> None:
        self._began = MissionTime()
        self._whereabouts = CallPlaces()
        self._decisions: list[schema.Decided] = []
        self._changes: list[schema.ServerStep] = []
        self._delays_s: list[float] = []
        self._going: dict[int | None, schema.StayOrGo] = {}  # by waypoint, until the mission takes the answer
        self._turned: dict[int | None, Position] = {}
        self._back_m: dict[int | None, float] = {}

    def take(self, event: Event) -> ExplainedCall | ExplainedAnswer | None:
        """Take the next event; return the call that it ends, or the result of flying on before an answer."""
        self._began.take(event)
        self._whereabouts.take(event)
        now_s = event.t - (self._began.at_s or 0.0)
        match event:
            case schema.Decided():
                self._decisions.append(event)
            case schema.Call():
                return self._explain(msgspec.structs.replace(event, t=now_s))
            case schema.ServerStep() if isinstance(event, _SELECTION_CHANGES):
                self._changes.append(msgspec.structs.replace(event, t=now_s))
            case schema.StayOrGo(waypoint=waypoint):
                self._going[waypoint] = event
            case schema.TurnedBack(waypoint=waypoint, position=position):
                self._turned[waypoint] = position
            case schema.Arrived(waypoint=waypoint) if waypoint in self._turned:
                there = Position(event.east_m, event.north_m)
                self._back_m[waypoint] = ground_distance_m(self._turned.pop(waypoint), there)
            case schema.AnswerTaken():
                return self._explain_answer(msgspec.structs.replace(event, t=now_s))
        return None

    def _explain_answer(self, taken: schema.AnswerTaken) -> ExplainedAnswer | None:
        """None if the drone stayed or the call failed."""
        going, back_m = self._going.pop(taken.waypoint, None), self._back_m.pop(taken.waypoint, None)
        number = self._whereabouts.answered
        if number is None or going is None or not going.goes:
            return None
        return ExplainedAnswer(number, taken, max(0.0, self._delays_s[number] - taken.waited_s), back_m)

    def _explain(self, outcome: schema.Call) -> ExplainedCall:
        decisions, changes = self._decisions, self._changes
        later = [change for change in changes if change.t >= outcome.t]
        self._decisions, self._changes = [], later
        began_s = outcome.t - outcome.delay_s
        waypoint = self._whereabouts.of_call
        self._delays_s.append(outcome.delay_s)
        return ExplainedCall(
            waypoint,
            began_s,
            outcome,
            decisions,
            changes[: len(changes) - len(later)],
            self._going.get(waypoint),
        )


def explained_calls(events: Iterable[Event]) -> list[list[str]]:
    """The calls of the last run in a log: for each a heading and its reasons, a line each."""
    reasons, calls = Reasons(), CallTexts()
    for event in events:
        if isinstance(event, schema.LogOpened):
            reasons, calls = Reasons(), CallTexts()
        calls.take(reasons.take(event))
    return calls.lines


class CallTexts:
    """The calls of a run as text, a list of lines for each call."""

    def __init__(self) -> None:
        self.lines: list[list[str]] = []

    def take(self, explained: ExplainedCall | ExplainedAnswer | None) -> None:
        """Add the explanation of an event, if it has one."""
        match explained:
            case ExplainedCall():
                self.lines.append(list(call_lines(explained)))
            case ExplainedAnswer(number=number):
                self.lines[number].append(answer_text(explained))


def call_lines(call: ExplainedCall) -> Iterator[str]:
    """A call and its reasons, a line each."""
    outcome = call.outcome
    where = "" if call.waypoint is None else f"waypoint {call.waypoint}, "
    yield f"{where}{call.at_s:.1f} s: {outcome.operation} {ran_on(outcome.server)}, {outcome.delay_s:.2f} s"
    for change in call.changes:
        yield f"at {change.t:.1f} s {change.server} was {change.kind.replace('_', ' ')}: {change.why}"
    for decision in call.decisions:
        yield from decision_lines(decision)
    if outcome.asked and outcome.forecast_s is not None and outcome.finish_by_s is not None:
        yield (
            f"{outcome.asked} was asked for: so the mission would have ended at {outcome.forecast_s:.0f} s, "
            f"{outcome.forecast_s - outcome.finish_by_s:.1f} s later than it was to"
        )
    if outcome.hedged_s is not None:
        yield f"    no answer had come after {outcome.hedged_s:.2f} s, so the drone began on it too"
    if outcome.queued_s and outcome.queued_s >= _SHORTEST_S:
        yield f"    the drone was busy with an earlier call for {outcome.queued_s:.2f} s"
    if outcome.fell_back:
        yield _FELL_BACK[outcome.remote_fault]
    if call.going is not None:
        yield _going_text(call.going)


def answer_text(answer: ExplainedAnswer) -> str:
    """The result of flying on before an answer."""
    taken = answer.taken
    waited = f" after a wait of {taken.waited_s:.2f} s" if taken.waited_s else ""
    if answer.back_m is None:
        return f"the answer was taken at {taken.t:.1f} s{waited}, and demanded nothing"
    return f"the answer demanded something{waited}: the drone turned back, and flew {answer.back_m:.1f} m"


def _going_text(going: schema.StayOrGo) -> str:
    did = "went on before the answer" if going.goes else "stayed for the answer"
    if going.saved_s is None or going.lost_s is None:
        return f"the drone {did}: {going.why}"
    return (
        f"the drone {did}: {going.why}; to go saves {going.saved_s:.2f} s where the answer demands nothing, and "
        f"costs {going.lost_s:.2f} s where it does, by the last ones with a chance of {100 * going.chance:.0f} %"
    )


def decision_lines(decision: schema.Decided) -> Iterator[str]:
    """The estimates behind a decision, and the decision."""
    yield _beliefs(decision)
    yield f"decided: {_verdict(decision)} ({decision.why})"


def _beliefs(decision: schema.Decided) -> str:
    local_s, remote_s = decision.local_s, decision.remote_s
    drone = f"expected: {_seconds(local_s)} on the drone"
    if decision.selected is None:
        return f"{drone}; no server was selected"
    state = str(decision.state)
    if decision.state != State.READY and decision.check_s is not None:
        state += f" for {decision.check_elapsed_s or 0.0:.1f} of {decision.check_s:.1f} s"
    return f"{drone}, {_seconds(remote_s)} on {decision.selected} ({state})"


def _seconds(expected_s: float | None) -> str:
    return "an unknown time" if expected_s is None else f"{expected_s:.2f} s"


def _verdict(decision: schema.Decided) -> str:
    match decision:
        case schema.Decided(decision="remote", raced=True, server=server, deadline_s=float(deadline_s)):
            return f"run on the drone, and on {server} for at most {deadline_s:.1f} s"
        case schema.Decided(decision="remote", server=server, deadline_s=float(deadline_s)):
            return f"run on {server} for at most {deadline_s:.1f} s"
        case schema.Decided(decision="wait", server=server, at_most_s=float(at_most_s)):
            return f"wait for {server} for at most {at_most_s:.1f} s"
    return "run on the drone"
