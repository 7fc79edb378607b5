"""Promise 17: a server that failed costs nothing until it has answered, and is back in use once it is well."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from upwash.config import FaultConfig, ProbeConfig, ServerConfig, server_truth, true_areas
from upwash.core.geo import Position
from upwash.core.knowledge.servers import State
from upwash.core.selection.recovery import REST_S
from upwash.eventlog import schema
from upwash.eventlog.schema import Event
from upwash.lab.faults.promises.history import ANSWER_S, ROUNDING_S, Breach, History, position_jumps

_CHECK_LEAST_S, _CHECK_FACTOR = 10.0, 3.0  # of how long joining may take, by what is believed of it
_WELL_S = 60.0  # without failures, until those before are forgotten
_JOINING_S = 30.0  # for a network that was off the air when joining it began


@dataclass(slots=True)
class Spell:
    """For how long a server was blacklisted, and from when on it could be probed."""

    from_s: float
    probed_s: float
    until_s: float = math.inf


def spells_of(history: History) -> dict[str, list[Spell]]:
    """The spells of each server, by what it had failed before."""
    probing = history.config.policy.probing or ProbeConfig()
    spells: dict[str, list[Spell]] = {}
    failures: dict[str, tuple[int, float]] = {}  # how many in a row, and when the last one was
    for event in history.run.events:
        if not isinstance(event, schema.ServerStep):
            continue
        server, now_s = event.server, event.t
        if event.after is State.BLACKLISTED:
            count, last_s = failures.get(server, (0, -math.inf))
            if not isinstance(event, schema.NetworkLost):
                forgotten = now_s - last_s > _WELL_S + _alone_s(count) - ROUNDING_S
                count, last_s = failures[server] = (1 if forgotten else count + 1, now_s)
            alone_s = max(last_s + _alone_s(count) - now_s, probing.first_s)
            spells.setdefault(server, []).append(Spell(now_s, now_s + alone_s))
        elif event.before is State.BLACKLISTED:
            spells[server][-1].until_s = now_s
    return spells


def _alone_s(failures: int) -> float:
    """How long a server is left alone after so many failures in a row."""
    return min(10.0, 2.0 ** (failures - 2)) if failures > 1 else 0.0


def recovered(history: History) -> Iterator[Breach]:
    """A server that failed costs no time again until it has answered a call; once well it is back within bounds."""
    if history.config.policy.probing is None:
        return
    yield from _trusted_too_soon(history.run.events)
    yield from _left_unused(history)


def _trusted_too_soon(events: Iterable[Event]) -> Iterator[Breach]:
    """Until an operation is answered there, calls of it that go there are raced, and nobody waits for the server."""
    doubted: dict[
        str, set[str]
    ] = {}  # operations that were answered since the last failure, by server that failed
    for event in events:
        match event:
            case schema.Decided(server=str(server), operation=operation) if server in doubted:
                if operation not in doubted[server] and not event.raced:
                    yield event, f"{server} has answered no call of {operation} since it failed"
            case schema.ServerStep(after=State.BLACKLISTED, server=server):
                doubted[server] = set()
            case schema.Call(remote_fault="confirmed", operation=operation):
                for answered in doubted.values():
                    answered.add(operation)
            case (
                schema.Call(server=str(server), operation=operation)
                | schema.Dropped(server=str(server), operation=operation)
            ) if server in doubted:
                doubted[server].add(operation)
            case schema.RemoteRaised(server=server, operation=operation) if server in doubted:
                doubted[server].add(operation)  # where the drone's own service confirms it


def _left_unused(history: History) -> Iterator[Breach]:
    """A failed server that is well again, and in range all the time, does not stay blacklisted."""
    if position_jumps(history.config):
        return
    events, spells = history.run.events, spells_of(history)
    ends = (each.t for each in events if isinstance(each, (schema.MissionEnded, schema.MissionCompleted)))
    end_s = next(ends, events[-1].t)
    areas = true_areas(history.config)
    for server in _joinable(history):
        area = areas[server.name]
        outside_s = [
            each.t
            for each in events
            if isinstance(each, schema.PositionReport)
            and not area.contains(Position(each.east_m, each.north_m, each.altitude_m))
        ]
        for spell in spells.get(server.name, []):
            since_s = max(
                spell.probed_s,
                *(t for t in outside_s if t < spell.until_s),
                *(
                    each.t + each.pause_s
                    for each in events
                    if isinstance(each, schema.LeftOut)
                    and each.server == server.name
                    and each.t <= spell.until_s
                ),
                *(each.to_s for each in _faults_of(history, server.name) if each.from_s < spell.until_s),
                0.0,
            )
            unused_s = min(spell.until_s, end_s) - since_s
            if unused_s > REST_S + _JOINING_S + 2 * ANSWER_S:
                yield None, f"{server.name} was well and in range for {unused_s:.3f} s, and still blacklisted"


def _joinable(history: History) -> Iterator[ServerConfig]:
    """The servers that can serve the drone whenever they are well: all that it wants, soon enough, and alone."""
    config = history.config
    wanted = {service.name for service in config.services}
    for server in config.servers:
        truth = server_truth(server, config.services)
        shared = any(
            fact.event == "asked" and fact.server == server.name and fact.drone != config.name
            for fact in history.seen
        )
        longest_s = max(_CHECK_LEAST_S, _CHECK_FACTOR * server.check_running_s)
        if not shared and wanted <= set(truth.images) and truth.join_s <= longest_s:
            yield server


def _faults_of(history: History, server: str) -> Iterator[FaultConfig]:
    return (each for each in history.config.faults if each.target in (server, f"link:{server}"))
