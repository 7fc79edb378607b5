"""The measured delays of calls to a server without a range, at each place.

A server that is reached over LTE, a mesh or a cable has no circle around it. Whether it answers at a place, and how
soon, is only known from calls that were made there:

    at a place   the mean of the last three calls made there
    around it    the same as the nearest place, if it is near enough
    elsewhere    unknown: the server is believed to be as fast as in its last calls

A failed call counts with its cost: the wait for it, and then the drone's own computing.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field

from upwash.core.geo import Grid, Placed, Position, ground_distance_m
from upwash.core.operation import Operation

SAME_M = 8.0  # calls within this distance count for one place
NEAR_M = 12.0  # a measured place says this much of its surroundings
_LATEST = 3  # calls, whose mean counts
_LEAST_BYTES = 10_000  # of a call whose delay is, for its most part, that of the transfer


@dataclass(slots=True)
class MeasuredPlace(Placed):
    """A place where calls to one server were made: how many, how many were answered, and their delays.

    `bits` and `transfer_s` sum the sizes and delays of the answered calls. `flights_ago` is the age of the last one.
    """

    tried: int = 0
    answered: int = 0
    bits: float = 0.0
    transfer_s: float = 0.0
    flights_ago: int = 0
    came_to_s: dict[Operation, tuple[float, ...]] = field(default_factory=dict)

    @property
    def goodput_bit_s(self) -> float | None:
        """Bits of answered calls per second of their delay, computing included; None if unknown."""
        return self.bits / self.transfer_s if self.bits > 0 and self.transfer_s > 0 else None

    @property
    def reached(self) -> bool:
        """Whether at least half of the calls from here were answered."""
        return 2 * self.answered >= self.tried

    def call_s(self, operation: Operation) -> float | None:
        """The mean delay (s) of the last three calls of the operation here; None if none was made."""
        known = self.came_to_s.get(operation)
        return None if known is None else sum(known) / len(known)

    def carry(self, size_bytes: int, transfer_s: float) -> None:
        """Add an answered call of `size_bytes` that took `transfer_s`; calls below 10 kB do not count."""
        if size_bytes >= _LEAST_BYTES:
            self.bits += 8 * size_bytes
            self.transfer_s += transfer_s

    def note(self, operation: Operation, came_to_s: float) -> None:
        """Add a call of the operation that took `came_to_s` seconds; of each operation the last three count."""
        self.came_to_s[operation] = (*self.came_to_s.get(operation, ()), came_to_s)[-_LATEST:]


class Coverage:
    """The measured places of each server without a range."""

    def __init__(self, places: Mapping[str, Collection[MeasuredPlace]]) -> None:
        self._places = {server: Grid(known, side_m=NEAR_M) for server, known in places.items()}

    @property
    def servers(self) -> Collection[str]:
        """The servers without a range."""
        return self._places.keys()

    def places(self, server: str) -> Iterator[MeasuredPlace]:
        """Every place where the server was measured."""
        return iter(self._places[server])

    def at(self, server: str, position: Position) -> MeasuredPlace | None:
        """The nearest measured place within 12 m; None if there is none, or for a server with a range."""
        nearest, nearest_m = None, NEAR_M
        for place in self._places[server].around(position) if server in self._places else ():
            if (distance_m := ground_distance_m(place.position, position)) <= nearest_m:
                nearest, nearest_m = place, distance_m
        return nearest

    def asked(self, server: str, position: Position, *, answered: bool) -> MeasuredPlace:
        """Count an attempt to reach the server from the position; return the place that counted it."""
        place = self.at(server, position)
        if place is None or ground_distance_m(place.position, position) > SAME_M:
            place = MeasuredPlace(Position(position.east_m, position.north_m))
            self._places[server].add(place)
        place.tried += 1
        place.answered += answered
        place.flights_ago = 0
        return place
