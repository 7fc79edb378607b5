"""Where a drone is, from its vehicle's own stream."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Callable, Iterator
from functools import partial

from upwash.core.geo import LocalFrame, Position
from upwash.emulation.namespaces import enter
from upwash.emulation.threads import on_a_loop
from upwash.real.mavlink import connect_autopilot


@contextlib.contextmanager
def tracked(connection: str, *, namespace: str, frame: LocalFrame) -> Iterator[Callable[[], Position]]:
    """Listens to the vehicle from inside the namespace until the end of the block; AutopilotError if it is not heard.

    Yields what tells its position, relative to home, which it says ten times a second.
    """
    with on_a_loop(partial(enter, namespace), partial(_listening, connection, frame)) as position:
        yield position


@contextlib.asynccontextmanager
async def _listening(connection: str, frame: LocalFrame) -> AsyncIterator[Callable[[], Position]]:
    autopilot = await connect_autopilot(
        connection, frame=frame, ground_speed_m_s=1.0
    )  # it is never told to fly
    try:
        yield lambda: autopilot.position
    finally:
        await autopilot.close()
