"""Event loops inside namespaces: a thread's sockets are of the namespace that the thread has entered."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import AbstractAsyncContextManager
from typing import Any, TypeVar

T = TypeVar("T")


@contextlib.contextmanager
def on_a_loop(
    enter: Callable[[], object], using: Callable[[], AbstractAsyncContextManager[T]]
) -> Iterator[T]:
    """Holds what `using` opens until the end of the block, on the loop of a thread that has entered a namespace.

    A loop that ends earlier has its failure raised at the end of the block.
    """
    ready: Future[Any] = Future()  # what is held, and what ends that

    async def hold() -> None:
        loop, over = asyncio.get_running_loop(), asyncio.Event()
        async with using() as held:
            ready.set_result((held, lambda: loop.call_soon_threadsafe(over.set)))
            await over.wait()

    def run() -> None:
        enter()
        asyncio.run(hold())

    with ThreadPoolExecutor(1, "namespace") as threads:
        over: Future[Any] = threads.submit(run)
        wait((ready, over), return_when=FIRST_COMPLETED)
        if not ready.done():
            over.result()
        held, end = ready.result()
        try:
            yield held
        finally:
            with contextlib.suppress(RuntimeError):  # the loop has ended by itself, and the result says why
                end()
            over.result()
