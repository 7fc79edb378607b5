"""A service in a container of Docker or Podman, from its start until it is stopped or frozen."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable

from upwash.errors import InstanceError
from upwash.ports import Answered, InstanceSpec
from upwash.real.instances.docker.container import Container
from upwash.real.instances.local_instance import LocalInstance, Run
from upwash.real.link.door import Lead
from upwash.support.waiting import first

_log = logging.getLogger("upwash.docker")


class ContainerInstance(LocalInstance):
    """One that is frozen instead of stopped, and then handed to `keep`, where that is given."""

    def __init__(
        self,
        spec: InstanceSpec,
        run: Run,
        *,
        image: str,
        keep: Callable[[ContainerInstance], None] | None,
        called: Callable[[str], None],
        answered: Answered,
        lead: Lead | None,
    ) -> None:
        super().__init__(spec, run, called=called, answered=answered, lead=lead)
        self.image = image  # the id of that of which its container is made
        self._keep = keep
        self._stopped = asyncio.Event()

    async def drain(self, why: str) -> None:
        """Has every further call refused for that reason; it never answers again, and is not kept."""
        self._keep = None
        await super().drain(why)

    async def exited(self) -> str:
        """Returns how it ended, with its last words, when it does, or that it was stopped."""
        return await first(super().exited(), self._until_stopped())

    async def stop(self) -> None:
        """Freezes it if it is to be kept so, or stops it; returns when that is done."""
        if self._stopped.is_set():
            return
        self._stopped.set()
        if self._keep is None or self._control is None or self._control.is_over:
            await super().stop()
            return
        await self._shut()
        try:
            await self.control.admit(frozenset())
            await self._container.pause()
        except InstanceError as error:
            _log.warning("%s cannot be frozen and is stopped: %s", self.spec.name, error)
            await super().stop()
        else:
            self._keep(self)

    async def end(self) -> None:
        """Stops it, frozen or not."""
        self._stopped.set()
        await super().stop()

    async def resume(self, *, called: Callable[[str], None], answered: Answered) -> None:
        """Has a frozen one serve again; raises InstanceError."""
        self._stopped.clear()
        self.control.called, self.control.answered = called, answered
        await self._container.unpause()
        await self.control.admit(frozenset())
        if self._lead is not None:
            await self._open()

    async def _until_stopped(self) -> str:
        await self._stopped.wait()
        return "stopped"

    @property
    def _container(self) -> Container:
        assert isinstance(self._running, Container)  # noqa: S101 - it has begun
        return self._running
