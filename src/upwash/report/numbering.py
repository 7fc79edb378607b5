"""One number for each finding, of one flight or of a fleet, and what was found in a sentence."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from upwash.core.geo import GeoPosition
from upwash.report.findings import Finding
from upwash.support.text import counted, printable

_FAULTS = {
    "hot-spot": "hot-spot",
    "broken-module": "broken module",
}  # labels of the bundled detector, in words
_MESSAGE = ""  # the label of what has none
_MOST_KINDS = 6
_LONGEST_LABEL = 40  # characters


@dataclass(frozen=True, slots=True)
class FlightFindings:
    """What was found on one flight, whose log has that name; before the mission began the drone is None.

    `opened` is the time of day at second 0 of the log, None for a simulated flight; `began_s` the mission's start in
    seconds of the log.
    """

    log: str
    drone: str | None
    opened: datetime | None
    began_s: float
    home: GeoPosition | None
    found: Sequence[Finding]


@dataclass(frozen=True, slots=True)
class PlacedFinding:
    """A finding of a flight under its number, which is the same on map, photo, list and in every file."""

    number: int
    flight: FlightFindings
    finding: Finding

    @property
    def mission_s(self) -> float:
        """When the message was sent, in seconds of the mission."""
        return self.finding.at_s - self.flight.began_s

    @property
    def time(self) -> datetime | None:
        """The time of day of the message, None if unknown."""
        if self.flight.opened is None:
            return None
        try:
            return self.flight.opened.astimezone(UTC) + timedelta(seconds=self.finding.at_s)
        except OverflowError:
            return None

    @property
    def earth(self) -> tuple[float, float] | None:
        """Latitude and longitude of the finding's place in degrees; None where home is not known."""
        return self.finding.earth(self.flight.home)


def are_a_fleet(drones: Sequence[str | None]) -> bool:
    """Whether flights of these drones are of several; those that have yet to begin at once are taken for that."""
    return len(drones) > 1 and (len(set(drones)) > 1 or None in drones)


def numbers_of(flights: Sequence[FlightFindings]) -> list[list[int]]:
    """The number of each finding, flight by flight.

    The findings of a fleet are numbered from 1 in one list, in the order of the messages. The findings of one drone's
    flights are numbered from 1 for each flight.
    """
    numbers: list[list[int]] = [[] for _ in flights]
    if are_a_fleet([flight.drone for flight in flights]):
        for number, (_, index) in enumerate(
            heapq.merge(*map(_told_at, flights, range(len(flights)))), start=1
        ):
            numbers[index].append(number)
        return numbers
    return [list(range(1, 1 + len(flight.found))) for flight in flights]


def _told_at(flight: FlightFindings, index: int) -> Iterator[tuple[float, int]]:
    """The time of each of the flight's findings, and the flight's index."""
    opened_s = flight.opened.timestamp() if flight.opened else 0.0
    latest_s = -float("inf")
    for finding in flight.found:
        latest_s = max(
            latest_s, opened_s + finding.at_s
        )  # a log that a clock's step set back stays in its order
        yield latest_s, index


def placed(flights: Sequence[FlightFindings]) -> list[PlacedFinding]:
    """The findings of the flights by their numbers; those of one drone's flights flight after flight."""
    found = [
        PlacedFinding(number, flight, finding)
        for flight, numbers in zip(flights, numbers_of(flights), strict=True)
        for number, finding in zip(numbers, flight.found, strict=True)
    ]
    if are_a_fleet([flight.drone for flight in flights]):
        found.sort(key=lambda each: each.number)
    return found


def what_was_found(findings: Iterable[Finding]) -> str:
    """Such as "12 faults: 7 hot-spots, 5 broken modules", "2 hot-spots" or "1 finding"; empty where nothing is."""
    kinds = Counter(finding.box.label if finding.box else _MESSAGE for finding in findings)
    if not kinds:
        return ""
    if len(kinds) == 1:
        ((label, number),) = kinds.items()
        return counted(number, "finding") if label == _MESSAGE else _of_kind(label, number)
    shown = [kind for kind in kinds.most_common() if kind[0] != _MESSAGE][:_MOST_KINDS]
    parts = [_of_kind(label, number) for label, number in shown]
    if messages := kinds[_MESSAGE]:
        parts.append(counted(messages, "message"))
    if others := kinds.total() - messages - sum(number for _, number in shown):
        parts.append(f"{others} of other kinds")
    noun = "fault" if kinds.keys() <= _FAULTS.keys() else "finding"
    return f"{counted(kinds.total(), noun)}: {', '.join(parts)}"


def _of_kind(label: str, number: int) -> str:
    noun = _FAULTS.get(label) or printable(label.replace("_", " "), _LONGEST_LABEL)
    if not noun[-1:].isalpha():
        return f"{number} x {noun}"
    return counted(number, noun)
