"""What is true of a simulated server, which is what the drone believes unless the file says otherwise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

from msgspec import Struct

from upwash.config.drone import ServerConfig, ServiceConfig

_TURN_S = 30.0


class ServerTruth(Struct, frozen=True, kw_only=True):
    """What is true of a simulated server, the belief taken wherever the file says nothing else.

    Where the radio is "fixed" a service in `remote_call_s` takes that long end to end. Any other takes its
    `processing_s` and the transfer: by the radio's goodput at the drone's distance, or else by the bandwidth.

    An instance computes `lanes` calls at a time; None: as many as its service declares. One that takes so long end to
    end occupies a lane for its `occupying_s`, where that is known, and else for all of its time.
    """

    join_s: float
    leave_s: float
    start_s: float
    processing_s: Mapping[str, Mapping[str, float]]
    remote_call_s: Mapping[str, Mapping[str, float]]
    occupying_s: Mapping[str, Mapping[str, float]]
    first_extra_s: float
    bandwidth_bit_s: float | None
    radio: str
    slots: int | Literal["auto"]
    turn_s: float
    lanes: int | None
    images: tuple[str, ...]
    peers: tuple[str, ...]


def server_truth(server: ServerConfig, services: Sequence[ServiceConfig]) -> ServerTruth:
    """What is true of the server in simulation."""
    truth = server.truth
    start_s = server.check_s - server.check_running_s if truth.start_s is None else truth.start_s
    return ServerTruth(
        join_s=server.check_running_s if truth.join_s is None else truth.join_s,
        leave_s=truth.leave_s,
        start_s=start_s,
        processing_s=_merged(server.processing_s, truth.processing_s),
        remote_call_s=_merged(_remote_calls_still_believed(server), truth.remote_call_s),
        occupying_s=_occupying(server),
        first_extra_s=truth.first_extra_s,
        bandwidth_bit_s=server.bandwidth_bit_s,
        radio=truth.radio,
        slots=truth.slots,
        turn_s=_TURN_S if truth.turn_s is None else truth.turn_s,
        lanes=truth.lanes,
        images=tuple(service.name for service in services) if truth.images is None else truth.images,
        peers=truth.peers,
    )


def _merged(
    belief: Mapping[str, Mapping[str, float]], truth: Mapping[str, Mapping[str, float]]
) -> Mapping[str, Mapping[str, float]]:
    if not truth:
        return belief
    return {
        service: {**belief.get(service, {}), **truth.get(service, {})}
        for service in dict.fromkeys([*belief, *truth])
    }


def _occupying(server: ServerConfig) -> Mapping[str, Mapping[str, float]]:
    """The processing times, but not those that are only believed where the call's delay is told truly."""
    told, delays = server.truth.processing_s, server.truth.remote_call_s
    if not delays:
        return _merged(server.processing_s, told)
    return {
        service: {
            key: seconds
            for key, seconds in by_key.items()
            if key in told.get(service, {}) or key not in delays.get(service, {})
        }
        for service, by_key in _merged(server.processing_s, told).items()
    }


def _remote_calls_still_believed(server: ServerConfig) -> Mapping[str, Mapping[str, float]]:
    """The believed delays, but for operations whose processing time or radio is told truly."""
    if server.truth.radio != "fixed":
        return {}
    told = server.truth.processing_s
    if not told:
        return server.remote_call_s
    return {
        service: {key: seconds for key, seconds in by_key.items() if key not in told.get(service, {})}
        for service, by_key in server.remote_call_s.items()
    }
