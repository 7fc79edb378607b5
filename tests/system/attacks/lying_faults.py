"""A server that says of every call that the service raised there: `python -m tests.system.attacks.lying_faults`.

It names a class of its choice, upwash's own among them, to have the drone take that for the truth. Each line is a
flight past such a server: the class that was named, how the flight ended, how many of its photos had a result.
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from typing import Any
from unittest.mock import patch

import msgspec
from tests.scenarios import scenario, server

from upwash.core.admission.clients import Client
from upwash.errors import MissionFailed
from upwash.lab.run import Run, simulate
from upwash.sim.faults import FaultyServer
from upwash.sim.link import Handler

NAMED = (
    "upwash.drone.flight:AutopilotOverruled",
    "upwash.drone.coming_down:AutopilotOverruled",
    "upwash.errors:AutopilotOverruled",
    "upwash.drone.mission:MissionStopped",
    "upwash.drone.calling:UpwashError",
    "builtins:ValueError",
    "nobody.knows:This",
)
PHOTOS = 6


@contextlib.contextmanager
def lying(named: str) -> Iterator[None]:
    """Every server says of every call that it raised the class."""
    lie = msgspec.msgpack.encode({"fault": {"type": named, "message": "mission: the pilot has the vehicle"}})

    plug = FaultyServer.plug

    def plug_liar(self: FaultyServer, address: str, instance: Handler) -> None:
        async def answer(path: str, body: bytes, client: Client) -> bytes:
            await instance(path, body, client)  # which takes its time
            return lie

        plug(self, address, answer)

    with patch.object(FaultyServer, "plug", plug_liar):
        yield


def attack(named: str, **tables: Any) -> Run | str:
    """A survey past a server that is always in range and names that class; in words where its program raised."""
    near = server("s1", 0.0, 0.0, range_m=1000.0)
    with lying(named):
        try:
            return simulate(scenario(near, columns=3, rows=PHOTOS // 3, **tables))
        except MissionFailed as error:
            return str(error)


def main() -> int:
    """Makes every attack; returns how many ended a mission."""
    harmed = 0
    for named in NAMED:
        run = attack(named)
        if isinstance(run, str):
            line, results = run, 0
        else:
            results = len(run.result.calls)
            line = "completed" if run.result.completed else f"ended early: {run.failure}"
        harmed += line != "completed" or results != PHOTOS
        sys.stdout.write(f"{named}: {line}; {results} of {PHOTOS} photos have a result\n")
    return harmed


if __name__ == "__main__":
    sys.exit(main())
