"""A flight as a program of its own: `upwash fly` as a process, from its start to its exit code."""

from __future__ import annotations

import asyncio
import contextlib
import signal
from collections.abc import Callable, Sequence
from pathlib import Path

from upwash.launch.processes import STOP_S
from upwash.support.lines import lines_of
from upwash.support.loading import module_command

INTERRUPTED = 130  # the exit code of a flight that a Ctrl-C has ended


class FlightProgram:
    """One `upwash fly` of that configuration and log; each line that it prints is told to `say`.

    `options` are more of the command's, and `through` is a command that runs it, such as one that enters a namespace.
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
        self._command = (*through, python, "-u", *fly, *options)  # unbuffered, as someone may be watching
        self._say = say
        self._process: asyncio.subprocess.Process | None = None
        self._stopped = asyncio.Event()

    async def run(self, *, after_s: float = 0.0) -> int:
        """Runs it after so many seconds, unless it is stopped before, and returns its exit code.

        Who is cancelled meanwhile ends it at once.
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
                await _end(process)

    def stop(self) -> None:
        """Has it end its mission and land, as a Ctrl-C would."""
        self._stopped.set()
        if self._process is not None and self._process.returncode is None:
            self._process.send_signal(signal.SIGINT)


async def _end(process: asyncio.subprocess.Process) -> None:
    process.terminate()
    try:
        await asyncio.wait_for(process.wait(), STOP_S)
    except TimeoutError:
        process.kill()
        await process.wait()
