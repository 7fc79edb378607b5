"""A page that shows flights while they last, by a process of its own that no flight waits for."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path

from upwash.launch.processes import ready_program
from upwash.support.loading import extra


@contextlib.contextmanager
def shown_live(logs: Sequence[Path], port: int | None, *, photos: Path | None = None) -> Iterator[None]:
    """Shows the logs, which have to be there, on a page on that port until the end of the block; 0 is any port.

    Without a port nothing is shown. `photos` is where the photos are that the logs name.
    """
    if port is None:
        yield
        return
    with extra("view"):
        import uvicorn  # noqa: F401 - asked here, as the page is another process's
    from rich.console import Console

    arguments = ["view", *map(str, logs), "--port", str(port)]
    arguments += ["--photos", str(photos)] if photos else []
    with ready_program(f"{logs[0].stem}-view", logs[0].parent, *arguments) as address:
        Console(markup=False, stderr=True).print(f"live view: {address}", soft_wrap=True)
        yield
