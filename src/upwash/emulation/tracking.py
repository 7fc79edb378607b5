"""Where a drone is, from its vehicle's own stream."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass

from upwash.core.geo import LocalFrame, Position
from upwash.emulation.namespaces import enter
from upwash.real.autopilot import connect_autopilot


@dataclass(frozen=True, slots=True)
class Tracker:
    """A vehicle that is listened to; it says ten times a second where it is."""

    position: Callable[[], Position]  # relative to home
    end: Callable[[], object]


@contextlib.contextmanager
def tracked(connection: str, *, namespace: str, frame: LocalFrame) -> Iterator[Callable[[], Position]]:
    """Listens to the vehicle until the end of the block, and yields what tells its position, relative to home.

    Raises AutopilotError where it is not heard. It is reached from inside the namespace by a thread, whose sockets
    are of the namespace that it has entered.
    """
    heard: Future[Tracker] = Future()
    thread = threading.Thread(target=_run, args=(connection, namespace, frame, heard), name="tracker")
    thread.start()
    tracker = heard.result()
    try:
        yield tracker.position
    finally:
        tracker.end()
        thread.join()


def _run(connection: str, namespace: str, frame: LocalFrame, heard: Future[Tracker]) -> None:
    try:
        enter(namespace)
        asyncio.run(_listen(connection, frame, heard))
    except Exception as error:  # noqa: BLE001 - carried over to the thread that waits
        heard.set_exception(error)


async def _listen(connection: str, frame: LocalFrame, heard: Future[Tracker]) -> None:
    loop, over = asyncio.get_running_loop(), asyncio.Event()
    autopilot = await connect_autopilot(connection, frame=frame, ground_speed_m_s=1.0)
    heard.set_result(
        Tracker(position=lambda: autopilot.position, end=lambda: loop.call_soon_threadsafe(over.set))
    )
    try:
        await over.wait()
    finally:
        await autopilot.close()
