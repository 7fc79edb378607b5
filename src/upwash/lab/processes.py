"""Work spread over processes of this machine."""

from __future__ import annotations

import contextlib
import gc
import itertools
import multiprocessing
import os
import signal
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from typing import TypeVar

from upwash.errors import UpwashError
from upwash.support.background import thread

T = TypeVar("T")
R = TypeVar("R")

_AHEAD = 4  # parts for each process that are handed out before they are needed
_WORTH_STARTING_S = 2.0  # of computing: what two processes need before they are ready


@contextlib.contextmanager
def in_processes(
    do: Callable[[T], R], parts: Sequence[T], *, workers: int | None = None
) -> Generator[Iterator[R]]:
    """The results of the parts, as they come in; by default from one process for each core that may be used.

    Leaving early gives up the parts that have not begun.
    """
    processes = max(1, min(workers or cores(), len(parts)))
    pool = ProcessPoolExecutor(
        processes,
        mp_context=multiprocessing.get_context("spawn"),  # forking a process with threads is not safe
        initializer=_begin,
        initargs=(do,),  # which has a process import what it needs
    )
    try:
        yield _results(pool, do, parts, at_once=_AHEAD * processes)
    except BrokenProcessPool:
        raise UpwashError(
            "a process was killed, perhaps for want of memory; --workers 1 needs less of it"
        ) from None
    finally:
        pool.shutdown(cancel_futures=True)


def _results(
    pool: ProcessPoolExecutor, do: Callable[[T], R], parts: Sequence[T], *, at_once: int
) -> Iterator[R]:
    """The results as they come in; few parts are handed out at a time, to save memory."""
    left = iter(parts)
    with _without_ctrl_c():
        under_way = {pool.submit(do, part) for part in itertools.islice(left, at_once)}
    while under_way:
        done: set[Future[R]]
        done, under_way = wait(under_way, return_when=FIRST_COMPLETED)
        under_way |= {pool.submit(do, part) for part in itertools.islice(left, len(done))}
        for future in done:
            yield future.result()


@contextlib.contextmanager
def _without_ctrl_c() -> Iterator[None]:
    """Processes that start meanwhile ignore Ctrl-C, which this process gets at the end."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextlib.contextmanager
def here_first(
    do: Callable[[T], R], parts: Sequence[T], *, workers: int | None = None
) -> Generator[Iterator[R]]:
    """The results of the parts: from this process as long as others would take to start, the rest from those.

    One worker is this process alone.
    """

    def results() -> Generator[R]:
        ends_s = time.process_time() + _WORTH_STARTING_S
        left = deque(parts)
        while left and (workers == 1 or time.process_time() < ends_s):
            yield do(left.popleft())
        if left:
            with in_processes(do, left, workers=workers) as others:
                yield from others

    with contextlib.closing(results()) as all_of_them:
        yield all_of_them


def in_order(
    do: Callable[[T], R],
    parts: Sequence[T],
    *,
    workers: int | None = None,
    done: Callable[[], None] = lambda: None,
) -> list[R]:
    """The results in the order of the parts, computed as by `here_first`; calls `done` after each."""
    found: dict[int, R] = {}
    with here_first(partial(_numbered, do), list(enumerate(parts)), workers=workers) as results:
        for number, result in results:
            found[number] = result
            done()
    return [found[number] for number in range(len(parts))]


def _numbered(do: Callable[[T], R], part: tuple[int, T]) -> tuple[int, R]:
    return part[0], do(part[1])


def cores() -> int:
    """The number of processors that this process may use, which a container or taskset may reduce."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _begin(_do: Callable[[T], R]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to all; the first process ends the others
    thread(_end_with_parent, name="watch of the parent", failed=lambda _: os._exit(1)).start()
    gc.freeze()  # what was imported stays: the garbage collector need not look through it again and again


def _end_with_parent() -> None:
    """End this process when its parent is killed outright."""
    parent = multiprocessing.parent_process()
    assert parent is not None  # noqa: S101 - this runs in a child
    parent.join()
    os._exit(1)
