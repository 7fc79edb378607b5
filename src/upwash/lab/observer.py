"""The facts of a simulated world that an observer sees, and no program knows or reports.

The models name each event to an observer, and know nothing of what it keeps.

| event | with |
|---|---|
| `dialled` | a drone opens a link: server, and the address |
| `sent` | a drone sends a request: server, path, and where the drone is |
| `joined`, `left` | a drone, a network, and the radio |
| `computed` | a drone's own service has done a call: the operation, and how long it took |
| `asked`, `answered` | a drone's request reaches a daemon, and is answered: server, path |
| `held` | a daemon holds a slot for a drone, for at most `for_s`, at the request of the peer `by` |
| `instance_started`, `instance_ended` | server, service, endpoint; from the first moment of its start |
| `admitted` | the drones that an instance answers from now on |
| `served` | an instance begins a drone's call |
| `commanded` | a command of the drone's program reaches its vehicle |
| `taken` | a pilot, a ground station, a fail-safe or a restart takes the vehicle: `by` |
| `taken_unseen` | a fail-safe lands a vehicle that lands already, which no report shows: `by` |
| `given_back_unheard` | a pilot who took the vehicle and gives it back within one silence of its link |
| `reached` | the vehicle counts as arrived, or a waypoint as reached; `off_m` is the true distance to that place |
| `jumped_unheard` | its reported position jumps within a silence of the vehicle's link |
| `flight_over` | the drone, and its altitude |
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NoReturn

import msgspec

from upwash.core.admission.clients import Client
from upwash.core.geo import Circle, Position, Reach, distance_m
from upwash.core.knowledge.ranges import Ranges
from upwash.eventlog import schema
from upwash.ports import Journal
from upwash.rpc.protocol import HOLD, HoldReply, HoldRequest
from upwash.sim.autopilot import ModelAutopilot
from upwash.sim.link import Handler, Life, Observe


class Observation(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One observed fact: its name from the table above, and the fields that belong to it.

    `t` is the second of the simulation, `radio` counts from 0, and a time in seconds ends in `_s`.
    """

    t: float = msgspec.field(default_factory=lambda: round(asyncio.get_running_loop().time(), 6))
    event: str
    drone: str = ""
    server: str = ""
    path: str = ""
    address: str = ""
    position: Position | None = None
    network: str = ""
    radio: int = 0
    operation: str = ""
    took_s: float = 0.0
    by: str = ""
    for_s: float = 0.0
    service: str = ""
    drones: Sequence[str] = ()
    command: str = ""
    altitude_m: float = 0.0
    off_m: float = 0.0


def drone_observer(
    drone: str, seen: list[Observation], *, position: Callable[[], Position], life: Life
) -> Observe:
    """The observer of one drone while its computer is there; requests and the flight's end have its position."""

    def note(event: str, **facts: Any) -> None:
        if not life.is_over:
            place = position() if event in ("sent", "flight_over") else None
            seen.append(Observation(event=event, drone=drone, position=place, **facts))

    return note


@dataclass(frozen=True, slots=True)
class ObservedJournal:
    """The drone's event log; the observer sees how far truly from each waypoint it counts as reached.

    `spots` has the waypoints by their numbers.
    """

    journal: Journal
    spots: Mapping[int, Position]
    true_position: Callable[[], Position]
    observe: Observe

    def record(self, event: schema.Event) -> None:
        """Adds one event."""
        if isinstance(event, schema.Arrived) and event.waypoint is not None:
            self.observe("reached", off_m=distance_m(self.true_position(), self.spots[event.waypoint]))
        self.journal.record(event)


def server_observer(server: str, seen: list[Observation]) -> Observe:
    """The observer of one server."""

    def note(event: str, **facts: Any) -> None:
        seen.append(Observation(event=event, server=server, **facts))

    return note


def observed_daemon(handle: Handler, observe: Observe) -> Handler:
    """The daemon's handler; the observer sees its requests and the slots that it holds."""

    async def answer(path: str, body: bytes, client: Client) -> bytes:
        observe("asked", path=path, drone=client.name)
        reply = await handle(path, body, client)
        observe("answered", path=path, drone=client.name)
        if path == HOLD and msgspec.msgpack.decode(reply, type=HoldReply).held:
            hold = msgspec.msgpack.decode(body, type=HoldRequest)
            observe("held", drone=hold.drone, by=client.name, for_s=hold.for_s)
        return reply

    return answer


_HAIR_M = 0.01  # a drone that hovers on a border is now within and now without


@dataclass(frozen=True, slots=True)
class RangeInterval:
    """A time that the drone spent in range of a server, or within a hair of it; the last one has no end."""

    server: str
    from_s: float
    to_s: float = math.inf


async def observe_ranges(
    autopilot: ModelAutopilot, areas: Mapping[str, Reach], stays: list[RangeInterval]
) -> NoReturn:
    """Adds each stay as it begins, and ends it, until cancelled."""
    wider = {
        name: Circle(area.centre, area.radius_m + _HAIR_M) if isinstance(area, Circle) else area
        for name, area in areas.items()
    }
    ranges, circles = Ranges(wider), [area for area in wider.values() if isinstance(area, Circle)]
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
