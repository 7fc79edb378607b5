"""A service instance on this machine, in a process or a container: it gets its sockets from this program."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import socket
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path

import msgspec

from upwash.errors import InstanceError
from upwash.ports import Handed, InstanceSpec, ServiceProcess
from upwash.real.instances.control import Begin
from upwash.real.instances.instance_control import ControlledInstance, InstanceCallbacks, InstanceControl
from upwash.real.instances.output import chunks_of
from upwash.real.link.direct import Calls, direct_pair
from upwash.real.link.proxy import announcing_at
from upwash.real.link.streams import connected_pair, endpoint_of, hang_up, listening_socket
from upwash.support.background import end, first, only_logged, start

STOP_GRACE_S = 2.0
_numbers = itertools.count()  # of pairs, in their names
_INSIDE = "unix:/tmp/instance.sock"  # in its own /tmp


Run = Callable[[InstanceSpec, Handed], Awaitable[ServiceProcess]]


class LocalInstance(ControlledInstance):
    """An instance that `run` starts.

    It prints into a socket pair instead of a pipe of asyncio's: asyncio reports the end of a process only when its
    pipes are closed too, and a child that the service left behind would hold them open.
    """

    def __init__(self, spec: InstanceSpec, run: Run, callbacks: InstanceCallbacks) -> None:
        super().__init__(spec, callbacks)
        self._run = run
        self._calls: Calls | None = None
        self._path = ""  # of the socket to which callers are led
        self._files: list[Path] = []  # that its sockets leave
        self._running: ServiceProcess | None = None
        self._prints: asyncio.StreamWriter | None = None  # kept, or the socket would be closed with it
        self._listening: asyncio.Task[None] | None = None

    async def begin(self, begin: Begin, *, is_apart: bool) -> None:
        """Start the instance; returns when it is ready, raises InstanceError.

        An instance that `is_apart` cannot listen at an address of this machine, and behind a door each connection has
        a first line: both inherit the listening socket. Without an address, calls pass over a pair: `take_calls`.
        """
        listen, endpoint = begin.listen, ""
        if listen.startswith("unix:"):
            path = listen.removeprefix("unix:")
            self._files = [Path(path), Path(f"{path}-inside")]
        with contextlib.ExitStack() as stack:
            outside: socket.socket | None = None
            if not listen:
                with self._failing("did not start"):
                    self._calls, outside = await direct_pair()
                endpoint = f"pair:{next(_numbers)}"
            elif is_apart or self._lead is not None:
                with self._failing(f"cannot listen at {listen}"):
                    outside = listening_socket(listen)
                endpoint = endpoint_of(outside)
                begin = msgspec.structs.replace(begin, listen=_INSIDE if is_apart else f"{listen}-inside")
            if outside is not None:
                stack.enter_context(outside)
            control = await self._start(outside)
        try:
            address = await control.begin(begin)
        except EOFError:
            raise InstanceError(f"{self.spec.name} did not start: {await self.how_it_ended()}") from None
        if outside is not None:
            self.endpoint = endpoint
        else:
            self.endpoint = address if address.startswith("unix:") else f":{address.rpartition(':')[2]}"
        self._path = listen.removeprefix("unix:")
        await self.open()

    def take_calls(self) -> Calls:
        """The program's end of the pair to an instance without an address; only once."""
        assert self._calls is not None  # noqa: S101 - it began so, and nobody has it yet
        calls, self._calls = self._calls, None
        return calls

    async def open(self) -> None:
        """Lead callers to the instance through the door, if there is one."""
        await self._lead_to(announcing_at(self._path))

    async def how_it_ended(self) -> str:
        """How the instance ended, with its last lines of output, once it has."""
        assert self._running is not None and self._listening is not None  # noqa: S101 - it has begun
        code = await first(self._running.ended(), self._cut())
        if code is None:  # it runs on, although its control line is cut
            return self.control.fault or "it closed its control line"
        await self._running.end()  # what a crashed service had started
        await asyncio.wait([self._listening], timeout=STOP_GRACE_S)
        return self.control.fault or self._output.explain(code)

    async def end(self) -> None:
        """End the instance and all processes that it started; returns when they are gone."""
        await self._shut()
        if self._calls is not None:
            _, unused = self.take_calls()
            hang_up(unused.transport)
        try:
            if self._running is not None:
                await self._running.end()
        finally:  # also if the wait for its end is given up
            await self._hang_up()

    async def _hang_up(self) -> None:
        for file in self._files:
            file.unlink(missing_ok=True)
        await end(self._listening)
        self._output.close()
        if self._control is not None:
            await self._control.close()
        if self._prints is not None:
            self._prints.close()
            with contextlib.suppress(ConnectionError):
                await self._prints.wait_closed()

    async def _cut(self) -> None:
        await self.control.ended()
        if not self.control.fault:
            await asyncio.sleep(STOP_GRACE_S)

    @contextlib.contextmanager
    def _failing(self, how: str) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise InstanceError(f"{self.spec.name} {how}: {error}") from error

    async def _start(self, outside: socket.socket | None) -> InstanceControl:
        with contextlib.ExitStack() as theirs, self._failing("did not start"):
            (reports, orders), control = await connected_pair()
            theirs.enter_context(control)
            found = self._connect_control(reports, orders)
            (prints, self._prints), output = await connected_pair()
            theirs.enter_context(output)
            self._running = await self._run(self.spec, Handed(control, output, outside))
        self._listening = start(
            self._listen(prints), name=f"the output of {self.spec.name}", failed=only_logged
        )
        return found

    async def _listen(self, prints: asyncio.StreamReader) -> None:
        async for chunk in chunks_of(prints):
            self._output.add(chunk)
