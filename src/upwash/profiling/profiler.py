"""PROGRAM: measures what a service's calls cost, on the drone and on a server: the offline profiling before a flight.

The thesis takes a first estimate of a remote call from a server's processing time and bandwidth (equation 3.1), and
every other one from tests on the ground (section 3.3).
"""

from __future__ import annotations

import asyncio
import inspect
import itertools
import statistics
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass

from msgspec import inspect as types

from upwash.core.operation import ON_DRONE, Operation
from upwash.drone.onboard import started
from upwash.drone.server_session import ServerEndpoint, ServerSession
from upwash.errors import UpwashError, UsageError
from upwash.ports import Dialer, InstanceSpec, Link, Network, Runtime
from upwash.profiling.agreement import LabelledBox, lost, mean_ap50
from upwash.rpc.protocol import service_path
from upwash.rpc.service import Method, ServiceSpec
from upwash.support.background import beside
from upwash.support.text import worded

LONGEST_CALL_S = 600.0
_PROBES = 7
_LEAST_CARRIED_S = 1e-3  # a shorter difference is noise: the way is too fast to tell
_UNDECODABLE = b"\xc1"  # never in MessagePack: a service refuses it without computing


@dataclass(frozen=True)
class CallSample:
    """One operation, and a request of it for each photo, by the photo's name."""

    operation: Operation
    method: Method
    requests: Mapping[str, bytes]

    @property
    def request_bytes(self) -> int:
        """The mean size of its requests."""
        return round(statistics.fmean(map(len, self.requests.values())))


@dataclass(frozen=True)
class CallProfile:
    """What calls of one operation took: the first of a new instance, those after it, and the mean size of a reply.

    `answers` has the result for each photo.
    """

    sample: CallSample
    first_s: float
    call_s: tuple[float, ...]
    reply_bytes: int
    answers: tuple[object, ...] = ()

    @property
    def mean_s(self) -> float:
        """The mean delay of the calls after the first."""
        return statistics.fmean(self.call_s)


@dataclass(frozen=True)
class OnboardProfile:
    """A service on the drone: its calls, and how long an instance took to start and how much memory it needed."""

    calls: tuple[CallProfile, ...]
    start_s: tuple[float, ...]
    peak_memory_bytes: int

    @property
    def mean_s(self) -> float:
        """The sum of the mean delays of all operations, in seconds."""
        return sum(call.mean_s for call in self.calls)


@dataclass(frozen=True)
class PartProfile:
    """A part before sending: its mean time and the mean sizes before and after, and what it costs each operation.

    `ap50` has the score of the answers to whole and to smaller requests, by operation, where there are labels.
    """

    takes_s: float
    request_bytes: int
    sent_bytes: int
    loss: Mapping[Operation, float]
    ap50: Mapping[Operation, tuple[float, float]]


@dataclass(frozen=True)
class ServerProfile:
    """A service on a server: its calls, the times from selection to READY, and the goodput of the path.

    `check_s` is None if the services ran already, `goodput_bit_s` if the path is too fast to measure.
    """

    calls: tuple[CallProfile, ...]
    processing_s: Mapping[Operation, float]
    check_s: float | None
    check_running_s: float
    goodput_bit_s: float | None


Watch = Callable[[str], None]  # told what is done next, once per call


def samples(spec: ServiceSpec, photos: Mapping[str, bytes]) -> list[CallSample]:
    """Every operation that can be called with a photo, for photos by their names; UsageError where there is none.

    That is a method with one parameter of bytes; the profile argument takes each of its values, and any other
    parameter has a default.
    """
    found = [
        CallSample(
            Operation(spec.name, method.name, key),
            method,
            {called: method.encode((), {name: photo, **arguments})[1] for called, photo in photos.items()},
        )
        for method in spec.methods.values()
        if not method.once and (name := _photo_parameter(method)) is not None
        for key, arguments in _keys(method)
    ]
    if not found:
        raise UsageError(
            f"service {spec.name!r} has no method that takes one photo (a parameter of bytes, all others with "
            "defaults): profile it with a program of your own"
        )
    return found


def values_of(spec: ServiceSpec, setting: str) -> tuple[str, ...]:
    """The words that a setting can be; raises UsageError if it is not a Literal of words."""
    settings = types.type_info(spec.settings)
    assert isinstance(settings, types.StructType)  # noqa: S101 - made by settings.py
    found = {field.name: field.type for field in settings.fields}
    if setting not in found:
        raise UsageError(
            f"service {spec.name!r} has no setting {setting!r}; it has {', '.join(found) or 'none'}"
        )
    given = found[setting]
    for kind in given.types if isinstance(given, types.UnionType) else (given,):
        if isinstance(kind, types.LiteralType) and all(isinstance(value, str) for value in kind.values):
            return tuple(map(str, kind.values))
    raise UsageError(
        f"setting {setting} of service {spec.name!r} can be more than a few words: measure one at a time"
    )


