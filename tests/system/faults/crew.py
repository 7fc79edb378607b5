"""The programs of a flight under faults: processes in namespaces that can be killed, frozen and started again."""

from __future__ import annotations

import asyncio
import contextlib
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

from tests.system.faults.lateness import noting_waits, waits_of

from upwash.emulation.namespaces import inside

_RESTART_S = 0.5  # as a service manager waits
_READY_S = 20.0
_INSTANCE = "upwash.real.instances.instance"
PYTHON = (sys.executable, "-m")


class Daemon:
    """An edge server's daemon, which is started again when it is gone."""

    def __init__(self, file: Path, *, namespace: str, address: str, keys: Path) -> None:
        self.name = file.stem
        self._command = (*inside(namespace), *PYTHON)
        self._file = file
        self._address = address
        self._keys = keys
        self._log = file.with_suffix(".log")
        self._restarting = False
        self._process: asyncio.subprocess.Process | None = None

    async def start(self) -> None:
        self._process = await self._started("upwash", "serve", "--config", str(self._file))

    @property
    def pid(self) -> int:
        assert self._process is not None
        return self._process.pid

    @property
    def ended(self) -> bool:
        """Whether it has ended of itself, which no fault makes it do."""
        return not self._restarting and self._process is not None and self._process.returncode is not None

    def instances(self) -> list[int]:
        return instances_below(self.pid)

    async def restart(
        self, number: signal.Signals, *, impostor: str = "", after_s: float = _RESTART_S
    ) -> None:
        """Ends it by the signal and starts it again later; meanwhile an impostor may be in its place."""
        assert self._process is not None
        self._restarting = True
        self._process.send_signal(number)
        await self._process.wait()
        if impostor:
            program = "tests.system.faults.impostor"
            stranger = await self._started(program, impostor, self._address, str(self._keys), self.name)
            await asyncio.sleep(after_s)
            stranger.kill()
            await stranger.wait()
        else:
            await asyncio.sleep(after_s)
        await self.start()
        self._restarting = False

    async def _started(self, *arguments: str) -> asyncio.subprocess.Process:
        """A process that has said that it is ready."""
        with self._log.open("ab") as log:
            process = await asyncio.create_subprocess_exec(
                *self._command,
                *arguments,
                stdin=asyncio.subprocess.DEVNULL,
                stdout=asyncio.subprocess.PIPE,
                stderr=log,
            )
        assert process.stdout is not None
        async with asyncio.timeout(_READY_S):
            said = await process.stdout.readline()
        if b"ready" not in said:
            raise RuntimeError(f"{' '.join(arguments)} did not start: {self._log} says why")
        return process


class DroneProgram:
    """A drone's `upwash fly`, which is started again with --resume when it was killed."""

    def __init__(self, file: Path, *, namespace: str) -> None:
        self.name = file.stem
        self.log = file.with_suffix(".jsonl")
        self.exit_code: int | None = None
        self.killed = False  # by a fault, so that its flight is to be taken up again
        self._command = (*inside(namespace), *PYTHON, "upwash", "fly", "--config", str(file))
        self._printed = file.with_suffix(".printed")
        self._process: asyncio.subprocess.Process | None = None

    @property
    def pid(self) -> int:
        assert self._process is not None
        return self._process.pid

    def instances(self) -> list[int]:
        return instances_below(self.pid)

    async def fly(self) -> None:
        """Flies to the end of the mission, however often it is killed."""
        how = "--log"
        while True:
            self.killed = False
            with self._printed.open("ab") as printed:
                self._process = await asyncio.create_subprocess_exec(
                    *self._command,
                    *(how, str(self.log)),
                    stdin=asyncio.subprocess.DEVNULL,
                    stdout=printed,
                    stderr=printed,
                )
            with noting_waits(waits_of(self.log), lambda: [self.pid]):
                code = await self._process.wait()
            if not self.killed:
                self.exit_code = code
                return
            how = "--resume"
            await asyncio.sleep(_RESTART_S)


def instances_below(process: int) -> list[int]:
    """The service instances that a program runs, without the sandboxes around them."""
    return [descendant for descendant in _descendants(process) if _is_instance(descendant)]


def _is_instance(process: int) -> bool:
    with contextlib.suppress(OSError):
        words = Path(f"/proc/{process}/cmdline").read_bytes().split(b"\0")
        return words[0].decode() == sys.executable and _INSTANCE.encode() in words
    return False


def _descendants(process: int) -> Iterator[int]:
    with contextlib.suppress(OSError):
        for thread in Path(f"/proc/{process}/task").iterdir():
            for child in map(int, (thread / "children").read_text().split()):
                yield child
                yield from _descendants(child)
