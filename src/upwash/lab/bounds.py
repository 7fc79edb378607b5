"""How fast simulated missions could have been at best: the bounds of lab/least_time.py in their world."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean

from msgspec import structs

from upwash.config import (
    DroneConfig,
    PolicyConfig,
    ServerTruth,
    ServiceConfig,
    only_on_servers,
    server_places,
    server_truth,
)
from upwash.core.geo import Position, ground_distance_m
from upwash.core.operation import Operation
from upwash.core.planning.schedule import ComingCall, Offer
from upwash.drone.preparation import make_estimates, two_answers
from upwash.errors import MissionFailed
from upwash.eventlog import schema
from upwash.eventlog.progress import CallPlaces
from upwash.eventlog.schema import Event
from upwash.lab.least_time import Bound, FleetBound, Onward, SharedMission, bound, shared_s
from upwash.lab.observer import RangeInterval
from upwash.lab.run import Run, time_alone_s
from upwash.missions.bundled import load_services, load_specs
from upwash.rpc.service import spec_of
from upwash.sim.radio import Spot, goodput_of
from upwash.sim.world import computing_s, delay_of, occupying_s

_NO_TIME_S = 1e-9  # of a call, which has to take some


@dataclass(frozen=True, slots=True)
class _Made:
    """A call of a run; the mission waited `waited_s` for its answer.

    `passage` is what follows if the drone need not wait for it, and `on_the_way` the servers in range there.
    """

    operation: Operation
    call: ComingCall
    waited_s: float
    hidden_s: float = 0.0
    passage: AfterCall | None = None
    on_the_way: Sequence[Offer] = ()

    @property
    def offers(self) -> Sequence[Offer]:
        """The servers that could answer the call."""
        return (*self.call.offers, *self.on_the_way)

    @property
    def least_wait_s(self) -> float:
        """The least wait (s) of the mission for the call, with every server joined."""
        stay_s = min([self.call.local_s, *(offer.call_s for offer in self.call.offers)])
        if self.passage is None:
            return max(0.0, stay_s - self.hidden_s)
        go_s = min([stay_s, *(offer.call_s for offer in self.on_the_way)])
        return self.passage.onward.least_wait_s(stay_s, go_s)

    @property
    def least_local_wait_s(self) -> float:
        """The least wait (s) of the mission for the call, without any server."""
        local_s = self.call.local_s
        if self.passage is None:
            return max(0.0, local_s - self.hidden_s)
        return self.passage.onward.least_wait_s(local_s, local_s)


@dataclass(frozen=True, slots=True)
class _Mission:
    """A completed mission: its calls, and what it spent on other things than waiting for them."""

    calls: Sequence[_Made]
    other_s: float
    may_go: bool

    def bound(self, truths: Mapping[str, ServerTruth]) -> Bound:
        """The least times of the mission."""
        if self.may_go:
            least_s = self.other_s + sum(made.least_wait_s for made in self.calls)
            return Bound(least_s, least_s)
        joins_s = {name: truth.join_s for name, truth in truths.items()}
        calls = bound([made.call for made in self.calls], joins_s)
        return Bound(self.other_s + calls.free_s, self.other_s + calls.with_joins_s)


def bound_of(run: Run, config: DroneConfig) -> Bound | None:
    """The least times of the mission under any policy; None if it was not completed, or flew a recorded track.

    It flies and takes photos for as long as this run did, and makes the same calls at the same places. Computers are
    never hot and nothing fails; calls take their mean time, so with noise the bounds hold for the mean of many runs.
    If the drone may go on before answers are there, it turns back no more often than it has to.
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
    rates: dict[
        tuple[str, str], float
    ] = {}  # by server and service: the most that is saved in a second of a lane
    for run, config in zip(runs, fleet, strict=True):
        if not run.result.completed:
            own.append(None)
            continue
        truths = _truths(config)
        mission = _mission(run, config, truths)
        own.append(found := mission.bound(truths))
        local_s = mission.other_s + sum(call.least_local_wait_s for call in mission.calls)
        missions.append(SharedMission(_begun_s(run), local_s, found.free_s))
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
    if config.mission.photos is not None or any(map(only_on_servers, config.services)):
        return _Mission([], min(mission_s, _least_alone_s(run, config)), may_go=True)
    may_go = config.policy.stay_or_go != "stay" or any(service.two_answers for service in config.services)
    if not may_go:
        other_s = mission_s - run.result.totals.service_delay_s
        return _Mission(list(_made(run, config, truths)), other_s, may_go=False)
    ways = Ways()
    for event in run.events:
        ways.take(event)
    calls = list(_made(run, config, truths, ways))
    other_s = mission_s - ways.in_vain_s - sum(made.waited_s for made in calls)
    return _Mission(calls, other_s, may_go=True)


