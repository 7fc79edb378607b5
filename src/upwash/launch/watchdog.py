"""Ends a flight whose program stands still, as a mission can hold Python's lock: a process of its own stands by.

The program says each second that it goes on. After a silence the process kills it, and starts another that takes the
vehicle over, as `--resume` does, and ends the flight by `autopilot.on_failure`. A program that ends by itself, or is
killed by others, is none of its concern.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import select
import signal
import subprocess
import sys
from collections.abc import AsyncIterator, Sequence
from typing import TYPE_CHECKING

from upwash.errors import MissionStopped
from upwash.support.background import end, only_logged, start
from upwash.support.loading import module_command

if TYPE_CHECKING:
    from upwash.drone.api import Drone

SILENT_S = 20.0
_SIGN_S = 1.0
_KILLED_S = 5.0
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
        module_command(__name__, *arguments),
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


def _stand_by(signs: int, program: int, silent_s: float, takes_over: Sequence[str]) -> None:
    heard, patience_ms = select.poll(), None
    heard.register(signs, select.POLLIN)
    while heard.poll(patience_ms):
        if not os.read(signs, 4096):
            return
        patience_ms = round(1000 * silent_s)
    if os.getppid() != program:
        return
    os.kill(program, signal.SIGKILL)
    while heard.poll(1000 * _KILLED_S) and os.read(signs, 4096):
        pass
    nowhere = subprocess.DEVNULL  # a halted terminal may be why it stood still
    other = subprocess.Popen(takes_over, stdin=nowhere, stdout=nowhere, stderr=nowhere)  # noqa: S603 - as above
    sys.stderr.write(
        f"upwash: the program of the flight stood still for {silent_s:g} s: it was killed, and another ends the "
        "flight\n"
    )
    other.wait()


if __name__ == "__main__":
    _signs, _program, _silent_s, *_command = sys.argv[1:]
    _stand_by(int(_signs), int(_program), float(_silent_s), _command)
