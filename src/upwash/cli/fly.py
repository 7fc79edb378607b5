"""upwash fly: flies a mission, and shows its course and its result.

Modules that draw are imported by the functions that use them: with rich they take 1.9 MB, which an unwatched flight
does not need.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import io
import sys
from collections.abc import Iterator, Sequence
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec.structs import replace

from upwash.cli.arguments import (
    CALLS,
    LIVE,
    Live,
    OneOf,
    config_of,
    flown_by,
    live_of,
    new_run_folder,
    option,
    warn_of_files,
    writes,
)
from upwash.cli.exit_codes import MEANINGS
from upwash.config.checks import never_offloaded
from upwash.config.drone import DroneConfig
from upwash.config.drone_file import read_drone_config, refuse_several
from upwash.config.places import waypoints
from upwash.drone.speed import photo_doubts
from upwash.errors import MissionStopped, NotKept, UsageError
from upwash.eventlog import log as event_log
from upwash.eventlog.results import read_result
from upwash.eventlog.schema import Event, MissionStarted
from upwash.launch.flight import fly
from upwash.launch.processes import ready_program
from upwash.launch.watchdog import COME_DOWN
from upwash.real.host.journal import Unwritten, Watcher, read_events
from upwash.report.exports import write_result
from upwash.report.record import record_of
from upwash.support.loading import extra, module_command
from upwash.support.progress import shown
from upwash.support.standard_streams import forgiving_streams
from upwash.support.text import counted

if TYPE_CHECKING:
    from rich.console import Console

_AT_ONCE = (
    "the program was stopped at once, and sends nothing more: a vehicle in the air goes on with what it was last "
    "told, take over with the remote control"
)


class Show(Enum):
    """What a flight leaves on standard output: its course and its result for a person, nothing, or one object."""

    PROGRESS = "progress"
    NOTHING = "nothing"
    JSON = "json"


EPILOG = "\n".join(("exit codes:", *(f"  {code:<4}{meaning}" for code, meaning in MEANINGS.items())))
ARGUMENTS = {
    "mission": option("survey, or path/to/file.py:function (default: as configured)", nargs="?"),
    **config_of("drone"),
    "--autopilot CONNECTION": "instead of the configured one",
    "log": OneOf(
        {
            "--log": writes("where the event log goes (default: runs/TIME/events.jsonl)"),
            "--resume LOG": writes("take up the mission that this event log is of, where it broke off"),
        }
    ),
    "shown": OneOf(
        {
            "--quiet": "print only problems",
            "--json": "print the result as one JSON object at the end, and nothing else",
            **CALLS,
        }
    ),
    **LIVE,
}


def run(options: argparse.Namespace) -> None:
    """Fly; returns when the mission is over."""
    config = flown_by(read_drone_config(options.config), options.autopilot)
    refuse_several(config, options.config, what="a flight")
    warn_of_files(config)
    for problem in never_offloaded(config):
        sys.stderr.write(f"upwash: warning: {problem}\n")
    for _, doubt in photo_doubts(config):
        sys.stderr.write(f"upwash: warning: {doubt}\n")
    log = options.resume or options.log or new_run_folder() / "events.jsonl"
    fly_with_progress(
        config,
        program=options.mission,
        log=log,
        takes_over=_takes_over(options, log),
        resumes=options.resume is not None,
        show=Show.JSON if options.json else Show.NOTHING if options.quiet else Show.PROGRESS,
        live=live_of(options),
        calls=options.calls,
    )


def _takes_over(options: argparse.Namespace, log: Path) -> list[str]:
    """The command of a program that ends this flight after this program was killed."""
    autopilot = ["--autopilot", options.autopilot] if options.autopilot else []
    arguments = [
        "fly",
        COME_DOWN,
        "--config",
        str(options.config),
        *autopilot,
        "--resume",
        str(log),
        "--quiet",
    ]
    return module_command("upwash", *arguments)


def fly_with_progress(
    config: DroneConfig,
    *,
    program: str | None = None,
    log: Path,
    resumes: bool = False,
    show: Show = Show.PROGRESS,
    live: Live | None = None,
    calls: bool = False,
    takes_over: Sequence[str] = (),
) -> None:
    """Fly the mission, and show its course and its result; raises the error that ended it early.

    With `resumes` the flight continues the mission of that log, and the result is that of the whole. What the mission
    itself prints goes to standard error with Show.JSON. With `live` a page of this machine shows
    the flight while it lasts; 0 is any port. With `calls` the result has a row for each call. `takes_over` is as for
    `fly`. Raises NotKept where the mission was flown, and a part of its log or of its output could not be written.
    """
    config, speed_why = _with_speed(config, program)
    unwritten, has_begun = Unwritten(), False

    def watch(event: Event) -> None:
        nonlocal has_begun
        has_begun = has_begun or isinstance(event, MissionStarted)

    with forgiving_streams() as output:

        def what_is_not_kept() -> list[str]:
            problems = _show_result(config, log, unwritten, show, calls=calls) if has_begun else []
            output.flush()
            if output.trouble:
                problems.append(f"standard output could not be written ({output.trouble.strerror})")
            return problems

        if live is not None and not resumes:
            log.parent.mkdir(parents=True, exist_ok=True)
            log.touch()  # the page shows a flight that has yet to begin
        try:
            with shown_live([log], live, photos=config.camera.folder), _shown(config, show) as followers:
                asyncio.run(
                    fly(
                        config,
                        program=program,
                        log=log,
                        resumes=resumes,
                        watchers=(watch, *followers),
                        unwritten=unwritten,
                        takes_over=takes_over,
                        speed_why=speed_why,
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


def _with_speed(config: DroneConfig, program: str | None) -> tuple[DroneConfig, str]:
    """The configuration with its ground speed, and why; a speed that is chosen is flown in simulation here.

    The simulation's missions print nothing: the mission is still to be flown.
    """
    if config.mission.speed == "given":
        return config, ""
    from upwash.lab.run import simulate
    from upwash.lab.speed import with_speed

    if program is not None:
        config = replace(config, mission=replace(config.mission, program=program))
    with shown("fly"), contextlib.redirect_stdout(io.StringIO()):
        return with_speed(config, simulate)


@contextlib.contextmanager
def shown_live(logs: Sequence[Path], live: Live | None, *, photos: Path | None = None) -> Iterator[None]:
    """Show the logs, which must exist, on a page until the end of the block.

    The page is served by a process of its own: no flight waits for it. Without `live` nothing is shown. `photos` is
    the folder of the photos that the logs name.
    """
    if live is None:
        yield
        return
    with extra("view"):
        import uvicorn  # noqa: F401 - asked here, as the page is another process's

    arguments = ["view", *map(str, logs), "--port", str(live.port)]
    arguments += ["--photos", str(photos)] if photos else []
    arguments += ["--tiles", str(live.tiles), "--credit", live.credit] if live.tiles else []
    with ready_program(f"{logs[0].stem}-view", logs[0].parent, *arguments) as address:
        _console(stderr=True).print(f"live view: {address}", soft_wrap=True)
        yield


@contextlib.contextmanager
def _shown(config: DroneConfig, show: Show) -> Iterator[tuple[Watcher, ...]]:
    """What follows the events of the flight to show its course."""
    if show is Show.PROGRESS:
        from upwash.eventlog.terminal import FlightProgress

        servers = [server.name for server in config.servers]
        with FlightProgress(servers, len(waypoints(config.mission)), _console()) as progress:
            yield (progress.follow,)
    else:
        with contextlib.redirect_stdout(sys.stderr) if show is Show.JSON else contextlib.nullcontext():
            yield ()


def _show_result(
    config: DroneConfig, log: Path, unwritten: Unwritten, show: Show, *, calls: bool
) -> list[str]:
    """Show the result of the flight, by its log and the events that the log lacks; returns the log's problems."""
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
            from upwash.eventlog.terminal import print_result

            paced = any(service.local_pace_s for service in config.services)
            servers = bool(config.servers)
            print_result(read_result(events), events, _console(), paced=paced, servers=servers, calls=calls)
            _console().print(f"event log: {log}", soft_wrap=True)
    except UsageError as error:
        problems.append(f"its result cannot be shown: {error}")
    return problems


def _console(*, stderr: bool = False) -> Console:
    from rich.console import Console

    return Console(markup=False, stderr=stderr)
