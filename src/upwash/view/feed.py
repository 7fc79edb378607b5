"""What pages are sent: everything known when they connect, as server-sent events, and only what is new after that."""

from __future__ import annotations

import asyncio
import contextlib
import secrets
import time
from collections.abc import AsyncIterator, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import msgspec

from upwash.eventlog.objects import noun_of
from upwash.eventlog.results import RunResult
from upwash.report.numbering import (
    FlightFindings,
    Numbered,
    are_a_fleet,
    numbered,
    offset_m,
    what_was_found,
)
from upwash.report.outcome import what_it_came_to
from upwash.report.record import names_of
from upwash.report.reviewed import ReviewedFindings, with_reviews
from upwash.report.reviews import FindingKey, ReviewsBeside, Verdict, review_file
from upwash.view.elsewhere import Elsewhere, elsewhere
from upwash.view.recording import Piece, Recording, as_one
from upwash.view.tiles import Tiles

_REST = 20.0  # times what numbering the findings took
_LOOK_S = 0.05
_BATCH_BYTES = 2**18  # of facts, which are sent at once
_RETRY_MS = 1000  # after which a page that lost its connection tries again


class Reviewing(msgspec.Struct, frozen=True):
    """What a page sends with a review: the `token` that only this program's page has, and a name for the reviewer."""

    token: str
    reviewer: str


class Page(msgspec.Struct, frozen=True):
    """What a page shows: `together` says whether the logs are of several drones, to be shown on one map.

    `review_files` are the names of the files that have the logs' reviews. Without `reviewing` no program keeps
    reviews that are made on the page.
    """

    logs: Sequence[str]
    together: bool
    tiles: Tiles | None
    review_files: Sequence[str]
    reviewing: Reviewing | None


class Batch(msgspec.Struct, frozen=True):
    """Facts of one log; `start` counts those before them. Another `run` begins anew.

    `more` says whether others, that the log has already, follow at once.
    """

    log: int
    run: int
    start: int
    trouble: str
    more: bool
    facts: msgspec.Raw


class SeenObject(msgspec.Struct, frozen=True):
    """An object by all its sightings; `best` has the log and the index of the surest one, `surest` its score.

    `key` names it in reviews.
    """

    sightings: int
    surest: float | None
    east_m: float
    north_m: float
    error_m: float | None
    best: tuple[int, int]
    key: FindingKey


class SeenReview(msgspec.Struct, frozen=True):
    """What the last review of an object says."""

    verdict: Verdict
    label: str
    note: str
    reviewer: str


class Found(msgspec.Struct, frozen=True):
    """What was found on the flight of a log, or on all of a fleet, in a sentence; and the numbers of the log's own.

    `nouns` are what people call objects, by those labels that differ from it. `objects` has the objects that this log
    saw first, by the index of their first sighting. `reviews` are by number; `remarks` are sentences about them.
    """

    words: str
    nouns: Mapping[str, str]
    numbers: Sequence[int]
    objects: Mapping[int, SeenObject]
    reviews: Mapping[int, SeenReview]
    remarks: Sequence[str]


def _found(found: ReviewedFindings, log: int, *, is_a_fleet: bool) -> Found:
    flights = found.flights
    own = found.of_flight(log)
    here = offset_m(flights, log) if is_a_fleet else (0.0, 0.0)
    objects = {}
    for each in own.everything:
        there = offset_m(flights, each.best[0]) if is_a_fleet else here
        place = each.finding.place
        objects[each.first[1]] = SeenObject(
            each.sightings,
            each.finding.score,
            place.east_m + there[0] - here[0],
            place.north_m + there[1] - here[1],
            each.finding.error_m,
            each.best,
            flights[log].found[each.first[1]].key,
        )
    told = found if is_a_fleet else own
    labels = {each.what for each in flights[log].found}
    return Found(
        what_was_found(each.finding for each in told.objects),
        {label: noun for label in labels if label and (noun := noun_of(label)) != label},
        [found.everything[position].number for position in found.positions[log]],
        objects,
        {
            each.number: SeenReview(review.verdict, review.label, review.note, review.reviewer)
            for each in told.everything
            if (review := each.review) is not None
        },
        told.tally.remarks,
    )