def calls_to_make(found: Sequence[CallSample], calls: int) -> int:
    """The number of calls of a Watch during the measurement."""
    return len(found) * (calls + 1)


async def profile_onboard(
    spec: InstanceSpec,
    found: Sequence[CallSample],
    *,
    calls: int,
    drone: str,
    start_timeout_s: float,
    runtime: Runtime,
    dialer: Dialer,
    memory_bytes: Callable[[], int],
    watch: Watch,
) -> OnboardProfile:
    """Measures each operation in an instance of its own, so that each has a first call.

    `memory_bytes()` is the instance's peak memory.
    """
    own = _Own(drone, start_timeout_s, runtime, dialer)
    profiles, starts_s, memories_bytes = [], [], []
    for sample in found:
        began_s = _now_s()
        async with own.called(spec) as link:
            starts_s.append(_now_s() - began_s)
            profiles.append(await _measure(sample, _over(link), calls=calls, watch=watch))
            memories_bytes.append(memory_bytes())
    return OnboardProfile(tuple(profiles), tuple(starts_s), max(memories_bytes))


async def profile_part(
    part: InstanceSpec,
    spec: InstanceSpec,
    found: Sequence[CallSample],
    *,
    labels: Mapping[str, Sequence[LabelledBox]] | None,
    drone: str,
    start_timeout_s: float,
    runtime: Runtime,
    dialer: Dialer,
) -> PartProfile:
    """Measures the part of a service before sending, and compares the answers to whole and to smaller requests.

    Each operation that has the part is called twice for each photo. Raises UsageError where the part fails.
    """
    own, delays_s, sizes_bytes = _Own(drone, start_timeout_s, runtime, dialer), list[float](), list[int]()
    loss, ap50, sending = {}, {}, [sample for sample in found if sample.method.before is not None]
    async with own.called(part) as its, own.called(spec) as link:
        for sample in sending:
            method, request, whole, less = sample.method, _over(link), list[object](), list[object]()
            for photo, asked in sample.requests.items():
                began_s = _now_s()
                try:
                    reply = await its.request(
                        service_path(part.service, method.name),
                        method.request_of_part(asked),
                        timeout_s=LONGEST_CALL_S,
                    )
                    reduced = method.reduced(asked, reply)
                except (UpwashError, ValueError) as error:
                    raise UsageError(f"{part.service} failed on {photo}: {error}") from error
                delays_s.append(_now_s() - began_s)
                sizes_bytes.append(min(len(asked), len(reduced)))
                for body, answers in ((asked, whole), (reduced, less)):
                    answer = await request(sample.operation, body)
                    answers.append(answer_of(sample, photo, answer))
            loss[sample.operation] = lost(whole, less)
            if labels is not None:
                truth = [labels[photo] for photo in sample.requests]
                scores = ap50[sample.operation] = (mean_ap50(whole, truth), mean_ap50(less, truth))
                loss[sample.operation] = max(0.0, scores[0] - scores[1])
    # The first photo is measured too: a flight has a first one.
    return PartProfile(
        statistics.fmean(delays_s),
        round(statistics.fmean(sample.request_bytes for sample in sending)),
        round(statistics.fmean(sizes_bytes)),
        loss,
        ap50,
    )


@dataclass(frozen=True)
class _Own:
    """Starts instances on this computer, as a drone does."""

    drone: str
    start_timeout_s: float
    runtime: Runtime
    dialer: Dialer

    @asynccontextmanager
    async def called(self, spec: InstanceSpec) -> AsyncIterator[Link]:
        """A link to a new instance, which is stopped at the end of the block."""
        instance = await started(self.runtime, spec, within_s=self.start_timeout_s)
        try:
            await instance.admit(frozenset({self.drone}))
            link = self.dialer.dial(instance.endpoint, server=ON_DRONE)
            try:
                yield link
            finally:
                await link.close()
        finally:
            await instance.stop()


async def profile_server(
    endpoint: ServerEndpoint,
    found: Sequence[CallSample],
    *,
    calls: int,
    start_timeout_s: float,
    network: Network,
    dialer: Dialer,
    watch: Watch,
) -> ServerProfile:
    """Visits the server twice, as a drone does, and calls its services the second time."""
    check_s = await _check_stopped_s(
        ServerSession(endpoint, network=network, dialer=dialer), start_timeout_s=start_timeout_s
    )
    session = ServerSession(endpoint, network=network, dialer=dialer)
    began_s = _now_s()
    try:
        await session.ask()
        if not session.running:
            raise UpwashError(
                f"{endpoint.name} has stopped its services again already: let its idle_stop_s be longer"
            )
        check_running_s = _now_s() - began_s
        async with beside(session.keep_lease(), name=f"the lease at {session.server}"):
            profiles = [await _measure(sample, _to(session), calls=calls, watch=watch) for sample in found]
            transfer_s, goodput_bit_s = await _measure_transfer(found[0], _to(session))
    finally:
        await session.end(in_range=True)
    return ServerProfile(
        tuple(profiles),
        processing_s={
            profile.sample.operation: max(0.0, profile.mean_s - transfer_s) for profile in profiles
        },
        check_s=check_s,
        check_running_s=check_running_s,
        goodput_bit_s=goodput_bit_s,
    )


