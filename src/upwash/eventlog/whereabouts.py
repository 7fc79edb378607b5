"""At which waypoint each call of a log was made: where the drone was as it began, which it may have left since."""

from __future__ import annotations

from upwash.eventlog import schema
from upwash.eventlog.schema import Event


class Whereabouts:
    """Follows the events of a flight: `here` is where it last arrived, `of_call` where the last call was made."""

    def __init__(self) -> None:
        self.here: int | None = None
        self.of_call: int | None = None
        self._pending: schema.CallStarted | None = None

    def take(self, event: Event) -> None:
        """Takes in the next event."""
        match event:
            case schema.MissionStarted():
                self.here = self._pending = None
            case schema.Arrived(waypoint=waypoint):
                self.here = waypoint
            case schema.CallStarted():
                self._pending = event
            case schema.Call():
                self.of_call = self.here if self._pending is None else self._pending.waypoint
                self._pending = None
