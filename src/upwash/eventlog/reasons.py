"""Why each call of a flight ran at its place, and whether the drone waited for the answer, from the log, as text."""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace

from upwash.core.geo import Position, ground_distance_m
from upwash.core.knowledge.servers import State
from upwash.core.operation import titles
from upwash.eventlog import schema
from upwash.eventlog.causes import SHORTEST_S, Considered, Standings, cause_of, ran, ran_on
from upwash.eventlog.progress import CallPlaces, MissionTime
from upwash.eventlog.schema import Event
from upwash.support.text import clock

_SELECTION_CHANGES = {
    schema.Selected: "was selected",
    schema.CheckFailed: "failed its check",
    schema.CallFailedInRange: "failed the call",
    schema.CallFailedOutOfRange: "failed the call, out of its range",
    schema.Deselected: "was deselected",
    schema.DeselectedAfterStart: "was deselected",
}
_LATER = (
    schema.Selected,
    schema.Deselected,
    schema.DeselectedAfterStart,
)  # after a decision: for the next call
_LEAST_LOSS = 0.05  # of the delay that was expected
_LEAST_LOSS_S = 0.1


@dataclass(frozen=True, slots=True)
class ExplainedCall:
    """The call of that `number`, counted from 0, with its decisions and what the log told of servers, in its order.

    It has the events about servers since the call before, without later selections. The call began at `at_s` of
    the mission, which began at `began_s` of the log. `going` is the decision to wait for the answer or to fly on, if
    the mission asked for that decision.
    """

    number: int
    waypoint: int | None
    at_s: float
    began_s: float
    outcome: schema.Call
    told: Sequence[Considered | Event]
    going: schema.StayOrGo | None = None
    photographed_at: Position | None = None  # by a drone that flew on

    @property
    def decisions(self) -> Sequence[Considered]:
        """Its decisions, in their order."""
        return [each for each in self.told if isinstance(each, Considered)]

    @property
    def position(self) -> Position | None:
        """The position of the drone at the begin of the call, or of its photo; None if neither is known."""
        if self.photographed_at is not None:
            return self.photographed_at
        return next((decision.decided.position for decision in self.decisions), None)

    @property
    def sentence(self) -> str:
        """Where it ran, and why."""
        return ran(self.outcome, self.decisions, self._events)

    @property
    def cause(self) -> str:
        """Why it ran on the drone; empty if there is nothing to say, and for a call at a server."""
        return cause_of(self.outcome, self.decisions, self._events)

    @property
    def _events(self) -> Sequence[Event]:
        """What the log told of servers from its first decision on."""
        since = itertools.dropwhile(lambda each: isinstance(each, Event), self.told)
        return [each for each in since if isinstance(each, Event)]

    @property
    def is_final(self) -> bool:
        """Whether nothing that comes later is part of the sentence, such as the end of a blacklisting."""
        return all(stay.until_s is not None for each in self.decisions for stay in each.left_alone)

    @property
    def loss_s(self) -> float:
        """By how much it took longer than was expected of the best place when it began.

        0 where that is unknown, or no more than estimates are wrong by. Of several open calls the time in line does
        not count, as the drone flies on meanwhile.
        """
        expected_s = self.decisions[0].expected_s.values() if self.decisions else ()
        best_s = min(expected_s, default=self.outcome.delay_s)
        in_line_s = (self.outcome.queued_s or 0.0) if self.outcome.waypoint is not None else 0.0
        lost_s = self.outcome.delay_s - in_line_s - best_s
        return lost_s if lost_s > max(_LEAST_LOSS_S, _LEAST_LOSS * best_s) else 0.0


@dataclass(frozen=True, slots=True)
class ExplainedAnswer:
    """The result of flying on before the answer of call `number` of the run, counted from 0.

    The mission took the answer at `at_s`, and flew or did other work during `hidden_s` of the call. `back_m` is the
    distance that the drone flew back for the answer; None if it did not turn back.
    """

    number: int
    taken: schema.AnswerTaken
    at_s: float
    hidden_s: float
    back_m: float | None


