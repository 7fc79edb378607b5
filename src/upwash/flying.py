"""Flies, shows how it goes, and tells what it came to."""

from __future__ import annotations

import asyncio
import contextlib
import sys
from collections.abc import Iterator
from enum import Enum
from pathlib import Path

from rich.console import Console

from upwash.config import DroneConfig, waypoints
from upwash.launch import fly
from upwash.loading import extra
from upwash.real.journal import read_events
from upwash.report.exports import write_result
from upwash.report.record import read_records
from upwash.results import RunResult, read_result
from upwash.running import ready_program
from upwash.terminal import Progress, print_result


class Show(Enum):
    """What a flight leaves on standard output: its course and its result for a person, nothing, or one object."""

    PROGRESS = "progress"
    NOTHING = "nothing"
    JSON = "json"


def fly_with_progress(
    config: DroneConfig,
    *,
    program: str | None = None,
    log: Path,
    resumes: bool = False,
    show: Show = Show.PROGRESS,
    live_port: int | None = None,
) -> None:
    """Flies the mission, shows how it goes and what it came to; raises what ended it early.

    With `resumes` it takes up the mission that the log is of, and shows what all of it came to. What the mission
    itself prints goes to standard error where one object is shown. With `live_port` a page on that port of this
    machine shows the flight while it lasts; 0 is any port.
    """
    console = Console(markup=False) if show is Show.PROGRESS else _silent_console()
    progress = Progress(config, len(waypoints(config.mission)), console)
    try:
        with (
            _shown_live(log, live_port, config.camera.folder, resumes=resumes),
            progress,
            contextlib.redirect_stdout(sys.stderr) if show is Show.JSON else contextlib.nullcontext(),
        ):
            asyncio.run(fly(config, program=program, log=log, resumes=resumes, watchers=(progress.follow,)))
    finally:
        if progress.started:
            _show_result(config, log, show, console)


def _silent_console() -> Console:
    """One that is no terminal even where there is one: else it would swallow what the mission prints."""
    return Console(quiet=True, force_terminal=False)


def _show_result(config: DroneConfig, log: Path, show: Show, console: Console) -> None:
    if show is Show.JSON:
        (record,) = read_records([log])
        sys.stdout.write(write_result(record) + "\n")
    elif (result := read_log(log)).calls:
        paced = any(service.local_pace_s for service in config.services)
        print_result(result, console, paced=paced)
        console.print(f"event log: {log}", soft_wrap=True)


@contextlib.contextmanager
def _shown_live(log: Path, port: int | None, photos: Path | None, *, resumes: bool) -> Iterator[None]:
    """Shows the log on a page until the end of the block, by a process of its own that the flight never waits for."""
    if port is None:
        yield
        return
    with extra("view"):
        import uvicorn  # noqa: F401 - asked here, as the page is another process's
    log.parent.mkdir(parents=True, exist_ok=True)
    if not resumes:
        log.touch()  # a flight that has yet to begin
    arguments = ["view", str(log), "--port", str(port)]
    arguments += ["--photos", str(photos)] if photos else []
    with ready_program(f"{log.stem}-view", log.parent, *arguments) as address:
        Console(stderr=True, markup=False).print(f"live view: {address}", soft_wrap=True)
        yield


def read_log(log: Path) -> RunResult:
    """The result of the run that wrote the event log."""
    return read_result(read_events(log))
