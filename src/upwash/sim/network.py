"""Server networks that exist by position alone. It works on any clock, so a desk flight uses it too."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from upwash.core.geo import Circle, Position
from upwash.errors import NetworkError


@dataclass(frozen=True, slots=True)
class Cell:
    """Where a network can be joined, how long that takes, and whether it is on the air now."""

    area: Circle
    join_s: float
    is_up: Callable[[], bool] = field(default=lambda: True)


class ModelNetwork:
    """Joins a network after its `join_s`, if the drone is in one of its cells by then."""

    def __init__(self, cells: Mapping[str, Sequence[Cell]], position: Callable[[], Position]) -> None:
        self._cells = cells
        self._position = position
        self._joined: str | None = None

    async def join(self, network: str) -> None:
        """Joins the network; raises NetworkError out of range, or while another is joined."""
        if self._joined is not None:
            raise NetworkError(f"cannot join {network} while {self._joined} is joined")
        cells = self._cells.get(network)
        if not cells:
            raise NetworkError(f"no network {network} is known: name it in a [[server]] table")
        await asyncio.sleep(min(cell.join_s for cell in cells))
        if not any(cell.is_up() and cell.area.contains(self._position()) for cell in cells):
            raise NetworkError(f"network {network} is out of range")
        self._joined = network

    async def leave(self) -> None:
        """Leaves the network that is joined, if any."""
        self._joined = None


class NoNetwork:
    """For servers that are always connected, by cable or by a network that is joined for good."""

    async def join(self, network: str) -> None:
        """Nothing to join."""

    async def leave(self) -> None:
        """Nothing to leave."""
