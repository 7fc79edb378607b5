"""The configured deadlines of calls, and what can be had of them at each waypoint: too little is refused."""

from __future__ import annotations

import itertools
import math
import random
from collections.abc import Iterator, Mapping, Sequence

from msgspec import Struct, structs

from upwash.config.drone import DroneConfig
from upwash.config.places import server_areas
from upwash.config.traces import read_service_times
from upwash.config.truth import keys_of
from upwash.core.geo import Waypoint
from upwash.core.knowledge.estimates import Estimates
from upwash.core.operation import Operation
from upwash.core.selection.deadlines import MISS, AnswerDeadline, Deadlines, Delays, Prospect, prospect
from upwash.errors import UsageError
from upwash.eventlog import schema
from upwash.rpc.service import Specs
from upwash.support.text import counted

_CERTAIN = 1000  # calls that all take as long: those of the drone's own service


class DeadlineProspect(Struct, frozen=True):
    """What can be had of an operation's deadline at the waypoint where that is least, and where it is too little."""

    operation: Operation
    deadline: AnswerDeadline
    least: Prospect
    where: str  # which servers are in range there, and what keeps them from more
    short_of: tuple[int, ...] = ()  # the waypoints

    def __str__(self) -> str:
        asked, had = self.deadline, self.least
        second = (
            f"; a second server gets {had.extra:.0%} of the calls too, and the probability holds for servers that "
            "are late independently of each other: over one network both are late with it"
            if had.extra
            else ""
        )
        return (
            f"{self.operation}: answered within {asked.within_s:g} s with a probability of {_least(had)} at least, "
            f"with a confidence of 95 % ({asked.probability:g} asked for){second}"
        )

    @property
    def event(self) -> schema.DeadlinePromised:
        """The promise, as the log has it."""
        return schema.DeadlinePromised(
            operation=str(self.operation),
            within_s=self.deadline.within_s,
            asked=self.deadline.probability,
            expected=self.least.probability,
            extra=self.least.extra,
        )


def make_deadlines(config: DroneConfig, specs: Specs, estimates: Estimates) -> Deadlines:
    """The deadlines of the drone's operations, with the measured times of its servers."""
    return Deadlines(*_measured(config, specs, estimates))


def require_deadlines(
    config: DroneConfig, specs: Specs, estimates: Estimates, plan: Sequence[Waypoint]
) -> list[DeadlineProspect]:
    """What can be had of each deadline over these waypoints; raises UsageError if it is less than configured.

    A flight without servers promises nothing: other flights are compared with it.
    """
    if config.policy.name == "local-only":
        return []
    found = list(_prospects(config, specs, estimates, plan))
    for one in found:
        if one.short_of:
            raise UsageError(_refusal(one, len(plan)))
    return found


def _measured(
    config: DroneConfig, specs: Specs, estimates: Estimates
) -> tuple[dict[Operation, AnswerDeadline], dict[tuple[str, Operation], list[float]]]:
    asked = {service.name: service.deadline for service in config.services if service.deadline is not None}
    deadlines = {
        operation: asked[operation.service]
        for operation in estimates.operations
        if operation.service in asked and not specs[operation.service].methods[operation.method].once
    }
    known: dict[tuple[str, Operation], list[float]] = {}
    for server in config.servers:
        times = read_service_times(server.times_csv) if server.times_csv is not None else {}
        for operation, (name, seconds) in itertools.product(deadlines, times.items()):
            own = {(operation.service, key) for key in (operation.key, operation.method, "")}
            if name == str(operation) or not own.isdisjoint(keys_of(name, config.services)):
                known.setdefault((server.name, operation), []).extend(seconds)
    for times_s in known.values():  # the flight forgets the first ones first, and a file may be sorted
        random.Random(0).shuffle(times_s)  # noqa: S311 - no secret
    return deadlines, known


