"""Service instances as plain processes, each in a session of its own that is killed as a group."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import signal
import socket
import sys
from collections import deque
from collections.abc import Callable

from upwash.errors import InstanceError
from upwash.ports import InstanceSpec
from upwash.real.control import Admit, Admitted, Begin, Called, Failed, Ready, from_instance, line
from upwash.real.credentials import Credentials

_log = logging.getLogger("upwash.instance")

_STOP_GRACE_S = 2.0
_ADMIT_S = 5.0
_LAST_WORDS = 5  # lines of output that are kept to explain a crash


class ProcessRuntime:
    """Starts each instance as a process that listens at `listen(spec)`."""

    def __init__(
        self,
        listen: Callable[[InstanceSpec], str],
        *,
        credentials: Credentials | None,
        max_message_bytes: int,
    ) -> None:
        self._listen = listen
        self._credentials = credentials
        self._max_message_bytes = max_message_bytes

    async def start(self, spec: InstanceSpec, *, called: Callable[[str], None]) -> ProcessInstance:
        """Returns when the instance is ready to serve; raises InstanceError, leaving nothing behind."""
        ours, theirs = socket.socketpair()
        with theirs:
            process = await asyncio.create_subprocess_exec(
                sys.executable,
                "-m",
                "upwash.real.instance",
                str(theirs.fileno()),
                stdin=asyncio.subprocess.DEVNULL,
                stdout=asyncio.subprocess.PIPE,
                stderr=asyncio.subprocess.STDOUT,
                pass_fds=(theirs.fileno(),),
                start_new_session=True,
            )
        reader, writer = await asyncio.open_connection(sock=ours)
        instance = ProcessInstance(spec, process, reader, writer, called)
        try:
            await instance.begin(self._begin(spec))
        except BaseException:
            await instance.stop()
            raise
        return instance

    def _begin(self, spec: InstanceSpec) -> Begin:
        credentials = self._credentials
        return Begin(
            program=spec.program,
            service=spec.service,
            listen=self._listen(spec),
            max_message_bytes=self._max_message_bytes,
            pace_s=spec.pace_s,
            authority=credentials.authority.decode() if credentials else "",
            certificate=credentials.certificate.decode() if credentials else "",
            key=credentials.key.decode() if credentials else "",
        )


class ProcessInstance:
    """A service process and the control socket to it."""

    def __init__(
        self,
        spec: InstanceSpec,
        process: asyncio.subprocess.Process,
        reader: asyncio.StreamReader,
        writer: asyncio.StreamWriter,
        called: Callable[[str], None],
    ) -> None:
        self.endpoint = ""
        self._spec = spec
        self._process = process
        self._reader = reader
        self._writer = writer
        self._called = called
        self._last_words: deque[str] = deque(maxlen=_LAST_WORDS)
        self._admissions: deque[asyncio.Future[None]] = deque()
        self._tasks = [asyncio.create_task(self._listen_to_output())]

    async def begin(self, begin: Begin) -> None:
        """Tells the process what to be; returns when it is ready, raises InstanceError if it cannot be."""
        self._writer.write(line(begin))
        text = await self._reader.readline()
        if not text:
            raise InstanceError(f"{self._spec.name} did not start: {await self.exited()}")
        match from_instance.decode(text):
            case Ready(address):
                # A port is enough: whoever calls knows how this machine is reached from there.
                self.endpoint = address if address.startswith("unix:") else f":{address.rpartition(':')[2]}"
            case Failed(why):
                raise InstanceError(f"{self._spec.name} did not start: {why}")
            case other:
                raise InstanceError(f"{self._spec.name} said {other} before it was ready")
        self._tasks.append(asyncio.create_task(self._listen_to_control()))

    async def admit(self, drones: frozenset[str]) -> None:
        """Has only these drones get an answer; raises InstanceError where the instance does not confirm it."""
        if self._writer.is_closing():
            raise InstanceError(f"{self._spec.name} is gone")
        confirmed = asyncio.get_running_loop().create_future()
        self._admissions.append(confirmed)
        self._writer.write(line(Admit(sorted(drones))))
        try:
            async with asyncio.timeout(_ADMIT_S):
                await confirmed
        except TimeoutError:
            raise InstanceError(f"{self._spec.name} does not answer its runtime") from None

    async def exited(self) -> str:
        """Returns how the process ended, with its last words, when it does."""
        code = await self._process.wait()
        self._signal_group(signal.SIGKILL)  # what a crashed service had started
        await asyncio.wait(self._tasks[:1], timeout=_STOP_GRACE_S)
        how = f"killed by {signal.Signals(-code).name}" if code < 0 else f"ended with code {code}"
        return f"{how}: {' / '.join(self._last_words)}" if self._last_words else how

    async def stop(self) -> None:
        """Ends the process and everything that it started; returns when it is gone."""
        self._signal_group(signal.SIGTERM)
        try:
            async with asyncio.timeout(_STOP_GRACE_S):
                await self._process.wait()
        except TimeoutError:
            pass
        finally:
            self._signal_group(signal.SIGKILL)
        await self._process.wait()
        for task in self._tasks:
            task.cancel()
        self._writer.close()
        with contextlib.suppress(ConnectionError):
            await self._writer.wait_closed()
        self._process._transport.close()  # type: ignore[attr-defined]

    def _signal_group(self, number: signal.Signals) -> None:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, number)

    async def _listen_to_control(self) -> None:
        async for text in self._reader:
            match from_instance.decode(text):
                case Called(drone):
                    self._called(drone)
                case Admitted() if self._admissions:
                    confirmed = self._admissions.popleft()
                    if not confirmed.done():
                        confirmed.set_result(None)
                case _:
                    _log.warning("%s said something out of turn", self._spec.name)
        for confirmed in self._admissions:
            if not confirmed.done():
                confirmed.set_exception(InstanceError(f"{self._spec.name} is gone"))

    async def _listen_to_output(self) -> None:
        assert self._process.stdout is not None  # noqa: S101
        async for text in self._process.stdout:
            words = text.decode(errors="replace").rstrip()
            self._last_words.append(words)
            _log.info("%s: %s", self._spec.name, words)
