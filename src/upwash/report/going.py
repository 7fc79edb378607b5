"""The answers that a drone went on before: from when on, until it had them, and where it turned back for them."""

from __future__ import annotations

from dataclasses import dataclass

from upwash.core.geo import Position
from upwash.eventlog import schema
from upwash.eventlog.schema import Event


@dataclass(frozen=True, slots=True)
class OpenAnswer:
    """The answer of a waypoint while it was open, in seconds of the mission; `turned_at` is None without a turn."""

    waypoint: int | None
    from_s: float
    to_s: float
    turned_at: Position | None


class OpenAnswers:
    """Gathers them event by event."""

    def __init__(self, began_s: float) -> None:
        self.found: list[OpenAnswer] = []
        self._began_s = began_s
        self._since_s: dict[int | None, float] = {}
        self._turned_at: dict[int | None, Position] = {}

    def take(self, event: Event) -> None:
        """Takes in the next event."""
        match event:
            case (
                schema.StayOrGo(waypoint=waypoint, goes=True)
                | schema.Arrived(waypoint=waypoint, passing=True)
            ):
                self._since_s[waypoint] = event.t - self._began_s
            case schema.TurnedBack(waypoint=waypoint, position=position):
                self._turned_at[waypoint] = position
                self._since_s.setdefault(waypoint, event.t - self._began_s)  # of a row's end
            case schema.AnswerTaken(waypoint=waypoint) if waypoint in self._since_s:
                from_s, turned_at = self._since_s.pop(waypoint), self._turned_at.pop(waypoint, None)
                self.found.append(OpenAnswer(waypoint, from_s, event.t - self._began_s, turned_at))
