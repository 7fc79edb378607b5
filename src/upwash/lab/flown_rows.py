"""How a mission of rows went, by the log of its simulation: its photos, its answers, and its waits for them."""

from __future__ import annotations

import operator
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from msgspec import Struct

from upwash.core.geo import Waypoint, row_of
from upwash.eventlog import schema
from upwash.eventlog.results import RunResult
from upwash.eventlog.schema import Event

_LEAST_WAIT_S = 1.0
_AT_WORK = 2  # photos that are computed and do not wait in line: one on the drone, and one on a server


class RowAnswers(Struct, frozen=True, kw_only=True):
    """One row: its photos, those taken a second, the answers that came a second, and the most open answers."""

    row: int
    photos: int
    photos_per_s: float
    answers_per_s: float
    most_open: int


class RowForecast(Struct, frozen=True, kw_only=True):
    """A forecast at one ground speed: the mission's time, each row, and how often the drone stops for answers.

    `waited_s` is the time that it waits for answers, at these stops and at the end. The answers keep up if no photo
    waits in line when the last one is taken. The time is the mean over some `worlds`, the rest is of one of them.
    """

    ground_speed_m_s: float
    mission_s: float
    rows: tuple[RowAnswers, ...]
    stops: int
    waited_s: float
    turns_back: int
    keeps_up: bool
    worlds: int = 1

    @property
    def is_held_up(self) -> bool:
        """Whether answers make the mission longer, so that a lower speed may be as quick."""
        return bool(self.stops or self.turns_back) or self.waited_s >= _LEAST_WAIT_S

    @property
    def most_open(self) -> int:
        """The most open answers on any row."""
        return max(row.most_open for row in self.rows)

    @property
    def photos_per_s(self) -> float:
        """Photos that are taken a second on the rows, on average."""
        return self._over_rows([row.photos_per_s for row in self.rows])

    @property
    def answers_per_s(self) -> float:
        """Answers that come a second on the rows, on average."""
        return self._over_rows([row.answers_per_s for row in self.rows])

    def _over_rows(self, rates_per_s: Sequence[float]) -> float:
        """The mean of rates, each row by its photos."""
        legs = [row.photos - 1 for row in self.rows]
        return sum(map(operator.mul, rates_per_s, legs)) / sum(legs) if any(legs) else 0.0


def flown_rows(
    run: RunResult, events: Iterable[Event], plan: Sequence[Waypoint], ground_speed_m_s: float
) -> RowForecast:
    """The forecast by a mission that was completed, whose events these are."""
    course = _Course(plan)
    for event in events:
        course.take(event)
    return RowForecast(
        ground_speed_m_s=ground_speed_m_s,
        mission_s=run.mission_time_s,
        rows=tuple(row.told(number) for number, row in enumerate(course.rows)),
        stops=course.stops,
        waited_s=course.waited_s,
        turns_back=run.totals.turns_back,
        keeps_up=course.keeps_up and not course.stops,
    )


@dataclass(slots=True)
class _Row:
    key: object
    begun_s: float
    ended_s: float
    photos: int = 0
    answers: int = 0  # until the last photo
    most_open: int = 0

    def told(self, number: int) -> RowAnswers:
        lasted_s = self.ended_s - self.begun_s
        return RowAnswers(
            row=number,
            photos=self.photos,
            photos_per_s=(self.photos - 1) / lasted_s if lasted_s > 0 else 0.0,
            answers_per_s=self.answers / lasted_s if lasted_s > 0 else 0.0,
            most_open=self.most_open,
        )


@dataclass(slots=True)
class _Course:
    """The rows of a mission, followed event by event."""

    plan: Sequence[Waypoint]
    rows: list[_Row] = field(default_factory=list)
    stops: int = 0
    waited_s: float = 0.0
    keeps_up: bool = True
    _reached: set[int] = field(default_factory=set)
    _open: set[int | None] = field(default_factory=set)
    _come: int = 0  # answers since the last photo of the row

    def take(self, event: Event) -> None:
        match event:
            case schema.Arrived(waypoint=int(index)) if (
                index not in self._reached
            ):  # not back there for an act
                self._reached.add(index)
                self._reach(row_of(self.plan[index]) or index, event.t)
            case schema.CallStarted(waypoint=waypoint) if self.rows:
                self._open.add(waypoint)
                self.rows[-1].most_open = max(self.rows[-1].most_open, len(self._open))
                self.keeps_up = len(self._open) <= 1 + _AT_WORK
            case schema.AnswerTaken(waypoint=waypoint):
                self._open.discard(waypoint)
                self._come += 1
                self.waited_s += event.waited_s
            case schema.PhotosWait():
                self.stops += 1

    def _reach(self, key: object, at_s: float) -> None:
        if not self.rows or self.rows[-1].key != key:
            self.rows.append(_Row(key, at_s, at_s))
            self._come = 0
        row = self.rows[-1]
        row.ended_s, row.photos, row.answers = at_s, row.photos + 1, row.answers + self._come
        self._come = 0
