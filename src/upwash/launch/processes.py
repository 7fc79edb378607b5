"""Runs upwash's own commands as processes."""

from __future__ import annotations

import asyncio
import contextlib
import os
import shutil
import signal
import subprocess
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from upwash.config.drone import DroneConfig
from upwash.config.flight_times import pace_in_numbers
from upwash.core.geo import LocalFrame, Position
from upwash.errors import UpwashError, UsageError
from upwash.support.lines import lines_of
from upwash.support.loading import module_command

STOP_S = 5.0  # that a program has to end by itself
_HOME = Position(0.0, 0.0)
INTERRUPTED = 130  # the exit code of a flight that a Ctrl-C has ended


def ends_with_us() -> list[str]:
    """A prefix for commands that ends them when this process is killed; empty without `setpriv`."""
    return ["setpriv", "--pdeathsig", "TERM"] if shutil.which("setpriv") else []


@contextlib.contextmanager
def ready_program(name: str, folder: Path, *arguments: str, through: Sequence[str] = ()) -> Iterator[str]:
    """Run an upwash command until the end of the block, its log in the folder; yields its address once ready.

    `through` is a prefix, for example to enter a namespace. The command has a session of its own, without the
    terminal's Ctrl-C: the drone lands first. When this process is killed, the command ends too.
    """
    with (folder / f"{name}.log").open("wb") as log:
        process = subprocess.Popen(  # noqa: S603 - this very program
            [*through, *ends_with_us(), *module_command("upwash", *arguments)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=log,
            start_new_session=True,
            text=True,
        )
    assert process.stdout is not None  # noqa: S101
    try:
        said = process.stdout.readline()
        _, ready, address = said.strip().partition(" ready at ")
        if not ready:
            raise UpwashError(f"{name} did not start: {_last_words(folder / f'{name}.log')}")
        yield address
    finally:
        _end(process)
        process.stdout.close()


@contextlib.contextmanager
def ready_vehicle(
    name: str, folder: Path, config: DroneConfig, *, start: Position = _HOME, through: Sequence[str] = ()
) -> Iterator[str]:
    """Run a stand-in for the configured vehicle, at `start`, until the end of the block; yields its connection."""
    home = config.mission.home
    if home is None:
        raise UsageError("mission.home is missing: a stand-in vehicle needs a place on the Earth")
    stands = LocalFrame(home.place).geo(start)
    arguments = ["--listen", "udp:127.0.0.1:0", "--home", f"{stands.latitude_deg},{stands.longitude_deg}"]
    if config.vehicle.profile is None:
        arguments += ["--acceleration", str(pace_in_numbers(config.vehicle).acceleration_m_s2)]
    with ready_program(
        name, folder, "vehicle", *arguments, "--armable-after", "1", through=through
    ) as address:
        kind, host, port = address.split(":")
        yield f"{kind}out:{host}:{port}"


def _last_words(log: Path) -> str:
    lines = log.read_text(errors="replace").split("\n")
    return next((line for line in reversed(lines) if line.strip()), f"{log} does not say why")


def _end(process: subprocess.Popen[str]) -> None:
    process.terminate()
    try:
        process.wait(timeout=STOP_S)
    except subprocess.TimeoutExpired:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


class FlightProgram:
    """A process of `upwash fly` with that configuration and log; `say` gets each line that it prints.

    `options` are added to the command, and `through` is a prefix, for example to enter a namespace.
    """

    def __init__(
        self,
        config: Path,
        log: Path,
        *,
        say: Callable[[str], None],
        options: Sequence[str] = (),
        through: Sequence[str] = (),
    ) -> None:
        python, *fly = module_command("upwash", "fly", "--config", str(config), "--log", str(log))
        self._command = (*through, python, "-u", *fly, *options)  # unbuffered, for people who watch
        self._say = say
        self._process: asyncio.subprocess.Process | None = None
        self._stopped = asyncio.Event()

    async def run(self, *, after_s: float = 0.0) -> int:
        """Run the flight after `after_s`, unless it is stopped before; returns its exit code.

        A cancellation ends it at once.
        """
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._stopped.wait(), after_s)
        if self._stopped.is_set():
            return INTERRUPTED
        self._process = process = await asyncio.create_subprocess_exec(
            *self._command,
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.STDOUT,
        )
        assert process.stdout is not None  # noqa: S101
        try:
            async for line in lines_of(process.stdout):
                self._say(line.decode(errors="replace").rstrip("\r\n"))
            return await process.wait()
        finally:
            if process.returncode is None:
                process.terminate()
                try:
                    await asyncio.wait_for(process.wait(), STOP_S)
                except TimeoutError:
                    process.kill()
                    await process.wait()

    def stop(self) -> None:
        """Have the flight end its mission and land, like Ctrl-C."""
        self._stopped.set()
        if self._process is not None and self._process.returncode is None:
            self._process.send_signal(signal.SIGINT)
