"""The services on the drone, each in a process of its own, so that a crash does not end the drone's program."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from dataclasses import dataclass

from upwash.core.operation import ON_DRONE
from upwash.errors import InstanceError, LinkError, NotReadyInTime, OutcomeUnknown, Refused
from upwash.eventlog import schema
from upwash.ports import Dialer, Instance, InstanceSpec, Journal, Link, Runtime
from upwash.rpc.protocol import service_path
from upwash.support.background import end, start
from upwash.support.text import worded

_PAUSE_S = 1.0  # between two starts, so that a service that cannot start does not eat the computer


async def started(runtime: Runtime, spec: InstanceSpec, *, within_s: float) -> Instance:
    """Start an instance on this computer; raises InstanceError, NotReadyInTime after `within_s`."""
    try:
        async with asyncio.timeout(within_s):
            return await runtime.start(spec, called=lambda _: None)
    except TimeoutError:
        raise NotReadyInTime(spec.name, within_s) from None


class OnboardServices:
    """Keeps the drone's own instances running and calls them."""

    def __init__(
        self,
        specs: Iterable[InstanceSpec],
        *,
        start_timeout_s: float,
        runtime: Runtime,
        dialer: Dialer,
        journal: Journal,
    ) -> None:
        self._services = {
            spec.service: _OnboardService(spec, start_timeout_s, runtime, dialer, journal) for spec in specs
        }

    async def start(self) -> None:
        """Starts every service; raises InstanceError if one cannot run at all."""
        for service in self._services.values():
            await service.start()

    async def call(
        self, service: str, method: str, request: bytes, *, timeout_s: float, once: bool = False
    ) -> bytes:
        """Runs one call; a service that crashes or hangs in it is restarted and the call repeated, unless `once`.

        Raises InstanceError if the repetition fails too, and OutcomeUnknown if `once` forbids it.
        """
        own = self._services[service]
        try:
            return await own.attempt(method, request, timeout_s)
        except Refused as error:  # it is well, and would refuse again
            raise InstanceError(f"{service} on the drone: {error}") from error
        except LinkError as error:
            own.journal.record(schema.LocalFailed(service=service, method=method, why=str(error)))
            if once:
                raise OutcomeUnknown(
                    f"{service} failed on the drone in {method}, which may have run and must not run twice: {error}"
                ) from error
        try:
            return await own.attempt(method, request, timeout_s)
        except LinkError as error:
            raise InstanceError(f"{service} failed on the drone, twice: {error}") from error

    async def close(self) -> None:
        """Ends every service; returns when all have ended."""
        for service in self._services.values():
            await end(service.life)


@dataclass(frozen=True, slots=True, eq=False)
class _Running:
    instance: Instance
    link: Link


@dataclass(eq=False)
class _OnboardService:
    spec: InstanceSpec
    start_timeout_s: float
    runtime: Runtime
    dialer: Dialer
    journal: Journal
    life: asyncio.Task[None] | None = None

    def __post_init__(self) -> None:
        self._running: asyncio.Future[_Running] = asyncio.get_running_loop().create_future()

    async def start(self) -> None:
        first = await self._launch()
        self.life = start(self._live(first), name=f"the life of {self.spec.name}", failed=self._give_up)

    def _give_up(self, defect: Exception) -> None:
        """Fail every call from now on: nothing starts the service again."""
        why = f"{self.spec.service} is not watched any more, after a defect: {worded(defect)}"
        self.journal.record(schema.LocalFailed(service=self.spec.service, why=why))
        self._running = asyncio.get_running_loop().create_future()
        self._running.set_exception(InstanceError(why))

    async def attempt(self, method: str, request: bytes, timeout_s: float) -> bytes:
        try:
            async with asyncio.timeout(self.start_timeout_s):
                running = await asyncio.shield(self._running)
        except TimeoutError:
            raise NotReadyInTime(f"{self.spec.service} on the drone", self.start_timeout_s) from None
        path = service_path(self.spec.service, method)
        try:
            return await running.link.request(path, request, timeout_s=timeout_s)
        except Refused:
            raise
        except LinkError:
            self._forget(running)
            await running.instance.stop()  # it may hang, with the call still running
            raise

    async def _live(self, running: _Running) -> None:
        while True:
            try:
                how = await running.instance.exited()
            finally:
                self._forget(running)
                await running.link.close()
                await running.instance.stop()
            self.journal.record(schema.LocalEnded(service=self.spec.service, how=how))
            while not self._running.done():
                try:
                    running = await self._launch()
                except InstanceError as error:
                    self.journal.record(schema.LocalFailed(service=self.spec.service, why=str(error)))
                    await asyncio.sleep(_PAUSE_S)

    async def _launch(self) -> _Running:
        instance = await started(self.runtime, self.spec, within_s=self.start_timeout_s)
        try:
            await instance.admit(frozenset({self.spec.server}))
        except BaseException:
            await instance.stop()
            raise
        running = _Running(instance, self.dialer.dial(instance.endpoint, server=ON_DRONE))
        self._running.set_result(running)
        self.journal.record(schema.LocalReady(service=self.spec.service))
        return running

    def _forget(self, running: _Running) -> None:
        if self._running.done() and self._running.result() is running:
            self._running = asyncio.get_running_loop().create_future()
