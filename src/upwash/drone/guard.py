"""Offloading that may fail without the mission: from then on, the drone goes on alone."""

from __future__ import annotations

import asyncio
import contextlib
import traceback
from collections.abc import AsyncIterator
from typing import Any

from upwash.core.operation import Operation
from upwash.core.planning.stay_or_go import Outlook
from upwash.core.selection.events import Event
from upwash.drone.offloading import Offloading
from upwash.errors import TransitionError, UpwashError
from upwash.eventlog import schema
from upwash.ports import Journal
from upwash.rpc.service import Method
from upwash.support.background import end, start
from upwash.support.waiting import first


class FailSafeOffloading:
    """Offloading whose own defects end it and are logged, and reach neither the mission nor a call."""

    def __init__(self, offloading: Offloading, journal: Journal) -> None:
        self._offloading = offloading
        self._journal = journal
        self._failed = False
        self._background: asyncio.Task[Any] | None = None

    @contextlib.asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        """Looks for servers and visits them until the end of the block, by when whatever was selected is left."""
        background = self._background = start(self._offloading.run(), name="offloading", failed=self._fail)
        try:
            yield
        finally:
            await self._end(background)
            await end(background)

    async def invoke(self, operation: Operation, method: Method, request: bytes) -> Any:
        """Runs one call where it is decided to run, or on the drone; returns its decoded reply.

        Nothing is decided of a method that runs once, so that no defect has it run again. Raises InstanceError only
        when the drone's own service fails too.
        """
        if not self._failed and not method.once:
            try:
                return await self._offloading.invoke(operation, method, request)
            except Exception as error:
                if not _is_defect(error):
                    raise
                self._fail(error)
        return await self._offloading.invoke_alone(operation, method, request)

    @property
    def link(self) -> tuple[str | None, float | None]:
        """The server in use, if one is, and what the last question to its daemon took, once one was answered."""
        return (None, None) if self._failed else self._offloading.link

    def outlook(self) -> Outlook | None:
        """What going on before the call that is under way is over would come to; None where nothing is known."""
        if not self._failed:
            try:
                return self._offloading.outlook()
            except Exception as error:  # noqa: BLE001 - whatever it is, the drone flies on
                self._fail(error)
        return None

    def tell(self, event: Event) -> None:
        """Takes in what happened."""
        if not self._failed:
            try:
                self._offloading.tell(event)
            except Exception as error:  # noqa: BLE001 - whatever it is, the drone flies on
                self._fail(error)

    async def _end(self, background: asyncio.Task[Any]) -> None:
        """Leaves the server, unless the background fails before or meanwhile: it is what leaves."""
        if background.done():
            return
        try:
            await first(self._offloading.end(), asyncio.wait([background]))
        except Exception as error:  # noqa: BLE001 - the mission was flown all the same
            self._fail(error)

    def _fail(self, error: BaseException) -> None:
        if self._failed:
            return
        self._failed = True
        if self._background is not None:
            self._background.cancel()
        defect: BaseException = error
        while isinstance(defect, BaseExceptionGroup):
            defect = defect.exceptions[0]
        trace = "".join(traceback.format_exception(error))
        self._journal.record(schema.OffloadingFailed(why=f"{type(defect).__name__}: {defect}", trace=trace))


def _is_defect(error: Exception) -> bool:
    """Whether it is none of the errors that a call may end with."""
    return isinstance(error, TransitionError) or not isinstance(error, UpwashError)
