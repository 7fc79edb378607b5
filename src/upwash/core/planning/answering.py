"""When photos are expected to be answered that a drone takes in flight: on the drone, or on one server at a time.

    in line     photos that wait; the oldest is first, or the newest
    a place     the drone, or the server in use; it takes the first photo that it answers before the other place
                gets to it (earliest.py)
    a server    the fastest in range, used after its check, until the drone leaves its range

Calls take their estimates and nothing fails. A photo that a server had when its range ended is first in line again.
"""

from __future__ import annotations

import bisect
import itertools
import math
from collections import deque
from collections.abc import Mapping
from typing import NamedTuple

from msgspec import Struct

from upwash.core.geo import Position, Reach
from upwash.core.planning.earliest import first_taken
from upwash.core.planning.legs import ALWAYS, Motion, Stay, stay_in

_LEAST_S = 1e-6  # of a call


class ServerBelief(Struct, frozen=True):
    """A server's range, the seconds of a photo there, and of its check, with services that are started or run."""

    area: Reach
    call_s: float
    check_s: float
    check_running_s: float


class _Computed(NamedTuple):
    """A photo that is computed, and when its answer is there."""

    photo: int
    end_s: float


class Answering:
    """Answers photos, as time goes on.

    `could` counts the answers that the drone and its servers could have given until `now_s`. With an infinite
    `local_s` only servers answer. Of the servers, those that are faster than the drone count.
    """

    def __init__(
        self, local_s: float, servers: Mapping[str, ServerBelief], *, gain_switch: float, newest: bool = False
    ) -> None:
        self.now_s = 0.0
        self.could = 0.0
        self._local_s = local_s
        self.servers = {name: server for name, server in servers.items() if server.call_s < local_s}
        self._switch_s = gain_switch * local_s
        self._newest = newest
        self._coming: deque[tuple[float, int]] = deque()
        self._line: list[int] = []
        self._drone: _Computed | None = None
        self._remote: _Computed | None = None
        self._server: str | None = None
        self._ready_s = math.inf
        self._running: set[str] = set()
        self._stays: Mapping[str, Stay] = {}

    def flies(self, motion: Motion) -> None:
        """The drone flies that leg from now on."""
        stays = {name: stay_in(motion, server.area) for name, server in self.servers.items()}
        self._stays = {name: stay for name, stay in stays.items() if stay is not None}

    def rests(self, place: Position) -> None:
        """The drone rests there from now on."""
        self._stays = {name: ALWAYS for name, server in self.servers.items() if server.area.contains(place)}

    def take(self, photo: int, at_s: float) -> None:
        """A photo that is there at that time."""
        self._coming.append((at_s, photo))

    def next_answer(self, until_s: float) -> int | None:
        """Go on to the next answer, and return its photo; None at `until_s`, or where no photo is left."""
        while True:
            self._use_server()
            self._compute()
            due_s = self._next_s()
            if due_s > until_s or due_s == math.inf:
                if until_s < math.inf:
                    self._go_on(until_s)
                return None
            self._go_on(due_s)
            while self._coming and self._coming[0][0] <= self.now_s:
                bisect.insort(self._line, self._coming.popleft()[1])
            if (answered := self._drone) is not None and answered.end_s <= self.now_s:
                self._drone = None
                return answered.photo
            if (answered := self._remote) is not None and answered.end_s <= self.now_s:
                self._remote = None
                return answered.photo

    def _go_on(self, to_s: float) -> None:
        passed_s = to_s - self.now_s
        if passed_s > 0:
            self.could += passed_s / max(_LEAST_S, self._local_s)
            if (server := self._ready_server()) is not None:
                self.could += passed_s / max(_LEAST_S, server.call_s)
        self.now_s = max(self.now_s, to_s)

    def _use_server(self) -> None:
        in_range = {name: stay[1] for name, stay in self._stays.items() if stay[0] <= self.now_s < stay[1]}
        if self._server is not None and self._server not in in_range:
            self._server = None
            if self._remote is not None:
                bisect.insort(self._line, self._remote.photo)
                self._remote = None
        best = min(in_range, key=lambda name: (self.servers[name].call_s, -in_range[name]), default=None)
        if best is None or best == self._server:
            return
        server = self.servers[best]
        if self._server is not None:
            gain_s = self.servers[self._server].call_s - server.call_s
            if self._remote is not None or gain_s <= self._switch_s:
                return
        self._server = best
        self._ready_s = self.now_s + (server.check_running_s if best in self._running else server.check_s)
        self._running.add(best)

    def _compute(self) -> None:
        """Start the first photos in line, as far as their places are free."""
        server = self._ready_server()
        call_s = math.inf if server is None else server.call_s
        if self._remote is None and (photo := self._taken(call_s, self._local_s, self._drone)) is not None:
            self._remote = _Computed(photo, self.now_s + call_s)
        if self._drone is None:
            if (photo := self._taken(self._local_s, call_s, self._remote, in_ties=True)) is not None:
                self._drone = _Computed(photo, self.now_s + self._local_s)
        elif self._remote is None and not self._line:
            sooner_s = min(self._drone.end_s, self.now_s + call_s)
            self._drone = _Computed(self._drone.photo, sooner_s)  # it is sent there too

    def _taken(
        self, own_s: float, other_s: float, other: _Computed | None, *, in_ties: bool = False
    ) -> int | None:
        """The photo that a free place takes out of the line."""
        other_in_s = 0.0 if other is None else other.end_s - self.now_s
        line = itertools.repeat((own_s, other_s), len(self._line))
        taken = first_taken(line, other_in_s=other_in_s, in_ties=in_ties)
        return None if taken is None else self._line.pop(-1 - taken if self._newest else taken)

    def _ready_server(self) -> ServerBelief | None:
        if self._server is None or self._ready_s > self.now_s:
            return None
        return self.servers[self._server]

    def _next_s(self) -> float:
        times_s = [self._coming[0][0]] if self._coming else []
        times_s += [computed.end_s for computed in (self._drone, self._remote) if computed is not None]
        if not times_s and not self._line:
            return math.inf
        if self._server is not None and self._ready_s > self.now_s:
            times_s.append(self._ready_s)
        times_s += [time_s for stay in self._stays.values() for time_s in stay if time_s > self.now_s]
        return min(times_s, default=math.inf)  # of photos that only servers answer
