"""Clients that compute twice: drone and server race for each call, or each server in range gets it.

Racing is a policy of one's own. The programs cannot stop the drone's own computation when the server has answered;
`stoppable` has the models do so.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import NamedTuple
from unittest.mock import patch

from upwash.config.drone import DroneConfig
from upwash.config.places import server_places, true_areas
from upwash.config.truth import server_truth
from upwash.config.world import FaultConfig
from upwash.core.call import steps
from upwash.core.call.call import Call
from upwash.core.call.calls import Calls
from upwash.core.geo import Position, ground_distance_m
from upwash.core.operation import Operation
from upwash.drone.preparation import make_estimates
from upwash.eventlog import schema
from upwash.lab.run import Run
from upwash.missions.bundled import load_specs
from upwash.policies import CallInputs, Decision, Local, LookAhead, Remote
from upwash.sim.chance import Chance
from upwash.sim.radio import Spot, goodput_of
from upwash.sim.world import computing_s, delay_of

_FLAP_S = 5.0
_HARMLESS = ("full", "wrong")  # to a client that has its slot and the instances' addresses already


class Racing(LookAhead):
    """Looks ahead for a server, and computes each call on the drone too; the first answer counts."""

    def decide(self, call: CallInputs) -> Decision:
        """A race, or a call on the drone that a server may still overtake."""
        decision = super().decide(call)
        if isinstance(decision, Remote):
            return Remote(call.server, max(decision.deadline_s, call.local_s), "races", raced=True)
        return Local("begins on the drone at once")


@contextlib.contextmanager
def stoppable(stops: bool) -> Iterator[None]:
    """A drone that stops its own computation of a call once a server has answered, if it `stops`."""
    if not stops:
        yield
        return

    over = Calls.over

    def stops_own(self: Calls, call: Call) -> None:
        over(self, call)
        if call.own is not None and call.own.is_open:
            call.own.state = "failed"
            if call.own.began_s is not None:
                self.do(steps.Stop(call.own))
            self.end_own(call.own)

    with patch.object(Calls, "over", stops_own):
        yield


class Replicated(NamedTuple):
    """The mission's time, and the mean number of servers that computed a call."""

    mission_s: float
    copies: float


def replicated(run: Run, config: DroneConfig) -> Replicated:
    """The run's mission, if each call went to every server in range and to the drone, and the first answer counted.

    The replay favours it. Joining a network, questions to a daemon and starts of services take no time. Calls do
    not disturb each other, and the drone's computer is never hot. A server with a fault during a call has answered
    before. A server that is back has the call at once.
    """
    truths = {server.name: server_truth(server, config.services) for server in config.servers}
    services = {service.name: service for service in config.services}
    areas, places, chance = true_areas(config), server_places(config), Chance(config.seed)
    operations = {str(each): each for each in make_estimates(config, load_specs(config.services)).operations}
    goodputs = {
        (name, service): goodput_of(truth, service) for name, truth in truths.items() for service in services
    }
    saved_s, calls, copies = 0.0, 0, 0
    position, decided = Position(0.0, 0.0), False

    def answer_s(server: str, operation: Operation, at_s: float) -> float | None:
        """The server's delay for a call from then on; None without an answer."""
        service, truth = services[operation.service], truths[server]
        if not areas[server].contains(position) or service.name not in truth.images:
            return None
        try:
            call_s = computing_s(operation, truth)
        except KeyError:
            return None
        call_s *= chance.factor(f"copy/{server}/{operation}", config.noise.call)
        if (goodput := goodputs[server, service.name]) is not None:
            spot = Spot(ground_distance_m(position, places[server]), position, at_s)
            call_s += goodput.transfer_s(service.request_bytes, spot) + goodput.transfer_s(
                service.reply_bytes, spot
            )
        return call_s + _extra_s(config.faults, server, at_s)

    for event in run.events:
        match event:
            case schema.Decided() if not decided:
                position, decided = event.position, True
            case schema.Call(at_s=begun_s, operation=name, delay_s=delay_s):
                operation, decided = operations[name], False
                found = [answer_s(server, operation, begun_s - saved_s) for server in truths]
                answers_s = [answered_s for answered_s in found if answered_s is not None]
                local_s = delay_of(operation, services[operation.service].local_call_s)
                local_s *= chance.factor(f"copy/{operation}", config.noise.call)
                saved_s += delay_s - min([local_s, *answers_s])
                calls, copies = calls + 1, copies + sum(answered_s <= local_s for answered_s in answers_s)
    return Replicated(run.result.mission_time_s - saved_s, copies / max(1, calls))


def _extra_s(faults: tuple[FaultConfig, ...], server: str, at_s: float) -> float:
    """By how much faults delay the server's answer to a call that it gets once it is back; infinite if it is not."""
    extra_s = back_s = 0.0
    for fault in faults:
        if fault.target not in (server, f"link:{server}") or not fault.from_s <= at_s < fault.to_s:
            continue
        if fault.kind == "slow":
            extra_s += fault.extra_s
        elif fault.kind == "flapping":
            flaps_s = _FLAP_S - (at_s - fault.from_s) % (2 * _FLAP_S)
            back_s = max(back_s, min(flaps_s, fault.to_s - at_s))
        elif fault.kind not in _HARMLESS:
            back_s = max(back_s, fault.to_s - at_s)
    return back_s + extra_s
