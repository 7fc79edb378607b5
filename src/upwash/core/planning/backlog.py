"""Where a resting drone waits best for the answers to a line of photos: here, or in a range that it flies to.

The line is answered on the way too: by the drone, and by the fastest server in range, once its check is over. Each
takes a photo that it answers before the other gets to it (earliest.py). Calls take their estimates, and none fails. A
photo that a server had when its range ended is in line again. What counts is when the drone is where it has to be
afterwards, home or on its way.

`soonest` is the built-in rule.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

from msgspec import Struct

from upwash.core.geo import Circle, Position, Reach, distance_m, inside
from upwash.core.planning.answer_stops import AnswerStops, longer_m
from upwash.core.planning.earliest import first_taken
from upwash.core.planning.legs import Leg, Pace

LEAST_GAIN_S = 1.0


class ServerBelief(Struct, frozen=True):
    """A server's range, and the seconds of a photo there and of its check."""

    area: Reach
    call_s: float
    check_s: float


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
        leg, extra_m = self._leg(here, place), max(0.0, longer_m(here, place, self.after or here))
        gaining = [server for server in self.servers.values() if server.call_s < self.local_s]
        stays = [(server, _stay(leg, here, place, server.area)) for server in gaining]
        stays.sort(key=lambda each: each[1][1], reverse=True)  # of servers alike, the one left last is used
        line = _Line(self.photos, self.local_s, self.gain_switch * self.local_s)
        while line.has_photos:
            line.use([server for server, (from_s, to_s) in stays if from_s <= line.now_s < to_s])
            line.compute()
            if not line.go_on(time_s for _, stay in stays for time_s in stay):
                break  # of photos that only servers answer
        answered_s = max(leg.duration_s, line.now_s)
        extra_s, ends_s = extra_m / self.ground_speed_m_s, answered_s + self.onwards_s(place)
        return WaitPlace(server, place, extra_s, answered_s, ends_s)

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


class _Line:
    """Photos in line, what the drone and the server in use compute, and when that is over."""

    def __init__(self, photos: int, local_s: float, switch_s: float) -> None:
        self.now_s = 0.0
        self._waiting, self._local_s, self._switch_s = photos, local_s, switch_s
        self._drone_s = self._remote_s = self._ready_s = math.inf
        self._server: ServerBelief | None = None

    @property
    def has_photos(self) -> bool:
        """Whether a photo has no answer yet."""
        return self._waiting > 0 or min(self._drone_s, self._remote_s) < math.inf

    def use(self, in_range: Sequence[ServerBelief]) -> None:
        """Use the fastest of the servers in range."""
        if self._server is not None and self._server not in in_range:
            self._server = None
            self._waiting += self._remote_s < math.inf
            self._remote_s = math.inf
        best = min(in_range, key=lambda server: server.call_s, default=None)
        if best is None or best == self._server:
            return
        if self._server is not None:
            gain_s = self._server.call_s - best.call_s
            if self._remote_s < math.inf or gain_s <= self._switch_s:
                return
        self._server, self._ready_s = best, self.now_s + best.check_s

    def compute(self) -> None:
        """Start the first photos in line, as far as their places are free."""
        call_s = math.inf if self._server is None or self._ready_s > self.now_s else self._server.call_s
        if self._remote_s == math.inf and self._takes(call_s, self._local_s, self._drone_s):
            self._remote_s = self.now_s + call_s
        if self._drone_s == math.inf:
            if self._takes(self._local_s, call_s, self._remote_s, in_ties=True):
                self._drone_s = self.now_s + self._local_s
        elif self._remote_s == math.inf and not self._waiting:
            self._drone_s = min(self._drone_s, self.now_s + call_s)  # it is sent there too

    def _takes(self, own_s: float, other_s: float, other_end_s: float, *, in_ties: bool = False) -> bool:
        """Whether a free place takes a photo out of the line."""
        other_in_s = 0.0 if other_end_s == math.inf else other_end_s - self.now_s
        line = itertools.repeat((own_s, other_s), self._waiting)
        takes = first_taken(line, other_in_s=other_in_s, in_ties=in_ties) is not None
        self._waiting -= takes
        return takes

    def go_on(self, borders_s: Iterable[float]) -> bool:
        """Go on to the next answer, check or border of a range; False where none comes."""
        checks_s = [] if self._server is None else [self._ready_s]
        later_s = (time_s for time_s in (*checks_s, *borders_s) if time_s > self.now_s)
        next_s = min(self._drone_s, self._remote_s, *later_s)
        if next_s == math.inf:
            return False
        self.now_s = next_s
        if self._drone_s <= self.now_s:
            self._drone_s = math.inf
        elif self._remote_s <= self.now_s:
            self._remote_s = math.inf
        return True


def _stay(leg: Leg, start: Position, end: Position, area: Reach) -> tuple[float, float]:
    """From when to when the leg is in the area, for ever if it ends there; never: from an infinite time on."""
    if not isinstance(area, Circle):
        return -math.inf, math.inf
    shares = inside(area, start, end)
    if shares is None or shares[1] < 0 or shares[0] > 1:
        return math.inf, math.inf
    first, last = shares
    return (
        -math.inf if first <= 0 else leg.reached_s(first * leg.length_m),
        math.inf if last >= 1 else leg.reached_s(last * leg.length_m),
    )
