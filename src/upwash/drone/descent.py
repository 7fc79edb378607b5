"""How much longer the vehicle is in the air, while the program brings it down."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Literal

from upwash.core.geo import Position
from upwash.core.vehicle.energy import UNKNOWN
from upwash.core.vehicle.way_down import WayDown
from upwash.ports import Autopilot

ComingDown = Literal["return", "land"]
_HOME = Position(0.0, 0.0)


class Descent:
    """Follows the vehicle's way down; `doing` says whether the program has the vehicle return, land, or neither."""

    def __init__(self, autopilot: Autopilot, *, doing: Callable[[], ComingDown | None]) -> None:
        self._autopilot = autopilot
        self._doing = doing
        self._begun: ComingDown | None = None
        self._way: WayDown | None = None

    @property
    def left_s(self) -> float | None:
        """Seconds to the ground; None where the program does not bring it down, or no longer has it."""
        vehicle = self._autopilot
        doing = self._doing() if vehicle.control.is_ours and not vehicle.stands else None
        if doing != self._begun:
            self._begun, self._way = doing, None if doing is None else self._begin(doing)
        if self._way is None:
            return None
        return self._way.left_s(vehicle.position, now_s=asyncio.get_running_loop().time())

    def _begin(self, doing: ComingDown) -> WayDown:
        facts, here = self._autopilot.energy, self._autopilot.position
        home = None if doing == "land" else facts.home or _HOME
        return WayDown(facts.way_home or UNKNOWN, here, home)
