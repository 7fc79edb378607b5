"""The time of day of the seconds of a mission, as recordings have it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from upwash.report.record import Record

if TYPE_CHECKING:
    from foxglove.messages import Timestamp

_NS = 1_000_000_000
_LATEST_NS = (2**32 - 1) * _NS  # seconds of messages have 32 bits: in 2106


class RecordClock:
    """That of one run; a simulated one happened in 1970."""

    def __init__(self, record: Record) -> None:
        opened_ns = round(record.opened.timestamp() * 1e6) * 1000 if record.opened else 0
        self._began_ns = opened_ns + round(record.began_s * _NS)

    def ns(self, at_s: float) -> int:
        """In nanoseconds since 1970."""
        return min(_LATEST_NS, max(0, self._began_ns + round(at_s * _NS)))

    def time(self, at_s: float) -> Timestamp:
        """As Foxglove's messages have it."""
        from foxglove.messages import Timestamp

        return Timestamp(*divmod(self.ns(at_s), _NS))
