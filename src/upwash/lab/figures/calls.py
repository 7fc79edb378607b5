"""The calls of a mission as figures show them: what each took, where it ran, and whether it waited."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum

from upwash.core.geo import Position
from upwash.core.knowledge.servers import CHECKING
from upwash.eventlog import schema
from upwash.eventlog.progress import CallPlaces
from upwash.eventlog.schema import Event


class Wait(Enum):
    """What was decided about a server that was not ready yet, and what came of it."""

    NOT_ASKED = ""
    WAITED = "waited for a server"
    IN_VAIN = "waited, ran on the drone"
    DECLINED = "did not wait"


@dataclass(frozen=True, slots=True)
class CallPoint:
    """One call as it is drawn."""

    waypoint: int
    delay_s: float
    server: str | None  # None for the drone
    wait: Wait


def read_call_points(events: Iterable[Event]) -> Iterator[CallPoint]:
    """The calls at waypoints, in the order of the events."""
    whereabouts = CallPlaces()
    decided: schema.Decided | None = None  # the first decision of the call; another follows a wait
    for event in events:
        whereabouts.take(event)
        match event:
            case schema.Decided():
                decided = decided or event
            case schema.Call():
                if whereabouts.of_call is not None and decided is not None:
                    yield CallPoint(whereabouts.of_call, event.delay_s, event.server, _wait(decided, event))
                decided = None


def _wait(decided: schema.Decided, call: schema.Call) -> Wait:
    if call.wait:
        return Wait.IN_VAIN if call.wait == "failed" else Wait.WAITED
    if decided.decision == "local" and decided.state in CHECKING:
        return Wait.DECLINED
    return Wait.NOT_ASKED


@dataclass(frozen=True, slots=True)
class Strip:
    """One server: the runs of waypoints in its range, and of those whose calls ran there, as first and last."""

    server: str
    in_range: Sequence[tuple[int, int]]
    used: Sequence[tuple[int, int]]


def strips(events: Iterable[Event], calls: Iterable[CallPoint]) -> list[Strip]:
    """Those of the servers that the mission knew of, by name."""
    plan = next((event for event in events if isinstance(event, schema.Planned)), schema.Planned(t=0.0))
    ran_at: dict[str | None, set[int]] = {}
    for call in calls:
        ran_at.setdefault(call.server, set()).add(call.waypoint)
    return [
        Strip(
            server,
            _runs(
                index
                for index, (east_m, north_m) in enumerate(plan.waypoints_m)
                if plan.ranges[server].contains(Position(east_m, north_m))
            ),
            _runs(ran_at.get(server, set())),
        )
        for server in sorted(plan.ranges)
    ]


def _runs(waypoints: Iterable[int]) -> list[tuple[int, int]]:
    """The first and last of each run of neighbours."""
    found: list[tuple[int, int]] = []
    for waypoint in sorted(waypoints):
        if found and waypoint == found[-1][1] + 1:
            found[-1] = (found[-1][0], waypoint)
        else:
            found.append((waypoint, waypoint))
    return found
