"""How fast simulated missions could have been at best: the bounds of core/bound.py in the world that they flew in."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean

from upwash.config import DroneConfig, ServerTruth, ServiceConfig, server_areas, server_truth
from upwash.core.bound import Bound, FleetBound, SharedMission, bound, shared_s
from upwash.core.estimates import Operation
from upwash.core.geo import Position, ground_distance_m
from upwash.core.schedule import ComingCall, Offer
from upwash.drone.preparation import make_estimates
from upwash.eventlog import schema
from upwash.lab.run import Run
from upwash.missions.bundled import load_services, load_specs
from upwash.rpc.service import spec_of
from upwash.sim.radio import goodput_of
from upwash.sim.world import computing_s, delay_of, occupying_s


@dataclass(frozen=True, slots=True)
class _Made:
    """A call that a run made."""

    operation: Operation
    call: ComingCall


def bound_of(run: Run, config: DroneConfig) -> Bound | None:
    """The least times of the mission, whatever decides; None where it was not completed.

    It flies and takes photos for as long as this run did, and makes the same calls at the same places. Computers are
    never hot and nothing fails; calls take their mean time, so with noise the bounds hold for the mean of many runs.
    """
    if not run.result.completed:
        return None
    truths = _truths(config)
    return _bound(run, list(_made(run, config, truths)), truths)


def bounds_of(
    runs: Sequence[Run], fleet: Sequence[DroneConfig]
) -> tuple[list[Bound | None], FleetBound | None]:
    """The bounds of missions that were flown at the same time: of each as by itself, and of all that were completed.

    The latter are None where there are none.
    """
    own: list[Bound | None] = []
    missions: list[SharedMission] = []
    rates: dict[
        tuple[str, str], float
    ] = {}  # by server and service: the most that is saved in a second of a lane
    for run, config in zip(runs, fleet, strict=True):
        truths = _truths(config)
        made = list(_made(run, config, truths)) if run.result.completed else []
        own.append(_bound(run, made, truths) if run.result.completed else None)
        if (found := own[-1]) is None:
            continue
        local_s = _other_s(run) + sum(each.call.local_s for each in made)
        missions.append(SharedMission(_begun_s(run), local_s, found.free_s))
        for instance, rate in _rates(made, truths):
            rates[instance] = max(rates.get(instance, 0.0), rate)
    if not missions:
        return own, None
    saved_per_s = sum(rate * _lanes(instance, fleet[0]) for instance, rate in rates.items())
    bounds = [each for each in own if each is not None]
    return own, FleetBound(
        free_s=fmean(each.free_s for each in bounds),
        with_joins_s=fmean(each.with_joins_s for each in bounds),
        shared_s=shared_s(missions, saved_per_s),
    )


def _truths(config: DroneConfig) -> dict[str, ServerTruth]:
    return {server.name: server_truth(server, config.services) for server in config.servers}


def _bound(run: Run, made: Sequence[_Made], truths: Mapping[str, ServerTruth]) -> Bound:
    other_s = _other_s(run)
    calls = bound([each.call for each in made], {name: truth.join_s for name, truth in truths.items()})
    return Bound(other_s + calls.free_s, other_s + calls.with_joins_s)


def _other_s(run: Run) -> float:
    """What the mission spent on other things than calls."""
    return run.result.mission_time_s - run.result.totals.service_delay_s


def _begun_s(run: Run) -> float:
    """The second of the simulation at which a completed mission's time began."""
    ended_s = next(event.t for event in run.events if isinstance(event, schema.MissionCompleted))
    return ended_s - run.result.mission_time_s


def _rates(
    made: Sequence[_Made], truths: Mapping[str, ServerTruth]
) -> Iterator[tuple[tuple[str, str], float]]:
    """How much each call saves on each server that is in range of it, for each second that it keeps a lane busy."""
    for each in made:
        for offer in each.call.offers:
            gain_s = each.call.local_s - offer.call_s
            if gain_s > 0:
                busy_s = occupying_s(each.operation, truths[offer.server])
                yield (offer.server, each.operation.service), gain_s / busy_s if busy_s > 0 else math.inf


def _lanes(instance: tuple[str, str], config: DroneConfig) -> int:
    """How many calls the instance computes at a time."""
    name, service = instance
    truth = next(server.truth for server in config.servers if server.name == name)
    return truth.lanes or spec_of(load_services(config.services)[service].cls).concurrency


def _made(run: Run, config: DroneConfig, truths: Mapping[str, ServerTruth]) -> Iterator[_Made]:
    """The calls that the run made, with all that was in range of them."""
    specs = load_specs(config.services)
    operations = {str(operation): operation for operation in make_estimates(config, specs).operations}
    services = {service.name: service for service in config.services}
    areas = server_areas(config)
    ended_s, position = 0.0, Position(0.0, 0.0)
    for event in run.events:
        match event:
            case schema.Decided():
                position = event.position
            case schema.Call(at_s=begun_s, operation=name, t=now_s):
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
                    for stay in run.range_intervals
                    if stay.from_s <= begun_s < stay.to_s
                ]
                local_s = delay_of(operation, service.local_call_s)
                yield _Made(operation, ComingCall(local_s, begun_s - ended_s, offers))
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