@dataclass(frozen=True, slots=True)
class _Seen:
    run: int = 0
    facts: int = 0
    trouble: str = ""
    is_behind: bool = True


class Feed:
    """Follows logs, and tells any number of pages what they have told; none of them holds up another."""

    def __init__(
        self,
        recordings: Sequence[Recording],
        tiles: Tiles | None = None,
        flown: Mapping[str, RunResult] | None = None,
        *,
        reviewing: Reviewing | None = None,
        unreviewed: bool = False,
    ) -> None:
        self.recordings = list(recordings)
        self._names = names_of([recording.log for recording in recordings])
        self._tiles = tiles
        self._flown = flown or {}  # by policy, in the world of the one log
        self._elsewhere: Mapping[int, Sequence[Elsewhere]] = {}
        self._identity = secrets.token_hex(4)  # so that no page takes this feed for one before it
        self._summaries: dict[int, str] = {}
        self._summarized: dict[int, int] = {}
        self.reviewing = reviewing
        self._reviews = [] if unreviewed else [ReviewsBeside(recording.log) for recording in recordings]
        self._found = list[Found]()
        self._counted: list[tuple[int, int]] = []
        self._numbered: tuple[list[FlightFindings], Numbered] = [], Numbered((), ())
        self._next_numbering_s = 0.0
        self._closing = self._closed = False
        self._news = asyncio.Event()

    async def follow(self) -> None:
        """Looks at the logs several times a second, until the feed is closed; then says goodbye to all pages."""
        self._summarize()  # of short logs, which are read already
        self._number()
        self._tell()
        while True:
            last_look = self._closing
            news = [recording.advance() for recording in self.recordings]
            if any(news):
                self._summarize()
            if self._number(at_once=last_look) or any(news):
                self._tell()
            elif last_look:
                break
            await asyncio.sleep(0 if any(news) or self._closing else _LOOK_S)
        self._closed = True
        self._tell()

    def close(self) -> None:
        """Lets pages be told what is in the logs by now, and then the end."""
        self._closing = True

    def _tell(self) -> None:
        self._news.set()
        self._news = asyncio.Event()

    def _summarize(self) -> None:
        over = {
            log: recording.run
            for log, recording in enumerate(self.recordings)
            if recording.caught_up and recording.news.ended and not recording.trouble
        }
        if over == self._summarized:
            return
        self._summarized = over
        ended = {log: self.recordings[log].news.story.outcome(self._names[log]) for log in over}
        outcomes = {log: outcome for log, outcome in ended.items() if outcome is not None}
        every = list(outcomes.values())
        self._summaries = {log: what_it_came_to(outcome, every) for log, outcome in outcomes.items()}
        together = _are_of_several_drones(self.recordings)
        self._elsewhere = {} if together else elsewhere(outcomes, self._flown)

    @property
    def flights(self) -> list[FlightFindings]:
        """The findings of each flight until now, with their reviews."""
        named = zip(self.recordings, self._names, strict=True)
        return self._with_reviews([recording.news.story.findings_of(name) for recording, name in named])

    def _with_reviews(self, flights: list[FlightFindings]) -> list[FlightFindings]:
        pairs = zip(flights, self._reviews, strict=True) if self._reviews else ()
        return [replace(flight, reviews=beside.reviews) for flight, beside in pairs] or flights

    def _number(self, *, at_once: bool = True) -> bool:
        """Numbers what was found, once all logs are read to their ends, and looks at the reviews.

        Returns whether a finding or a review is new. Thousands of sightings take a second to join: unless `at_once`,
        that may fill a twentieth of the time.
        """
        if any(recording.is_behind for recording in self.recordings):
            return False
        is_new = self._join(at_once=at_once)
        looks = [beside.look() for beside in self._reviews]
        if not is_new and not any(looks):
            return False
        flights, found = self._numbered
        told = with_reviews(found, self._with_reviews(flights))
        is_a_fleet = _are_of_several_drones(self.recordings)
        self._found = [_found(told, log, is_a_fleet=is_a_fleet) for log in range(len(flights))]
        return True

    def _join(self, *, at_once: bool) -> bool:
        """Joins the sightings of what was found; returns whether a finding is new."""
        began_s = time.monotonic()
        if began_s < self._next_numbering_s and not at_once:
            return False
        count = [(recording.run, len(recording.news.story.findings)) for recording in self.recordings]
        if count == self._counted:
            return False
        flights = self.flights
        self._counted, self._numbered = count, (flights, numbered(flights))
        ended_s = time.monotonic()
        self._next_numbering_s = ended_s + _REST * (ended_s - began_s)
        return True

    def everything(self) -> Iterator[tuple[str, object]]:
        """The kind and the data of each message of finished logs."""
        for recording in self.recordings:
            while recording.is_behind:
                recording.advance()
        self._summarize()
        self._number()
        yield "page", self._page()
        for log, recording in enumerate(self.recordings):
            yield from (("facts", batch) for batch, _ in _batches(log, recording, _Seen()))
        yield "findings", self._found
        yield "summaries", self._summaries
        yield "elsewhere", self._elsewhere
        yield "end", None

    def _page(self) -> Page:
        files = [review_file(recording.log).name for recording in self.recordings]
        return Page(self._names, _are_of_several_drones(self.recordings), self._tiles, files, self.reviewing)

    async def messages(self, after: str = "") -> AsyncIterator[str]:
        """The events for one page, until the feed is closed; `after` is the id of the last one that it has."""
        yield f"retry: {_RETRY_MS}\n{_message('page', self._page())}"
        seen, summaries, found = self._seen(after), None, list[Found]()
        while True:
            news, closed = self._news, self._closed
            for log, recording in enumerate(self.recordings):
                for batch, has in _batches(log, recording, seen[log]):
                    seen[log] = has
                    yield self._identified(batch, seen)
            if found != self._found:
                found = self._found
                yield _message("findings", found)
            if summaries != self._summaries:
                summaries = self._summaries
                yield _message("summaries", summaries)
                yield _message("elsewhere", self._elsewhere)
            if closed:
                break
            await news.wait()
        yield _message("end", None)

    def _identified(self, batch: Batch, seen: Sequence[_Seen]) -> str:
        counts = ".".join(f"{each.run}-{each.facts}" for each in seen)
        return f"id: {self._identity}.{counts}\n{_message('facts', batch)}"

    def _seen(self, after: str) -> list[_Seen]:
        identity, *counts = after.split(".")
        if identity == self._identity and len(counts) == len(self.recordings):
            with contextlib.suppress(ValueError):
                pairs = [map(int, each.split("-")) for each in counts]
                return [_Seen(run, facts) for run, facts in pairs]
        return [_Seen()] * len(self.recordings)


