"""The instances of a daemon's services: started, watched and stopped, as the core's commands say."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NoReturn

from upwash.core.admission.admission import AdmissionController
from upwash.core.admission.instances import StartInstance, StopInstance
from upwash.core.admission.leases import Admit
from upwash.core.admission.limits import NO_LIMITS, Limits
from upwash.core.admission.server import Command, HostedServer
from upwash.core.admission.usage import LeaseEnded
from upwash.errors import InstanceError, NotReadyInTime
from upwash.ports import AnsweredCall, Instance, InstanceSpec, Program, Runtime
from upwash.support.background import beside, end, start

_log = logging.getLogger("upwash.server")
_usage = logging.getLogger("upwash.usage")
_WATCH_S = 5.0  # between two looks at whether an instance is of use
_LAST_CALLS_S = 2.0  # for the other calls of an instance of no use
_STOP_S = 30.0  # for an instance to be gone; a process that waits in the kernel may never be


@dataclass(frozen=True, slots=True)
class Image:
    """A service that can be started: its program, the least times of its calls and its start, and its methods.

    An instance computes as many calls at a time as it has `lanes`. The `version` changes with its code and files.
    """

    program: Program
    pace_s: Mapping[str, float] = field(default_factory=dict)
    start_pace_s: float = 0.0
    methods: frozenset[str] = frozenset()
    lanes: int = 1
    version: str = ""
    limits: Limits = NO_LIMITS
    devices: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Observer:
    """Functions to call for each start of an instance, with its duration (s), each failure and each answered call."""

    started: Callable[[InstanceSpec, float], None] = lambda *_: None
    failed: Callable[[InstanceSpec], None] = lambda _: None
    answered: Callable[[InstanceSpec, AnsweredCall], None] = lambda *_: None


UNOBSERVED = Observer()


@dataclass(slots=True, eq=False)
class _Life:
    """One instance, from its start to its end; `settled` is why it is not ready, "" when it is."""

    spec: InstanceSpec
    number: int
    image: Image
    host: HostedServer
    settled: asyncio.Future[str]
    task: asyncio.Task[None] = field(init=False)
    ending: asyncio.Task[None] | None = None  # while it has to stop
    instance: Instance | None = None  # while it can be called
    is_ending: bool = False
    is_over: bool = False

    @property
    def has_place(self) -> bool:
        """Whether drones are sent to this instance; other instances end soon, or are starting."""
        return self.host.has_place(self.spec.service, self.number)


class Instances:
    """Carries out the commands of `core`; calls `failed` with a defect in the life of an instance, or in its end."""

    def __init__(
        self,
        core: AdmissionController,
        images: Mapping[str, Image],
        runtime: Runtime,
        *,
        start_timeout_s: float,
        drain_s: float,
        observer: Observer,
        failed: Callable[[Exception], object],
    ) -> None:
        self.images = images
        self.used = asyncio.Event()  # wakes the watch over leases from idle
        self._core = core
        self._runtime = runtime
        self._start_timeout_s = start_timeout_s
        self._drain_s = drain_s
        self._observer = observer
        self._failed = failed
        self._lives: dict[int, _Life] = {}  # by instance number, until the life and its ending are over
        self._telling = set[asyncio.Task[None]]()  # commands that are carried out beside

    def outdated(self, images: Mapping[str, Image]) -> frozenset[tuple[str, str]]:
        """The servers and services whose instance is of another version than these images."""
        return frozenset(
            (life.spec.server, life.spec.service)
            for life in self._living()
            if life.has_place and images.get(life.spec.service) != life.image
        )

    async def settled(self, number: int) -> str:
        """Wait until the instance of that number is ready or gone; return why it is not ready, or ""."""
        life = self._lives.get(number)
        return "" if life is None or life.is_over else await asyncio.shield(life.settled)

    async def faults(self) -> list[str]:
        """Wait until every instance is ready or gone; return why some are not ready."""
        return [why for why in await asyncio.gather(*(life.settled for life in self._living())) if why]

    async def ended(self) -> None:
        """Wait until the stopping instances have ended their calls."""
        await asyncio.gather(*(life.ending for life in self._lives.values() if life.ending is not None))

    async def close(self) -> None:
        """End every instance; returns when none is left."""
        await end(*self._telling)
        lives = list(self._lives.values())
        for life in lives:
            if life.ending is not None:
                life.ending.cancel()
            self._cut(life)
        await asyncio.gather(*(life.task for life in lives), return_exceptions=True)

    def perform_beside(self, commands: Sequence[Command]) -> None:
        """Have the commands carried out, in their order, while the caller goes on."""
        task = start(self.perform(commands), name="what the operator ordered", failed=self._failed)
        self._telling.add(task)
        task.add_done_callback(self._telling.discard)

    async def perform(self, commands: Sequence[Command]) -> None:
        """Carry out the commands, in their order; instances start and stop meanwhile."""
        self.used.set()
        for command in commands:
            match command:
                case Admit():
                    await self._admit(command)
                case LeaseEnded():
                    _usage.info("%s: %s", command.server, _used(command))
                case StartInstance(_, service, number):
                    life = self._lives[number] = self._life(command)
                    life.task = start(self._live(life), name=f"the life of {service}", failed=self._failed)
                case StopInstance(_, service, number):
                    life = self._lives[number]
                    if life.settled.done():
                        life.settled = asyncio.get_running_loop().create_future()
                    end = self._end(life, command)
                    life.ending = start(end, name=f"the end of {service}", failed=self._failed)

    def _living(self) -> Iterator[_Life]:
        return (life for life in self._lives.values() if not life.is_over)

    def _life(self, command: StartInstance) -> _Life:
        image = self.images[command.service]
        spec = InstanceSpec(
            command.server,
            command.service,
            image.program,
            pace_s=image.pace_s,
            start_pace_s=image.start_pace_s,
            methods=image.methods,
            limits=image.limits,
            devices=image.devices,
        )
        settled = asyncio.get_running_loop().create_future()
        return _Life(spec, command.number, image, self._core.at(command.server), settled)

    async def _live(self, life: _Life) -> None:
        """The life of one instance, from its start to its end."""
        spec, host = life.spec, life.host
        if not life.has_place:
            _log.info("%s: another version starts beside the one that serves", spec.name)
        why = ""  # of its end; empty if it was stopped, and those who wait for it should ask again
        try:
            instance = await self._begin(life)
            life.settled.set_result("")
            async with beside(self._watch(life, instance), name=f"the watch of {spec.name}"):
                why = await instance.exited()
            _log.warning("%s is gone: %s", spec.name, why)
            # The successor starts while this instance is stopped below; the core ignores the second report.
            await self.perform(host.gone(spec.service, life.number, why, now_s=_now_s()))
        except TimeoutError:
            why = str(NotReadyInTime(spec.name, self._start_timeout_s, whose="the daemon's"))
            _log.warning("%s", why)
        except InstanceError as error:
            why = str(error)
            _log.warning("%s", why)
        finally:
            life.is_ending = True
            left, life.instance = life.instance, None
            if why:
                self._observer.failed(spec)
            if left is not None:
                await self._stop(spec, left)
            if why and left is None and not life.has_place:
                _log.error(
                    "%s serves on in its former version: remove the cause, and reload again", spec.name
                )
            anew = host.gone(spec.service, life.number, why, now_s=_now_s())
            if not life.settled.done():
                life.settled.set_result(why)
            life.is_over = True
            self._forget(life)
            await self.perform(anew)

    async def _begin(self, life: _Life) -> Instance:
        """Start the instance; drones are sent there once it knows which drones to answer."""
        spec, host, began_s = life.spec, life.host, _now_s()
        async with asyncio.timeout(self._start_timeout_s):
            instance = await self._runtime.start(
                spec,
                called=lambda drone: host.called(spec.service, life.number, drone, now_s=_now_s()),
                answered=lambda call: self._answered(life, call),
            )
        life.instance = instance
        self._observer.started(spec, _now_s() - began_s)
        await self._tell_whom(life, instance, host.leases.admitted())  # who hears of it may call
        _log.info("%s is ready at %s", spec.name, instance.endpoint)
        await self.perform(host.ready(spec.service, life.number, instance.endpoint, now_s=_now_s()))
        return instance

    async def _stop(self, spec: InstanceSpec, instance: Instance) -> None:
        try:
            async with asyncio.timeout(_STOP_S):
                await instance.stop()
        except TimeoutError:
            _log.error(
                "%s is not gone %.0f s after it was stopped and is left behind: look for a process in state D",
                spec.name,
                _STOP_S,
            )

    async def _end(self, life: _Life, stop: StopInstance) -> None:
        """Let an instance end the calls in progress, then stop it."""
        instance, name = life.instance, life.spec.name
        if stop.why and not self._core.closing:
            _log.warning("stopping %s: %s", name, stop.why)
        try:
            if instance is not None and stop.why:
                async with asyncio.timeout(_LAST_CALLS_S if stop.is_useless else self._drain_s):
                    await instance.drain(stop.why)
        except TimeoutError:
            _log.warning("%s was stopped in a call: %s", name, stop.why)
        except InstanceError as error:
            _log.warning("%s", error)  # it has ended by itself
        finally:
            life.ending = None
            self._cut(life)
            self._forget(life)

    def _cut(self, life: _Life) -> None:
        """End the life, unless it is ending: a cancellation would cut its end short."""
        if not life.is_ending:
            life.is_ending = True
            life.task.cancel()

    def _forget(self, life: _Life) -> None:
        if life.is_over and life.ending is None:
            self._lives.pop(life.number, None)

    async def _admit(self, command: Admit) -> None:
        """Inform all instances at once, so that a slow instance does not delay the others."""
        await asyncio.gather(
            *(
                self._tell_whom(life, life.instance, command)
                for life in self._lives.values()
                if life.spec.server == command.server and life.instance is not None
            )
        )

    async def _tell_whom(self, life: _Life, instance: Instance, command: Admit) -> None:
        try:
            await instance.admit(command.drones, command.finishing)
        except InstanceError as error:
            why = f"it cannot be told whom to serve: {error}"
            if life.has_place:
                await self.perform(life.host.silent(life.spec.service, why, now_s=_now_s()))
            else:
                _log.warning("stopping %s of a former version: %s", life.spec.name, why)
                self._cut(life)

    async def _watch(self, life: _Life, instance: Instance) -> NoReturn:
        """Check the instance until cancelled, and have it replaced once it is of no use."""
        host, service, number = life.host, life.spec.service, life.number
        while True:
            await asyncio.sleep(_WATCH_S)
            # The reply comes after all earlier reports: this program may have been suspended itself.
            with contextlib.suppress(TimeoutError, InstanceError):
                async with asyncio.timeout(_WATCH_S):
                    await instance.health()
                host.heard(service, number, now_s=_now_s())
            if life.has_place:
                await self.perform(host.watch(service, number, now_s=_now_s()))

    def _answered(self, life: _Life, call: AnsweredCall) -> None:
        self._observer.answered(life.spec, call)
        life.host.answered(
            life.spec.service,
            life.number,
            call.drone,
            took_s=call.took_s,
            queued_s=call.queued_s,
            outcome=call.outcome,
            now_s=_now_s(),
        )


def _used(lease: LeaseEnded) -> str:
    """The log's text for the end of a lease."""
    if lease.held_by:
        return (
            f"{lease.drone} did not come: a slot was held for {lease.slot_s:.1f} s, as {lease.held_by} asked"
        )
    return (
        f"{lease.drone} had a slot for {lease.slot_s:.1f} s: calls answered {lease.calls}, "
        f"seconds of computing {lease.computed_s:.1f}"
    )


def _now_s() -> float:
    return asyncio.get_running_loop().time()