def _least_alone_s(run: Run, config: DroneConfig) -> float:
    """The time of the way alone, without a wait or a way back, and of the actions that answers demand.

    A call that only servers compute need not be waited for.
    """
    replace = structs.replace
    services = tuple(
        replace(
            service, local_call_s=dict.fromkeys(service.local_call_s, _NO_TIME_S), local_first_extra_s=0.0
        )
        if not only_on_servers(service)
        else service
        for service in config.services
    )
    mission = config.mission
    for event in run.events:
        if isinstance(event, schema.SpeedChosen):
            mission = replace(mission, speed="given", ground_speed_m_s=event.ground_speed_m_s)
    alone = replace(
        config,
        mission=mission,
        servers=(),
        services=services,
        event=None,
        heat=None,
        energy=None,
        faults=(),
        policy=PolicyConfig(name="local-only", stay_or_go=config.policy.stay_or_go),
    )
    acted = sum(isinstance(event, schema.Acted) for event in run.events)
    try:
        alone_s = time_alone_s(alone)
    except MissionFailed:  # a program that needs its answers
        alone_s = None
    return math.inf if alone_s is None else alone_s + acted * config.mission.action_s


def _begun_s(run: Run) -> float:
    """When a completed mission's time began, in simulated seconds."""
    ended_s = next(event.t for event in run.events if isinstance(event, schema.MissionCompleted))
    return ended_s - run.result.mission_time_s


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
    run: Run, config: DroneConfig, truths: Mapping[str, ServerTruth], ways: Ways | None = None
) -> Iterator[_Made]:
    """The calls of the run, each with the servers in range of it and of the way that followed."""
    specs = load_specs(config.services)
    estimates = make_estimates(config, specs)
    operations = {str(operation): operation for operation in estimates.operations}
    twice = two_answers(config, specs, estimates)
    services = {service.name: service for service in config.services}
    places = server_places(config)
    ended_s, position, decided = 0.0, Position(0.0, 0.0), False
    number = 0
    for event in run.events:
        match event:
            case schema.Decided() if not decided:  # a second time where the drone may be by then
                position, decided = event.position, True
            case schema.Call(at_s=begun_s, operation=name, t=now_s, delay_s=delay_s):
                operation = operations[name if event.first_s is None else event.asked or name]
                service = services[operation.service]
                passage = ways.after(number) if ways else None
                offers = [
                    Offer(
                        stay.server,
                        _remote_s(
                            operation,
                            service,
                            truths[stay.server],
                            Spot(ground_distance_m(position, places[stay.server]), position),
                            less=estimates.may_send_less(stay.server, operation),
                        ),
                        begun_s - max(ended_s, stay.from_s),
                    )
                    for stay in run.range_intervals
                    if stay.from_s <= begun_s < stay.to_s
                ]
                on_the_way = [
                    Offer(
                        stay.server,
                        later_s
                        + _remote_s(
                            operation,
                            service,
                            truths[stay.server],
                            Spot(0.0),
                            less=estimates.may_send_less(stay.server, operation),
                        ),
                        0.0,
                    )
                    for stay, later_s in _met(run.range_intervals, passage)
                ]
                waited_s = ways.waited_s.get(number, delay_s) if ways else delay_s
                computed = twice[operation].first if operation in twice else operation
                local_s = delay_of(computed, service.local_call_s)
                call = ComingCall(local_s, begun_s - ended_s, offers)
                yield _Made(operation, call, waited_s, max(0.0, delay_s - waited_s), passage, on_the_way)
                ended_s, decided, number = now_s, False, number + 1


