"""PROGRAM: computes a stream of photos by the services, on the drone or a server, without a flight.

Each service has a line of its own: the newest photo is computed next, and of those that wait only the newest
`at_most` are kept. An exception of a service is an answer too.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

from upwash.config.drone import DroneConfig
from upwash.core.operation import Operation
from upwash.drone.offloading import CallPorts
from upwash.drone.pending import Hearing
from upwash.drone.preparation import make_offloading, make_selection
from upwash.errors import Unanswered, UpwashError
from upwash.eventlog import schema
from upwash.ports import Program
from upwash.rpc.service import Method, Patience, ServiceSpec, Specs
from upwash.support.background import beside
from upwash.support.text import worded

T = TypeVar("T")
_NUMBERS = schema.MOST_ITEMS  # of photos in the log, again and again


@dataclass(frozen=True, slots=True)
class StreamAnswer:
    """What became of a photo: a value, or why there is none; `call` has the place of an answer."""

    service: str
    method: str
    value: object = None
    why: str = ""
    call: schema.Call | None = None


def photo_method(spec: ServiceSpec) -> Method | None:
    """The service's first method that takes a photo and needs nothing besides, but its profile key; None if none."""
    for method in spec.methods.values():
        parameters = list(method.signature.parameters.values())
        if method.once or not parameters or parameters[0].annotation not in (bytes, "bytes"):
            continue
        if all(each.name == method.profile_by or each.default is not each.empty for each in parameters[1:]):
            return method
    return None


class _Line(Generic[T]):
    """Photos of one service, the newest first; `dropped` counts those that were never computed."""

    def __init__(self, at_most: int) -> None:
        self._waiting = deque[T](maxlen=at_most)
        self._came = asyncio.Event()
        self.dropped = 0
        self.last: T | None = None

    def add(self, photo: T) -> None:
        self.dropped += len(self._waiting) == self._waiting.maxlen
        self._waiting.append(photo)
        self.last = photo
        self._came.set()

    async def newest(self) -> T:
        while not self._waiting:
            self._came.clear()
            await self._came.wait()
        return self._waiting.pop()


class Stream(Generic[T]):
    """Computes photos of type `T`, which `jpeg` makes a JPEG of when it is a photo's turn.

    `answered` gets each photo with its answer. `jpeg` may raise UpwashError, which is the photo's answer.
    """

    def __init__(
        self,
        config: DroneConfig,
        *,
        specs: Specs,
        programs: Mapping[str, Program],
        parts: Mapping[str, Program],
        ports: CallPorts,
        jpeg: Callable[[T], Awaitable[bytes]],
        answered: Callable[[T, StreamAnswer], None],
        at_most: int,
    ) -> None:
        self._mode = config.mission.mode
        self._methods = {
            name: method if spec.on_drone else replace(method, patience=Patience(Unanswered))
            for name, spec in specs.items()
            if (method := photo_method(spec))
        }
        self._jpeg, self._answered = jpeg, answered
        self._lines = {name: _Line[T](at_most) for name in self._methods}
        self._numbers = itertools.count()
        self._calls: dict[int, schema.Call] = {}  # by the number of the photo
        selection = make_selection(config, specs, ())
        self._offloading = make_offloading(
            config, specs, selection, ports, programs=programs, parts=parts, first="newest"
        )

    @property
    def link(self) -> tuple[str | None, float | None]:
        """The server in use and the round-trip time (s) to it, as `Offloading.link`."""
        return self._offloading.link

    def dropped(self, service: str) -> int:
        """How many photos were replaced by newer ones before their turn."""
        return self._lines[service].dropped

    def follow(self, event: schema.Event) -> None:
        """Takes in an event of the journal: where calls were computed."""
        if isinstance(event, schema.Call) and event.waypoint is not None:
            self._calls[event.waypoint] = event

    def offer(self, photo: T) -> None:
        """Puts the photo first in every service's line."""
        for line in self._lines.values():
            line.add(photo)

    @contextlib.asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        """Computes photos until the end of the block; raises InstanceError if a service cannot run at all."""
        try:
            await self._offloading.start()
            async with self._offloading.running(), beside(self._compute_all(), name="photos of a stream"):
                yield
        finally:
            await self._offloading.close()

    async def ask(self, service: str) -> tuple[T | None, StreamAnswer]:
        """The newest photo with its answer, before all other photos; the answer says why if none has come."""
        photo = self._lines[service].last
        if photo is None:
            return None, StreamAnswer(service, self._methods[service].name, why="no photo has come yet")
        return photo, await self._answer(service, photo, urgent=True)

    async def _compute_all(self) -> None:
        async with asyncio.TaskGroup() as tasks:
            for service in self._methods:
                tasks.create_task(self._compute(service))

    async def _compute(self, service: str) -> None:
        while True:
            photo = await self._lines[service].newest()
            self._answered(photo, await self._answer(service, photo))

    async def _answer(self, service: str, photo: T, *, urgent: bool = False) -> StreamAnswer:
        method, number = self._methods[service], next(self._numbers) % _NUMBERS
        try:
            keys = {} if method.profile_by is None else {method.profile_by: method.argument(self._mode)}
            key, request = method.encode((await self._jpeg(photo),), keys)
            operation = Operation(service, method.name, key)
            hearing = Hearing()
            if method.patience is not None:  # a newer photo is worth more than a wait for the next range
                hearing.waits.set()
            reply = await self._offloading.invoke(
                operation, method, request, number, urgent=urgent, hearing=hearing
            )
            value = method.result(reply)
        except Exception as error:  # noqa: BLE001 - of the service, or of the photo: the stream goes on
            text = str(error) if isinstance(error, UpwashError) else worded(error)
            return StreamAnswer(service, method.name, why=text, call=self._calls.pop(number, None))
        return StreamAnswer(service, method.name, value, call=self._calls.pop(number, None))
