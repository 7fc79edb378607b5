"""One service that runs in a container."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable

import msgspec

from upwash.core.visitors import Visitor
from upwash.errors import EngineError, InstanceError
from upwash.ports import Answered
from upwash.real.announced import announcement
from upwash.real.control import Begin
from upwash.real.conversation import LONGEST_LINE_BYTES, Conversation
from upwash.real.door import Lead, Passage
from upwash.real.leash import CONTROL_PORT, SERVICE_PORT, Leash, new_leash, notice_silence
from upwash.real.lxd.container import Container
from upwash.real.lxd.engine import Engine
from upwash.real.output import Output
from upwash.real.streams import CHUNK_BYTES, Streams

_log = logging.getLogger("upwash.lxd")

_START_S = 20.0
_STOP_S = 10.0
_FREEZE_S = 5.0
_REACHED_S = 10.0  # from the start of a container until its process 1 answers
_RETRY_S = 0.02
_ANSWERS_S = 5.0


class ContainerInstance:
    """A service in a container, from its start until it is stopped or frozen."""

    def __init__(
        self,
        container: Container,
        *,
        name: str,
        engine: Engine,
        lost: Callable[[str], None],
        keep: Callable[[ContainerInstance], None] | None,
        lead: Lead,
    ) -> None:
        self.container = container
        self.endpoint = ""  # of a passage through the daemon's door
        self._lead = lead
        self._passage: Passage | None = None
        self._leash: Leash = new_leash()  # of the service: the container's own is its process 1's
        self._lost = lost  # is told the member of one that ended without a word
        self._name = name
        self._engine = engine
        self._keep = keep  # takes the instance once it is frozen
        self._output = Output(name)
        self._conversation: Conversation | None = None
        self._stopped = asyncio.Event()

    async def begin(
        self, begin: Begin, *, called: Callable[[str], None], answered: Answered, methods: frozenset[str]
    ) -> None:
        """Starts the container and tells it what to be; returns when it answers, raises InstanceError."""
        name = self.container.name
        await self._engine.change(name, "start", wait_s=_START_S)
        reports, orders = await self._reach()
        self._conversation = Conversation(
            self._name,
            called,
            self._output,
            answered=answered,
            methods=methods,
            reports=reports,
            orders=orders,
        )
        try:
            await self._conversation.begin(msgspec.structs.replace(begin, leash=self._leash.text()))
        except EOFError:
            raise InstanceError(f"{self._name} did not start: {self._how_it_ended()}") from None
        await self._open()

    async def resume(self, *, called: Callable[[str], None], answered: Answered) -> None:
        """Has a frozen instance serve again; raises InstanceError."""
        assert self._conversation is not None  # noqa: S101 - it has begun
        self._stopped.clear()
        self._conversation.called, self._conversation.answered = called, answered
        await self._engine.change(self.container.name, "unfreeze", wait_s=_FREEZE_S)
        await self._conversation.admit(frozenset())
        await self._open()

    async def admit(self, drones: frozenset[str]) -> None:
        """Has only these drones get an answer; raises InstanceError where the instance does not confirm it."""
        assert self._conversation is not None  # noqa: S101 - it has begun
        await self._conversation.admit(drones)

    async def drain(self, why: str) -> None:
        """Has every further call refused for that reason; returns when none is under way, or nothing is left.

        It never answers again, and is not kept.
        """
        assert self._conversation is not None  # noqa: S101 - it has begun
        self._keep = None
        await self._conversation.drain(why)

    async def exited(self) -> str:
        """Returns how the service ended, with its last words, when it does."""
        assert self._conversation is not None  # noqa: S101 - it has begun
        gone = asyncio.create_task(self._conversation.ended())
        stopped = asyncio.create_task(self._stopped.wait())
        try:
            await asyncio.wait([gone, stopped], return_when=asyncio.FIRST_COMPLETED)
            return "stopped" if self._stopped.is_set() else self._how_it_ended()
        finally:
            gone.cancel()
            stopped.cancel()

    async def stop(self) -> None:
        """Freezes the container if it is to be kept so, or stops it; returns when that is done."""
        if self._stopped.is_set():
            return
        self._stopped.set()
        await self._shut()
        if self._keep is not None and self._conversation is not None and not self._conversation.is_over:
            try:
                await self._conversation.admit(frozenset())
                await self._engine.change(self.container.name, "freeze", wait_s=_FREEZE_S)
            except InstanceError as error:
                _log.warning("%s cannot be frozen and is stopped: %s", self._name, error)
            else:
                self._keep(self)
                return
        await self.end()

    async def end(self) -> None:
        """Stops the container; where the engine does not answer, what runs in it ends by itself."""
        self._stopped.set()
        await self._shut()
        if self._conversation is not None:
            await self._conversation.close()
        try:
            await self._engine.change(self.container.name, "stop", wait_s=_STOP_S)
        except EngineError as error:
            _log.warning("%s could not be stopped: %s", self.container.name, error)

    async def _reach(self) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        """The control line to the container's process 1, which is about to listen."""
        leash = self.container.leash.context(is_server=False)
        try:
            async with asyncio.timeout(_REACHED_S):
                while True:
                    try:
                        reports, orders = await asyncio.open_connection(
                            self.container.address, CONTROL_PORT, ssl=leash, limit=LONGEST_LINE_BYTES
                        )
                    except OSError:
                        await asyncio.sleep(_RETRY_S)
                    else:
                        notice_silence(orders.get_extra_info("socket"))
                        return reports, orders
        except TimeoutError:
            raise EngineError(
                f"{self.container.name} was started, but nobody answers at {self.container.address}: "
                "is there a route to the subnet of runtime.network?"
            ) from None

    async def _open(self) -> None:
        """Leads callers to the service, once that was reached."""
        try:
            async with asyncio.timeout(_ANSWERS_S):
                _, writer = await self._connect(Visitor(""))
                writer.close()
        except OSError as error:
            raise InstanceError(f"{self._name} runs, but does not answer: {error}") from error
        self._passage = await self._lead(self.container.server, self._connect)
        self.endpoint = self._passage.endpoint

    async def _shut(self) -> None:
        if self._passage is not None:
            await self._passage.close()
            self._passage = None

    async def _connect(self, visitor: Visitor) -> Streams:
        reader, writer = await asyncio.open_connection(
            self.container.address, SERVICE_PORT, ssl=self._leash.context(is_server=False), limit=CHUNK_BYTES
        )
        writer.write(announcement(visitor))
        return reader, writer

    def _how_it_ended(self) -> str:
        assert self._conversation is not None  # noqa: S101 - it has begun
        code = self._conversation.code
        if self._conversation.fault:
            return self._conversation.fault
        if code is None:
            self._lost(self.container.member)
            return "the container is gone, or cannot be reached"
        return self._output.explain(code)
