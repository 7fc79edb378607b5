"""The events of the stand-in: what happened, numbered, for listeners and for those who missed one."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import TypeAlias

from upwash.mavlink.px4 import EVENTS, EventMessage

Tell: TypeAlias = Callable[..., None]  # notes an event by its name in PX4, with its arguments

_IDS = {kind.name: number for number, kind in EVENTS.items()}
_FIRST_SEQUENCE = 65_526
_KEPT = 40


class Events:
    """The events, oldest first."""

    def __init__(self) -> None:
        self._kept: deque[EventMessage] = deque(maxlen=_KEPT)
        self._unsaid: list[EventMessage] = []
        self._next = _FIRST_SEQUENCE

    def note(self, name: str, uptime_s: float, *arguments: float, log_levels: int | None = None) -> None:
        """Keeps an event by its name in PX4."""
        number = _IDS[name]
        kind = EVENTS[number]
        event = EventMessage(
            id_of_event=number,
            event_time_boot_ms=round(uptime_s * 1e3) % 2**32,
            sequence=self._next,
            destination_component=0,
            destination_system=0,
            log_levels=kind.log_levels if log_levels is None else log_levels,
            arguments=kind.packed(*arguments),
        )
        self._next = (self._next + 1) % 2**16
        self._kept.append(event)
        self._unsaid.append(event)

    def said(self) -> list[EventMessage]:
        """The events since it was last asked."""
        unsaid, self._unsaid = self._unsaid, []
        return unsaid

    def numbered(self, sequence: int) -> EventMessage | None:
        """An event that happened not too long ago."""
        return next((event for event in self._kept if event.sequence == sequence), None)

    @property
    def oldest(self) -> int:
        """The number of the oldest event that is still known."""
        return int(self._kept[0].sequence) if self._kept else self._next
