"""Flies, shows how it goes, and tells what it came to.

What draws for a person is imported where it draws: with rich it is 1.9 MB, which a flight that nobody watches need
not hold.
"""

from __future__ import annotations

import asyncio
import contextlib
import sys
from collections.abc import Iterator, Mapping
from enum import Enum
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

from upwash import event_log
from upwash.config import DroneConfig, waypoints
from upwash.errors import MissionStopped, NotKept, UsageError
from upwash.launch import fly
from upwash.loading import extra
from upwash.narration import Narrator, counted
from upwash.real.journal import read_events
from upwash.real.log_file import Unwritten
from upwash.report.exports import write_result
from upwash.report.record import record_of
from upwash.results import RunResult, read_result
from upwash.running import ready_program
from upwash.streams import forgiving_streams

if TYPE_CHECKING:
    from rich.console import Console

    from upwash.terminal import Progress

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
    """Flies the mission, shows how it goes and what it came to; raises what ended it early.

    With `resumes` it takes up the mission that the log is of, and shows what all of it came to. What the mission
    itself prints goes to standard error where one object is shown. With `live_port` a page on that port of this
    machine shows the flight while it lasts; 0 is any port. Raises NotKept where it was flown, but not
    all of its log, or of what there was to print, could be written.
    """
    unwritten = Unwritten()
    with forgiving_streams() as output:
        progress = _progress(config) if show is Show.PROGRESS else _Unseen()

        def what_is_not_kept() -> list[str]:
            problems = _show_result(config, log, unwritten, show) if progress.started else []
            output.flush()
            if output.trouble:
                problems.append(f"standard output could not be written ({output.trouble.strerror})")
            return problems

        try:
            with (
                _shown_live(log, live_port, config.camera.folder, resumes=resumes),
                progress,
                contextlib.redirect_stdout(sys.stderr) if show is Show.JSON else contextlib.nullcontext(),
            ):
                watching = (progress.follow,)
                asyncio.run(
                    fly(
                        config,
                        program=program,
                        log=log,
                        resumes=resumes,
                        watchers=watching,
                        unwritten=unwritten,
                    )
                )
        except BaseException as error:
            for problem in what_is_not_kept():
                sys.stderr.write(f"upwash: {problem}\n")
            if isinstance(error, asyncio.CancelledError):
                raise MissionStopped(_AT_ONCE) from None
            raise
        problems = what_is_not_kept()
    if problems:
        raise NotKept(f"the mission was flown to its end, but {'; '.join(problems)}")


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

    def follow(self, event: Mapping[str, Any]) -> None:
        """Takes in one event."""
        self._narrator.tell(event)


def _progress(config: DroneConfig) -> Progress:
    from upwash.terminal import Progress

    return Progress(config, len(waypoints(config.mission)), _console())


def _console(*, stderr: bool = False) -> Console:
    from rich.console import Console

    return Console(markup=False, stderr=stderr)


def _show_result(config: DroneConfig, log: Path, unwritten: Unwritten, show: Show) -> list[str]:
    """Shows what the flight came to, by its log and what that lacks; returns what is wrong with the log."""
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
        elif (result := read_result(events)).calls and show is Show.PROGRESS:
            _print_result(result, config, log)
    except UsageError as error:
        problems.append(f"its result cannot be told: {error}")
    return problems


def _print_result(result: RunResult, config: DroneConfig, log: Path) -> None:
    from upwash.terminal import print_result

    console = _console()
    print_result(result, console, paced=any(service.local_pace_s for service in config.services))
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
        _console(stderr=True).print(f"live view: {address}", soft_wrap=True)
        yield


def read_log(log: Path) -> RunResult:
    """The result of the run that wrote the event log."""
    return read_result(event_log.stream(log))
