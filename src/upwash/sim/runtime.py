"""Modelled service instances: the times and answers of their calls, without computing."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import itertools
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from types import MappingProxyType
from typing import Any, Literal, Protocol

import msgspec
from msgspec import inspect as types

from upwash.core.admission.clients import Client
from upwash.core.admission.instance_gate import InstanceGate
from upwash.core.admission.queue import CallQueue
from upwash.core.operation import Operation
from upwash.errors import InstanceError, NotBegun, Refused, UpwashError
from upwash.ports import Answered, AnsweredCall, InstanceSpec, Outcome, ignored
from upwash.rpc.arrays import array_hint
from upwash.rpc.protocol import HEALTH_CHECK, SERVING, service_path
from upwash.rpc.service import Method, Reduced, Request, ServiceSpec, carries_fault, with_queue
from upwash.rpc.wire import Encoding
from upwash.sim.drawn import shown_in
from upwash.sim.faults import FaultyServer
from upwash.sim.link import Observe, Switchboard, unobserved
from upwash.support.background import never

_FIRST_PORT = 40_000
_NEGLIGIBLE_S = 1e-9  # timers may run early by this


class ModelledComputer(Protocol):
    """The computer of instances: the times of their starts and calls."""

    async def start(self, spec: InstanceSpec) -> None:
        """Wait for the time that a service needs from its start until it is ready."""

    async def compute(self, spec: InstanceSpec, operation: Operation, *, less: bool = False) -> float:
        """Wait while a call of the operation occupies its instance; return the time of its answer.

        With `less` its request was made smaller before it was sent.

        Raises InstanceError if the instance crashes, Hangs if the call never ends, and Raises if the service raises.
        """


class Hangs(Exception):
    """Raised for a call that never ends."""


class Raises(Exception):
    """Raised for a call that ends in an exception of the service."""


class ModelRuntime:
    """Starts modelled instances of the services on a computer, plugged in at ports of their own.

    Services in `objects` answer with the object's results, others with empty results. Instances compute `lanes` calls
    at a time, or as many as their services declare. `observe` gets starts, ends, admissions and calls.
    """

    def __init__(
        self,
        services: Mapping[str, ServiceSpec],
        computer: ModelledComputer,
        switchboard: Switchboard | FaultyServer,
        *,
        objects: Mapping[str, object] = MappingProxyType({}),
        lanes: int | None = None,
        observe: Observe = unobserved,
    ) -> None:
        self.services = services
        self.observe = observe
        self.objects = objects
        self.lanes = lanes
        self.computer = computer
        self.switchboard = switchboard
        self._ports = itertools.count(_FIRST_PORT)
        self._instances: list[ModelInstance] = []

    async def start(
        self, spec: InstanceSpec, *, called: Callable[[str], None], answered: Answered = ignored
    ) -> ModelInstance:
        """Returns when the instance is ready to serve."""
        self.observe("instance_started", service=spec.service)
        try:
            await self.computer.start(spec)
        except (UpwashError, asyncio.CancelledError):
            self.observe("instance_ended", service=spec.service)
            raise
        instance = ModelInstance(spec, self, f":{next(self._ports)}", called=called, answered=answered)
        self._instances.append(instance)
        return instance

    def crash(self, how: str) -> None:
        """Ends every instance at once."""
        for instance in self._instances:
            instance.crash(how)
        self._instances.clear()


class ModelInstance:
    """One modelled instance: computes `lanes` calls at a time, in order, and answers with its target's results.

    A call may get its answer after it has left its lane, at the time that the computer returns.
    """

    def __init__(
        self,
        spec: InstanceSpec,
        runtime: ModelRuntime,
        endpoint: str,
        *,
        called: Callable[[str], None],
        answered: Answered,
    ) -> None:
        service = runtime.services[spec.service]
        self.endpoint = endpoint
        self._spec = spec
        self._target = runtime.objects.get(spec.service)
        self._methods = {service_path(spec.service, name): method for name, method in service.methods.items()}
        self._called = called
        self._answered = answered
        self._computer = runtime.computer
        self._switchboard = runtime.switchboard
        self._gate = InstanceGate()
        lanes = runtime.lanes or service.concurrency
        self._lanes = asyncio.Semaphore(lanes)  # first come, first served
        self._queue = CallQueue(lanes)
        self._is_hung = False
        self._under_way = 0
        self._idle = asyncio.Event()
        self._ended: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        self._observe = runtime.observe
        self._is_seen_ended = False
        self._switchboard.plug(endpoint, self._answer)

    async def admit(self, drones: frozenset[str], finishing: frozenset[str] = frozenset()) -> None:
        """Answer only these drones; of finishing drones, the calls that have arrived."""
        if not self._is_seen_ended:
            self._observe("admitted", service=self._spec.service, drones=sorted(drones))
        self._gate.admit(drones, finishing)

    async def drain(self, why: str) -> None:
        """Refuse every further call for that reason; returns when none is under way."""
        self._gate.close(why)
        while self._under_way:
            self._idle.clear()
            await self._idle.wait()

    async def health(self) -> None:
        """Return at once if the instance runs, as a hanging call does not stop the rest of it."""
        self._require_life()

    async def exited(self) -> str:
        """Wait for the end of the instance, and return how it ended."""
        how = await asyncio.shield(self._ended)
        self._see_ended()
        return how

    async def stop(self) -> None:
        """Ends the instance."""
        self._see_ended()
        self.crash("stopped")

    def _see_ended(self) -> None:
        if not self._is_seen_ended:
            self._is_seen_ended = True
            self._observe("instance_ended", service=self._spec.service)

    def crash(self, how: str) -> None:
        """Ends the instance at once, with the call that it runs."""
        self._switchboard.unplug(self.endpoint)
        if not self._ended.done():
            self._ended.set_result(how)

    async def _answer(self, path: str, body: bytes, drone: Client) -> bytes:
        if path == HEALTH_CHECK:
            return SERVING
        method = self._methods.get(path)
        if method is None:
            raise Refused(f"no method {path} here")
        self._gate.require(drone)
        may_queue_s = body.may_queue_s if isinstance(body, Request) else None
        with self._queued(may_queue_s) as call:
            whole_s = _now_s()
            async with self._lane(call, may_queue_s):
                if self._is_hung:
                    await never()
                self._require_life()
                self._gate.require_still(drone)  # now that its turn has come
                try:
                    operation = Operation(self._spec.service, method.name, method.key_of(body))
                except msgspec.MsgspecError:
                    return method.perform(None, body)[1]  # which says what is wrong with the arguments
                began_s = _now_s()
                self._queue.begin(call, now_s=began_s)
                answered_s, reply = await self._compute(operation, method, body, drone, whole_s)
                self._queue.end(call, now_s=_now_s())
            await _until(answered_s)
        self._require_life()
        return with_queue(reply, queued_s=began_s - whole_s, queue_s=self._queue.ahead_s(now_s=_now_s()))

    async def _compute(
        self, operation: Operation, method: Method, body: bytes, drone: Client, whole_s: float
    ) -> tuple[float, bytes]:
        """Compute a call; returns when it has its answer, and the answer."""
        began_s = _now_s()
        outcome: Outcome | Literal[""] = "dropped"  # "" for a call that never ends, or kills the instance
        self._observe("served", service=self._spec.service, drone=drone.key)
        self._called(drone.key)
        try:
            less = isinstance(body, Reduced)
            answered_s = await self._computer.compute(self._spec, operation, less=less)
            reply = (
                reply_to(method, body, operation.key)
                if self._target is None
                else method.perform(self._target, body)[1]
            )
            outcome = "raised" if carries_fault(reply) else "value"
        except Raises as error:
            answered_s, reply, outcome = _now_s(), method.fault_reply(error), "raised"
        except Hangs:
            self._is_hung, outcome = True, ""
            await never()
        except InstanceError as error:
            outcome = ""
            self.crash(str(error))
            return _now_s(), b""
        finally:
            if outcome:
                took_s = _now_s() - began_s
                self._answered(AnsweredCall(drone.key, operation.method, began_s - whole_s, took_s, outcome))
        return answered_s, reply

    @contextlib.contextmanager
    def _queued(self, may_queue_s: float | None) -> Iterator[int]:
        """Count a call from its arrival to its answer; raises NotBegun if it would wait for too long."""
        call = self._queue.arrive(may_queue_s, now_s=_now_s())
        self._under_way += 1
        try:
            yield call
        finally:
            self._queue.leave(call)
            self._under_way -= 1
            if not self._under_way:
                self._idle.set()

    @contextlib.asynccontextmanager
    async def _lane(self, call: int, may_queue_s: float | None) -> AsyncIterator[None]:
        """Wait for a lane and hold it; raises NotBegun after a wait of `may_queue_s`."""
        try:
            async with asyncio.timeout(may_queue_s if self._lanes.locked() else None):
                await self._lanes.acquire()
        except TimeoutError:
            self._queue.leave(call)
            raise NotBegun(self._queue.ahead_s(now_s=_now_s())) from None
        try:
            yield
        finally:
            self._lanes.release()

    def _require_life(self) -> None:
        if self._ended.done():
            raise InstanceError(f"{self._spec.name} {self._ended.result()}")


def _now_s() -> float:
    return asyncio.get_running_loop().time()


async def _until(time_s: float) -> None:
    loop = asyncio.get_running_loop()
    if time_s - loop.time() > _NEGLIGIBLE_S:
        come = loop.create_future()
        timer = loop.call_at(time_s, come.set_result, None)
        try:
            await come
        finally:
            timer.cancel()


EVENT = b"an event that the scenario put here"


def mistake_of(key: str) -> bytes:
    """What a photo has where calls with the profile key are mistaken about the event."""
    return f"mistaken: {key};".encode()


def reply_to(method: Method, request: bytes, key: str = "") -> bytes:
    """A reply with an empty value of the method's result type, or a truthy value if the call sees an event.

    Where the request has a photo of drawn objects, and the result may be a list of them, it is that list.
    """
    shown = shown_in(request)
    if shown is not None:
        with contextlib.suppress(msgspec.ValidationError):
            plain = {"value": msgspec.to_builtins(shown)}
            return method.reply.encode(msgspec.convert(plain, method.reply.type))
    return _reply(method.reply, (EVENT in request) != (mistake_of(key) in request))


@functools.cache
def _reply(encoding: Encoding[Any], has_event: bool) -> bytes:
    reply = types.type_info(encoding.type)
    assert isinstance(reply, types.StructType)  # noqa: S101 - made by service.py
    value = next(field.type for field in reply.fields if field.name == "value")
    plain = {"value": _filled(value) if has_event else _empty(value)}
    return encoding.encode(msgspec.convert(plain, encoding.type, dec_hook=_smallest))


def _smallest(hint: Any, _: object) -> Any:
    """The smallest array of the type hint, which msgspec cannot make."""
    import numpy as np

    meant = array_hint(hint)
    return np.zeros([size or 0 for size in meant.shape or (None,)], meant.dtype)


def _filled(found: types.Type) -> Any:
    """A truthy value of the type, or an empty one."""
    match found:
        case (
            types.ListType(item) | types.VarTupleType(item) | types.SetType(item) | types.FrozenSetType(item)
        ):
            return [_empty(item)]
        case types.DictType(key, value):
            return {_empty(key): _empty(value)}
        case types.BoolType():
            return True
        case types.IntType() | types.FloatType():
            return 1
        case types.StrType():
            return "event"
        case types.BytesType() | types.ByteArrayType() | types.MemoryViewType():
            return EVENT
        case types.UnionType(options):
            return _filled(
                next((option for option in options if not isinstance(option, types.NoneType)), options[0])
            )
    return _empty(found)


def _empty(found: types.Type) -> Any:
    match found:
        case types.NoneType():
            return None
        case types.ListType() | types.VarTupleType() | types.SetType() | types.FrozenSetType():
            return []
        case types.DictType() | types.CustomType():  # which is an array
            return {}
        case types.BoolType():
            return False
        case types.IntType() | types.FloatType():
            return 0
        case types.StrType():
            return ""
        case types.BytesType() | types.ByteArrayType() | types.MemoryViewType():
            return b""
        case types.UnionType(options):
            return (
                None if any(isinstance(option, types.NoneType) for option in options) else _empty(options[0])
            )
        case types.EnumType(cls):
            return next(iter(cls)).value
        case types.LiteralType(values):
            return values[0]
        case types.TupleType(items):
            return [_empty(item) for item in items]
        case types.StructType() | types.DataclassType() | types.TypedDictType() | types.NamedTupleType():
            return {field.encode_name: _empty(field.type) for field in found.fields if field.required}
    raise TypeError(f"no empty value of {found}")
