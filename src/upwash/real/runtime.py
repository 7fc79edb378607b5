"""Service instances as plain processes, each in a session of its own that is killed as a group."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import msgspec

from upwash.errors import InstanceError
from upwash.ports import Answered, InstanceSpec, ignored
from upwash.real.announced import announcing_at
from upwash.real.control import Begin
from upwash.real.door import Lead, Passage
from upwash.real.instance_control import InstanceControl
from upwash.real.output import Output, reading_pace
from upwash.real.sandbox import Sandbox, open_call_filter
from upwash.real.streams import endpoint_of, listening_socket

_STOP_GRACE_S = 2.0
_CHUNK_BYTES = 65536
_INSIDE = "unix:/tmp/instance.sock"  # in a sandbox's own /tmp
_SIGNALLED = 128


def sockets_in(folder: Path) -> Callable[[InstanceSpec], str]:
    """Has each instance listen at a unix socket of its own in the folder."""
    numbers = itertools.count()
    return lambda spec: f"unix:{folder}/{spec.name}-{next(numbers)}.sock"


class ProcessRuntime:
    """Starts each instance as a process that listens at `listen(spec)`, in the sandbox if there is one.

    With a way to `lead` callers to it, that address is a unix socket, and drones come through the door.
    """

    def __init__(
        self,
        listen: Callable[[InstanceSpec], str],
        *,
        max_message_bytes: int,
        lead: Lead | None = None,
        sandbox: Sandbox | None = None,
    ) -> None:
        self._listen = listen
        self._lead = lead
        self._max_message_bytes = max_message_bytes
        self._sandbox = sandbox

    async def start(
        self, spec: InstanceSpec, *, called: Callable[[str], None], answered: Answered = ignored
    ) -> ProcessInstance:
        """Returns when the instance is ready to serve; raises InstanceError, leaving nothing behind."""
        loop = asyncio.get_running_loop()
        paced_until_s = loop.time() + spec.start_pace_s
        instance = ProcessInstance(spec, called, answered, lead=self._lead)
        try:
            await instance.begin(self._begin(spec), self._sandbox)
            await asyncio.sleep(paced_until_s - loop.time())
        except BaseException:
            await instance.stop()
            raise
        return instance

    def _begin(self, spec: InstanceSpec) -> Begin:
        return Begin(
            program=spec.program.path,
            settings=dict(spec.program.settings),
            service=spec.service,
            listen=self._listen(spec),
            max_message_bytes=self._max_message_bytes,
            pace_s=spec.pace_s,
            heats=spec.heats,
            is_announced=self._lead is not None,
        )


class ProcessInstance:
    """A service process, the control with it, and what it prints.

    It prints into a socket pair instead of a pipe of asyncio's: the end of such a process is noticed only when its
    pipes are closed too, and a child that it left behind would hold them open.
    """

    def __init__(
        self,
        spec: InstanceSpec,
        called: Callable[[str], None],
        answered: Answered,
        *,
        lead: Lead | None = None,
    ) -> None:
        self.endpoint = ""
        self._lead = lead
        self._passage: Passage | None = None
        self._spec = spec
        self._called = called
        self._answered = answered
        self._is_in_sandbox = False
        self._process: asyncio.subprocess.Process | None = None
        self._output = Output(spec.name)
        self._control: InstanceControl | None = None
        self._prints: asyncio.StreamWriter | None = None  # kept, or the socket would be closed with it
        self._listening: asyncio.Task[None] | None = None

    async def begin(self, begin: Begin, sandbox: Sandbox | None = None) -> None:
        """Starts the process and tells it what to be; returns when it is ready, raises InstanceError.

        In a sandbox there is no address to listen at, and behind a door each connection has a first line: the process
        inherits the listening socket, and hands on what comes to it.
        """
        listen, endpoint = begin.listen, ""
        with contextlib.ExitStack() as stack:
            outside: socket.socket | None = None
            self._is_in_sandbox = sandbox is not None
            if sandbox is not None or self._lead is not None:
                outside = stack.enter_context(self._listen_at(listen))
                endpoint = endpoint_of(outside)
                inside = _INSIDE if sandbox else f"{listen}-inside"
                begin = msgspec.structs.replace(
                    begin, listen=inside, limits=sandbox.limits if sandbox else None
                )
            control = await self._spawn(sandbox, outside)
        try:
            address = await control.begin(begin)
        except EOFError:
            raise InstanceError(f"{self._spec.name} did not start: {await self.exited()}") from None
        if self._lead is not None:
            self._passage = await self._lead(self._spec.server, announcing_at(listen.removeprefix("unix:")))
            self.endpoint = self._passage.endpoint
        elif outside is not None:
            self.endpoint = endpoint
        else:
            self.endpoint = address if address.startswith("unix:") else f":{address.rpartition(':')[2]}"

    async def admit(self, drones: frozenset[str], finishing: frozenset[str] = frozenset()) -> None:
        """Has only these drones get an answer; raises InstanceError where the instance does not confirm it."""
        assert self._control is not None  # noqa: S101 - it has begun
        await self._control.admit(drones, finishing)

    async def drain(self, why: str) -> None:
        """Has every further call refused for that reason; returns when none is under way, or nothing is left."""
        assert self._control is not None  # noqa: S101 - it has begun
        await self._control.drain(why)

    async def exited(self) -> str:
        """Returns how the process ended, with its last words, when it does."""
        assert self._process is not None and self._listening is not None  # noqa: S101 - it has begun
        code = await self._end_of(self._process)
        if code is None:
            return self._fault() or "it closed its control line"
        if self._is_in_sandbox and _SIGNALLED < code < _SIGNALLED + signal.NSIG:
            code = _SIGNALLED - code  # as bubblewrap passes on how a process in it was killed
        self._signal_group(signal.SIGKILL)  # what a crashed service had started
        await asyncio.wait([self._listening], timeout=_STOP_GRACE_S)
        return self._fault() or self._output.explain(code)

    async def _end_of(self, process: asyncio.subprocess.Process) -> int | None:
        """The process's code when it has ended; None for one that goes on although its control line is cut."""
        ended = asyncio.create_task(process.wait())
        cut = asyncio.create_task(self._cut())
        try:
            await asyncio.wait([ended, cut], return_when=asyncio.FIRST_COMPLETED)
            return process.returncode
        finally:
            ended.cancel()
            cut.cancel()

    async def _cut(self) -> None:
        """Returns when this end has hung up, or the other end has for longer than the process needs to end."""
        assert self._control is not None  # noqa: S101 - it has begun
        await self._control.ended()
        if not self._control.fault:
            await asyncio.sleep(_STOP_GRACE_S)

    def _fault(self) -> str:
        assert self._control is not None  # noqa: S101 - it has begun
        return self._control.fault

    async def stop(self) -> None:
        """Ends the process and everything that it started; returns when it is gone."""
        if self._passage is not None:
            await self._passage.close()
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
        if self._listening is not None:
            self._listening.cancel()
        if self._control is not None:
            await self._control.close()
        if self._prints is not None:
            self._prints.close()
            with contextlib.suppress(ConnectionError):
                await self._prints.wait_closed()

    def _listen_at(self, address: str) -> socket.socket:
        try:
            return listening_socket(address)
        except OSError as error:
            raise InstanceError(f"{self._spec.name} cannot listen at {address}: {error}") from error

    async def _spawn(self, sandbox: Sandbox | None, outside: socket.socket | None) -> InstanceControl:
        control, their_control = socket.socketpair()
        output, their_output = socket.socketpair()
        try:
            reports, orders = await asyncio.open_connection(sock=control)
            self._control = InstanceControl(
                self._spec.name,
                self._called,
                self._output,
                answered=self._answered,
                methods=self._spec.methods,
                reports=reports,
                orders=orders,
            )
            prints, self._prints = await asyncio.open_connection(sock=output)
            inherited = [each.fileno() for each in (their_control, outside) if each is not None]
            command = [sys.executable, "-m", "upwash.real.instance", *map(str, inherited)]
            with contextlib.ExitStack() as stack:
                if sandbox is not None:
                    inherited.append(stack.enter_context(open_call_filter()))
                    command = sandbox.wrap(command, call_filter=inherited[-1], program=self._spec.program)
                self._process = await asyncio.create_subprocess_exec(
                    *command,
                    stdin=subprocess.DEVNULL,
                    stdout=their_output.fileno(),
                    stderr=their_output.fileno(),
                    pass_fds=inherited,
                    start_new_session=True,
                )
        except OSError as error:
            raise InstanceError(f"{self._spec.name} did not start: {error}") from error
        finally:
            their_control.close()
            their_output.close()
            if self._control is None:
                control.close()
            if self._prints is None:
                output.close()
        self._listening = asyncio.create_task(self._listen(prints))
        return self._control

    def _signal_group(self, number: signal.Signals) -> None:
        if self._process is not None:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(self._process.pid, number)

    async def _listen(self, prints: asyncio.StreamReader) -> None:
        pace, now_s = reading_pace(), asyncio.get_running_loop().time
        with contextlib.suppress(ConnectionError):
            while chunk := await prints.read(_CHUNK_BYTES):
                self._output.add(chunk)
                await asyncio.sleep(pace.take_anyway_s(len(chunk), now_s=now_s()))
