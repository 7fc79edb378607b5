"""The declaration of a service: one class gives the local object, the instance on a server, and the typed stub.

    @service(profile_by="mode")
    class Detector:
        def __init__(self, threads: int = 2) -> None: ...                 # paid once per instance: the cold start
        def process_photo(self, photo: bytes, mode: Mode) -> list[Detection]: ...

Arguments and results travel as MessagePack, built and checked by the type hints: a request is a map from parameter
name to value, a reply a map with either `value` or `fault`. Services keep no state between calls, and a call may run
twice: on a server and, if that gives no usable answer, on the drone. A method can forbid that:

        @once
        def drop_parcel(self) -> None: ...                                # on the drone alone, never again

`@service(where="servers")` declares a service that no drone can run. Its stub knows what a call without an answer
returns.

A service may name a part that makes its requests smaller on the drone, before they are sent to a server:

    @service
    class Shrink:
        def process_photo(self, photo: bytes) -> bytes: ...               # the new value of its parameter

    @service(profile_by="mode", before_sending=Shrink)
    class Detector: ...
"""

from __future__ import annotations

import enum
import inspect
import math
import sys
import typing
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType, ModuleType
from typing import Any, Literal, ParamSpec, TypeAlias, TypeVar, cast, get_args, overload

import msgspec
from msgspec import UNSET, UnsetType

from upwash.core.operation import Operation
from upwash.errors import (
    DeclarationError,
    GarbledReply,
    ServiceError,
    Unanswered,
    UpwashError,
    UsageError,
)
from upwash.rpc.operations import operations_of
from upwash.rpc.settings import describe_settings
from upwash.rpc.wire import Encoding, require_sendable
from upwash.support.loading import load
from upwash.support.text import message_of, printable

T = TypeVar("T")
P = ParamSpec("P")
R = TypeVar("R")
_PLAIN = (str, int, float, bool, type(None))
_SPEC = "__upwash_service__"
_ONCE = "__upwash_once__"
_STUB = "__upwash_stub__"
_MOST_CONCURRENCY = 64  # more threads of one process only wait for each other
_LONGEST_MESSAGE = 10_000  # characters of an exception's that is too long to send
_MOST_QUEUE_S = 600.0  # that a peer may state
_LONGEST_SUMMARY = 200  # characters of an exception that is not raised
Where: TypeAlias = Literal["anywhere", "servers"]


@dataclass(frozen=True)
class Patience:
    """What a mission chose for calls that only servers compute: `value` for one without an answer `within_s`.

    The value may be the class Unanswered, which is raised.
    """

    value: object
    within_s: float | None = None


class NoAnswer(msgspec.Struct, frozen=True):
    """In place of a decoded reply: no server answered, and why."""

    why: str


class ServiceFault(msgspec.Struct, frozen=True):
    """A service's own exception on its way to the caller; `type` is `module:qualified.name`."""

    type: str
    message: str
    args: list[str | int | float | bool | None] | None = None


class Request(bytes):
    """A simulated call that its instance need not begin after `may_queue_s`; None: it waits as long as its caller."""

    may_queue_s: float | None = None


class Reduced(Request):
    """A request that a part before sending has changed."""


class Reply(bytes):
    """An encoded reply to a call that waited `queued_s` for others; a new call would have `queue_s` before it."""

    queued_s = 0.0
    queue_s = 0.0


def may_queue(request: bytes, may_queue_s: float) -> Request:
    """The request, with the seconds within which an instance begins it or refuses it."""
    made = Reduced(request) if isinstance(request, Reduced) else Request(request)
    made.may_queue_s = may_queue_s
    return made


def with_queue(reply: bytes, *, queued_s: float, queue_s: float) -> Reply:
    """The reply, with what its instance says of its queue; 600 s at most count, and none of what is no time."""
    made = Reply(reply)
    made.queued_s, made.queue_s = bounded_queue_s(queued_s), bounded_queue_s(queue_s)
    return made


def bounded_queue_s(stated_s: float) -> float:
    """What counts of the seconds that a peer states."""
    return min(max(0.0, stated_s), _MOST_QUEUE_S) if math.isfinite(stated_s) else 0.0


