"""Flies with progress in the terminal and the result at the end."""

from __future__ import annotations

import asyncio
from pathlib import Path

import msgspec
from rich.console import Console

from upwash.config import DroneConfig, waypoints
from upwash.launch import fly
from upwash.results import RunResult, read_result
from upwash.terminal import Progress, print_result


def fly_with_progress(
    config: DroneConfig, *, program: str | None = None, log: Path, console: Console | None = None
) -> None:
    """Flies the mission, prints how it goes and what it came to; raises what ended it early."""
    console = console or Console(markup=False)
    progress = Progress(config, len(waypoints(config.mission)), console)
    try:
        with progress:
            asyncio.run(fly(config, program=program, log=log, watchers=(progress.follow,)))
    finally:
        if progress.started and (result := read_log(log)).calls:
            paced = any(service.local_pace_s for service in config.services)
            print_result(result, console, paced=paced)
            console.print(f"event log: {log}", soft_wrap=True)


def read_log(log: Path) -> RunResult:
    """The result of the run that wrote the event log."""
    with log.open("rb") as lines:
        return read_result(msgspec.json.decode(line) for line in lines)
