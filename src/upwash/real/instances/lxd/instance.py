"""One service that runs in a container."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import AsyncIterator, Callable

import msgspec

from upwash.core.admission.clients import Client
from upwash.errors import EngineError, InstanceError
from upwash.ports import Answered
from upwash.real.instances.control import Begin
from upwash.real.instances.control_credentials import (
    CONTROL_PORT,
    SERVICE_PORT,
    ControlCredentials,
    new_control_credentials,
    notice_silence,
)
from upwash.real.instances.instance_control import LONGEST_LINE_BYTES, InstanceControl
from upwash.real.instances.lxd.container import Container
from upwash.real.instances.lxd.engine import Engine
from upwash.real.instances.output import Output
from upwash.real.link.announced import announcement
from upwash.real.link.door import Lead, Passage
from upwash.real.link.streams import End
from upwash.support.waiting import first

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
        self._credentials: ControlCredentials = new_control_credentials()  # of the service alone
        self._lost = lost  # is told the member of one that ended without a word
        self._name = name
        self._engine = engine
        self._keep = keep  # takes the instance once it is frozen
        self._output = Output(name)
        self._control: InstanceControl | None = None
        self._stopped = asyncio.Event()

    @property
    def image(self) -> str:
        """The id of that of which its container is made."""
        return self.container.image

    async def begin(
        self, begin: Begin, *, called: Callable[[str], None], answered: Answered, methods: frozenset[str]
    ) -> None:
        """Starts the container and tells it what to be; returns when it answers, raises InstanceError."""
        name = self.container.name
        await self._engine.change(name, "start", wait_s=_START_S)
        reports, orders = await self._reach()
        self._control = InstanceControl(
            self._name,
            called,
            self._output,
            answered=answered,
            methods=methods,
            reports=reports,
            orders=orders,
        )
        try:
            await self._control.begin(msgspec.structs.replace(begin, credentials=self._credentials.text()))
        except EOFError:
            raise InstanceError(f"{self._name} did not start: {self._how_it_ended()}") from None
        await self._open()

    async def resume(self, *, called: Callable[[str], None], answered: Answered) -> None:
        """Has a frozen instance serve again; raises InstanceError."""
        assert self._control is not None  # noqa: S101 - it has begun
        self._stopped.clear()
        self._control.called, self._control.answered = called, answered
        await self._engine.change(self.container.name, "unfreeze", wait_s=_FREEZE_S)
        await self._control.admit(frozenset())
        await self._open()

    async def admit(self, drones: frozenset[str], finishing: frozenset[str] = frozenset()) -> None:
        """Has only these drones get an answer; raises InstanceError where the instance does not confirm it."""
        assert self._control is not None  # noqa: S101 - it has begun
        await self._control.admit(drones, finishing)

    async def drain(self, why: str) -> None:
        """Has every further call refused for that reason; returns when none is under way, or nothing is left.

        It never answers again, and is not kept.
        """
        assert self._control is not None  # noqa: S101 - it has begun
        self._keep = None
        await self._control.drain(why)

    async def health(self) -> None:
        """Returns at its next sign of life; raises InstanceError where it is gone."""
        assert self._control is not None  # noqa: S101 - it has begun
        await self._control.health()

    async def exited(self) -> str:
        """Returns how the service ended, with its last words, when it does."""
        assert self._control is not None  # noqa: S101 - it has begun
        await first(self._control.ended(), self._stopped.wait())
        return "stopped" if self._stopped.is_set() else self._how_it_ended()

    async def stop(self) -> None:
        """Freezes the container if it is to be kept so, or stops it; returns when that is done."""
        if self._stopped.is_set():
            return
        self._stopped.set()
        await self._shut()
        if self._keep is not None and self._control is not None and not self._control.is_over:
            try:
                await self._control.admit(frozenset())
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
        if self._control is not None:
            await self._control.close()
        try:
            await self._engine.change(self.container.name, "stop", wait_s=_STOP_S)
        except EngineError as error:
            _log.warning("%s could not be stopped: %s", self.container.name, error)

    async def _reach(self) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        """The control line to the container's process 1, which is about to listen."""
        credentials = self.container.credentials.context(is_server=False)
        try:
            async with asyncio.timeout(_REACHED_S):
                while True:
                    try:
                        reports, orders = await asyncio.open_connection(
                            self.container.address, CONTROL_PORT, ssl=credentials, limit=LONGEST_LINE_BYTES
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
                async with self._connect(Client("")):
                    pass
        except OSError as error:
            raise InstanceError(f"{self._name} runs, but does not answer: {error}") from error
        self._passage = await self._lead(self.container.server, self._connect)
        self.endpoint = self._passage.endpoint

    async def _shut(self) -> None:
        if self._passage is not None:
            await self._passage.close()
            self._passage = None

    @contextlib.asynccontextmanager
    async def _connect(self, client: Client) -> AsyncIterator[End]:
        _, end = await asyncio.get_running_loop().create_connection(
            End, self.container.address, SERVICE_PORT, ssl=self._credentials.context(is_server=False)
        )
        try:
            end.transport.write(announcement(client))
            yield end
        finally:
            end.close()

    def _how_it_ended(self) -> str:
        assert self._control is not None  # noqa: S101 - it has begun
        code = self._control.code
        if self._control.fault:
            return self._control.fault
        if code is None:
            self._lost(self.container.member)
            return "the container is gone, or cannot be reached"
        return self._output.explain(code)
