"""One run as reports tell it, read from its event log."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from upwash.core.geo import Position
from upwash.errors import UsageError
from upwash.eventlog import schema
from upwash.eventlog.ending import Ending, EndingSoFar
from upwash.eventlog.log import EventLog
from upwash.eventlog.notices import Notices
from upwash.eventlog.reasons import Reasons
from upwash.eventlog.results import CallResult, RunResult
from upwash.eventlog.schema import Event
from upwash.report.findings import Pairing, TakenPhoto
from upwash.report.numbering import FlightFindings
from upwash.report.reviewed import ReviewedFindings, reviewed
from upwash.report.reviews import NO_REVIEWS, read_reviews
from upwash.report.story import Story, place_of
from upwash.support.progress import work
from upwash.support.text import by_name

_LATEST_NS = (2**32 - 1) * 1_000_000_000  # seconds of recordings have 32 bits: in 2106


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


class Record(Story):
    """One run under a name, with its `events` until the mission was completed, and with its `reviews`."""

    result: RunResult
    ending: Ending

    def __init__(self, name: str) -> None:
        super().__init__()
        self.name = name
        self.reviews = NO_REVIEWS
        self.events: Iterable[Event] = ()

    def finish(self) -> None:
        """Keep the result and the ending; let go of what only further events need: a long flight keeps its record."""
        self.result = self.tally.result()
        self.ending = self._ending.ending(self.result, self.began_s)
        self.reasons, self.finder.pairing = Reasons(), Pairing()
        self._notices, self._ending = Notices(), EndingSoFar()

    @property
    def calls(self) -> Sequence[CallResult]:
        """The calls, in the order of their ends."""
        return self.result.calls

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
        known = {*self.steps, *self.result.totals.remote}
        return sorted(known, key=by_name)

    @property
    def photos(self) -> Iterator[tuple[TakenPhoto, schema.PhotoTaken]]:
        """Each photo, with its event."""
        pairing = Pairing()
        for event in self.events:
            pairing.take(event)
            if isinstance(event, schema.PhotoTaken) and pairing.last is not None:
                yield pairing.last, event

    def ns(self, at_s: float) -> int:
        """A second of the mission in nanoseconds since 1970, when simulated flights happen."""
        opened_ns = round(self.opened.timestamp() * 1e6) * 1000 if self.opened else 0
        return min(_LATEST_NS, max(0, opened_ns + round(self.began_s * 1e9) + round(at_s * 1e9)))

    @property
    def flight(self) -> FlightFindings:
        """What was found on the flight, with what people decided about it."""
        return replace(self.findings_of(self.name), reviews=self.reviews)


def read_records(logs: Sequence[Path], *, unreviewed: bool = False) -> list[Record]:
    """The last run of each log, named after its file; raises UsageError for what is no log of a mission.

    Reviews beside the logs count, except `unreviewed`.
    """
    names = names_of(logs)
    records = []
    with work("logs read", len(logs)) as done:
        for log, name in zip(logs, names, strict=True):
            events = EventLog(log)
            record = _record(events, log, name)
            record.ending = record.ending.with_caution(events.left_out)
            record.reviews = NO_REVIEWS if unreviewed else read_reviews(log)
            records.append(record)
            done()
    return records


def reviewed_of(records: Sequence[Record]) -> ReviewedFindings:
    """What was found on these flights, with its reviews."""
    return reviewed([record.flight for record in records])


def record_of(events: Sequence[Event], log: Path) -> Record:
    """The last run of these events, which the log has or should have; raises UsageError as `read_records` does."""
    return _record(events, log, *names_of([log]))


def names_of(logs: Sequence[Path]) -> list[str]:
    """The shortest names that tell the logs apart: those of runs/TIME/events.jsonl are their folders'."""
    short = [log.resolve().parent.name if log.stem == "events" else log.stem for log in logs]
    return [name if short.count(name) == 1 else str(log) for name, log in zip(short, logs, strict=True)]


def _record(events: Iterable[Event], log: Path, name: str) -> Record:
    record, first, end = Record(name), 0, 0
    track = _Track(0.0)
    try:
        for number, event in enumerate(events):
            if isinstance(event, schema.LogOpened):
                record, first = Record(name), number
            if not record.tally.completed:
                record.take(event)
                track.take(event)  # whether it can be read is known from here on
                end = number + 1
        if record.tally.began_s is None:
            raise UsageError(f"{log} has no mission: it ended before one began")
        record.finish()
    except (KeyError, TypeError, ValueError) as error:  # msgspec's ValidationError is a ValueError
        raise UsageError(f"{log} is not an event log that this version reads: {error!r}") from error
    record.events = MissionEvents(events, first, end)
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