class Reasons:
    """Gathers the reasons of each call of a run, event by event; `began` and `whereabouts` follow the mission."""

    def __init__(self) -> None:
        self.began = MissionTime()
        self.whereabouts = CallPlaces()
        self._standings = Standings()
        self._told: list[Considered | Event] = []  # since the last call was over
        self._delays_s: list[float] = []
        self._several: set[int] = set()  # the numbers of calls that were open beside others
        self._going: dict[int | None, schema.StayOrGo] = {}  # by waypoint, until the mission takes the answer
        self._turned: dict[int | None, Position] = {}
        self._places: dict[int, Position] = {}  # of the waypoints that were reached
        self._back_m: dict[int | None, float] = {}

    @property
    def ended(self) -> int:
        """The number of calls that are over."""
        return len(self._delays_s)

    @property
    def under_way(self) -> Sequence[Considered]:
        """The decisions of the call that is not over."""
        return [each for each in self._told if isinstance(each, Considered)]

    def take(self, event: Event) -> ExplainedCall | ExplainedAnswer | None:
        """Take the next event; return the call that it ends, or the result of flying on before an answer."""
        self.began.take(event)
        self.whereabouts.take(event)
        self._standings.take(event)
        match event:
            case schema.Decided():
                self._told.append(self._standings.considered(event, self.began.at_s or 0.0))
            case schema.Call():
                return self._explain(event)
            case schema.ServerStep() | schema.RemoteFailed() | schema.RemoteRaised():
                self._told.append(event)
            case schema.Arrived(waypoint=int(waypoint), east_m=east_m, north_m=north_m):
                self._arrived(waypoint, Position(east_m, north_m))
            case schema.StayOrGo(waypoint=waypoint):
                self._going[waypoint] = event
            case schema.TurnedBack(waypoint=waypoint, position=position, object=None):
                self._turned[waypoint] = position
            case schema.AnswerTaken():
                return self._explain_answer(event)
        return None

    def _arrived(self, waypoint: int, there: Position) -> None:
        self._places[waypoint] = there
        if waypoint in self._turned:
            self._back_m[waypoint] = ground_distance_m(self._turned.pop(waypoint), there)

    def _explain_answer(self, taken: schema.AnswerTaken) -> ExplainedAnswer | None:
        """None if the drone stayed for the answer, or the call failed."""
        going, back_m = self._going.pop(taken.waypoint, None), self._back_m.pop(taken.waypoint, None)
        number = self.whereabouts.answered
        went_on = number in self._several if going is None else going.goes
        if number is None or not went_on:
            return None
        hidden_s = max(0.0, self._delays_s[number] - taken.waited_s)
        return ExplainedAnswer(number, taken, taken.t - (self.began.at_s or 0.0), hidden_s, back_m)

    def _explain(self, outcome: schema.Call) -> ExplainedCall:
        if outcome.waypoint is None:
            its, later = _parted(self._told)
        else:
            its, later = _own(self._told, outcome.waypoint)
        self._told = later
        waypoint, began_s = self.whereabouts.of_call, self.began.at_s or 0.0
        if outcome.waypoint is not None:
            self._several.add(len(self._delays_s))
        self._delays_s.append(outcome.delay_s)
        return ExplainedCall(
            len(self._delays_s) - 1,
            waypoint,
            outcome.t - outcome.delay_s - began_s,
            began_s,
            outcome,
            its,
            self._going.get(waypoint),
            None if outcome.waypoint is None else self._places.get(outcome.waypoint),
        )


def _parted(told: Sequence[Considered | Event]) -> tuple[list[Considered | Event], list[Considered | Event]]:
    """What belongs to the call that is over, and what came after its last decision and concerns the next."""
    last = max((number for number, each in enumerate(told) if isinstance(each, Considered)), default=None)
    if last is None:
        return list(told), []
    asked = {each.decided.server for each in told if isinstance(each, Considered)}
    its, later = list(told[: last + 1]), list[Considered | Event]()
    for event in told[last + 1 :]:
        is_its = getattr(event, "server", None) in asked and not isinstance(event, _LATER)
        (its if is_its else later).append(event)
    return its, later


def _own(
    told: Sequence[Considered | Event], waypoint: int
) -> tuple[list[Considered | Event], list[Considered | Event]]:
    """The decisions of one of several open calls, and those of the others."""
    its, others = list[Considered | Event](), list[Considered | Event]()
    for each in told:
        if isinstance(each, Considered):
            (its if each.decided.waypoint == waypoint else others).append(each)
    return its, others


def explained_calls(events: Iterable[Event]) -> list[CallText]:
    """The calls of the last run in a log, as text."""
    reasons, calls = Reasons(), list[CallText]()
    for event in events:
        if isinstance(event, schema.LogOpened):
            reasons, calls = Reasons(), []
        match reasons.take(event):
            case ExplainedCall() as call:
                calls.append(CallText(call))
            case ExplainedAnswer(number=number) as answer:
                calls[number].answers.append(answer)
    named = titles({text.call.outcome.operation for text in calls})
    return [replace(text, title=named[text.call.outcome.operation]) for text in calls]


