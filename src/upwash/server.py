"""PROGRAM: the edge daemon. Answers drones, starts and stops service instances, and admits what it can hold."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NoReturn, TypeVar

import msgspec

from upwash.core.instances import (
    Admit,
    Available,
    Command,
    Denied,
    Host,
    Pending,
    Running,
    StartInstance,
    StopInstance,
)
from upwash.errors import InstanceError, Refused
from upwash.ports import Instance, InstanceSpec, Program, Runtime
from upwash.protocol import (
    AVAILABILITY,
    LEAVE,
    START,
    AvailabilityReply,
    AvailabilityRequest,
    LeaveReply,
    LeaveRequest,
    StartReply,
    StartRequest,
)
from upwash.wire import decode

_log = logging.getLogger("upwash.server")
_LEAST_LOOK_S = 1.0  # between two looks at what has come to its end
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Image:
    """A service that can be started: its program, and the least times that its calls and its start take."""

    program: Program
    pace_s: Mapping[str, float] = field(default_factory=dict)
    start_pace_s: float = 0.0


class EdgeServer:
    """One daemon: `host` decides, `runtime` runs, `images` says what each service is."""

    def __init__(
        self, host: Host, *, images: Mapping[str, Image], runtime: Runtime, start_timeout_s: float
    ) -> None:
        self._host = host
        self._images = images
        self._runtime = runtime
        self._start_timeout_s = start_timeout_s
        self._instances: dict[StartInstance, Instance] = {}
        self._lives: dict[int, asyncio.Task[None]] = {}  # by instance number, from start to end
        self._settled: dict[int, asyncio.Future[str]] = {}  # why it is not ready; "" when it is

    async def handle(self, path: str, body: bytes, drone: str) -> bytes:
        """Answers one request of a drone; raises Refused for what is not understood."""
        if not drone:
            raise Refused("this request names no drone")
        match path:
            case _ if path == AVAILABILITY:
                return msgspec.msgpack.encode(
                    await self._availability(_decode(body, AvailabilityRequest), drone)
                )
            case _ if path == START:
                return msgspec.msgpack.encode(await self._start(_decode(body, StartRequest), drone))
            case _ if path == LEAVE:
                return msgspec.msgpack.encode(await self._leave(_decode(body, LeaveRequest), drone))
            case _:
                raise Refused(f"no such request: {path}")

    async def run(self) -> NoReturn:
        """Ends leases and idle instances as their time comes, until cancelled."""
        while True:
            next_end_s = self._host.next_end_s(now_s=self._now_s())
            await asyncio.sleep(max(_LEAST_LOOK_S, next_end_s - self._now_s()))
            await self._perform(self._host.look(now_s=self._now_s()))

    async def close(self) -> None:
        """Ends every instance; returns when none is left."""
        lives = list(self._lives.values())
        for life in lives:
            life.cancel()
        await asyncio.gather(*lives, return_exceptions=True)

    async def _availability(self, request: AvailabilityRequest, drone: str) -> AvailabilityReply:
        answer, commands = self._host.availability(
            request.server, request.services, drone, now_s=self._now_s()
        )
        await self._perform(commands)
        match answer:
            case Available(endpoints):
                return AvailabilityReply(
                    available=True, endpoints=dict(endpoints), lease_s=self._host.settings.lease_s
                )
            case Denied(why):
                _log.info("%s: no place for %s: %s", request.server, drone, why)
                return AvailabilityReply(available=False, reason=why)

    async def _start(self, request: StartRequest, drone: str) -> StartReply:
        while True:
            answer, commands = self._host.start(request.server, request.service, drone, now_s=self._now_s())
            await self._perform(commands)
            match answer:
                case Running(endpoint):
                    return StartReply(endpoint=endpoint)
                case Denied(why):
                    return StartReply(reason=why)
                case Pending(number, stopping):
                    settled = self._settled.get(number)
                    why = await asyncio.shield(settled) if settled else ""
                    if why and not stopping:
                        return StartReply(reason=why)

    async def _leave(self, request: LeaveRequest, drone: str) -> LeaveReply:
        await self._perform(self._host.leave(request.server, drone))
        return LeaveReply()

    async def _perform(self, commands: Sequence[Command]) -> None:
        for command in commands:
            match command:
                case Admit():
                    await self._admit(command)
                case StartInstance(_, _, number):
                    self._settled[number] = asyncio.get_running_loop().create_future()
                    self._lives[number] = asyncio.create_task(self._live(command))
                case StopInstance(_, _, number):
                    self._settled[number] = asyncio.get_running_loop().create_future()
                    self._lives[number].cancel()

    async def _admit(self, command: Admit) -> None:
        for start, instance in list(self._instances.items()):
            if start.server != command.server:
                continue
            try:
                await instance.admit(command.drones)
            except InstanceError as error:
                _log.warning("stopping an instance that cannot be told whom to serve: %s", error)
                self._lives[start.number].cancel()

    async def _live(self, start: StartInstance) -> None:
        """The life of one instance, from its start to its end."""
        image = self._images[start.service]
        spec = InstanceSpec(
            start.server, start.service, image.program, pace_s=image.pace_s, start_pace_s=image.start_pace_s
        )
        instance: Instance | None = None
        why = "stopped"
        try:
            async with asyncio.timeout(self._start_timeout_s):
                instance = await self._runtime.start(spec, called=lambda drone: self._called(start, drone))
            self._instances[start] = instance
            _log.info("%s is ready at %s", spec.name, instance.endpoint)
            await self._perform(
                self._host.ready(
                    start.server, start.service, start.number, instance.endpoint, now_s=self._now_s()
                )
            )
            self._settled[start.number].set_result("")
            why = await instance.exited()
            self._host.gone(start.server, start.service, start.number)
            _log.warning("%s is gone: %s", spec.name, why)
        except TimeoutError:
            why = f"{spec.name} was not ready within {self._start_timeout_s:.0f} s"
            _log.warning("%s", why)
        except InstanceError as error:
            why = str(error)
            _log.warning("%s", why)
        finally:
            self._instances.pop(start, None)
            if instance is not None:
                await instance.stop()
            self._host.gone(start.server, start.service, start.number)
            settled = self._settled.pop(start.number)
            if not settled.done():
                settled.set_result(why)
            del self._lives[start.number]

    def _called(self, start: StartInstance, drone: str) -> None:
        self._host.called(start.server, start.service, drone, now_s=self._now_s())

    def _now_s(self) -> float:
        return asyncio.get_running_loop().time()


def _decode(body: bytes, expected: type[T]) -> T:
    try:
        return decode(body, msgspec.msgpack.Decoder(expected))
    except msgspec.MsgspecError as error:
        raise Refused(f"undecodable request: {error}") from error
