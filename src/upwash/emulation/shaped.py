"""The radio as shaped cables: as fast as a table says at the drone's distance, cut out of range."""

from __future__ import annotations

from collections.abc import Iterable

from upwash.config import true_range_m
from upwash.core.geo import Position, ground_distance_m
from upwash.emulation.field import Link
from upwash.emulation.namespaces import End, join_by_cable
from upwash.emulation.tools import command
from upwash.sim.radio import read_goodput

_FRAME_PER_PAYLOAD = 1514 / 1448  # bytes of a full TCP segment on the cable by those that goodput counts
_FASTEST_BIT_S = 1e9
_BURST_BYTES = 8_000  # what may pass at once: a few frames
_QUEUE_BYTES = (
    2_000_000  # several photos: one lost here would cost a timeout that no table of goodput knows of
)
_WORTH_A_CHANGE = 0.02  # of the rate


class ShapedRadio:
    """A cable for each link, shaped alike at both ends."""

    lag_s = 0.0  # the kernel shapes

    def __init__(self, links: Iterable[Link]) -> None:
        self._links: dict[str, list[_ShapedLink]] = {}
        for link in links:
            join_by_cable(link.drone_end, link.server_end)
            self._links.setdefault(link.drone, []).append(_ShapedLink(link))

    def move(self, drone: str, position: Position) -> None:
        """Shapes the drone's links anew."""
        for link in self._links[drone]:
            link.move(position)

    def close(self) -> None:
        """The cables go with their namespaces."""


class _ShapedLink:
    def __init__(self, link: Link) -> None:
        self._link = link
        self._table = read_goodput(link.server.truth.radio)
        self._rate_bit_s = -1.0
        self._shape(0.0)

    def move(self, position: Position) -> None:
        rate_bit_s = (
            self._goodput_bit_s(ground_distance_m(position, self._link.server_at)) * _FRAME_PER_PAYLOAD
        )
        if abs(rate_bit_s - self._rate_bit_s) > _WORTH_A_CHANGE * self._rate_bit_s or not rate_bit_s:
            self._shape(rate_bit_s)

    def _goodput_bit_s(self, distance_m: float) -> float:
        server = self._link.server
        if distance_m > true_range_m(server):
            return 0.0
        if self._table is not None:
            return self._table.at(distance_m)
        return server.bandwidth_bit_s or _FASTEST_BIT_S

    def _shape(self, rate_bit_s: float) -> None:
        if rate_bit_s == self._rate_bit_s:
            return
        self._rate_bit_s = rate_bit_s
        for end in (self._link.drone_end, self._link.server_end):
            command(*_queue(end), *_discipline(rate_bit_s))


def _queue(end: End) -> tuple[str, ...]:
    return ("tc", "-n", end.namespace, "qdisc", "replace", "dev", end.device, "root")


def _discipline(rate_bit_s: float) -> tuple[str, ...]:
    """A queue of that rate; one of rate 0 loses every frame, as the air does."""
    if rate_bit_s == 0:
        return ("blackhole",)
    return ("tbf", "rate", f"{rate_bit_s:.0f}bit", "burst", str(_BURST_BYTES), "limit", str(_QUEUE_BYTES))
