"""One run as reports tell it, read from its event log."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path

from upwash.core.geo import Position
from upwash.core.knowledge.servers import State
from upwash.errors import UsageError
from upwash.eventlog import schema
from upwash.eventlog.ending import Ending, EndingSoFar
from upwash.eventlog.log import EventLog
from upwash.eventlog.progress import MissionTime
from upwash.eventlog.reasons import CallText, ExplainedAnswer, ExplainedCall, Reasons, worst_of
from upwash.eventlog.results import CallResult, RunResult, Tally
from upwash.eventlog.schema import Event
from upwash.report.findings import Finder, Finding
from upwash.report.numbering import FlightFindings, PlacedFinding
from upwash.report.outcome import UNPLANNED, Outcome
from upwash.report.reviewed import ReviewedFindings, reviewed
from upwash.report.reviews import NO_REVIEWS, Reviews, read_reviews
from upwash.support.progress import work
from upwash.support.text import by_name

_WORST = 5


@dataclass(frozen=True, slots=True)
class ReportedCall:
    """One call, where the drone was then, whether it waited, and whether it fell back to the drone."""

    result: CallResult
    position: Position | None
    wait: str
    fell_back: bool

    @property
    def place(self) -> str:
        """What people call the place where it ran: the server's name, or the drone."""
        return self.result.server or "drone"


@dataclass(frozen=True, slots=True)
class WorstCall:
    """One of the calls that lost most against the best place for them, and why it ran where it ran, in sentences."""

    call: ReportedCall
    loss_s: float
    reasons: Sequence[str]


@dataclass(frozen=True, slots=True)
class Stretch:
    """A time that a server spent in one state, in seconds of the mission, and why it came into it."""

    state: State
    from_s: float
    to_s: float
    why: str


@dataclass(frozen=True, slots=True)
class Fix:
    """Where the drone was at a second of the mission; not a number above the sea where home's altitude is unknown."""

    at_s: float
    position: Position
    above_sea_m: float


class MissionEvents:
    """The events of a log's last run until the mission was completed, read anew by whoever wants them.

    A long flight's log is larger than what a page about it holds, so that none of them is kept.
    """

    def __init__(self, events: Iterable[Event]) -> None:
        self._events = events
        self._first = self._end = 0
        self.opening: Event | None = None  # the first of them
        self.planned = UNPLANNED
        self.drone = ""
        self.began_s: float | None = None
        self._look_through()

    def _look_through(self) -> None:
        began, completed = MissionTime(), False
        for number, event in enumerate(self._events):
            if isinstance(event, schema.LogOpened) or number == 0:
                began, completed = MissionTime(), False
                self._first, self.opening, self.planned = number, event, UNPLANNED
            if completed:
                continue
            began.take(event)
            if isinstance(event, schema.Planned) and self.planned is UNPLANNED:
                self.planned = event
            elif isinstance(event, schema.MissionStarted):
                self.drone = event.drone
            self._end = number + 1
            completed = isinstance(event, schema.MissionCompleted)
        self.began_s = began.at_s

    def __iter__(self) -> Iterator[Event]:
        return itertools.islice(self._events, self._first, self._end)


