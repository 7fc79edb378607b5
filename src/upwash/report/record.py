"""One run as reports tell it, read from its event log."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path

from upwash.core.geo import Position
from upwash.errors import UsageError
from upwash.eventlog import schema
from upwash.eventlog.ending import Ending
from upwash.eventlog.log import EventLog
from upwash.eventlog.reasons import CallText
from upwash.eventlog.results import CallResult, RunResult
from upwash.eventlog.schema import Event
from upwash.report.findings import Finding
from upwash.report.numbering import FlightFindings, PlacedFinding
from upwash.report.outcome import Outcome
from upwash.report.reviewed import ReviewedFindings, reviewed
from upwash.report.reviews import NO_REVIEWS, Reviews, read_reviews
from upwash.report.story import Story, Stretch, place_of
from upwash.support.progress import work
from upwash.support.text import by_name


@dataclass(frozen=True, slots=True)
class Fix:
    """Where the drone was at a second of the mission; not a number above the sea where home's altitude is unknown."""

    at_s: float
    position: Position
    above_sea_m: float


class MissionEvents:
    """The events of a log from the `first` to before the `end`; each pass reads them again.

    A long flight's log is larger than what a page about it holds, so that none of them is kept.
    """

    def __init__(self, events: Iterable[Event], first: int, end: int) -> None:
        self._events, self._first, self._end = events, first, end

    def __iter__(self) -> Iterator[Event]:
        return itertools.islice(self._events, self._first, self._end)


@dataclass(frozen=True, slots=True)
class Record:
    """One run, with its events until the mission was completed."""

    name: str
    story: Story
    events: Iterable[Event]
    result: RunResult
    stretches: Mapping[str, Sequence[Stretch]]
    ending: Ending
    reviews: Reviews = NO_REVIEWS

    @property
    def opened(self) -> datetime | None:
        """The time of day at second 0 of the log, None for a simulated one."""
        return self.story.opened

    @property
    def simulated(self) -> schema.Simulated | None:
        """The simulation's own first line, None for a flight."""
        return self.story.simulated

    @property
    def drone(self) -> str:
        """The drone's name."""
        return self.story.drone or ""

    @property
    def began_s(self) -> float:
        """The mission's begin, in seconds of the log."""
        return self.story.began_s

    @property
    def plan(self) -> schema.Planned:
        """What the drone set out to do."""
        return self.story.plan

    @property
    def findings(self) -> Sequence[Finding]:
        """Each sighting that the log tells."""
        return self.story.finder.found

    @property
    def calls(self) -> Sequence[CallResult]:
        """The calls, in the order of their ends."""
        return self.result.calls

    @property
    def places(self) -> Sequence[Position | None]:
        """The place of the drone at each call; None if unknown."""
        return self.story.places

    @property
    def worst(self) -> Sequence[CallText]:
        """The calls that lost most, the worst first."""
        return self.story.worst

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
        return replace(self.story.findings(self.name), reviews=self.reviews)

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
    return _record(events, log, *names_of([log]))


def _record_of_log(events: EventLog, log: Path, name: str) -> Record:
    record = _record(events, log, name)
    return replace(record, ending=record.ending.with_caution(events.left_out))


def names_of(logs: Sequence[Path]) -> list[str]:
    """The shortest names that tell the logs apart: those of runs/TIME/events.jsonl are their folders'."""
    short = [log.resolve().parent.name if log.stem == "events" else log.stem for log in logs]
    return [name if short.count(name) == 1 else str(log) for name, log in zip(short, logs, strict=True)]


def _record(events: Iterable[Event], log: Path, name: str) -> Record:
    story, first, end = Story(), 0, 0
    track = _Track(0.0)
    try:
        for number, event in enumerate(events):
            if isinstance(event, schema.LogOpened):
                story, first = Story(), number
            if not story.tally.completed:
                story.take(event)
                track.take(event)  # whether it can be read is known from here on
                end = number + 1
        if story.tally.began_s is None:
            raise UsageError(f"{log} has no mission: it ended before one began")
        result = story.tally.result()
        record = Record(
            name=name,
            story=story,
            events=MissionEvents(events, first, end),
            result=result,
            stretches=story.stretches,
            ending=story.ending(result),
        )
    except (KeyError, TypeError, ValueError) as error:  # msgspec's ValidationError is a ValueError
        raise UsageError(f"{log} is not an event log that this version reads: {error!r}") from error
    story.finish()
    return record


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