Request = Callable[[Operation, bytes], Awaitable[bytes]]


def _over(link: Link) -> Request:
    return lambda operation, body: link.request(
        service_path(operation.service, operation.method), body, timeout_s=LONGEST_CALL_S
    )


def _to(session: ServerSession) -> Request:
    return lambda operation, body: session.call(
        operation.service, operation.method, body, deadline_s=LONGEST_CALL_S
    )


async def _measure(sample: CallSample, request: Request, *, calls: int, watch: Watch) -> CallProfile:
    delays_s, replies_bytes, answers = [], [], dict[str, object]()
    for photo in itertools.islice(itertools.cycle(sample.requests), calls + 1):
        watch(str(sample.operation))
        began_s = _now_s()
        reply = await request(sample.operation, sample.requests[photo])
        delays_s.append(_now_s() - began_s)
        replies_bytes.append(len(reply))
        answers[photo] = answer_of(sample, photo, reply)
    return CallProfile(
        sample,
        delays_s[0],
        tuple(delays_s[1:]),
        round(statistics.fmean(replies_bytes)),
        tuple(answers.values()),
    )


def answer_of(sample: CallSample, photo: str, reply: bytes) -> object:
    """The result in a reply; raises UsageError, with the photo's name, for an exception of the service."""
    try:
        return sample.method.result(sample.method.decode(reply))
    except Exception as error:
        raise UsageError(f"{sample.operation} failed on {photo}: {worded(error)}") from error


async def _measure_transfer(sample: CallSample, request: Request) -> tuple[float, float | None]:
    """The delay of a request without computation, and the goodput by its size."""
    sizes_bytes = 1, sample.request_bytes
    delays_s: dict[int, list[float]] = {size_bytes: [] for size_bytes in sizes_bytes}
    for _ in range(_PROBES):
        for size_bytes in sizes_bytes:
            began_s = _now_s()
            await request(sample.operation, _UNDECODABLE * size_bytes)
            delays_s[size_bytes].append(_now_s() - began_s)
    small_s, large_s = (statistics.median(delays_s[size_bytes]) for size_bytes in sizes_bytes)
    carried_s = large_s - small_s
    if carried_s < _LEAST_CARRIED_S:
        return large_s, None
    return large_s, 8 * (sizes_bytes[1] - sizes_bytes[0]) / carried_s


async def _check_stopped_s(session: ServerSession, *, start_timeout_s: float) -> float | None:
    """Time from selection to READY including the start; None if the services ran already."""
    began_s = _now_s()
    try:
        await session.ask()
        if session.running:
            return None
        await session.start_patiently(within_s=start_timeout_s)
        return _now_s() - began_s
    finally:
        await session.end(in_range=True)


def _photo_parameter(method: Method) -> str | None:
    """The only parameter of bytes, if all others have values."""
    parameters, nothing = method.signature.parameters, inspect.Parameter.empty
    needed = [field for field in _fields(method) if parameters[field.name].default is nothing]
    photos = [field for field in needed if isinstance(field.type, types.BytesType)]
    if len(photos) != 1 or any(field.name not in (photos[0].name, method.profile_by) for field in needed):
        return None
    return photos[0].name


def _keys(method: Method) -> Iterator[tuple[str, dict[str, object]]]:
    if method.profile_by is None:
        yield "", {}
        return
    found = next(field.type for field in _fields(method) if field.name == method.profile_by)
    match found:
        case types.LiteralType(values):
            arguments: Sequence[object] = values
        case types.EnumType(cls):
            arguments = tuple(cls)
        case types.BoolType():
            arguments = (False, True)
        case _:
            raise UsageError(
                f"method {method.name}: the values of {method.profile_by} are not known; "
                "declare it as a Literal or an Enum"
            )
    for argument in arguments:
        yield str(getattr(argument, "value", argument)), {method.profile_by: argument}


def _fields(method: Method) -> tuple[types.Field, ...]:
    request = types.type_info(method.request.type)
    assert isinstance(request, types.StructType)  # noqa: S101 - made by service.py
    return request.fields


def _now_s() -> float:
    return asyncio.get_running_loop().time()
