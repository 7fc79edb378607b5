"""Ends a flight whose program stands still, as a mission can hold Python's lock: a process of its own stands by.

The program says each second that it goes on. After a silence the process kills it, and starts another that takes the
vehicle over, as `--resume` does, and ends the flight by `autopilot.on_failure`. A program that ends by itself, or is
killed by others, is none of its concern.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import subprocess
from collections.abc import AsyncIterator, Sequence
from typing import TYPE_CHECKING

from upwash.errors import MissionStopped
from upwash.support.background import end, only_logged, start
from upwash.support.loading import module_command

if TYPE_CHECKING:
    from upwash.drone.api import Drone

SILENT_S = 20.0
_SIGN_S = 1.0
_PROGRAM = "upwash.launch.standby"
COME_DOWN = f"{__name__}:come_down"


def come_down(_: Drone) -> None:
    """The mission of the program that takes over: none."""
    raise MissionStopped(f"the program of the flight stood still for {SILENT_S:g} s and was killed")


@contextlib.asynccontextmanager
async def watched(takes_over: Sequence[str]) -> AsyncIterator[None]:
    """In the block, have that command run after a silence of this program, which is killed then; none if empty."""
    if not takes_over:
        yield
        return
    theirs, ours = os.pipe()
    os.set_blocking(ours, False)
    arguments = (str(theirs), str(os.getpid()), str(SILENT_S), *takes_over)
    process = subprocess.Popen(  # noqa: ASYNC220, S603 - it begins before take-off; a module of this package
        module_command(_PROGRAM, *arguments),
        stdin=subprocess.DEVNULL,
        pass_fds=[theirs],
        start_new_session=True,  # Ctrl-C is for the flight
    )
    os.close(theirs)

    async def say() -> None:
        while True:
            with contextlib.suppress(OSError):
                os.write(ours, b".")
            await asyncio.sleep(_SIGN_S)

    saying = start(say(), name="signs to the watchdog", failed=only_logged)
    try:
        yield
    finally:
        await end(saying)
        os.close(ours)
        process.wait()
