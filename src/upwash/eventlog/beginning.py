"""When a mission's time begins, by which people are told when something was."""

from __future__ import annotations

from upwash.eventlog import schema
from upwash.eventlog.schema import Event

# Most events of a long log are positions, which are passed over at once: each case of a match takes time.
BEGINNING = frozenset(
    {
        schema.MissionStarted,
        schema.Armed,
        schema.Photo,
        schema.CallStarted,
        schema.Call,
        schema.Leg,
        schema.LogResumed,
    }
)


class Beginning:
    """When the mission's time begins, gathered event by event: as it is armed for its first leg.

    `at_s` is None before the mission has started; where it took photos or called services before it was armed, or was
    taken up again in the air, it began as it started.
    """

    def __init__(self) -> None:
        self.at_s: float | None = None
        self.arming_s = 0.0
        self._settled = False

    def take(self, event: Event) -> None:
        """Takes in the next event."""
        if type(event) not in BEGINNING:
            return
        match event:
            case schema.MissionStarted() if self.at_s is None:
                self.at_s = event.t
            case schema.Armed() if self.at_s is not None and not self._settled:
                self.arming_s = event.t - self.at_s
                self.at_s, self._settled = event.t, True
            case (
                schema.Photo() | schema.CallStarted() | schema.Call() | schema.Leg() | schema.LogResumed()
            ) if self.at_s is not None:
                self._settled = True

    def told(self, t: float) -> str:
        """A second of the log as people read it: of the mission, or in brackets of the log before that began."""
        if self.at_s is None or not self._settled:
            return f"[{t:.1f} s]"
        return f"{t - self.at_s:.1f} s"