@dataclass(frozen=True, slots=True)
class CallText:
    """A call as text, with the title of its operation, and with what became of its answer."""

    call: ExplainedCall
    title: str = ""
    answers: list[ExplainedAnswer] = field(default_factory=list)

    @property
    def heading(self) -> str:
        """The call in short."""
        outcome = self.call.outcome
        where = "" if self.call.waypoint is None else f"waypoint {self.call.waypoint}, "
        place = ran_on(outcome.server)
        return f"{where}{clock(self.call.at_s)}: {self.title} {place}, {outcome.delay_s:.2f} s"

    @property
    def reasons(self) -> list[str]:
        """The sentence that says why it ran at its place, and the particulars, a line each."""
        return [*call_lines(self.call), *map(answer_text, self.answers)]


def worst_of(calls: Iterable[CallText], most: int) -> list[CallText]:
    """The calls that lost most against the best place for them, the worst first, without those that lost nothing."""
    lost = (text for text in calls if text.call.loss_s > 0)
    return heapq.nsmallest(most, lost, key=lambda text: (-text.call.loss_s, text.call.number))


def call_lines(call: ExplainedCall) -> Iterator[str]:
    """Why the call ran at its place: a sentence, and then the particulars, a line each."""
    outcome = call.outcome
    yield f"{call.sentence}."
    for each in call.told:
        match each:
            case Considered(decided=decided):
                yield from decision_lines(decided)
            case schema.ServerStep(server=server, why=why) if type(each) in _SELECTION_CHANGES:
                yield f"at {clock(each.t - call.began_s)} {server} {_SELECTION_CHANGES[type(each)]}: {why}"
    if outcome.asked and outcome.forecast_s is not None and outcome.finish_by_s is not None:
        yield (
            f"{outcome.asked} was asked for: so the mission would have ended at {clock(outcome.forecast_s)}, "
            f"{outcome.forecast_s - outcome.finish_by_s:.1f} s later than it was to"
        )
    if outcome.first_s is not None:
        better = f"no better one came in {outcome.delay_s:.2f} s"
        if not outcome.asked:
            better = f"the better one of {outcome.place} was there after {outcome.delay_s:.2f} s"
        yield f"the drone's first answer was there after {outcome.first_s:.2f} s; {better}"
    if outcome.second_s is not None:
        yield f"    no answer had come after {outcome.second_s:.2f} s, so a second server got it too"
    if outcome.hedged_s is not None:
        yield f"    no answer had come after {outcome.hedged_s:.2f} s, so the drone began on it too"
    if outcome.waypoint is None and outcome.queued_s and outcome.queued_s >= SHORTEST_S:
        yield f"    the drone was busy with an earlier call for {outcome.queued_s:.2f} s"
    if call.going is not None:
        yield _going_text(call.going)


def answer_text(answer: ExplainedAnswer) -> str:
    """The result of flying on before an answer."""
    taken = answer.taken
    waited = f" after a wait of {taken.waited_s:.2f} s" if taken.waited_s else ""
    if answer.back_m is None:
        demanded = "something" if taken.demanded else "nothing"
        return f"the answer was taken at {clock(answer.at_s)}{waited}, and demanded {demanded}"
    return f"the answer demanded something{waited}: the drone turned back, and flew {answer.back_m:.1f} m"


def _going_text(going: schema.StayOrGo) -> str:
    did = "went on before the answer" if going.goes else "stayed for the answer"
    if going.saved_s is None or going.lost_s is None:
        return f"the drone {did}: {going.why}"
    return (
        f"the drone {did}: {going.why}; to go saves {going.saved_s:.2f} s where the answer demands nothing, and "
        f"costs {going.lost_s:.2f} s where it does, by earlier answers with a chance of {100 * going.chance:.0f} %"
    )


def decision_lines(decision: schema.Decided) -> Iterator[str]:
    """The estimates behind a decision, and the decision."""
    yield _beliefs(decision)
    why = (
        "" if decision.selected is None else f" ({decision.why})"
    )  # the sentence says why there was no server
    yield f"decided: {_verdict(decision)}{why}"


def _beliefs(decision: schema.Decided) -> str:
    local_s, remote_s = decision.local_s, decision.remote_s
    drone = f"expected: {_seconds(local_s)} on the drone"
    if local_s is None and decision.decision == "remote":
        drone = "expected: no answer on the drone, which cannot run it"
    if decision.selected is None:
        return drone
    state = "ready"
    if decision.state != State.READY and decision.check_s is not None:
        state = f"joining for {decision.check_elapsed_s or 0.0:.1f} of {decision.check_s:.1f} s"
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