def _met(stays: Sequence[RangeInterval], passage: AfterCall | None) -> Iterator[tuple[RangeInterval, float]]:
    """The servers that the drone passes on its way, each with the least time (s) from its departure."""
    if passage is None or passage.departed_s is None:
        return
    for stay in stays:
        if stay.from_s < passage.ended_s and stay.to_s > passage.departed_s:
            yield stay, max(0.0, stay.from_s - passage.departed_s)


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


@dataclass(slots=True)
class _Way:
    """From one call that the mission started to the next one, or to what waits for its answer."""

    waypoint: int | None
    begun_s: float
    left_out_s: float = 0.0  # what the mission waited, did about the answer, and flew in vain
    departed_s: float | None = None
    leg_s: float = 0.0
    demanded: bool = False
    ended_s: float | None = None


@dataclass(frozen=True, slots=True)
class AfterCall:
    """What follows a call; the drone departs for the next one at `departed_s`, or does not."""

    onward: Onward
    departed_s: float | None
    ended_s: float


class Ways:
    """Collects from a mission's events what followed each call whose answer came later; calls are numbered from 0.

    `waited_s` has the wait for each of these answers. `in_vain_s` is the time of legs back, and of legs that were
    flown twice or in vain because of them.
    """

    def __init__(self) -> None:
        self.waited_s: dict[int, float] = {}
        self.in_vain_s = 0.0
        self._whereabouts = CallPlaces()
        self._ways: dict[int, _Way] = {}
        self._way: _Way | None = None
        self._started = 0  # calls that are not over
        self._leg_begun_s: float | None = None
        self._turned_s: float | None = None
        self._again = False  # whether the next leg was flown before
        self._taken_s = 0.0

    def take(self, event: Event) -> None:
        """Take in the next event of the log."""
        self._whereabouts.take(event)
        match event:
            case schema.CallStarted(waypoint=waypoint):
                self._end(event.t)
                self._way = _Way(waypoint, event.t)
                self._started += 1
            case schema.Call() if self._started:
                self._started -= 1
            case schema.Call(at_s=begun_s):
                self._end(begun_s)
            case schema.Returning() | schema.Landing() | schema.Holding():
                self._end(event.t)
            case schema.AnswerTaken():
                self._take_answer(event)
            case schema.Acted():
                self._leave_out(event.t - self._taken_s)
            case schema.SetOff():
                self._leg_begun_s = event.t
                if self._way is not None and self._way.departed_s is None:
                    self._way.departed_s = event.t
            case schema.TurnedBack():
                self._again = self._leg_begun_s is None
                self._fly_in_vain(event.t, since_s=self._leg_begun_s)
                self._turned_s = event.t
            case schema.Arrived():
                self._arrive(event.t)

    def after(self, number: int) -> AfterCall | None:
        """What follows the call of that number; None for a call with an immediate wait."""
        way = self._ways.get(number)
        if way is None or way.ended_s is None:
            return None
        onward = Onward(way.ended_s - way.begun_s - way.left_out_s, way.leg_s, way.demanded)
        return AfterCall(onward, way.departed_s, way.ended_s)

    def _take_answer(self, event: schema.AnswerTaken) -> None:
        self._taken_s = event.t
        self._leave_out(event.waited_s)
        self._started -= bool(event.failed)
        if (number := self._whereabouts.answered) is not None:
            self.waited_s[number] = event.waited_s
            if self._way is not None and self._way.waypoint == event.waypoint:
                self._ways[number] = self._way
                self._way.demanded = event.demanded

    def _arrive(self, at_s: float) -> None:
        begun_s, self._leg_begun_s = self._leg_begun_s, None
        if self._turned_s is not None:
            self._fly_in_vain(at_s, since_s=self._turned_s)
            self._turned_s = None
        elif self._again:
            self._fly_in_vain(at_s, since_s=begun_s)
            self._again = False
        elif self._way is not None and begun_s is not None and not self._way.leg_s:
            self._way.leg_s = at_s - begun_s

    def _fly_in_vain(self, now_s: float, *, since_s: float | None) -> None:
        if since_s is not None:
            self.in_vain_s += now_s - since_s
            self._leave_out(now_s - since_s)

    def _leave_out(self, duration_s: float) -> None:
        if self._way is not None:
            self._way.left_out_s += duration_s

    def _end(self, at_s: float) -> None:
        if self._way is not None:
            self._way.ended_s = at_s
            self._way = None
