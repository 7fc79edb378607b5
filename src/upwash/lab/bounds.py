"""How fast simulated missions could have been at best: the bounds of lab/least_time.py in their world."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean

from msgspec.structs import replace

from upwash.config.checks import only_on_servers
from upwash.config.drone import DroneConfig, PolicyConfig, ServiceConfig
from upwash.config.places import server_places
from upwash.config.truth import ServerTruth, server_truth
from upwash.core.geo import Position, ground_distance_m
from upwash.core.operation import Operation
from upwash.core.planning.schedule import ComingCall, Offer
from upwash.drone.preparation import make_estimates, two_answers
from upwash.errors import MissionFailed
from upwash.eventlog import schema
from upwash.lab.least_time import Bound, FleetBound, SharedMission, bound, shared_s
from upwash.lab.run import Alone, Run, flown_alone
from upwash.missions.bundled import load_services, load_specs
from upwash.rpc.service import spec_of
from upwash.sim.radio import Spot, goodput_of
from upwash.sim.world import computing_s, delay_of, occupying_s

_NO_TIME_S = 1e-9  # of a call, which has to take some


@dataclass(frozen=True, slots=True)
class _Made:
    """A call of a run; the way to the next call, in `way_s`, may hide it.

    `on_the_way` has the servers in range before the next call.
    """

    operation: Operation
    call: ComingCall
    way_s: float = 0.0
    on_the_way: Sequence[Offer] = ()

    @property
    def offers(self) -> Sequence[Offer]:
        """The servers that could answer the call."""
        return (*self.call.offers, *self.on_the_way)

    def least_wait_s(self, *, joined: bool) -> float:
        """The least wait (s) of the mission for the call: with every server `joined`, or without any."""
        remote_s = [offer.call_s for offer in self.offers] if joined else []
        return max(0.0, min([self.call.local_s, *remote_s]) - self.way_s)


@dataclass(frozen=True, slots=True)
class _Mission:
    """A completed mission: its calls, and what it spent on other things than waiting for them.

    A drone that may go on before answers waits while it acts, for `acting_s`.
    """

    calls: Sequence[_Made]
    other_s: float
    may_go: bool
    acting_s: float = 0.0

    @property
    def local_s(self) -> float:
        """The least time with every call on the drone."""
        return self._least_s(joined=False)

    def _least_s(self, *, joined: bool) -> float:
        waits_s = sum(made.least_wait_s(joined=joined) for made in self.calls)
        return self.other_s + max(self.acting_s, waits_s)

    def bound(self, truths: Mapping[str, ServerTruth]) -> Bound:
        """The least times of the mission."""
        if self.may_go:
            return Bound(self._least_s(joined=True), self._least_s(joined=True))
        joins_s = {name: truth.join_s for name, truth in truths.items()}
        calls = bound([made.call for made in self.calls], joins_s)
        return Bound(self.other_s + calls.free_s, self.other_s + calls.with_joins_s)


def bound_of(run: Run, config: DroneConfig) -> Bound | None:
    """The least times of the mission under any policy; None if it was not completed, or flew a recorded track.

    It flies and takes photos for as long as this run did, and makes the same calls at the same places. Computers are
    never hot and nothing fails; calls take their mean time, so with noise the bounds hold for the mean of many runs.
    If the drone may go on before answers are there, no way to an act makes its way longer.
    """
    if not run.result.completed or config.vehicle.track_csv is not None:
        return None
    truths = _truths(config)
    return _mission(run, config, truths).bound(truths)


def bounds_of(
    runs: Sequence[Run], fleet: Sequence[DroneConfig]
) -> tuple[list[Bound | None], FleetBound | None]:
    """The bounds of missions that were flown at the same time: of each as by itself, and of all that were completed.

    The latter are None where there are none.
    """
    own: list[Bound | None] = []
    missions: list[SharedMission] = []
    rates: dict[tuple[str, str], float] = {}  # by server and service, the most that a second of a lane saves
    for run, config in zip(runs, fleet, strict=True):
        if not run.result.completed:
            own.append(None)
            continue
        truths = _truths(config)
        mission = _mission(run, config, truths)
        own.append(found := mission.bound(truths))
        ended_s = next(event.t for event in run.events if isinstance(event, schema.MissionCompleted))
        missions.append(SharedMission(ended_s - run.result.mission_time_s, mission.local_s, found.free_s))
        for instance, rate in _rates(mission.calls, truths):
            rates[instance] = max(rates.get(instance, 0.0), rate)
    if not missions:
        return own, None
    saved_per_s = sum(rate * _lanes(instance, fleet[0]) for instance, rate in rates.items())
    bounds = [least for least in own if least is not None]
    return own, FleetBound(
        free_s=fmean(bound.free_s for bound in bounds),
        with_joins_s=fmean(bound.with_joins_s for bound in bounds),
        shared_s=shared_s(missions, saved_per_s),
    )


def _truths(config: DroneConfig) -> dict[str, ServerTruth]:
    return {server.name: server_truth(server, config.services) for server in config.servers}


def _mission(run: Run, config: DroneConfig, truths: Mapping[str, ServerTruth]) -> _Mission:
    mission_s = run.result.mission_time_s
    on_rows = config.mission.photos is not None or any(map(only_on_servers, config.services))
    waits = config.policy.stay_or_go == "stay" and not any(service.two_answers for service in config.services)
    if waits and not on_rows:
        other_s = mission_s - run.result.totals.service_delay_s
        return _Mission(list(_made(run, config, truths)), other_s, may_go=False)
    acting_s = config.mission.action_s * sum(isinstance(event, schema.Acted) for event in run.events)
    alone = _way_alone(run, config)
    if alone is None:
        return _Mission([], mission_s, may_go=True)
    calls = [] if on_rows else list(_made(run, config, truths, alone))
    return _Mission(calls, min(mission_s - acting_s, alone.time_s), may_go=True, acting_s=acting_s)


def _way_alone(run: Run, config: DroneConfig) -> Alone | None:
    """The way alone, without a wait, an action or a way back; None if the program needs its answers.

    A call that only servers compute need not be waited for.
    """

    def in_no_time(service: ServiceConfig) -> ServiceConfig:
        if only_on_servers(service):
            return service
        call_s = dict.fromkeys(service.local_call_s, _NO_TIME_S)
        return replace(service, local_call_s=call_s, local_first_extra_s=0.0)

    mission = config.mission
    for event in run.events:
        if isinstance(event, schema.SpeedChosen):
            mission = replace(mission, speed="given", ground_speed_m_s=event.ground_speed_m_s)
    alone = replace(
        config,
        mission=mission,
        servers=(),
        services=tuple(map(in_no_time, config.services)),
        event=None,
        heat=None,
        energy=None,
        faults=(),
        policy=PolicyConfig(name="local-only", stay_or_go=config.policy.stay_or_go),
    )
    try:
        return flown_alone(alone)
    except MissionFailed:
        return None


def _rates(
    made: Sequence[_Made], truths: Mapping[str, ServerTruth]
) -> Iterator[tuple[tuple[str, str], float]]:
    """By server and service, the seconds that each call saves there for each second of a busy lane."""
    for call in made:
        for offer in call.offers:
            gain_s = call.call.local_s - offer.call_s
            if gain_s > 0:
                busy_s = occupying_s(call.operation, truths[offer.server])
                yield (offer.server, call.operation.service), gain_s / busy_s if busy_s > 0 else math.inf


def _lanes(instance: tuple[str, str], config: DroneConfig) -> int:
    name, service = instance
    truth = next(server.truth for server in config.servers if server.name == name)
    return truth.lanes or spec_of(load_services(config.services)[service].cls).concurrency


def _made(
    run: Run, config: DroneConfig, truths: Mapping[str, ServerTruth], alone: Alone | None = None
) -> Iterator[_Made]:
    """The calls of the run, each with the servers in range of it; and of the way after it, where that may hide it."""
    specs = load_specs(config.services)
    estimates = make_estimates(config, specs)
    operations = {str(operation): operation for operation in estimates.operations}
    twice = two_answers(config, specs, estimates)
    services = {service.name: service for service in config.services}
    places = server_places(config)
    ended_s, position, decided = 0.0, Position(0.0, 0.0), False
    starts_s = [event.t for event in run.events if isinstance(event, schema.CallStarted)]
    alone_s = () if alone is None else alone.started_s
    ways_s = [following_s - since_s for since_s, following_s in itertools.pairwise(alone_s)]
    ways_s.append(0.0)  # from the last call
    number, is_started = -1, False
    for event in run.events:
        match event:
            case schema.CallStarted():
                number, is_started = number + 1, True
            case schema.AnswerTaken() if event.failed:
                is_started = False
            case schema.Decided() if not decided:  # a second time where the drone may be by then
                position, decided = event.position, True
            case schema.Call(at_s=begun_s, operation=name, t=now_s):
                operation = operations[name if event.first_s is None else event.asked or name]
                service = services[operation.service]
                hides = is_started and alone is not None
                until_s = [*starts_s, begun_s][number + 1] if hides else begun_s
                offers, on_the_way = list[Offer](), list[Offer]()
                for stay in run.range_intervals:
                    truth, less = truths[stay.server], estimates.may_send_less(stay.server, operation)
                    if stay.from_s <= begun_s < stay.to_s:
                        spot = Spot(ground_distance_m(position, places[stay.server]), position)
                        call_s = _remote_s(operation, service, truth, spot, less=less)
                        offers.append(Offer(stay.server, call_s, begun_s - max(ended_s, stay.from_s)))
                    if stay.from_s < until_s and stay.to_s > begun_s:
                        call_s = _remote_s(operation, service, truth, Spot(0.0), less=less)
                        on_the_way.append(Offer(stay.server, call_s, 0.0))
                computed = twice[operation].first if operation in twice else operation
                local_s = delay_of(computed, service.local_call_s)
                call = ComingCall(local_s, begun_s - ended_s, offers)
                way_s = ways_s[number] if number < len(ways_s) else math.inf
                yield _Made(operation, call, way_s if hides else 0.0, on_the_way)
                ended_s, decided, is_started = now_s, False, False


def _remote_s(
    operation: Operation, service: ServiceConfig, truth: ServerTruth, spot: Spot, *, less: bool
) -> float:
    """The true delay (s) of a call there; infinite if the server does not serve it.

    It is the shorter of both ways if the drone may send `less`.
    """
    if service.name not in truth.images:
        return math.inf
    try:
        call_s = computing_s(operation, truth)
    except KeyError:
        return math.inf
    goodput, part = goodput_of(truth, service.name), service.before_sending if less else None
    less_s = part.takes_s + computing_s(operation, truth, less=True) if part is not None else math.inf
    if goodput is not None:
        reply_s = goodput.transfer_s(service.reply_bytes, spot)
        call_s += goodput.transfer_s(service.request_bytes, spot)
        call_s += reply_s
        less_s += reply_s if part is None else goodput.transfer_s(part.request_bytes, spot) + reply_s
    return min(call_s, less_s)
