"""Runs upwash's own commands as processes beside this one."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
from collections.abc import Iterator, Sequence
from pathlib import Path

from upwash.config import DroneConfig, pace_in_numbers
from upwash.core.geo import GeoPosition, LocalFrame, Position
from upwash.errors import UpwashError, UsageError
from upwash.support.loading import module_command

STOP_S = 5.0  # that a program has to end by itself
_HOME = Position(0.0, 0.0)


def ends_with_us() -> list[str]:
    """What a command is run through so that it ends where this process is killed; empty where nothing does that."""
    return ["setpriv", "--pdeathsig", "TERM"] if shutil.which("setpriv") else []


@contextlib.contextmanager
def ready_program(name: str, folder: Path, *arguments: str, through: Sequence[str] = ()) -> Iterator[str]:
    """Runs an upwash command until the end of the block, its log in the folder; yields its address once ready.

    `through` is a command that runs it, such as one that enters a namespace. A session of its own keeps a Ctrl-C at
    the terminal from it: the drone lands first. Where this process is killed, it ends too.
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
    """Runs a stand-in for the configured vehicle until the end of the block; yields how to connect to it.

    At its boot it stands at `start`.
    """
    home = config.mission.home
    if home is None:
        raise UsageError("mission.home is missing: a stand-in vehicle needs a place on the Earth")
    stands = LocalFrame(GeoPosition(home.latitude_deg, home.longitude_deg)).geo(start)
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
