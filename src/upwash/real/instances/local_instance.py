"""One service instance on this machine, whatever runs it: it is spoken to over sockets that were handed to it."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import socket
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import msgspec

from upwash.errors import InstanceError
from upwash.ports import Answered, InstanceSpec
from upwash.real.instances.control import Begin
from upwash.real.instances.instance_control import InstanceControl
from upwash.real.instances.output import Output, chunks_of
from upwash.real.link.announced import announcing_at
from upwash.real.link.direct import Calls, direct_pair
from upwash.real.link.door import Lead, Passage
from upwash.real.link.streams import connected_pair, endpoint_of, hang_up, listening_socket
from upwash.support.background import end, only_logged, start
from upwash.support.waiting import first

STOP_GRACE_S = 2.0
_numbers = itertools.count()  # of pairs, in their names
_INSIDE = "unix:/tmp/instance.sock"  # in its own /tmp


@dataclass(frozen=True, slots=True)
class Handed:
    """The instance's ends: its control line, what it prints to, and where callers come if it does not listen."""

    control: socket.socket
    output: socket.socket
    outside: socket.socket | None


class Running(Protocol):
    """What runs an instance: a group of processes, or a container."""

    async def ended(self) -> int:
        """Returns its exit code, negative for a signal, when its first process has ended."""

    async def end(self) -> None:
        """Ends it with everything that it started; returns when it is gone."""


Run = Callable[[InstanceSpec, Handed], Awaitable[Running]]


class LocalInstance:
    """An instance that `run` starts: the control line to it, its output, and the way of callers to it.

    It prints into a socket pair instead of a pipe of asyncio's: the end of such a process is noticed only when its
    pipes are closed too, and a child that it left behind would hold them open.
    """

    def __init__(
        self,
        spec: InstanceSpec,
        run: Run,
        *,
        called: Callable[[str], None],
        answered: Answered,
        lead: Lead | None = None,
    ) -> None:
        self.endpoint = ""
        self.spec = spec
        self._run = run
        self._lead = lead
        self._called = called
        self._answered = answered
        self._passage: Passage | None = None
        self._calls: Calls | None = None
        self._path = ""  # of the socket to which callers are led
        self._files: list[Path] = []  # that its sockets leave
        self._running: Running | None = None
        self._output = Output(spec.name)
        self._prints: asyncio.StreamWriter | None = None  # kept, or the socket would be closed with it
        self._listening: asyncio.Task[None] | None = None
        self._control: InstanceControl | None = None

    async def begin(self, begin: Begin, *, is_apart: bool) -> None:
        """Starts it and tells it what to be; returns when it is ready, raises InstanceError.

        One that `is_apart` has no address to listen at, and behind a door each connection has a first line: it
        inherits the listening socket, and hands on what comes to it. Without an address the
        instance is called over a pair: `take_calls`.
        """
        listen, endpoint = begin.listen, ""
        if listen.startswith("unix:"):
            path = listen.removeprefix("unix:")
            self._files = [Path(path), Path(f"{path}-inside")]
        with contextlib.ExitStack() as stack:
            outside: socket.socket | None = None
            if not listen:
                outside = stack.enter_context(await self._pair())
                endpoint = f"pair:{next(_numbers)}"
            elif is_apart or self._lead is not None:
                outside = stack.enter_context(self._listen_at(listen))
                endpoint = endpoint_of(outside)
                begin = msgspec.structs.replace(begin, listen=_INSIDE if is_apart else f"{listen}-inside")
            control = await self._start(outside)
        try:
            address = await control.begin(begin)
        except EOFError:
            raise InstanceError(f"{self.spec.name} did not start: {await self.exited()}") from None
        if self._lead is not None:
            self._path = listen.removeprefix("unix:")
            await self._open()
        elif outside is not None:
            self.endpoint = endpoint
        else:
            self.endpoint = address if address.startswith("unix:") else f":{address.rpartition(':')[2]}"

    def take_calls(self) -> Calls:
        """The program's end of the pair to an instance without an address; only once."""
        assert self._calls is not None  # noqa: S101 - it began so, and nobody has it yet
        calls, self._calls = self._calls, None
        return calls

    async def admit(self, drones: frozenset[str], finishing: frozenset[str] = frozenset()) -> None:
        """Has only these drones get an answer; raises InstanceError where the instance does not confirm it."""
        await self.control.admit(drones, finishing)

    async def drain(self, why: str) -> None:
        """Has every further call refused for that reason; returns when none is under way, or nothing is left."""
        await self.control.drain(why)

    async def health(self) -> None:
        """Returns at its next sign of life; raises InstanceError where it is gone."""
        await self.control.health()

    async def exited(self) -> str:
        """Returns how it ended, with its last words, when it does."""
        assert self._running is not None and self._listening is not None  # noqa: S101 - it has begun
        code = await self._end_of(self._running)
        if code is None:
            return self.control.fault or "it closed its control line"
        await self._running.end()  # what a crashed service had started
        await asyncio.wait([self._listening], timeout=STOP_GRACE_S)
        return self.control.fault or self._output.explain(code)

    async def stop(self) -> None:
        """Ends it and everything that it started; returns when it is gone."""
        await self._shut()
        if self._calls is not None:
            _, unused = self.take_calls()
            hang_up(unused.transport)
        try:
            if self._running is not None:
                await self._running.end()
        finally:  # also where its end is given up
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

    @property
    def control(self) -> InstanceControl:
        """The control line to it, once it was started."""
        assert self._control is not None  # noqa: S101 - it has begun
        return self._control

    async def _open(self) -> None:
        """Leads callers to it, through the door."""
        assert self._lead is not None  # noqa: S101 - there is a door
        self._passage = await self._lead(self.spec.server, announcing_at(self._path))
        self.endpoint = self._passage.endpoint

    async def _shut(self) -> None:
        if self._passage is not None:
            await self._passage.close()
            self._passage = None

    async def _end_of(self, running: Running) -> int | None:
        """Its code when it has ended; None for one that goes on although its control line is cut."""
        return await first(running.ended(), self._cut())

    async def _cut(self) -> None:
        """Returns when this end has hung up, or the other end has for longer than it needs to end."""
        await self.control.ended()
        if not self.control.fault:
            await asyncio.sleep(STOP_GRACE_S)

    async def _pair(self) -> socket.socket:
        try:
            self._calls, theirs = await direct_pair()
        except OSError as error:
            raise InstanceError(f"{self.spec.name} did not start: {error}") from error
        return theirs

    def _listen_at(self, address: str) -> socket.socket:
        try:
            return listening_socket(address)
        except OSError as error:
            raise InstanceError(f"{self.spec.name} cannot listen at {address}: {error}") from error

    async def _start(self, outside: socket.socket | None) -> InstanceControl:
        with contextlib.ExitStack() as theirs:
            try:
                (reports, orders), control = await connected_pair()
                theirs.enter_context(control)
                self._control = InstanceControl(
                    self.spec.name,
                    self._called,
                    self._output,
                    answered=self._answered,
                    methods=self.spec.methods,
                    reports=reports,
                    orders=orders,
                )
                (prints, self._prints), output = await connected_pair()
                theirs.enter_context(output)
                self._running = await self._run(self.spec, Handed(control, output, outside))
            except OSError as error:
                raise InstanceError(f"{self.spec.name} did not start: {error}") from error
        self._listening = start(
            self._listen(prints), name=f"the output of {self.spec.name}", failed=only_logged
        )
        return self._control

    async def _listen(self, prints: asyncio.StreamReader) -> None:
        async for chunk in chunks_of(prints):
            self._output.add(chunk)