@dataclass(frozen=True)
class PartBeforeSending:
    """The method of a part before sending, and the parameters of the operation that its result replaces."""

    method: Method
    replaces: tuple[str, ...]


@dataclass(frozen=True)
class Method:
    """One operation of a service: encodes its calls for a stub, and performs them in an instance.

    With `once` a call runs only on the drone, and never a second time. With `patience` only servers compute it.
    """

    service: str
    name: str
    signature: inspect.Signature
    profile_by: str | None
    request: Encoding[Any]
    reply_type: Callable[..., Any]
    reply: Encoding[Any]
    once: bool = False
    key_type: Any = None  # the type hint of the parameter that `profile_by` names
    patience: Patience | None = None
    before: PartBeforeSending | None = None

    def encode(self, args: tuple[object, ...], kwargs: Mapping[str, object]) -> tuple[str, bytes]:
        """The profile key and the request of a call with these arguments.

        Raises TypeError as the call would, and ValueError for arguments above the bounds.
        """
        bound = self.signature.bind(*args, **kwargs)
        bound.apply_defaults()
        return self._key(bound.arguments), self.request.encode(bound.arguments)

    def perform(self, target: object, request: bytes) -> tuple[str, bytes]:
        """Runs the call on a service object; returns its profile key, and its value or exception as a reply."""
        try:
            arguments = self.arguments(request)
        except msgspec.MsgspecError as error:
            return "", self.fault_reply(TypeError(f"{self.name}(): {error}"))
        key = self._key(arguments)
        try:
            value = getattr(target, self.name)(**arguments)
            return key, self.reply.encode(self.reply_type(value=value))
        except BaseException as error:  # noqa: BLE001 - the caller gets all that it raises, sys.exit() too
            return key, self.fault_reply(error)

    def key_of(self, request: bytes) -> str:
        """The profile key of a request; raises msgspec.MsgspecError for other bytes."""
        return self._key(self.arguments(request))

    def under(self, key: str, request: bytes) -> bytes:
        """The request with the profile argument changed to `key`; raises ValueError for an invalid key."""
        arguments = self.request.decode(request)
        return self.request.encode(
            msgspec.structs.replace(arguments, **{str(self.profile_by): self.argument(key)})
        )

    def request_of_part(self, request: bytes) -> bytes:
        """The request of the part before sending for this request; raises msgspec.MsgspecError or ValueError."""
        assert self.before is not None  # noqa: S101 - the caller has looked
        arguments, part = self.arguments(request), self.before.method
        return part.encode((), {name: arguments[name] for name in part.signature.parameters})[1]

    def reduced(self, request: bytes, reply: bytes) -> Reduced:
        """The request with what the part before sending replied.

        Raises UpwashError for values of other types and for an exception of the part, ValueError above the bounds.
        """
        assert self.before is not None  # noqa: S101 - the caller has looked
        part, names = self.before.method, self.before.replaces
        decoded = part.decode(reply)
        if raised := part.raised(decoded):
            raise UpwashError(raised)
        value = decoded.value
        values = (value,) if len(part.signature.parameters) == 1 else cast(tuple[object, ...], value)
        changed = dict(zip(names, values, strict=True))
        return Reduced(self.request.encode(msgspec.structs.replace(self.request.decode(request), **changed)))

    def argument(self, key: str) -> object:
        """The profile argument for that key; raises ValueError if its type hint has no such value."""
        try:
            return msgspec.convert(key, self.key_type, strict=False)
        except msgspec.ValidationError as error:
            raise ValueError(f"{self.name}({self.profile_by}=...): {error}") from error

    def decode(self, reply: bytes) -> Any:
        """A reply, checked against the type hints; raises GarbledReply if it does not fit them."""
        try:
            decoded = self.reply.decode(reply)
        except msgspec.MsgspecError as error:
            raise GarbledReply(
                f"{self.service}.{self.name}(): what it returned is not what its type hint says: {error}"
            ) from error
        if decoded.value is UNSET and decoded.fault is UNSET:
            raise GarbledReply(f"{self.service}.{self.name}(): the reply carries no value and no fault")
        return decoded

    def raised(self, decoded: Any) -> str:
        """The exception in a decoded reply, as a short text; "" if the reply has a value."""
        if decoded.fault is UNSET:
            return ""
        return printable(f"{decoded.fault.type.replace(':', '.')}: {decoded.fault.message}", _LONGEST_SUMMARY)

    def result(self, decoded: Any) -> object:
        """The value of a decoded reply; raises the service's exception if the reply has one.

        Without an answer, the value that the mission chose; raises Unanswered if it chose that.
        """
        if isinstance(decoded, NoAnswer):
            if self.patience is None or self.patience.value is Unanswered:
                raise Unanswered(f"{self.service}.{self.name}(): {decoded.why}")
            return self.patience.value
        if decoded.fault is not UNSET:
            raise _rebuild(decoded.fault)
        return decoded.value

    def fault_reply(self, error: BaseException) -> bytes:
        """The encoded reply of a call that raised this exception."""
        cls = type(error)
        type_path = f"{cls.__module__}:{cls.__qualname__}"
        message = message_of(error)
        try:
            return self.reply.encode({"fault": ServiceFault(type_path, message, _plain_args(error))})
        except (OverflowError, ValueError):  # its text or arguments have no encoding, or are too long
            message = message[:_LONGEST_MESSAGE].encode(errors="backslashreplace").decode()
            return self.reply.encode({"fault": ServiceFault(type_path, message)})

    def arguments(self, request: bytes) -> dict[str, Any]:
        """The arguments of an encoded call, by name; raises msgspec.MsgspecError for other bytes."""
        decoded = self.request.decode(request)
        return {name: getattr(decoded, name) for name in self.signature.parameters}

    def _key(self, arguments: Mapping[str, object]) -> str:
        if self.profile_by is None:
            return ""
        value = arguments[self.profile_by]
        return str(value.value if isinstance(value, enum.Enum) else value)


