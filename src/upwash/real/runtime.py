"""Service instances as plain processes, each in a session of its own that is killed as a group."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import re
import signal
import socket
import subprocess
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
_LONGEST_LINE = 1000
_CHUNK_BYTES = 65536
_LINE_END = re.compile(rb"[\r\n]+")


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
        instance = ProcessInstance(spec, called)
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
    """A service process, the control socket to it, and what it prints.

    It prints into a socket pair instead of a pipe of asyncio's: the end of such a process is noticed only when its
    pipes are closed too, and a child that it left behind would hold them open.
    """

    def __init__(self, spec: InstanceSpec, called: Callable[[str], None]) -> None:
        self.endpoint = ""
        self._spec = spec
        self._called = called
        self._process: asyncio.subprocess.Process | None = None
        self._last_words: deque[str] = deque(maxlen=_LAST_WORDS)
        self._admissions: deque[asyncio.Future[None]] = deque()
        self._writers: list[asyncio.StreamWriter] = []
        self._control: asyncio.StreamWriter | None = None
        self._output: asyncio.Task[None] | None = None
        self._reports: asyncio.Task[None] | None = None

    async def begin(self, begin: Begin) -> None:
        """Starts the process and tells it what to be; returns when it is ready, raises InstanceError."""
        reports = await self._spawn()
        assert self._control is not None  # noqa: S101 - of the process that was just spawned
        self._control.write(line(begin))
        text = await reports.readline()
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
        self._reports = asyncio.create_task(self._listen_to_reports(reports))

    async def admit(self, drones: frozenset[str]) -> None:
        """Has only these drones get an answer; raises InstanceError where the instance does not confirm it."""
        if self._control is None or self._reports is None or self._reports.done():
            raise InstanceError(f"{self._spec.name} is gone")
        confirmed: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._admissions.append(confirmed)
        self._control.write(line(Admit(sorted(drones))))
        try:
            async with asyncio.timeout(_ADMIT_S):
                await confirmed
        except TimeoutError:
            raise InstanceError(f"{self._spec.name} does not answer its runtime") from None

    async def exited(self) -> str:
        """Returns how the process ended, with its last words, when it does."""
        assert self._process is not None and self._output is not None  # noqa: S101 - it has begun
        code = await self._process.wait()
        self._signal_group(signal.SIGKILL)  # what a crashed service had started
        await asyncio.wait([self._output], timeout=_STOP_GRACE_S)
        how = f"killed by {signal.Signals(-code).name}" if code < 0 else f"ended with code {code}"
        return f"{how}: {' / '.join(self._last_words)}" if self._last_words else how

    async def stop(self) -> None:
        """Ends the process and everything that it started; returns when it is gone."""
        if self._process is not None:
            self._signal_group(signal.SIGTERM)
            try:
                async with asyncio.timeout(_STOP_GRACE_S):
                    await self._process.wait()
            except TimeoutError:
                pass
            finally:
                self._signal_group(signal.SIGKILL)
            await self._process.wait()
        for task in (self._output, self._reports):
            if task is not None:
                task.cancel()
        for writer in self._writers:
            writer.close()
            with contextlib.suppress(ConnectionError):
                await writer.wait_closed()

    async def _spawn(self) -> asyncio.StreamReader:
        control, their_control = socket.socketpair()
        output, their_output = socket.socketpair()
        try:
            reports, self._control = await asyncio.open_connection(sock=control)
            self._writers.append(self._control)
            prints, writer = await asyncio.open_connection(sock=output)
            self._writers.append(writer)  # kept, or the socket would be closed with it
            self._process = await asyncio.create_subprocess_exec(
                sys.executable,
                "-m",
                "upwash.real.instance",
                str(their_control.fileno()),
                stdin=subprocess.DEVNULL,
                stdout=their_output.fileno(),
                stderr=their_output.fileno(),
                pass_fds=(their_control.fileno(),),
                start_new_session=True,
            )
        except OSError as error:
            raise InstanceError(f"{self._spec.name} did not start: {error}") from error
        finally:
            their_control.close()
            their_output.close()
            if not self._writers:
                control.close()
            if len(self._writers) < 2:
                output.close()
        self._output = asyncio.create_task(self._listen_to_output(prints))
        return reports

    def _signal_group(self, number: signal.Signals) -> None:
        if self._process is not None:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(self._process.pid, number)

    async def _listen_to_reports(self, reports: asyncio.StreamReader) -> None:
        try:
            while text := await reports.readline():
                match from_instance.decode(text):
                    case Called(drone):
                        self._called(drone)
                    case Admitted() if self._admissions:
                        confirmed = self._admissions.popleft()
                        if not confirmed.done():
                            confirmed.set_result(None)
                    case _:
                        _log.warning("%s said something out of turn", self._spec.name)
        except ConnectionError:
            pass  # as good as its end
        finally:
            for confirmed in self._admissions:
                if not confirmed.done():
                    confirmed.set_exception(InstanceError(f"{self._spec.name} is gone"))

    async def _listen_to_output(self, prints: asyncio.StreamReader) -> None:
        """Logs what the service prints, progress bars and endless lines included."""
        rest = b""
        with contextlib.suppress(ConnectionError):
            while chunk := await prints.read(_CHUNK_BYTES):
                *whole, rest = _LINE_END.split(rest + chunk)
                rest = rest[-_LONGEST_LINE:]
                for text in whole:
                    self._note(text)
        self._note(rest)

    def _note(self, text: bytes) -> None:
        words = text[:_LONGEST_LINE].decode(errors="replace").strip()
        if words:
            self._last_words.append(words)
            _log.info("%s: %s", self._spec.name, words)
