"""Notes when the machine was late: `python -m tests.system.faults.lateness FILE`, until it is killed.

It only sleeps, with the priority of the flight's programs: whenever it wakes up late, so would they. A program that
has something to do may wait longer, for those that were before it: the kernel counts that.
"""

from __future__ import annotations

import contextlib
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

_PERIOD_S = 0.005
_WORTH_NOTING_S = 0.01
_LOOK_S = 0.1


def main(file: Path) -> None:
    with file.open("w", buffering=1) as noted:
        while True:
            slept_s = time.monotonic()
            time.sleep(_PERIOD_S)
            late_s = time.monotonic() - slept_s - _PERIOD_S
            if late_s > _WORTH_NOTING_S:
                now_s = time.time()
                noted.write(f"{now_s - late_s} {now_s}\n")


@contextlib.contextmanager
def noting_lateness(file: Path) -> Iterator[None]:
    """Notes it in a process of its own until the end of the block."""
    with subprocess.Popen([sys.executable, "-m", "tests.system.faults.lateness", str(file)]) as process:
        try:
            yield
        finally:
            process.kill()


def waits_of(log: Path) -> Path:
    """Where it is noted when the program of an event log waited for a processor."""
    return log.with_suffix(".waits")


@contextlib.contextmanager
def noting_waits(file: Path, processes: Callable[[], Iterable[int]]) -> Iterator[None]:
    """Adds to the file when threads of these programs waited for a processor, until the end of the block."""
    ended = threading.Event()

    def note() -> None:
        with file.open("a", buffering=1) as noted:
            waits = _Waits(processes())
            while not ended.wait(_LOOK_S):
                noted.write(waits.since_last_look(processes()))

    thread = threading.Thread(target=note)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


class _Waits:
    """For how long threads waited for a processor between one look and the next."""

    def __init__(self, processes: Iterable[int]) -> None:
        self._looked_s, self._before_ns = time.time(), _waited_ns(processes)

    def since_last_look(self, processes: Iterable[int]) -> str:
        """The line to note, which is empty where it is not worth it."""
        now_s, now_ns = time.time(), _waited_ns(processes)
        waited_ns = sum(ns - self._before_ns.get(thread, 0) for thread, ns in now_ns.items())
        waited_s = min(1e-9 * waited_ns, now_s - self._looked_s)
        self._looked_s, self._before_ns = now_s, now_ns
        return f"{now_s - waited_s} {now_s}\n" if waited_s > _WORTH_NOTING_S else ""


def _waited_ns(processes: Iterable[int]) -> dict[str, int]:
    """How long each thread has waited in the run queue so far: schedstat's second number."""
    waited_ns = {}
    for process in processes:
        with contextlib.suppress(OSError):  # the program has ended meanwhile
            for thread in Path(f"/proc/{process}/task").iterdir():
                with contextlib.suppress(OSError):  # this thread has
                    waited_ns[thread.name] = int((thread / "schedstat").read_text().split()[1])
    return waited_ns


def read_lateness(file: Path) -> list[tuple[float, float]]:
    """From when to when the machine was late, by the time of day."""
    if not file.exists():
        return []
    return [(float(from_s), float(to_s)) for from_s, to_s in map(str.split, file.read_text().splitlines())]


if __name__ == "__main__":
    main(Path(sys.argv[1]))