@dataclass(frozen=True)
class ServiceSpec:
    """A declared service; an instance of it, `where` it may be, computes `concurrency` calls at a time."""

    name: str
    methods: Mapping[str, Method]
    settings: type[msgspec.Struct]  # what its constructor takes
    concurrency: int = 1
    before_sending: type | None = None  # the service that makes its requests smaller
    where: Where = "anywhere"

    @property
    def on_drone(self) -> bool:
        """Whether the drone has an instance."""
        return self.where != "servers"


Specs: TypeAlias = Mapping[str, ServiceSpec]  # by the services' names


# Runs a request, which was made of the arguments, somewhere; returns its decoded reply.
Invoke = Callable[[Operation, Method, bytes, tuple[object, ...]], Any]


@overload
def service(declared: type[T], /) -> type[T]: ...


@overload
def service(
    *,
    name: str | None = None,
    profile_by: str | None = None,
    concurrency: int = 1,
    where: Where = "anywhere",
    before_sending: type | None = None,
) -> Callable[[type[T]], type[T]]: ...


def service(
    declared: type[T] | None = None,
    /,
    *,
    name: str | None = None,
    profile_by: str | None = None,
    concurrency: int = 1,
    where: Where = "anywhere",
    before_sending: type | None = None,
) -> type[T] | Callable[[type[T]], type[T]]:
    """Declares a class as a service, called `name` (by default the class's name in lower case).

    Its public methods are its operations; each value of the parameter that `profile_by` names has its own estimates.
    An instance computes `concurrency` calls at a time, each in a thread: with more than 1 its methods must be safe
    for threads. With `where="servers"` no call runs on the drone. `before_sending` is another service, which may make
    requests smaller before they go to a server: its methods have names of operations, take their parameters and
    return new values. Raises DeclarationError if a parameter, its default or a result cannot be sent, for public
    attributes that are no plain methods and no data, and for a part that does not fit.
    """

    if inspect.isroutine(declared):
        raise DeclarationError(
            f"@service is above the function {declared.__name__}: make it a method of a class"
        )
    if declared is not None and not isinstance(declared, type):
        raise DeclarationError(
            f"@service({declared!r}): write @service above the class, or @service(name={declared!r})"
        )

    def declare(cls: type[T]) -> type[T]:
        spec = _describe(cls, name or cls.__name__.lower(), profile_by, concurrency, where)
        setattr(cls, _SPEC, _with_part(cls, spec, before_sending) if before_sending is not None else spec)
        return cls

    return declare if declared is None else declare(declared)


