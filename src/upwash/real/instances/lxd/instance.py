"""A service in a container of LXD or Incus, reached over the network."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import AsyncIterator, Callable

import msgspec

from upwash.core.admission.clients import Client
from upwash.errors import EngineError, InstanceError
from upwash.ports import InstanceSpec
from upwash.real.instances.control import Begin
from upwash.real.instances.control_credentials import (
    CONTROL_PORT,
    SERVICE_PORT,
    new_control_credentials,
    notice_silence,
)
from upwash.real.instances.instance_control import LONGEST_LINE_BYTES, ControlledInstance, InstanceCallbacks
from upwash.real.instances.lxd.container import LxdContainer
from upwash.real.instances.lxd.engine import Engine
from upwash.real.link.proxy import announcement
from upwash.real.link.streams import StreamEnd

_log = logging.getLogger("upwash.lxd")

_START_S = 20.0
_STOP_S = 10.0
_FREEZE_S = 5.0
_REACHED_S = 10.0  # from the start of a container until its process 1 answers
_RETRY_S = 0.02
_ANSWERS_S = 5.0


class LxdInstance(ControlledInstance):
    """A service in a container; `lost` gets the cluster's member of a container that ended without a report."""

    def __init__(
        self,
        container: LxdContainer,
        spec: InstanceSpec,
        callbacks: InstanceCallbacks,
        *,
        engine: Engine,
        lost: Callable[[str], None],
    ) -> None:
        super().__init__(spec, callbacks)
        self.container = container
        self._credentials = new_control_credentials()  # of the service alone
        self._lost = lost
        self._engine = engine

    async def begin(self, begin: Begin) -> None:
        """Start the container and its service; returns when it answers, raises InstanceError."""
        await self._engine.change(self.container.name, "start", wait_s=_START_S)
        control = self._connect_control(*await self._reach())
        try:
            await control.begin(msgspec.structs.replace(begin, credentials=self._credentials.text()))
        except EOFError:
            raise InstanceError(f"{self.spec.name} did not start: {self._explain()}") from None
        await self.open()

    async def open(self) -> None:
        """Lead callers to the service, once a connection to it succeeds."""
        try:
            async with asyncio.timeout(_ANSWERS_S), self._connect(Client("")):
                pass
        except OSError as error:
            raise InstanceError(f"{self.spec.name} runs, but does not answer: {error}") from error
        await self._lead_to(self._connect)

    async def how_it_ended(self) -> str:
        """How the service ended, with its last lines of output, once it has."""
        await self.control.ended()
        return "stopped" if self._stopped.is_set() else self._explain()

    async def freeze(self) -> None:
        """Suspend the container; raises EngineError."""
        await self._engine.change(self.container.name, "freeze", wait_s=_FREEZE_S)

    async def thaw(self) -> None:
        """Let a frozen container go on; raises EngineError."""
        await self._engine.change(self.container.name, "unfreeze", wait_s=_FREEZE_S)

    async def end(self) -> None:
        """Stop the container; if the engine does not answer, the service ends without its control line."""
        self._stopped.set()
        await self._shut()
        if self._control is not None:
            await self._control.close()
        try:
            await self._engine.change(self.container.name, "stop", wait_s=_STOP_S)
        except EngineError as error:
            _log.warning("%s could not be stopped: %s", self.container.name, error)

    async def _reach(self) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        """The control line to the container's process 1, which will listen soon."""
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
                f"{self.container.name} was started, but does not answer at {self.container.address}: "
                "is there a route to the subnet of runtime.network?"
            ) from None

    @contextlib.asynccontextmanager
    async def _connect(self, client: Client) -> AsyncIterator[StreamEnd]:
        _, end = await asyncio.get_running_loop().create_connection(
            StreamEnd, self.container.address, SERVICE_PORT, ssl=self._credentials.context(is_server=False)
        )
        try:
            end.transport.write(announcement(client))
            yield end
        finally:
            end.close()

    def _explain(self) -> str:
        if self.control.fault:
            return self.control.fault
        if self.control.code is None:
            self._lost(self.container.member)
            return "the container is gone, or cannot be reached"
        return self._output.explain(self.control.code)
