"""What is true of a simulated server: what the drone believes, unless the file says otherwise."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from statistics import fmean

from msgspec.structs import asdict, replace

from upwash.config.drone import ServerConfig, ServiceConfig
from upwash.config.traces import read_service_times
from upwash.config.world import TruthConfig
from upwash.core.operation import Operation

Times = Mapping[str, Mapping[str, float]]  # seconds, by service and profile key

_TURN_S = 30.0


class ServerTruth(TruthConfig, frozen=True, kw_only=True):
    """What is true of a simulated server; where the file says nothing else, what the drone believes.

    With a "fixed" radio a call of `remote_call_s` takes that time from request to reply. Any other call takes its
    `processing_s` and the transfer: by the radio's goodput at the drone's distance, or else by the bandwidth.

    An instance computes `lanes` calls at a time; None: as many as its service declares. A call of `remote_call_s`
    occupies a lane for its `occupying_s`; where that is unknown, for all of its time. `processing_s` has the
    means of `service_times`, which are by operation as the trace names it. `saved_s` is by how much a call of a
    service, given from end to end, is shorter with less to send.
    """

    join_s: float
    start_s: float
    turn_s: float
    images: tuple[str, ...]
    occupying_s: Times
    bandwidth_bit_s: float | None
    service_times: Mapping[str, Sequence[float]]
    saved_s: Mapping[str, float]


def server_truth(server: ServerConfig, services: Sequence[ServiceConfig]) -> ServerTruth:
    """What is true of the server in simulation; raises ConfigError for a trace that is none."""
    truth = server.truth
    times = read_service_times(truth.service_csv) if truth.service_csv is not None else {}
    truth = replace(truth, processing_s=_merged(truth.processing_s, _means(times, services)))
    server = replace(server, truth=truth)
    told = replace(
        truth,
        join_s=server.check_running_s if truth.join_s is None else truth.join_s,
        start_s=server.check_s - server.check_running_s if truth.start_s is None else truth.start_s,
        processing_s=_merged(server.processing_s, truth.processing_s),
        remote_call_s=_merged(_remote_calls_still_believed(server, services), truth.remote_call_s),
        turn_s=_TURN_S if truth.turn_s is None else truth.turn_s,
        images=tuple(service.name for service in services) if truth.images is None else truth.images,
    )
    return ServerTruth(
        **asdict(told),
        occupying_s=_occupying(server),
        bandwidth_bit_s=server.bandwidth_bit_s,
        service_times=times,
        saved_s={
            service.name: 8 * (service.request_bytes - part.request_bytes) / server.bandwidth_bit_s
            for service in services
            if (part := service.before_sending) is not None and server.bandwidth_bit_s is not None
        },
    )


def times_of(operation: Operation, times: Mapping[str, Sequence[float]]) -> Sequence[float]:
    """The operation's measured times, by its name, its profile key or its method; empty where there are none."""
    names = (str(operation), operation.key, operation.method)
    return next((times[name] for name in names if name and name in times), ())


def _means(times: Mapping[str, Sequence[float]], services: Sequence[ServiceConfig]) -> Times:
    found: dict[str, dict[str, float]] = {}
    for name, seconds in times.items():
        for service, key in keys_of(name, services):
            found.setdefault(service, {})[key] = fmean(seconds)
    return found


def keys_of(name: str, services: Sequence[ServiceConfig]) -> Iterator[tuple[str, str]]:
    """The services and keys of a trace's operation: `service.method[key]`, `service.method`, a key or a method."""
    path, _, key = name.removesuffix("]").partition("[")
    named, dot, method = path.rpartition(".")
    keys = (key,) if key else (method, "") if dot else (method,)
    for service in services:
        if not dot or service.name == named:
            yield from ((service.name, one) for one in keys if one in service.local_call_s)


def _merged(belief: Times, truth: Times) -> Times:
    if not truth:
        return belief
    return {
        service: {**belief.get(service, {}), **truth.get(service, {})}
        for service in dict.fromkeys([*belief, *truth])
    }


def _occupying(server: ServerConfig) -> Times:
    """The processing times, without those that are only believed while the call's delay is true."""
    true_s, delays_s = server.truth.processing_s, server.truth.remote_call_s

    def counts(service: str, key: str) -> bool:
        return key in true_s.get(service, {}) or key not in delays_s.get(service, {})

    return {
        service: {key: seconds for key, seconds in by_key.items() if counts(service, key)}
        for service, by_key in _merged(server.processing_s, true_s).items()
    }


def _remote_calls_still_believed(server: ServerConfig, services: Sequence[ServiceConfig]) -> Times:
    """The believed delays, without those of operations whose processing time or radio is true.

    An operation with a true processing time, among others with a believed delay, has its transfer added.
    """
    if server.truth.radio != "fixed" or server.truth.goodput_csv is not None:
        return {}
    true_s = server.truth.processing_s
    believed = {
        service: {key: seconds for key, seconds in by_key.items() if key not in true_s.get(service, {})}
        for service, by_key in server.remote_call_s.items()
    }
    goodput_bit_s = server.bandwidth_bit_s
    if goodput_bit_s is None and server.truth.service_csv is not None:
        goodput_bit_s = math.inf  # its times have the transfer in them
    for service in services:
        if believed.get(service.name) and goodput_bit_s is not None:
            transfer_s = 8 * (service.request_bytes + service.reply_bytes) / goodput_bit_s
            true = true_s.get(service.name, {})
            believed[service.name] |= {key: seconds + transfer_s for key, seconds in true.items()}
    return believed