def once(method: Callable[P, R], /) -> Callable[P, R]:
    """Declares that calls of a service's method run only on the drone, and never a second time.

    For methods that act on the world: no call goes to a server, or is repeated after a failure.
    """
    if not inspect.isfunction(method):
        raise DeclarationError(
            f"@once: write it directly above the method, not above {printable(repr(method))}"
        )
    setattr(method, _ONCE, True)
    return method


def spec_of(cls: type) -> ServiceSpec:
    """The service that a class declares; raises UsageError for a class that declares none."""
    spec = vars(cls).get(_SPEC)
    if not isinstance(spec, ServiceSpec):
        raise UsageError(f"{cls.__name__} is not a service: put @service above the class")
    return spec


def load_service(program: str) -> type:
    """The service class of that path, `package.module:Class` or `path/to/file.py:Class`; raises UsageError."""
    found = load(program)
    if not isinstance(found, type):
        raise UsageError(f"service {program!r} is not a class")
    spec_of(found)
    return found


def make_stub(cls: type[T], invoke: Invoke, patience: Patience | None = None) -> T:
    """An object with the service's methods, which send their calls through `invoke`."""
    spec = spec_of(cls)
    described: Iterable[Method] = spec.methods.values()
    if patience is not None:
        described = [replace(method, patience=patience) for method in described]
    methods = {method.name: _stub_method(spec.name, method, invoke) for method in described}
    return cast(T, type(f"{cls.__name__}Stub", (), methods)())


def _stub_method(service_name: str, method: Method, invoke: Invoke) -> Callable[..., object]:
    def call(_: object, *args: object, **kwargs: object) -> object:
        key, request = method.encode(args, kwargs)
        given = (*args, *kwargs.values())
        return method.result(invoke(Operation(service_name, method.name, key), method, request, given))

    call.__name__ = method.name
    setattr(call, _STUB, (service_name, method))
    return call


def request_of(
    call: Callable[..., object], args: tuple[object, ...], kwargs: Mapping[str, object]
) -> tuple[Operation, Method, bytes]:
    """The operation, method and request of a stub's method with these arguments; raises TypeError as the call would.

    Raises UsageError if `call` is no method of a stub.
    """
    stub = getattr(call, _STUB, None)
    if stub is None:
        name = getattr(call, "__qualname__", repr(call))
        raise UsageError(
            f"{name} is no method of a service: give one of an object that drone.service(...) returned"
        )
    service_name, method = stub
    key, request = method.encode(args, kwargs)
    return Operation(service_name, method.name, key), method, request


def _describe(cls: type, name: str, profile_by: str | None, concurrency: int, where: Where) -> ServiceSpec:
    if type(concurrency) is not int or not 1 <= concurrency <= _MOST_CONCURRENCY:
        raise DeclarationError(
            f"service {cls.__name__}: concurrency is {concurrency!r}: give how many calls an instance computes at a "
            f"time, an integer from 1 to {_MOST_CONCURRENCY}"
        )
    methods = {
        method_name: _describe_method(cls, name, method_name, function, profile_by)
        for method_name, function in operations_of(cls).items()
    }
    if profile_by is not None and all(method.profile_by is None for method in methods.values()):
        raise DeclarationError(
            f"service {cls.__name__}: no method has the parameter {profile_by!r} of profile_by"
        )
    if where not in get_args(Where):
        raise DeclarationError(
            f'service {cls.__name__}: where is {where!r}: write where="servers" if no drone can run it, or nothing'
        )
    acting = [method.name for method in methods.values() if method.once]
    if where == "servers" and acting:
        raise DeclarationError(
            f'service {cls.__name__}: {", ".join(acting)} runs once, and on the drone alone, and where="servers" '
            "says that no drone can run the service: leave one of the two out"
        )
    settings = describe_settings(cls, lambda hint: _used_by(cls, hint, where))
    return ServiceSpec(name, MappingProxyType(methods), settings, concurrency, where=where)


