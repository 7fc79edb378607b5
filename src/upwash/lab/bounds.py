"""How fast a simulated mission could have been at best: the bounds of core/bound.py in the world that it flew in."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from upwash.bundled import load_services
from upwash.config import DroneConfig, ServerTruth, ServiceConfig, server_area, server_truth
from upwash.core.bound import Bound, bound
from upwash.core.estimates import Operation
from upwash.core.geo import Position, ground_distance_m
from upwash.core.schedule import ComingCall, Offer
from upwash.lab.run import Run
from upwash.preparation import make_estimates
from upwash.service import spec_of
from upwash.sim.radio import goodput_of
from upwash.sim.world import computing_s, delay_of


def bound_of(run: Run, config: DroneConfig) -> Bound | None:
    """The least times of the mission, whatever decides; None where it was not completed.

    It flies and takes photos for as long as this run did, and makes the same calls at the same places. Computers are
    never hot and nothing fails; calls take their mean time, so with noise the bounds hold for the mean of many runs.
    """
    if not run.result.completed:
        return None
    other_s = run.result.mission_time_s - run.result.totals.service_delay_s
    truths = {server.name: server_truth(server, config.services) for server in config.servers}
    joins_s = {name: truth.join_s for name, truth in truths.items()}
    calls = bound(list(_calls(run, config, truths)), joins_s)
    return Bound(other_s + calls.free_s, other_s + calls.with_joins_s)


def _calls(run: Run, config: DroneConfig, truths: Mapping[str, ServerTruth]) -> Iterator[ComingCall]:
    """The calls that the run made, with all that was in range of them."""
    specs = {name: spec_of(each.cls) for name, each in load_services(config.services).items()}
    operations = {str(operation): operation for operation in make_estimates(config, specs).operations}
    services = {service.name: service for service in config.services}
    areas = {server.name: server_area(server, config.mission.home) for server in config.servers}
    ended_s, position = 0.0, Position(0.0, 0.0)
    for event in run.events:
        match event:
            case {"event": "decided", "position": place}:
                position = Position(**place)
            case {"event": "call", "at_s": begun_s, "operation": name, "t": now_s}:
                operation = operations[name]
                service = services[operation.service]
                offers = [
                    Offer(
                        stay.server,
                        _remote_s(
                            operation,
                            service,
                            truths[stay.server],
                            ground_distance_m(position, areas[stay.server].centre),
                        ),
                        begun_s - max(ended_s, stay.from_s),
                    )
                    for stay in run.stays
                    if stay.from_s <= begun_s < stay.to_s
                ]
                yield ComingCall(delay_of(operation, service.local_call_s), begun_s - ended_s, offers)
                ended_s = now_s


def _remote_s(operation: Operation, service: ServiceConfig, truth: ServerTruth, distance_m: float) -> float:
    """The true delay of a call at that distance; infinite where the server cannot answer it."""
    if service.name not in truth.images:
        return math.inf
    try:
        call_s = computing_s(operation, truth)
    except KeyError:
        return math.inf
    goodput = goodput_of(truth, service.name)
    if goodput is not None:
        call_s += goodput.transfer_s(service.request_bytes, distance_m)
        call_s += goodput.transfer_s(service.reply_bytes, distance_m)
    return call_s
