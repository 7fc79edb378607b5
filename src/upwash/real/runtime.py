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
from upwash.ports import Answered, InstanceSpec, unheard
from upwash.real.control import Begin
from upwash.real.conversation import Conversation
from upwash.real.credentials import Credentials
from upwash.real.output import Output
from upwash.real.sandbox import Sandbox

_STOP_GRACE_S = 2.0
_CHUNK_BYTES = 65536
_INSIDE = "unix:/tmp/instance.sock"  # in a sandbox's own /tmp
_SIGNALLED = 128
_BACKLOG = 64


def sockets_in(folder: Path) -> Callable[[InstanceSpec], str]:
    """Has each instance listen at a unix socket of its own in the folder."""
    numbers = itertools.count()
    return lambda spec: f"unix:{folder}/{spec.name}-{next(numbers)}.sock"


class ProcessRuntime:
    """Starts each instance as a process that listens at `listen(spec)`, in the sandbox if there is one."""

    def __init__(
        self,
        listen: Callable[[InstanceSpec], str],
        *,
        credentials: Credentials | None,
        max_message_bytes: int,
        sandbox: Sandbox | None = None,
    ) -> None:
        self._listen = listen
        self._credentials = credentials
        self._max_message_bytes = max_message_bytes
        self._sandbox = sandbox

    async def start(
        self, spec: InstanceSpec, *, called: Callable[[str], None], answered: Answered = unheard
    ) -> ProcessInstance:
        """Returns when the instance is ready to serve; raises InstanceError, leaving nothing behind."""
        loop = asyncio.get_running_loop()
        paced_until_s = loop.time() + spec.start_pace_s
        instance = ProcessInstance(spec, called, answered)
        try:
            await instance.begin(self._begin(spec), self._sandbox)
            await asyncio.sleep(paced_until_s - loop.time())
        except BaseException:
            await instance.stop()
            raise
        return instance

    def _begin(self, spec: InstanceSpec) -> Begin:
        credentials = self._credentials
        return Begin(
            program=spec.program.path,
            settings=dict(spec.program.settings),
            service=spec.service,
            listen=self._listen(spec),
            max_message_bytes=self._max_message_bytes,
            pace_s=spec.pace_s,
            authority=credentials.authority.decode() if credentials else "",
            certificate=credentials.certificate.decode() if credentials else "",
            key=credentials.key.decode() if credentials else "",
        )


class ProcessInstance:
    """A service process, the conversation with it, and what it prints.

    It prints into a socket pair instead of a pipe of asyncio's: the end of such a process is noticed only when its
    pipes are closed too, and a child that it left behind would hold them open.
    """

    def __init__(self, spec: InstanceSpec, called: Callable[[str], None], answered: Answered) -> None:
        self.endpoint = ""
        self._spec = spec
        self._called = called
        self._answered = answered
        self._process: asyncio.subprocess.Process | None = None
        self._output = Output(spec.name)
        self._conversation: Conversation | None = None
        self._prints: asyncio.StreamWriter | None = None  # kept, or the socket would be closed with it
        self._listening: asyncio.Task[None] | None = None

    async def begin(self, begin: Begin, sandbox: Sandbox | None = None) -> None:
        """Starts the process and tells it what to be; returns when it is ready, raises InstanceError.

        In a sandbox there is no address to listen at: the process inherits the listening socket.
        """
        address = begin.listen
        with contextlib.ExitStack() as stack:
            outside: socket.socket | None = None
            if sandbox is not None:
                outside = stack.enter_context(self._listen_at(begin.listen))
                address = _address(outside)
                begin = msgspec.structs.replace(begin, listen=_INSIDE, limits=sandbox.limits)
            conversation = await self._spawn(sandbox, outside)
        try:
            inside = await conversation.begin(begin)
        except EOFError:
            raise InstanceError(f"{self._spec.name} did not start: {await self.exited()}") from None
        address = inside if sandbox is None else address
        # A port is enough: whoever calls knows how this machine is reached from there.
        self.endpoint = address if address.startswith("unix:") else f":{address.rpartition(':')[2]}"

    async def admit(self, drones: frozenset[str]) -> None:
        """Has only these drones get an answer; raises InstanceError where the instance does not confirm it."""
        assert self._conversation is not None  # noqa: S101 - it has begun
        await self._conversation.admit(drones)

    async def drain(self, why: str) -> None:
        """Has every further call refused for that reason; returns when none is under way, or nothing is left."""
        assert self._conversation is not None  # noqa: S101 - it has begun
        await self._conversation.drain(why)

    async def exited(self) -> str:
        """Returns how the process ended, with its last words, when it does."""
        assert self._process is not None and self._listening is not None  # noqa: S101 - it has begun
        code = await self._process.wait()
        if code > _SIGNALLED:  # as bubblewrap passes on how a process in it was killed
            code = _SIGNALLED - code
        self._signal_group(signal.SIGKILL)  # what a crashed service had started
        await asyncio.wait([self._listening], timeout=_STOP_GRACE_S)
        return self._output.explain(code)

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
        if self._listening is not None:
            self._listening.cancel()
        if self._conversation is not None:
            await self._conversation.close()
        if self._prints is not None:
            self._prints.close()
            with contextlib.suppress(ConnectionError):
                await self._prints.wait_closed()

    def _listen_at(self, address: str) -> socket.socket:
        try:
            return _listening_socket(address)
        except OSError as error:
            raise InstanceError(f"{self._spec.name} cannot listen at {address}: {error}") from error

    async def _spawn(self, sandbox: Sandbox | None, outside: socket.socket | None) -> Conversation:
        control, their_control = socket.socketpair()
        output, their_output = socket.socketpair()
        try:
            reports, orders = await asyncio.open_connection(sock=control)
            self._conversation = Conversation(
                self._spec.name,
                self._called,
                self._output,
                answered=self._answered,
                reports=reports,
                orders=orders,
            )
            prints, self._prints = await asyncio.open_connection(sock=output)
            inherited = [each.fileno() for each in (their_control, outside) if each is not None]
            command = [sys.executable, "-m", "upwash.real.instance", *map(str, inherited)]
            self._process = await asyncio.create_subprocess_exec(
                *(sandbox.wrap(command, program=self._spec.program) if sandbox else command),
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
            if self._conversation is None:
                control.close()
            if self._prints is None:
                output.close()
        self._listening = asyncio.create_task(self._listen(prints))
        return self._conversation

    def _signal_group(self, number: signal.Signals) -> None:
        if self._process is not None:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(self._process.pid, number)

    async def _listen(self, prints: asyncio.StreamReader) -> None:
        with contextlib.suppress(ConnectionError):
            while chunk := await prints.read(_CHUNK_BYTES):
                self._output.add(chunk)


def _listening_socket(address: str) -> socket.socket:
    if address.startswith("unix:"):
        path = Path(address.removeprefix("unix:"))
        path.unlink(missing_ok=True)  # of an instance that has ended
        listening = socket.socket(socket.AF_UNIX)
        listening.bind(str(path))
        listening.listen(_BACKLOG)
        return listening
    host, _, port = address.rpartition(":")
    family, _, _, _, place = socket.getaddrinfo(host.strip("[]"), int(port), type=socket.SOCK_STREAM)[0]
    is_any = family == socket.AF_INET6 and place[0] == "::"
    return socket.create_server(place[:2], family=family, backlog=_BACKLOG, dualstack_ipv6=is_any)


def _address(listening: socket.socket) -> str:
    name = listening.getsockname()
    return f"unix:{name}" if isinstance(name, str) else f":{name[1]}"
