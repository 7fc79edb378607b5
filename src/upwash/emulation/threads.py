"""Event loops inside namespaces: a thread's sockets are of the namespace that the thread has entered."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import AbstractAsyncContextManager
from typing import TypeVar

T = TypeVar("T")


@contextlib.contextmanager
def on_a_loop(
    enter: Callable[[], object], using: Callable[[], AbstractAsyncContextManager[T]]
) -> Iterator[T]:
    """Holds what `using` opens until the end of the block, on the loop of a thread that has entered a namespace."""
    ready: Future[tuple[T, Callable[[], object]]] = Future()

    async def hold() -> None:
        loop, over = asyncio.get_running_loop(), asyncio.Event()
        async with using() as held:
            ready.set_result((held, lambda: loop.call_soon_threadsafe(over.set)))
            await over.wait()

    def run() -> None:
        try:
            enter()
            asyncio.run(hold())
        except Exception as error:  # noqa: BLE001 - carried over to the thread that waits
            if not ready.done():
                ready.set_exception(error)

    thread = threading.Thread(target=run, name="namespace")
    thread.start()
    held, end = ready.result()
    try:
        yield held
    finally:
        end()
        thread.join()
