"""What the figures of all flights of a page have in common, so that they can be compared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from upwash.report.map import View, view_of
from upwash.report.places import Places
from upwash.report.record import Record


@dataclass(frozen=True, slots=True)
class Scales:
    """Marks, the part of the plane, and the ends of the axes."""

    places: Places
    view: View
    longest_call_s: float
    last_waypoint: int
    longest_s: float

    @classmethod
    def of(cls, records: Sequence[Record]) -> Scales:
        """With room for everything of all of them."""
        calls = [call for record in records for call in record.result.calls]
        return cls(
            places=Places(
                sorted({server for record in records for server in record.servers}),
                sorted({call.operation for call in calls}),
            ),
            view=view_of(records),
            longest_call_s=max((call.delay_s for call in calls), default=1.0),
            last_waypoint=max(max(record.result.waypoints - 1, 0) for record in records),
            longest_s=max(record.result.mission_time_s for record in records),
        )
