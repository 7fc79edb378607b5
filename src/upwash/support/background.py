"""Background work: tasks and threads that run beside their owner, and never fail in silence.

    beside(work)               for a block: work that fails cancels the block, which raises the failure.
    start(work, failed=...)    for an object: a failure is logged with its trace, then passed to `failed`.
    thread(work, failed=...)   the same in a thread.
    in_thread(work)            for a result of work that blocks: awaiting it raises its failure.
    kept_up(work)              for work that must not end: it runs again after a failure.
    begin(work)                for a result: awaiting the task raises its failure.
    first(work, ...)           for the first result of several.

An owner ends its tasks with `end`. Nothing else in upwash makes a thread, or a task outside an `asyncio.TaskGroup`.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import logging
import threading
from collections.abc import AsyncIterator, Callable, Coroutine
from typing import Any, NoReturn, TypeVar

from upwash.support.text import worded

T = TypeVar("T")
Failed = Callable[[Exception], object]  # what a failure leads to

_log = logging.getLogger("upwash.background")


def only_logged(_: Exception) -> None:
    """The consequence of a failure of work that its owner does not need."""


@contextlib.asynccontextmanager
async def beside(work: Coroutine[Any, Any, object], *, name: str) -> AsyncIterator[None]:
    """Run `work` until the end of the block; work that fails cancels the block, which raises the failure."""
    failures: tuple[BaseException, ...] = ()
    try:
        async with asyncio.TaskGroup() as group:
            task = group.create_task(work, name=name)
            yield
            task.cancel()
    except BaseExceptionGroup as both:
        failures = both.exceptions
    for failure in failures[:-1]:  # of the work, while the block failed by itself
        _report(name, failure)
    if failures:
        raise failures[-1]


def start(work: Coroutine[Any, Any, T], *, name: str, failed: Failed) -> asyncio.Task[T]:
    """A task whose failure is logged with its trace, and then passed to `failed`."""
    task = begin(work, name=name)

    def look(ended: asyncio.Task[T]) -> None:
        if not ended.cancelled() and isinstance(failure := ended.exception(), Exception):
            _report(name, failure)
            failed(failure)

    task.add_done_callback(look)
    return task


async def kept_up(
    work: Callable[[], Coroutine[Any, Any, object]],
    *,
    name: str,
    pause_s: float,
    failed: Failed = only_logged,
) -> NoReturn:
    """Run work that must not end: again, after a pause, whenever it has failed or ended.

    A failure is logged and passed to `failed` where it differs from the one before.
    """
    last = ""
    while True:
        try:
            await work()
        except Exception as failure:  # noqa: BLE001 - every one has the same consequence
            if (said := worded(failure)) != last:
                last = said
                _report(name, failure)
                failed(failure)
        await asyncio.sleep(pause_s)


def begin(work: Coroutine[Any, Any, T], *, name: str | None = None) -> asyncio.Task[T]:
    """A task whose owner awaits its result, and gets its failure there; asyncio logs a failure of a dropped task."""
    return asyncio.get_running_loop().create_task(work, name=name)


def now_s() -> float:
    """The time of the running event loop, in seconds."""
    return asyncio.get_running_loop().time()


async def end(*tasks: asyncio.Task[Any] | None) -> None:
    """Cancel the tasks, and return when they have ended."""
    running = [task for task in tasks if task is not None and not task.done()]
    for task in running:
        task.cancel()
    if running:
        await asyncio.wait(running)


def thread(work: Callable[[], object], *, name: str, failed: Failed) -> threading.Thread:  # noqa: TID251 - here alone
    """A thread that does not hold up the program's end; its failure is logged, and passed to `failed`, there."""

    def run() -> None:
        try:
            work()
        except Exception as failure:  # noqa: BLE001 - every one has the same consequence
            _report(name, failure)
            failed(failure)

    return threading.Thread(target=run, name=name, daemon=True)  # noqa: TID251 - here alone


async def in_thread(work: Callable[[], T], *, name: str) -> T:
    """The result or failure of `work` in a thread that does not hold up the program's end.

    A cancellation ends the wait, not the work.
    """
    loop = asyncio.get_running_loop()
    done: asyncio.Future[T] = loop.create_future()

    def settle(set_it: Callable[[], None]) -> None:
        if not done.done():
            set_it()

    def run() -> None:
        try:
            settled = functools.partial(done.set_result, work())
        except Exception as failure:  # noqa: BLE001 - passed on
            settled = functools.partial(done.set_exception, failure)
        with contextlib.suppress(RuntimeError):  # the loop is closed: nothing waits any more
            loop.call_soon_threadsafe(settle, settled)

    thread(run, name=name, failed=only_logged).start()
    return await done


def _report(name: str, failure: BaseException) -> None:
    _log.error("%s failed: %s: %s", name, type(failure).__name__, failure, exc_info=failure)


async def never() -> NoReturn:
    """Wait until cancelled."""
    await asyncio.get_running_loop().create_future()
    raise AssertionError("an unsettled future has ended")


async def first(*waits: Coroutine[Any, Any, T]) -> T:
    """The result of the first of them, or its failure; the others are cancelled and have ended by then."""
    tasks = [begin(wait) for wait in waits]
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        winner = next(task for task in tasks if task.done())
    finally:
        await end(*tasks)
    return winner.result()
