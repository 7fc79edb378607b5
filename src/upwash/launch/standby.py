"""PROGRAM: stands by a flight for `watchdog`; it imports little, as it takes its memory in each flight."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
from collections.abc import Sequence

_KILLED_S = 5.0


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