@dataclass(frozen=True, slots=True)
class Record:
    """One run; `servers` are those of the plan and of the calls, in the order of their names.

    `opened` is the time of day at second 0 of the event log, None for a simulated one; `began_s` is the mission's
    start in seconds of the log. `simulated` is the simulation's own first line, None for a flight. `worst` are the
    calls that lost most, the worst first.
    """

    name: str
    opened: datetime | None
    simulated: schema.Simulated | None
    drone: str
    began_s: float
    events: Iterable[Event]
    result: RunResult
    plan: schema.Planned
    calls: Sequence[ReportedCall]
    worst: Sequence[WorstCall]
    stretches: Mapping[str, Sequence[Stretch]]
    ending: Ending
    findings: Sequence[Finding] = ()
    reviews: Reviews = NO_REVIEWS

    @property
    def turns(self) -> Iterator[tuple[int | None, Position]]:
        """The waypoints that the drone turned back to, and where it did."""
        return ((each.waypoint, each.position) for each in self.events if isinstance(each, schema.TurnedBack))

    @property
    def track(self) -> Iterator[Fix]:
        """Every place that an event tells: simulated drones report none by the second."""
        track = _Track(self.began_s)
        return (fix for event in self.events if (fix := track.take(event)) is not None)

    @property
    def servers(self) -> list[str]:
        """The servers that the run knows of, by name."""
        known = {*self.plan.ranges, *self.plan.measured, *self.stretches, *self.result.totals.remote}
        return sorted(known, key=by_name)

    @property
    def found(self) -> FlightFindings:
        """What was found on the flight, with what people decided about it."""
        return FlightFindings(
            self.name, self.drone, self.opened, self.began_s, self.plan.home, self.findings, self.reviews
        )

    @property
    def outcome(self) -> Outcome:
        """What the run came to."""
        return Outcome(self.name, self.plan, self.result)


def read_records(logs: Sequence[Path], *, unreviewed: bool = False) -> list[Record]:
    """The last run of each log, named after its file; raises UsageError for what is no log of a mission.

    Reviews beside the logs count, except `unreviewed`.
    """
    names = names_of(logs)
    records = []
    with work("logs read", len(logs)) as done:
        for log, name in zip(logs, names, strict=True):
            record = _record_of_log(EventLog(log), log, name)
            records.append(record if unreviewed else replace(record, reviews=read_reviews(log)))
            done()
    return records


def reviewed_of(records: Sequence[Record]) -> ReviewedFindings:
    """What was found on these flights, with its reviews."""
    return reviewed([record.found for record in records])


def findings_of(records: Sequence[Record]) -> list[PlacedFinding]:
    """The same as a list, each under its number, without what was rejected."""
    return reviewed_of(records).objects


def record_of(events: Sequence[Event], log: Path) -> Record:
    """The last run of these events, which the log has or should have; raises UsageError as `read_records` does."""
    return _record(MissionEvents(events), log, *names_of([log]))


def _record_of_log(events: EventLog, log: Path, name: str) -> Record:
    record = _record(MissionEvents(events), log, name)
    return replace(record, ending=record.ending.with_caution(events.left_out))


def names_of(logs: Sequence[Path]) -> list[str]:
    """The shortest names that tell the logs apart: those of runs/TIME/events.jsonl are their folders'."""
    short = [log.resolve().parent.name if log.stem == "events" else log.stem for log in logs]
    return [name if short.count(name) == 1 else str(log) for name, log in zip(short, logs, strict=True)]


def _record(events: MissionEvents, log: Path, name: str) -> Record:
    if events.began_s is None:
        raise UsageError(f"{log} has no mission: it ended before one began")
    try:
        plan = events.planned
        tally, calls, track = Tally(), _Calls(), _Track(events.began_s)
        finder, ending = Finder(), EndingSoFar(events.began_s)
        states = _States((*plan.ranges, *plan.measured), began_s=events.began_s)
        for event in events:
            tally.take(event)
            calls.take(event)
            states.take(event)
            finder.take(event)
            ending.take(event)
            track.take(event)  # whether it can be read is known from here on
        result = tally.result()
        reported = calls.with_results(result.calls)
        return Record(
            name=name,
            opened=events.opening.time if isinstance(events.opening, schema.LogOpened) else None,
            simulated=events.opening if isinstance(events.opening, schema.Simulated) else None,
            drone=events.drone,
            began_s=events.began_s,
            events=events,
            result=result,
            plan=plan,
            calls=reported,
            worst=calls.worst(reported),
            stretches=states.stretches(),
            ending=ending.ending(result),
            findings=finder.found,
        )
    except (KeyError, TypeError, ValueError) as error:  # msgspec's ValidationError is a ValueError
        raise UsageError(f"{log} is not an event log that this version reads: {error!r}") from error