def _with_part(cls: type, spec: ServiceSpec, part: type) -> ServiceSpec:
    """The service with the part before sending; raises DeclarationError for a part that does not fit."""
    where = f"service {cls.__name__}: before_sending"
    declared = vars(part).get(_SPEC) if isinstance(part, type) else None
    if not isinstance(declared, ServiceSpec):
        raise DeclarationError(
            f"{where} = {printable(repr(part))}: name a class with @service above it, whose methods have the names "
            "of operations"
        )
    methods = dict(spec.methods)
    for name, method in declared.methods.items():
        if why := _why_no_part(methods.get(name), method):
            raise DeclarationError(f"{where}: {part.__name__}.{name}: {why}")
        methods[name] = replace(
            methods[name], before=PartBeforeSending(method, tuple(method.signature.parameters))
        )
    return replace(spec, methods=MappingProxyType(methods), before_sending=part)


def _why_no_part(operation: Method | None, part: Method) -> str:
    """Why the method cannot run before calls of the operation are sent, with the remedy; "" if it can."""
    if operation is None:
        return "the service has no method of this name: give it the name of the operation whose requests it changes"
    if operation.once:
        return "calls of a method with @once are never sent: leave it out"
    if part.once or part.profile_by is not None:
        return "a part has neither @once nor profile_by: leave it out"
    wanted = typing.get_type_hints(operation.request.type, include_extras=True)
    given = typing.get_type_hints(part.request.type, include_extras=True)
    if not given:
        return "it has no parameter: give it those of the operation whose values it changes"
    for name, hint in given.items():
        if name == operation.profile_by:
            return f"{name!r} says which operation it is, and must not change: leave it out"
        if name not in wanted or wanted[name] != hint:
            expected = f"{name}: {_shown(wanted[name])}" if name in wanted else f"one of {', '.join(wanted)}"
            return f"parameter {name!r} is none of the operation's with its type: write {expected}"
    hints = tuple(given.values())
    result = hints[0] if len(hints) == 1 else tuple[hints]  # type: ignore[valid-type]
    returned = typing.get_type_hints(part.reply.type, include_extras=True)["value"]
    if returned != result | UnsetType:
        return f"it returns the new values of its parameters: write -> {_shown(result)}"
    return ""


def _shown(hint: Any) -> str:
    return hint.__name__ if isinstance(hint, type) and not typing.get_args(hint) else str(hint)


def _used_by(cls: type, hint: Any, where: Where) -> type[msgspec.Struct] | None:
    """The settings of the service in a type hint, perhaps one of `Service | None`; None without a service."""
    parts = [part for part in typing.get_args(hint) if part is not type(None)] or [hint]
    spec = vars(parts[0]).get(_SPEC) if len(parts) == 1 and isinstance(parts[0], type) else None
    if not isinstance(spec, ServiceSpec):
        return None
    if acting := [method.name for method in spec.methods.values() if method.once]:
        raise DeclarationError(
            f"service {cls.__name__} uses {spec.name}, whose {', '.join(acting)} runs once, and on the drone alone, "
            f"but {cls.__name__} may run on a server: have the mission call {spec.name} itself"
        )
    if where == "anywhere" and not spec.on_drone:
        raise DeclarationError(
            f"service {cls.__name__} uses {spec.name}, which only servers run, but {cls.__name__} may run on the "
            f'drone: declare it with @service(where="servers") too'
        )
    return spec.settings