def _prospects(
    config: DroneConfig, specs: Specs, estimates: Estimates, plan: Sequence[Waypoint]
) -> Iterator[DeadlineProspect]:
    deadlines, known_s = _measured(config, specs, estimates)
    areas, hedging = server_areas(config), config.policy.hedging
    called = [operation for operation in deadlines if operation.key in ("", config.mission.mode)]
    for operation in called or deadlines:
        deadline, local_s = deadlines[operation], estimates.local_s(operation)
        delays = {
            server.name: Delays(known_s.get((server.name, operation), ()))
            for server in config.servers
            if estimates.remote_s(server.name, operation) is not None
        }
        in_time = local_s is not None and local_s <= deadline.within_s
        onboard = Delays([local_s or 0.0] * _CERTAIN)
        miss = MISS / 2 if hedging is not None and in_time else MISS  # of two plans, or of one
        found: list[tuple[Prospect, str, int]] = []
        for waypoint in plan:
            near = sorted(
                (name for name in delays if areas[name].contains(waypoint.position)),
                key=lambda name: estimates.remote_s(name, operation) or 0.0,
            )
            if not near:
                found.append((Prospect(float(in_time)), "no server is in range there", waypoint.index))
                continue
            second = _second(config, near)
            best = prospect(deadline, delays[near[0]], delays.get(second or ""), miss=miss)
            if hedging is not None and in_time:
                by_drone = structs.replace(deadline, extra=hedging.budget)
                joined = prospect(by_drone, delays[near[0]], onboard, miss=miss).probability
                best = max(best, Prospect(joined), key=lambda had: had.probability)
            found.append((best, _why(config, near, delays, best, deadline), waypoint.index))
        if found:
            least, where, _ = min(found, key=lambda one: one[0].probability)
            short = tuple(index for had, _, index in found if had.probability < deadline.probability)
            yield DeadlineProspect(operation, deadline, least, where, short)


def _second(config: DroneConfig, near: Sequence[str]) -> str | None:
    """The server whose help is promised beside the first one; None if both are late with one network."""
    networks = {server.name: server.network for server in config.servers}
    if config.network.radios == 1 or len(near) == 1 or networks[near[0]] == networks[near[1]]:
        return None
    return near[1]


def _why(
    config: DroneConfig,
    near: Sequence[str],
    delays: Mapping[str, Delays],
    best: Prospect,
    deadline: AnswerDeadline,
) -> str:
    second = _second(config, near)
    asked = near[:1] if second is None else near[:2]
    if unknown := [name for name in asked if not delays[name].known]:
        return f"nothing is measured of {unknown[0]}: give its times_csv"
    needed = deadline.delays_needed(len(asked))
    if few := [name for name in asked if delays[name].known < needed]:
        known = counted(delays[few[0]].known, "delay")
        return f"{known} of {few[0]} in its times_csv, and this p takes {needed} at least, all in time: measure more"
    if len(near) == 1:
        return f"only {near[0]} is in range there"
    if config.network.radios == 1:
        return f"{near[0]} alone, as network.radios is 1: with 2, {near[1]} could get late calls too"
    if second is None:
        return f"{near[0]} alone, as {near[1]} is reached over the same network, and both are late with it"
    if best.after_s is not None and best.extra > deadline.extra - 1e-9:
        return f"{near[1]} may get a share of {deadline.extra:g} of the calls too: allow more as extra"
    return f"{near[0]} with {near[1]}"


def _least(had: Prospect) -> str:
    """The probability in figures, never rounded up."""
    return f"{math.floor(1e4 * had.probability + 1e-6) / 1e4:g}"


def _refusal(one: DeadlineProspect, waypoints: int) -> str:
    asked = one.deadline
    where = f"waypoint {one.short_of[0]}"
    if len(one.short_of) > 1:
        where = f"{len(one.short_of)} of {waypoints} waypoints, such as {one.short_of[0]}"
    return (
        f"service.{one.operation.service}.deadline: {one.operation} is answered within {asked.within_s:g} s with a "
        f"probability of {_least(one.least)} at least, and {asked.probability:g} is asked for: it is less at "
        f"{where}: {one.where}; or ask for a lower p, or a longer s"
    )