class _Calls:
    """Gathers a run's calls, event by event, and keeps the reasons of the worst calls alone."""

    def __init__(self) -> None:
        self._reasons = Reasons()
        self._facts: list[tuple[Position | None, str, bool]] = []
        self._worst: list[CallText] = []

    def take(self, event: Event) -> None:
        """Takes in the next event."""
        match self._reasons.take(event):
            case ExplainedCall() as explained:
                outcome = explained.outcome
                self._facts.append((explained.position, outcome.wait, outcome.fell_back))
                self._worst = worst_of([*self._worst, CallText(explained)], _WORST)
            case ExplainedAnswer(number=number) as answer:
                for text in self._worst:
                    if text.call.number == number:
                        text.answers.append(answer)

    def with_results(self, results: Sequence[CallResult]) -> list[ReportedCall]:
        """The calls, with their results in the same order."""
        return [ReportedCall(result, *facts) for result, facts in zip(results, self._facts, strict=True)]

    def worst(self, calls: Sequence[ReportedCall]) -> list[WorstCall]:
        """The calls that lost most, the worst first."""
        return [WorstCall(calls[text.call.number], text.call.loss_s, text.reasons) for text in self._worst]


class _Track:
    """Says where the drone was, event by event, where that is another place than before."""

    def __init__(self, began_s: float) -> None:
        self._began_s = began_s
        self._last: Position | None = None
        self._home_above_sea_m = math.nan

    def take(self, event: Event) -> Fix | None:
        """Takes in the next event; the place that it tells."""
        if isinstance(event, schema.LimitsRead) and event.home_above_sea_m is not None:
            self._home_above_sea_m = event.home_above_sea_m
        here = place_of(event, self._last) if event.t >= self._began_s else None
        if here is None or here == self._last:
            return None
        self._last = here
        return Fix(event.t - self._began_s, here, self._home_above_sea_m + here.altitude_m)


def place_of(event: Event, last: Position | None) -> Position | None:
    """Where an event tells that the drone was; as high as `last` where it tells a place without an altitude."""
    match event:
        case schema.PositionReport(east_m=east_m, north_m=north_m, altitude_m=altitude_m):
            return Position(east_m, north_m, altitude_m)
        case schema.Arrived(east_m=east_m, north_m=north_m):
            return Position(east_m, north_m, last.altitude_m if last else 0.0)
    place = getattr(event, "position", None)
    return place if isinstance(place, Position) else None


class _States:
    """Gathers the states that servers were in, event by event."""

    def __init__(self, servers: Iterable[str], *, began_s: float) -> None:
        self._began_s = began_s
        self._now: dict[str, tuple[State, float, str]] = dict.fromkeys(servers, (State.AVL, 0.0, ""))
        self._stretches: dict[str, list[Stretch]] = {name: [] for name in self._now}
        self._ended_s = 0.0

    def take(self, event: Event) -> None:
        """Takes in the next event."""
        at_s = event.t - self._began_s
        self._ended_s = max(self._ended_s, at_s)
        if isinstance(event, schema.LogResumed):  # a program that starts again knows no server's state
            for server in self._now:
                self._end(server, at_s)
                self._now[server] = (State.AVL, at_s, "taken up again")
        elif isinstance(event, schema.ServerStep):
            server, at_s = event.server, max(0.0, at_s)
            if server not in self._now:
                self._now[server], self._stretches[server] = (event.before, 0.0, ""), []
            self._end(server, at_s)
            self._now[server] = (event.after, at_s, event.why)

    def stretches(self) -> Mapping[str, Sequence[Stretch]]:
        """The stretches of each server, up to the last event."""
        for server in self._now:
            self._end(server, self._ended_s)
        return {server: self._stretches[server] for server in sorted(self._stretches, key=by_name)}

    def _end(self, server: str, at_s: float) -> None:
        state, since_s, why = self._now[server]
        if at_s > since_s:
            self._stretches[server].append(Stretch(state, since_s, at_s, why))
