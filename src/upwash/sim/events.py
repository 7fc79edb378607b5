"""At which waypoints of a simulated mission there is something to see."""

from __future__ import annotations

from collections.abc import Sequence

from upwash.config import EventConfig
from upwash.core.geo import Waypoint
from upwash.sim.chance import Chance


def eventful(event: EventConfig | None, waypoints: Sequence[Waypoint], chance: Chance) -> list[Waypoint]:
    """The waypoints with an event; by a probability each draws for itself, so that an order changes none."""
    if event is None:
        return []
    if event.every is not None:
        return [each for each in waypoints if each.index % event.every == event.offset]
    return [
        each
        for each in waypoints
        if chance.stream(f"event/{each.index}").random() < (event.probability or 0.0)
    ]