def _are_of_several_drones(recordings: Sequence[Recording]) -> bool:
    """Whether they are; flights that have yet to begin at once are taken for those of several."""
    return are_a_fleet([recording.news.story.drone for recording in recordings])


def _batches(log: int, recording: Recording, seen: _Seen) -> Iterator[tuple[Batch, _Seen]]:
    """What a page lacks of a log now, batch by batch, and what it has with each."""
    now = _Seen(recording.run, recording.count, recording.trouble, recording.is_behind)
    if now == seen:
        return
    has = seen.facts if seen.run == now.run and seen.facts <= now.facts else 0
    for piece in _joined(recording.since(has) or [Piece(has, 0, b"[]")]):
        then = now if piece.end == now.facts else _Seen(now.run, piece.end)
        facts = msgspec.Raw(piece.json)
        yield Batch(log, now.run, piece.start, then.trouble, more=then.is_behind, facts=facts), then


def _joined(pieces: Sequence[Piece]) -> Iterator[Piece]:
    """The same facts, in fewer pieces where these are small."""
    some, size = list[Piece](), 0
    for piece in pieces:
        some.append(piece)
        size += len(piece.json)
        if size >= _BATCH_BYTES or piece is pieces[-1]:
            yield as_one(some)
            some, size = [], 0


def _message(kind: str, data: object) -> str:
    return f"event: {kind}\ndata: {msgspec.json.encode(data).decode()}\n\n"
