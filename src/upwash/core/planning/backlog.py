"""Where a resting drone waits best for the answers to a line of photos: here, or in a range that it flies to.

The line is answered as in answering.py, also on the way; nothing fails. What counts is when the drone is where it has
to be afterwards, home or on its way.

`soonest` is the built-in rule.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence

from msgspec import Struct

from upwash.core.geo import Circle, Position, distance_m
from upwash.core.planning.answer_stops import AnswerStops, longer_m
from upwash.core.planning.answering import Answering, ServerBelief
from upwash.core.planning.legs import Leg, Motion, Pace

LEAST_GAIN_S = 1.0


class WaitPlace(Struct, frozen=True):
    """A place to wait for answers, in the range of the `server`; None for where the drone is.

    The way over the place is `extra_s` longer. All answers are expected in `answered_s`, and in `ends_s` the drone is
    where it has to be afterwards, if nothing fails and the built-in rule places the calls.
    """

    server: str | None
    position: Position
    extra_s: float
    answered_s: float
    ends_s: float


class Stay(Struct, frozen=True):
    """A rest with this number of `calls` in line, and where the drone may wait for their answers, here first.

    `passes_range` if the way from the next waypoint on passes a range of these servers anyway. Places are left out
    that a fence, the reserve or `policy.detour_s` forbids, and those of earlier flights in this rest.
    """

    calls: int
    places: Sequence[WaitPlace]
    passes_range: bool = False


def soonest(stay: Stay) -> str | None:
    """The server of the range where the wait ends soonest; None for here."""
    here, *ranges = stay.places
    best = min(ranges, key=lambda place: place.ends_s, default=here)
    return best.server if not stay.passes_range and best.ends_s < here.ends_s - LEAST_GAIN_S else None


class Backlog(Struct, frozen=True, kw_only=True):
    """`photos` without an answer, each of `local_s` on the drone, and the servers that may answer them.

    After the last answer the drone flies to `after`; None: it stays where it is. Where the vehicle returns by itself,
    `home_s` has the seconds from a place to the ground at home.
    """

    photos: int
    local_s: float
    servers: Mapping[str, ServerBelief]
    gain_switch: float
    ground_speed_m_s: float
    pace: Pace
    after: Position | None
    home_s: Callable[[Position], float] | None = None

    def wait_at(self, place: Position, *, here: Position, server: str | None = None) -> WaitPlace:
        """The place, and what a wait there takes for a drone that is here."""
        answered_s = self._answered_s(here, place)
        extra_m = max(0.0, longer_m(here, place, self.after or here))
        return WaitPlace(
            server, place, extra_m / self.ground_speed_m_s, answered_s, answered_s + self.onwards_s(place)
        )

    def _answered_s(self, here: Position, place: Position) -> float:
        leg = self._leg(here, place)
        answering = Answering(self.local_s, self.servers, gain_switch=self.gain_switch)
        answering.flies(Motion(here, place, leg, 0.0))
        for photo in range(self.photos):
            answering.take(photo, 0.0)
        while answering.next_answer(math.inf) is not None:
            pass
        return max(leg.duration_s, answering.now_s)

    def onwards_s(self, place: Position) -> float:
        """The seconds from the place to where the drone has to be afterwards."""
        if self.home_s is not None:
            return self.home_s(place)
        return 0.0 if self.after is None else self._leg(place, self.after).duration_s

    def ranges(self, here: Position) -> Iterator[WaitPlace]:
        """The places in ranges of servers that are faster than the drone."""
        for name, server in self.servers.items():
            if server.call_s < self.local_s and isinstance(server.area, Circle):
                place = AnswerStops([server.area]).beside(here, self.after or here)
                if place is not None and place != here:
                    yield self.wait_at(place, here=here, server=name)

    def _leg(self, start: Position, end: Position) -> Leg:
        length_m = distance_m(start, end.at_altitude(start.altitude_m))
        return self.pace.leg(length_m, self.ground_speed_m_s)
