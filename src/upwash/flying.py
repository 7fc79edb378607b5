"""Flies with progress in the terminal and the result at the end."""

from __future__ import annotations

import asyncio
from pathlib import Path

from rich.console import Console

from upwash.config import DroneConfig, waypoints
from upwash.launch import fly
from upwash.real.journal import read_events
from upwash.results import RunResult, read_result
from upwash.terminal import Progress, print_result


def fly_with_progress(
    config: DroneConfig,
    *,
    program: str | None = None,
    log: Path,
    resumes: bool = False,
    console: Console | None = None,
) -> None:
    """Flies the mission, prints how it goes and what it came to; raises what ended it early.

    With `resumes` it takes up the mission that the log is of, and prints what all of it came to.
    """
    console = console or Console(markup=False)
    progress = Progress(config, len(waypoints(config.mission)), console)
    try:
        with progress:
            asyncio.run(fly(config, program=program, log=log, resumes=resumes, watchers=(progress.follow,)))
    finally:
        if progress.started and (result := read_log(log)).calls:
            paced = any(service.local_pace_s for service in config.services)
            print_result(result, console, paced=paced)
            console.print(f"event log: {log}", soft_wrap=True)


def read_log(log: Path) -> RunResult:
    """The result of the run that wrote the event log."""
    return read_result(read_events(log))
