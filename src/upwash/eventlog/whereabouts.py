"""At which waypoint each call of a log was made: where the drone was as it began, which it may have left since."""

from __future__ import annotations

from collections import deque

from upwash.eventlog import schema
from upwash.eventlog.schema import Event


class Whereabouts:
    """Follows the events of a flight: `here` is where it last arrived, `of_call` where the last call was made.

    `answered` is the number, from 0 on, of the call whose answer the mission just took; None at any other event.
    """

    def __init__(self) -> None:
        self.here: int | None = None
        self.of_call: int | None = None
        self.answered: int | None = None
        self._calls = 0  # that are over
        self._under_way: deque[int | None] = deque()  # calls that were started, by waypoint, in their order
        self._untaken: list[
            tuple[int | None, int]
        ] = []  # started calls that are over, by waypoint and number

    @property
    def of_call_under_way(self) -> int | None:
        """Where the call under way was made, or one that begins now is made."""
        return self._under_way[0] if self._under_way else self.here

    def take(self, event: Event) -> None:
        """Takes in the next event."""
        self.answered = None
        match event:
            case schema.MissionStarted():
                self.here = None
                self._under_way.clear()
                self._untaken.clear()
            case schema.Arrived(waypoint=waypoint):
                self.here = waypoint
            case schema.CallStarted(waypoint=waypoint):
                self._under_way.append(waypoint)
            case schema.Call():
                self.of_call = self.of_call_under_way
                if self._under_way:
                    self._untaken.append((self._under_way.popleft(), self._calls))
                self._calls += 1
            case schema.AnswerTaken(waypoint=waypoint, failed=""):
                self.answered = self._taken(waypoint)
            case schema.AnswerTaken(waypoint=waypoint) if waypoint in self._under_way:
                self._under_way.remove(waypoint)  # it failed, and no event says that it is over

    def _taken(self, waypoint: int | None) -> int | None:
        """The last call that was made there, as those before it were dropped."""
        for made_at, number in reversed(self._untaken):
            if made_at == waypoint:
                self._untaken.remove((made_at, number))
                return number
        return None
