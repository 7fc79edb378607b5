"""Which answers a mission still wants, and which demands of answers it has not met yet, by waypoint."""

from __future__ import annotations

from upwash.eventlog import schema
from upwash.eventlog.schema import Event

OWED = frozenset({schema.CallStarted, schema.Demanded, schema.AnswerTaken, schema.Acted})


class Owed:
    """Follows the events of a flight, and of the flights that took it up.

    `answers` are the waypoints of started calls whose answers the mission has not taken. `demands` are the waypoints
    whose answers demand what is not done yet. `failures` are the waypoints of failed calls without a reaction.
    """

    def __init__(self) -> None:
        self.answers: set[int | None] = set()
        self.demands: set[int | None] = set()
        self.failures: set[int | None] = set()

    @property
    def waypoints(self) -> set[int | None]:
        """All of them."""
        return self.answers | self.demands | self.failures

    def take(self, event: Event) -> None:
        """Takes in the next event."""
        match event:
            case schema.CallStarted(waypoint=waypoint):
                self.answers.add(waypoint)
            case schema.Demanded(waypoint=waypoint, failed=failed):
                (self.failures if failed else self.demands).add(waypoint)
            case schema.AnswerTaken(waypoint=waypoint):
                self._settle(waypoint)
                if event.failed:
                    self.failures.add(waypoint)
                elif event.demanded:
                    self.demands.add(waypoint)
            case schema.Acted(waypoint=waypoint):
                self._settle(waypoint)

    def _settle(self, waypoint: int | None) -> None:
        for owed in (self.answers, self.demands, self.failures):
            owed.discard(waypoint)
