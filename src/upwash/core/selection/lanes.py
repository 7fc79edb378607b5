"""The lanes that compute a drone's calls, one on the drone and one at each server: who holds them, and who waits.

A lane is held from the decision for it until the answer is there. A computation or a request that goes on after the
call was answered holds its lane too. Only a free lane gets a call.

A server computes calls of other drones too. It says how long a call waited for these, and how long a new call would.

Calls wait in one line: first those that the mission waits for, then those that only servers compute, then the others.
In each group the oldest is first, or the newest.
"""

from __future__ import annotations

import bisect
from collections import defaultdict, deque
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import fmean

from upwash.core.operation import Operation

_NEGLIGIBLE_S = 1e-6  # timers may run early by less
_LATEST = 3  # waits whose mean the next call is expected to have


@dataclass(slots=True, eq=False)
class InLine:
    """A call in line, made at `since_s`; the mission waits for an `urgent` one, and `on_drone` runs nowhere else."""

    operation: Operation
    since_s: float
    urgent: bool = False
    needs_server: bool = False
    on_drone: bool = False


class Lanes:
    """Which lanes the drone's own calls hold, and until when; a lane has the name of its place."""

    def __init__(self) -> None:
        self.newest_first = False
        self.has_line = False  # several calls may be open at the same time
        self._queue_until_s: dict[str, float] = {}  # of other drones' calls, by place
        self._waits_s = defaultdict[str, deque[float]](lambda: deque([0.0] * _LATEST, _LATEST))
        self._held: dict[object, tuple[str, float]] = {}
        self._line: list[InLine] = []  # the oldest first

    def hold(self, holder: object, place: str, until_s: float) -> None:
        """Note that a lane is held, and when that is expected to end; a holder has one lane at a time."""
        self._held[holder] = place, until_s

    def release(self, holder: object) -> None:
        """Note that the holder has no lane any more."""
        self._held.pop(holder, None)

    def is_free(self, place: str) -> bool:
        """Whether no call holds the lane."""
        return all(held != place for held, _ in self._held.values())

    @property
    def are_free(self) -> bool:
        """Whether no call holds any lane."""
        return not self._held

    def rest_s(self, place: str, now_s: float) -> float:
        """The seconds until the lane is expected to be free; 0 where that was expected earlier."""
        ends_s = [until_s for held, until_s in self._held.values() if held == place]
        return max([now_s, *ends_s]) - now_s

    def waited(self, place: str, waited_s: float) -> None:
        """Note how long a call there waited for calls of other drones."""
        self._waits_s[place].append(waited_s)

    def queue(self, place: str, queue_s: float, now_s: float) -> None:
        """Note that a call sent there now would have `queue_s` of other drones' calls before it."""
        self._queue_until_s[place] = now_s + queue_s

    def queue_s(self, place: str, now_s: float) -> float:
        """The seconds of other drones' calls before a call that is sent there now."""
        left_s = self._queue_until_s.get(place, now_s) - now_s
        return left_s if left_s > _NEGLIGIBLE_S else 0.0

    def usual_wait_s(self, place: str) -> float:
        """The mean wait for other drones' calls, of the latest calls there."""
        return fmean(self._waits_s[place])

    @property
    def line(self) -> Sequence[InLine]:
        """The calls that wait, the first in line first."""
        urgent = [call for call in self._line if call.urgent]
        others = [call for call in self._line if not call.urgent][:: -1 if self.newest_first else 1]
        return [*urgent, *sorted(others, key=lambda call: not call.needs_server)]

    def enter(self, call: InLine) -> None:
        """Put the call behind those of its group that were made before it."""
        bisect.insort(self._line, call, key=lambda call: call.since_s)

    def leave(self, call: InLine) -> None:
        """Take the call out of the line."""
        self._line.remove(call)
