"""Whether a reported position can be true: only if the vehicle's speed allows it since the last sure position.

A position filter that accepts a wrong satellite fix moves the reported place at once, and may report no fault
afterwards. The vehicle itself does not jump. Laws:

1. A report that lies farther from the one before it than time and the greater of both speeds allow is a jump.
2. A jump is undone by jumps that lead back, or by a receiver that agrees with the new place. The receiver's reports
   must have come without a gap and without a jump since before the estimate jumped.
3. While a jump is not undone, the vehicle's place is unknown.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

from upwash.core.geo import Position, Velocity, ground_distance_m

_FASTER_M_S = 3.0  # than it reports: speeds are reported late, and smoothed
_NOISE_M = 3.0  # of one report; a smaller jump moves no arrival by much
_AGREES_M = 5.0  # a filter's place and its receiver's, in flight
_GAP_S = 3.0  # in a longer one, a wrong fix may have taken its place unseen
_JUMPS_KEPT = 16


class PositionSeries:
    """One series of positions, and its jumps that are not undone."""

    def __init__(self) -> None:
        self.place: Position | None = None
        self.jumps: deque[tuple[float, float]] = deque(maxlen=_JUMPS_KEPT)  # when, and how far
        self.unbroken_s = math.inf  # since when its reports have come without a gap
        self._time_s = -math.inf
        self._speed_m_s = 0.0
        self._off_m = 0j  # east and north

    @property
    def off_m(self) -> float:
        """How far all jumps together have moved the position, in metres."""
        return abs(self._off_m)

    def take(self, place: Position, *, time_s: float, velocity: Velocity) -> None:
        """Add a position at `time_s`, and the velocity that the vehicle reports with it."""
        before, passed_s = self.place, time_s - self._time_s
        fastest_m_s = max(self._speed_m_s, velocity.ground_m_s) + _FASTER_M_S
        self.place, self._time_s, self._speed_m_s = place, time_s, velocity.ground_m_s
        if not 0 <= passed_s <= _GAP_S:
            self.unbroken_s = time_s
        if before is None or passed_s < 0:  # a clock that goes back: nothing is known of the time between
            return
        moved_m = ground_distance_m(before, place)
        if moved_m <= _NOISE_M + fastest_m_s * passed_s:
            return
        self.jumps.append((time_s, moved_m))
        flown_s = passed_s if passed_s <= _GAP_S else 0.0  # in a gap it may have flown anywhere
        off_east_m = place.east_m - before.east_m - velocity.east_m_s * flown_s
        off_north_m = place.north_m - before.north_m - velocity.north_m_s * flown_s
        self._off_m += complex(off_east_m, off_north_m)
        if self.off_m <= _NOISE_M:
            self.believe()

    def believe(self) -> None:
        """Accept the present place as true."""
        self._off_m = 0j


class Continuity:
    """Compares the position estimate of the autopilot with the positions of its satellite receiver."""

    def __init__(self) -> None:
        self._estimate = PositionSeries()
        self._receiver = PositionSeries()

    @property
    def doubt_m(self) -> float:
        """How far the vehicle may be from its reported place, in metres; 0 if that can be true (law 3)."""
        return self._estimate.off_m

    @property
    def jumps(self) -> Sequence[tuple[float, float]]:
        """The last 16 jumps of the estimate: the time of each, and its length in metres."""
        return self._estimate.jumps

    def take_estimate(self, place: Position, *, time_s: float, velocity: Velocity) -> None:
        """Add a position of the autopilot's estimate."""
        self._estimate.take(place, time_s=time_s, velocity=velocity)
        self._reconcile()

    def take_receiver(self, place: Position, *, time_s: float, velocity: Velocity) -> None:
        """Add a position of the satellite receiver alone, with the vehicle's velocity."""
        self._receiver.take(place, time_s=time_s, velocity=velocity)
        self._reconcile()

    def believe(self) -> None:
        """Accept the present place as true, for a vehicle that has stood still for a while."""
        self._estimate.believe()
        self._receiver.believe()

    def _reconcile(self) -> None:
        estimate, receiver = self._estimate, self._receiver
        if not estimate.off_m or receiver.off_m or estimate.place is None or receiver.place is None:
            return
        if receiver.unbroken_s >= estimate.jumps[-1][0]:
            return
        if ground_distance_m(estimate.place, receiver.place) <= _AGREES_M:
            estimate.believe()
