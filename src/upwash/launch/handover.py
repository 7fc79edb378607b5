"""Hands the findings of a flight over while the flight lasts.

The laws: a recipient gets findings in their order, one at a time. It may get a finding twice, with the same `uid`.
Findings wait in memory for a recipient that does not take them; beyond 1,000 the oldest are dropped. No recipient
ends or delays the flight.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections import deque
from collections.abc import AsyncIterator, Callable, Iterable, Iterator, Sequence
from datetime import UTC, datetime, timedelta

from upwash.core.geo import GeoPosition
from upwash.eventlog import schema
from upwash.eventlog.progress import MissionTime
from upwash.eventlog.schema import Event
from upwash.launch.recipients import Facts, NotTaken, Recipient
from upwash.report.finding_files import facts_of
from upwash.report.findings import Finder
from upwash.report.numbering import FlightFindings, PlacedFinding
from upwash.support.background import end, start
from upwash.support.text import printable

_MOST_WAITING = 1000
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 1.0, 60.0
_LAST_S = 5.0  # for what still waits at the end of the flight
_LONGEST_DRONE = 60  # characters of its name in a uid
_OF_FILES = ("number", "log", "sightings")  # decided when all findings are known
Tell = Callable[[Event], None]


class Handover:
    """Hands findings to all recipients; `earlier` are the events of the same flight before it was resumed."""

    def __init__(
        self,
        recipients: Iterable[Recipient],
        *,
        drone: str,
        home: GeoPosition | None,
        earlier: Iterable[Event] = (),
    ) -> None:
        self._told = HandoverFacts(drone, home)
        self._deliveries = [Delivery(recipient) for recipient in recipients]
        for event in earlier:
            self._told.by(event)

    def follow(self, event: Event) -> None:
        """Takes in the next event of the flight."""
        for facts in self._told.by(event):
            for delivery in self._deliveries:
                delivery.put(facts)

    @contextlib.asynccontextmanager
    async def running(self, tell: Tell) -> AsyncIterator[None]:
        """Delivers in the block, and for some seconds after it; `tell` gets what becomes of that as events."""
        tasks = [
            start(delivery.run(tell), name=f"handing over to {delivery.to}", failed=delivery.fail)
            for delivery in self._deliveries
        ]
        last_s = _LAST_S
        try:
            yield
        except asyncio.CancelledError:
            last_s = 0.0  # the program must end at once
            raise
        finally:
            for delivery in self._deliveries:
                delivery.finish()
            try:
                if tasks:
                    await asyncio.wait(tasks, timeout=last_s)
            finally:
                await end(*tasks)
                for delivery in self._deliveries:
                    if (failed := delivery.failure()) is not None:
                        tell(failed)


class HandoverFacts:
    """The findings in the events of a flight as recipients get them."""

    def __init__(self, drone: str, home: GeoPosition | None) -> None:
        self._drone = drone
        self._home = home
        self._finder = Finder(with_texts=True)
        self._began = MissionTime()
        self._flight = ""
        self._opened = datetime.fromtimestamp(0, UTC)
        self._number = 0

    def by(self, event: Event) -> Sequence[Facts]:
        """The findings that the next event tells, by the names of the columns of files."""
        self._began.take(event)
        match event:
            case schema.LogOpened(time=now) | schema.LogResumed(time=now) | schema.ClockSet(after=now):
                self._opened = now - timedelta(seconds=event.t)
                self._flight = self._flight or f"{self._drone[:_LONGEST_DRONE]}-{now:%Y%m%dT%H%M%S.%f}"
        found = self._finder.take(event)
        if not found:
            return ()
        flight = FlightFindings("", self._drone, self._opened, self._began.at_s or 0.0, self._home, ())
        return list(self._facts(PlacedFinding(0, flight, finding) for finding in found))

    def _facts(self, found: Iterable[PlacedFinding]) -> Iterator[Facts]:
        for finding in found:
            self._number += 1
            facts = {name: value for name, value in facts_of(finding).items() if name not in _OF_FILES}
            photo = facts["photo"]
            yield {
                "uid": f"upwash-{self._flight}-{self._number}",
                **facts,
                "photo": None if photo is None else printable(photo),
            }


class Delivery:
    """The findings for one recipient, those that wait and those that were not taken."""

    def __init__(self, recipient: Recipient) -> None:
        self.to = recipient.name
        self._recipient = recipient
        self._waiting = deque[Facts]()
        self._under_way: Facts | None = None
        self._refused = self._dropped = 0
        self._refusal = self._problem = ""  # the last of each
        self._is_in_trouble = self._has_told_dropped = False
        self._more, self._ending = asyncio.Event(), asyncio.Event()

    def put(self, facts: Facts) -> None:
        """Has the finding delivered after those before it."""
        if len(self._waiting) == _MOST_WAITING:
            self._waiting.popleft()
            self._dropped += 1
        self._waiting.append(facts)
        self._more.set()

    async def run(self, tell: Tell) -> None:
        """Delivers until nothing waits after `finish`; tells when trouble begins, and when it is over."""
        pause_s = _FIRST_PAUSE_S
        while (facts := await self._next()) is not None:
            if self._dropped and not self._has_told_dropped:
                self._has_told_dropped = True
                self._set_trouble(f"more than {_MOST_WAITING:,} wait: the oldest are dropped", tell)
            try:
                await self._recipient.take(facts)
            except NotTaken as problem:
                self._set_trouble(str(problem), tell)
                if not problem.for_good:
                    await self._pause(pause_s)
                    pause_s = min(2 * pause_s, _LONGEST_PAUSE_S)
                    continue
                self._refused += 1
                self._refusal = str(problem)
            else:
                self._set_trouble("", tell)
            pause_s = _FIRST_PAUSE_S
            self._under_way = None

    def finish(self) -> None:
        """Has what still waits tried at once, and `run` end after that."""
        self._ending.set()
        self._more.set()

    def fail(self, defect: Exception) -> None:
        """Takes in that `run` has ended by a defect."""
        self._problem = f"a defect of upwash: {type(defect).__name__}"

    def failure(self) -> Event | None:
        """What was not delivered; None if all findings were taken."""
        left = len(self._waiting) + (self._under_way is not None)
        reasons = (
            (self._refused, f"refused: {self._refusal}"),
            (self._dropped, f"dropped, as more than {_MOST_WAITING:,} waited"),
            (left, f"left at the end: {self._problem or 'there was no time'}"),
        )
        why = "; ".join(f"{count} {reason}" for count, reason in reasons if count)
        count = self._refused + self._dropped + left
        return schema.HandoverFailed(to=self.to, count=count, why=why) if count else None

    async def _next(self) -> Facts | None:
        while self._under_way is None:
            if self._waiting:
                self._under_way = self._waiting.popleft()
            elif self._ending.is_set():
                return None
            else:
                self._more.clear()
                await self._more.wait()
        return self._under_way

    async def _pause(self, pause_s: float) -> None:
        if self._ending.is_set():
            await asyncio.sleep(_FIRST_PAUSE_S)
            return
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(pause_s):
                await self._ending.wait()

    def _set_trouble(self, why: str, tell: Tell) -> None:
        self._problem = why or self._problem
        if self._is_in_trouble != bool(why):
            self._is_in_trouble = bool(why)
            tell(schema.HandoverTrouble(to=self.to, why=why))
