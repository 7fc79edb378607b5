"""Server networks that exist by position alone. It works on any clock, so a desk flight uses it too."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, field

from upwash.core.geo import Circle, Position
from upwash.errors import NetworkError
from upwash.sim.faults import never


@dataclass(frozen=True, slots=True)
class Cell:
    """Where a network can be joined, how long that takes, whether it is on the air now, and when it goes off it."""

    area: Circle
    join_s: float
    is_up: Callable[[], bool] = field(default=lambda: True)
    goes_down: Callable[[], Awaitable[None]] = never


class ModelNetwork:
    """Joins a network after its `join_s`, if the drone is in one of its cells by then."""

    def __init__(self, cells: Mapping[str, Sequence[Cell]], position: Callable[[], Position]) -> None:
        self._cells = cells
        self._position = position
        self._joined: str | None = None

    async def join(self, network: str, *, timeout_s: float) -> None:
        """Joins the network; raises NetworkError out of range, too late, or while another is joined."""
        if self._joined is not None:
            raise NetworkError(f"cannot join {network} while {self._joined} is joined")
        cells = self._cells.get(network)
        if not cells:
            raise NetworkError(f"no network {network} is known: name it in a [[server]] table")
        join_s = min(cell.join_s for cell in cells)
        await asyncio.sleep(min(join_s, timeout_s))
        if join_s > timeout_s:
            raise NetworkError(f"network {network} was not joined within {timeout_s:.1f} s")
        if not any(cell.is_up() and cell.area.contains(self._position()) for cell in cells):
            raise NetworkError(f"network {network} is out of range")
        self._joined = network

    async def lost(self) -> str:
        """Returns once the network is off the air; that the drone left its area, the drone itself notices."""
        if self._joined is None:
            await never()
        while on_the_air := next((cell for cell in self._cells[self._joined] if cell.is_up()), None):
            await on_the_air.goes_down()
        return f"network {self._joined} is off the air"

    async def leave(self) -> None:
        """Leaves the network that is joined, if any."""
        self._joined = None


class NoNetwork:
    """For servers that are always connected, by cable or by a network that is joined for good."""

    async def join(self, network: str, *, timeout_s: float) -> None:
        """Nothing to join."""

    async def lost(self) -> str:
        """Never: nothing was joined."""
        await never()

    async def leave(self) -> None:
        """Nothing to leave."""
