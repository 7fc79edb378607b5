"""Flies, and shows the course and the result of the flight.

Modules that draw are imported by the functions that use them: with rich they take 1.9 MB, which an unwatched flight
does not need.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import sys
from enum import Enum
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

from upwash.cli.live import shown_live
from upwash.config import DroneConfig, waypoints
from upwash.errors import MissionStopped, NotKept, UsageError
from upwash.eventlog import log as event_log
from upwash.eventlog.narration import Narrator, counted
from upwash.eventlog.results import RunResult, read_result
from upwash.eventlog.schema import Event
from upwash.launch.flight import fly
from upwash.real.host.journal import read_events
from upwash.real.host.log_file import Unwritten
from upwash.report.exports import write_result
from upwash.report.record import record_of
from upwash.support.standard_streams import forgiving_streams

if TYPE_CHECKING:
    from rich.console import Console

    from upwash.eventlog.terminal import Progress

_AT_ONCE = (
    "the program was stopped at once, and sends nothing more: a vehicle in the air goes on with what it was last "
    "told, take over with the remote control"
)


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
    """Flies the mission, and shows its course and its result; raises the error that ended it early.

    With `resumes` it continues the mission of that log, and shows the result of the whole. What the mission
    itself prints goes to standard error where one object is shown. With `live_port` a page on that port of this
    machine shows the flight while it lasts; 0 is any port. Raises NotKept where the mission was
    flown, and a part of its log or of its output could not be written.
    """
    unwritten = Unwritten()
    flight = functools.partial(fly, config, program=program, log=log, resumes=resumes)
    with forgiving_streams() as output:
        progress = _progress(config) if show is Show.PROGRESS else _Unseen()

        def what_is_not_kept() -> list[str]:
            problems = _show_result(config, log, unwritten, show) if progress.started else []
            output.flush()
            if output.trouble:
                problems.append(f"standard output could not be written ({output.trouble.strerror})")
            return problems

        if live_port is not None and not resumes:
            _begin(log)
        try:
            with (
                shown_live([log], live_port, photos=config.camera.folder),
                progress,
                contextlib.redirect_stdout(sys.stderr) if show is Show.JSON else contextlib.nullcontext(),
            ):
                asyncio.run(flight(watchers=(progress.follow,), unwritten=unwritten))
        except BaseException as error:
            for problem in what_is_not_kept():
                sys.stderr.write(f"upwash: {problem}\n")
            if isinstance(error, asyncio.CancelledError):
                raise MissionStopped(_AT_ONCE) from None
            raise
        problems = what_is_not_kept()
    if problems:
        raise NotKept(f"the mission was flown to its end, but {'; '.join(problems)}")


def _begin(log: Path) -> None:
    """Makes the log of a flight that has yet to begin."""
    log.parent.mkdir(parents=True, exist_ok=True)
    log.touch()


class _Unseen:
    """Follows the events of a flight that is not shown."""

    def __init__(self) -> None:
        self._narrator = Narrator()

    def __enter__(self) -> _Unseen:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        pass

    @property
    def started(self) -> bool:
        """Whether the mission has begun."""
        return self._narrator.started

    def follow(self, event: Event) -> None:
        """Takes in one event."""
        self._narrator.tell(event)


def _progress(config: DroneConfig) -> Progress:
    from upwash.eventlog.terminal import Progress

    return Progress([server.name for server in config.servers], len(waypoints(config.mission)), _console())


def _console() -> Console:
    from rich.console import Console

    return Console(markup=False)


def _show_result(config: DroneConfig, log: Path, unwritten: Unwritten, show: Show) -> list[str]:
    """Shows the result of the flight, by its log and the events that the log lacks; returns the log's problems."""
    problems = []
    if unwritten.why:
        problems.append(
            f"the event log {log} lacks {counted(len(unwritten), 'event')} at its end ({unwritten.why}): "
            "the result has them, nothing else does"
        )
    try:
        events = [*read_events(log), *map(event_log.decode, unwritten.lines)]
        if show is Show.JSON:
            sys.stdout.write(write_result(record_of(events, log)) + "\n")
        elif show is Show.PROGRESS:
            _print_result(read_result(events), config, log)
    except UsageError as error:
        problems.append(f"its result cannot be told: {error}")
    return problems


def _print_result(result: RunResult, config: DroneConfig, log: Path) -> None:
    from upwash.eventlog.terminal import print_result

    console = _console()
    paced = any(service.local_pace_s for service in config.services)
    print_result(result, console, paced=paced, servers=bool(config.servers))
    console.print(f"event log: {log}", soft_wrap=True)


def read_log(log: Path) -> RunResult:
    """The result of the run that wrote the event log."""
    return read_result(event_log.EventLog(log))
