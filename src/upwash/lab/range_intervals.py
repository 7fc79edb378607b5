"""When a simulated drone was in range of what, whether it noticed or not."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NoReturn

from upwash.core.geo import Circle
from upwash.core.knowledge.ranges import Ranges
from upwash.sim.autopilot import ModelAutopilot

_HAIR_M = 0.01  # a drone that hovers on a border is now within and now without


@dataclass(frozen=True, slots=True)
class RangeInterval:
    """A time that the drone spent in range of a server, or within a hair of it; the last one has no end."""

    server: str
    from_s: float
    to_s: float = math.inf


async def observe(
    autopilot: ModelAutopilot, areas: Mapping[str, Circle], stays: list[RangeInterval]
) -> NoReturn:
    """Adds each stay as it begins, and ends it, until cancelled."""
    wider = {name: Circle(area.centre, area.radius_m + _HAIR_M) for name, area in areas.items()}
    ranges, circles = Ranges(wider), list(wider.values())
    begun: dict[str, int] = {}  # where in the list each stay is that has no end yet
    while True:
        now_s = asyncio.get_running_loop().time()
        for server in ranges.crossed(autopilot.position):
            if server in begun:
                number = begun.pop(server)
                stays[number] = replace(stays[number], to_s=now_s)
            else:
                begun[server] = len(stays)
                stays.append(RangeInterval(server, now_s))
        await autopilot.border_truly_crossed(circles)
