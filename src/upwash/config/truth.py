"""What is true of a simulated server: what the drone believes, unless the file says otherwise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

from msgspec import Struct

from upwash.config.drone import ServerConfig, ServiceConfig

Times = Mapping[str, Mapping[str, float]]  # seconds, by service and profile key

_TURN_S = 30.0


class ServerTruth(Struct, frozen=True, kw_only=True):
    """What is true of a simulated server; where the file says nothing else, what the drone believes.

    With a "fixed" radio a call of `remote_call_s` takes that time from request to reply. Any other call takes its
    `processing_s` and the transfer: by the radio's goodput at the drone's distance, or else by the bandwidth.

    An instance computes `lanes` calls at a time; None: as many as its service declares. A call of `remote_call_s`
    occupies a lane for its `occupying_s`, if that is known, or else for all of its time.
    """

    join_s: float
    leave_s: float
    start_s: float
    processing_s: Times
    remote_call_s: Times
    occupying_s: Times
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
    return ServerTruth(
        join_s=server.check_running_s if truth.join_s is None else truth.join_s,
        leave_s=truth.leave_s,
        start_s=server.check_s - server.check_running_s if truth.start_s is None else truth.start_s,
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
    return {
        service: {
            key: seconds
            for key, seconds in by_key.items()
            if key in true_s.get(service, {}) or key not in delays_s.get(service, {})
        }
        for service, by_key in _merged(server.processing_s, true_s).items()
    }


def _remote_calls_still_believed(server: ServerConfig) -> Times:
    """The believed delays, without those of operations whose processing time or radio is true."""
    if server.truth.radio != "fixed":
        return {}
    true_s = server.truth.processing_s
    return {
        service: {key: seconds for key, seconds in by_key.items() if key not in true_s.get(service, {})}
        for service, by_key in server.remote_call_s.items()
    }
