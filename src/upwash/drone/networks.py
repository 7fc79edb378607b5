"""Networks that need no join, and networks that are in range by the drone's position alone.

Both need only a clock, and so are the same in simulation and on a computer without a radio.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, field

from upwash.core.geo import Position, Reach
from upwash.errors import NetworkError
from upwash.support.background import never, now_s


@dataclass(frozen=True, slots=True)
class NetworkCell:
    """Where a network can be joined, how long joining and leaving take, and whether it is on the air.

    `stretch` gives a factor on the duration of each join, for noise.
    """

    area: Reach
    join_s: float
    is_up: Callable[[], bool] = field(default=lambda: True)
    goes_down: Callable[[], Awaitable[None]] = never
    leave_s: float = 0.0
    stretch: Callable[[], float] = field(default=lambda: 1.0)


class PositionNetwork:
    """Joins a network after its `join_s`, if the drone is in one of its cells by then.

    Leaving keeps the radio busy for `leave_s`; only the next join waits for that.
    """

    def __init__(self, cells: Mapping[str, Sequence[NetworkCell]], position: Callable[[], Position]) -> None:
        self._cells = cells
        self._position = position
        self._joined: str | None = None
        self._free_s = 0.0  # when the radio is done with the network that was left last

    async def join(self, network: str, *, timeout_s: float) -> None:
        """Joins the network; raises NetworkError out of range, too late, or while another is joined.

        `timeout_s` counts from the time when the former network is left.
        """
        if self._joined is not None:
            raise NetworkError(f"cannot join {network} while {self._joined} is joined")
        cells = self._cells.get(network)
        if not cells:
            raise NetworkError(f"no network {network} is known: name it in a [[server]] table")
        await asyncio.sleep(max(0.0, self._free_s - now_s()))
        join_s = min(cell.join_s * cell.stretch() for cell in cells)
        await asyncio.sleep(min(join_s, timeout_s))
        if join_s > timeout_s:
            raise NetworkError(f"network {network} was not joined within {timeout_s:.1f} s")
        if not any(cell.is_up() and cell.area.contains(self._position()) for cell in cells):
            raise NetworkError(f"network {network} is out of range")
        self._joined = network

    async def lost(self) -> str:
        """Returns the reason once the network is off the air; it does not watch whether the drone leaves the area."""
        if self._joined is None:
            await never()
        while on_the_air := next((cell for cell in self._cells[self._joined] if cell.is_up()), None):
            await on_the_air.goes_down()
        return f"network {self._joined} is off the air"

    async def leave(self) -> None:
        """Leaves the joined network, if any."""
        if self._joined is not None:
            leave_s = min(cell.leave_s for cell in self._cells[self._joined])
            self._free_s = now_s() + leave_s
        self._joined = None


class NoNetwork:
    """A network without a join, for servers reached over the computer's present networks."""

    async def join(self, network: str, *, timeout_s: float) -> None:
        """Does nothing."""

    async def lost(self) -> str:
        """Never returns, as nothing was joined."""
        await never()

    async def leave(self) -> None:
        """Does nothing."""