def _describe_method(
    cls: type, service_name: str, name: str, function: Callable[..., object], profile_by: str | None
) -> Method:
    where = f"service {cls.__name__}, method {name}"
    try:
        hints = typing.get_type_hints(function, include_extras=True)
    except Exception as error:  # a hint in quotes is any expression
        raise DeclarationError(f"{where}: a type hint cannot be resolved: {message_of(error)}") from error
    signature = inspect.signature(function)
    parameters = list(signature.parameters.values())[1:]
    fields: list[tuple[str, Any]] = []
    for parameter in parameters:
        if parameter.kind not in (parameter.POSITIONAL_OR_KEYWORD, parameter.KEYWORD_ONLY):
            raise DeclarationError(f"{where}: parameter {parameter.name!r} must be passable by its name")
        if parameter.name not in hints:
            raise DeclarationError(f"{where}: parameter {parameter.name!r} has no type hint")
        require_sendable(hints[parameter.name], f"{where}: parameter {parameter.name!r}")
        _require_default(parameter, hints[parameter.name], where)
        fields.append((parameter.name, hints[parameter.name]))
    if "return" not in hints:
        raise DeclarationError(f"{where}: the result has no type hint; write -> None where there is none")
    require_sendable(hints["return"], f"{where}: the result")
    reply_type = msgspec.defstruct(
        f"{cls.__name__}_{name}_reply",
        [("value", hints["return"] | UnsetType, UNSET), ("fault", ServiceFault | UnsetType, UNSET)],
    )
    request_type = msgspec.defstruct(f"{cls.__name__}_{name}_request", fields)
    types = dict(fields)
    return Method(
        service=service_name,
        name=name,
        signature=signature.replace(parameters=parameters),
        profile_by=profile_by if profile_by in types else None,
        request=Encoding(request_type),
        reply_type=reply_type,
        reply=Encoding(reply_type),
        once=any(hasattr(vars(base).get(name), _ONCE) for base in cls.__mro__),  # also where it is overridden
        key_type=types.get(profile_by or ""),
    )


def _require_default(parameter: inspect.Parameter, hint: Any, where: str) -> None:
    if parameter.default is parameter.empty:
        return
    encoding: Encoding[Any] = Encoding(hint)
    try:
        encoding.decode(encoding.encode(parameter.default))
    except Exception as error:  # a class may have code that encodes it, or a union no encoding
        raise DeclarationError(
            f"{where}: parameter {parameter.name!r}: its default {printable(repr(parameter.default))} cannot be "
            f"sent: {message_of(error)}: change the default, or the type hint"
        ) from error


_FAULT = msgspec.msgpack.encode({"fault": None})[:-1]  # the beginning of a reply that carries one


def carries_fault(reply: bytes) -> bool:
    """Whether the reply of `Method.perform` has an exception of the service."""
    return reply.startswith(_FAULT)


def _plain_args(error: BaseException) -> list[Any] | None:
    try:
        args = error.__reduce__()[1]
    except Exception:  # noqa: BLE001 - its own code may raise any
        return None
    return list(args) if all(type(argument) in _PLAIN for argument in args) else None


def _rebuild(fault: ServiceFault) -> Exception:
    """The exception, made again without its constructor; a ServiceError that names it if that fails."""
    cls = _exception_class(fault.type)
    for args in ((fault.message,) if fault.args is None else tuple(fault.args), (fault.message,)):
        try:
            if cls is not None:
                error = cls.__new__(cls, *args)
                error.args = args
                if str(error) == fault.message:
                    return error
        except Exception:  # noqa: BLE001, S110 - such a class cannot be made from its arguments alone
            pass
    return ServiceError(fault.type.replace(":", "."), fault.message)


def _exception_class(type_path: str) -> type[Exception] | None:
    """The exception class of that path, if this process has it already.

    Nothing is imported and no module's own code runs: a reply must not choose what runs here. Errors of upwash itself
    are refused under any name, as they report on the vehicle.
    """
    module_name, _, qualname = type_path.partition(":")
    found: object = sys.modules.get(module_name)
    for name in qualname.split("."):
        if not isinstance(found, (type, ModuleType)):
            return None
        found = vars(found).get(name)
    if not isinstance(found, type) or not issubclass(found, Exception) or issubclass(found, UpwashError):
        return None
    return found
