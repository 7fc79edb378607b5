"""Promises about the choice of servers: 5, 6, 7, 17."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from upwash.config.drone import ServerConfig
from upwash.config.places import true_areas
from upwash.config.truth import server_truth
from upwash.core.geo import Position
from upwash.core.knowledge.servers import SELECTED, TRANSITIONS, State, Trigger
from upwash.core.selection.recovery import REST_S, Probing
from upwash.eventlog import schema
from upwash.eventlog.schema import Event
from upwash.lab.faults.history import ANSWER_S, ROUNDING_S, Breach, History
from upwash.lab.observer import Observation
from upwash.rpc.protocol import AVAILABILITY, DENY, HEALTH_CHECK, LEAVE

_SERVICE_PATH = "/upwash.service."
_MOST_SELECTED, _SELECTED_IN_S = 4, 1.0


def one_selection(history: History) -> Iterator[Breach]:
    """Each change starts where the last one ended and is the table's; one server and one network for each radio.

    Of two servers that are selected the one in use was there first: calls go there. Few are selected in a second.
    """
    yield from _selected_too_often(history)
    radios = history.config.network.radios
    states: dict[str, State] = {}
    for event in history.logged(schema.ServerStep):
        name, before, after = event.server, event.before, event.after
        if states.get(name, State.AVL) is not before:
            yield event, f"{name} was {states.get(name, State.AVL)} before"
        if TRANSITIONS.get((before, Trigger(event.kind))) is not after:
            yield event, f"{event.kind} does not lead from {before} to {after}"
        states[name] = after
        selected = [server for server, state in states.items() if state in SELECTED]
        if len(selected) > radios:
            yield event, f"{' and '.join(selected)} are selected at the same time"
    yield from _used_out_of_turn(history)
    joined: dict[int, str] = {}  # by radio
    for fact in history.own("joined", "left"):
        if fact.event == "joined" and joined.get(fact.radio):
            yield fact, f"{joined[fact.radio]} is still joined"
        joined[fact.radio] = fact.network if fact.event == "joined" else ""


def _selected_too_often(history: History) -> Iterator[Breach]:
    """Servers that are selected in turn, without end, as each is found stopped."""
    selected = list(history.logged(schema.Selected))
    for before, event in zip(selected, selected[_MOST_SELECTED:], strict=False):
        if event.t - before.t < _SELECTED_IN_S - ROUNDING_S:
            yield event, f"{_MOST_SELECTED} others were selected in the {event.t - before.t:.3f} s before"


def _used_out_of_turn(history: History) -> Iterator[Breach]:
    """Calls go to the selected server with the earliest selection, or the one preferred since."""
    selected: list[str] = []
    for event in history.run.events:
        if isinstance(event, schema.ServerStep):
            if event.server in selected and event.after not in SELECTED:
                selected.remove(event.server)
            elif event.server not in selected and event.after in SELECTED:
                selected.append(event.server)
        elif isinstance(event, schema.Preferred):
            selected.remove(event.server)
            selected.insert(0, event.server)
        elif (
            isinstance(event, schema.Decided) and event.decision != "local" and [event.server] != selected[:1]
        ):
            yield event, f"{event.server} is not the one in use of {' and '.join(selected)}"


def in_range(history: History) -> Iterator[Breach]:
    """No call is sent from outside the server's range."""
    areas = true_areas(history.config)
    remote = (event for event in history.logged(schema.Decided) if event.decision == "remote")
    sent = (call for call in history.own("sent") if call.path.startswith(_SERVICE_PATH))
    calls: list[schema.Decided | Observation] = [*remote, *sent]
    for call in calls:
        if call.server and call.position and not areas[call.server].contains(call.position):
            yield call, f"a call was sent to {call.server}, which is out of range"


def respect(history: History) -> Iterator[Breach]:
    """A blacklisted server gets only the farewell and probes; calls go to servers that are READY."""
    for event in history.logged(schema.Decided):
        if event.decision == "remote" and event.state != State.READY:
            yield event, f"{event.selected} is {event.state}"
    if history.config.policy.probing is not None:
        yield from _probed_too_much(history)
    else:
        yield from _contacted_too_soon(history)


def _contacted_too_soon(history: History) -> Iterator[Breach]:
    """Without probing, a failed server is left alone for the configured time."""
    blacklisted: dict[str, list[tuple[float, float]]] = {}
    for event in history.run.events:
        if isinstance(event, schema.ServerStep) and event.after is State.BLACKLISTED:
            until_s = event.t + history.config.policy.left_alone_s
            blacklisted.setdefault(event.server, []).append((event.t, until_s))
        elif isinstance(event, schema.Selected):
            spells = blacklisted.get(event.server, [])
            if spells and event.t < spells[-1][1] - ROUNDING_S:
                yield event, f"{event.server} is blacklisted until {spells[-1][1]:.3f} s"
    for fact in history.own("sent"):
        for from_s, until_s in blacklisted.get(fact.server, []):
            if fact.path not in (LEAVE, DENY) and from_s + ROUNDING_S < fact.t < until_s - ROUNDING_S:
                yield fact, f"{fact.server} is blacklisted until {until_s:.3f} s"


def _probed_too_much(history: History) -> Iterator[Breach]:
    """A failed server gets only probes, no more often than configured and than its failures allow."""
    probing, spells = history.config.policy.probing or Probing(), spells_of(history)
    last_s: dict[str, float] = {}
    for fact in history.own("sent"):
        server, now_s = fact.server, fact.t
        spell = next(
            (spell for spell in spells.get(server, []) if spell.from_s + ROUNDING_S < now_s < spell.until_s),
            None,
        )
        if spell is None or fact.path in (LEAVE, DENY):
            continue
        if fact.path not in (AVAILABILITY, HEALTH_CHECK):
            yield fact, f"{server} is blacklisted until {spell.until_s:.3f} s"
        elif fact.path == AVAILABILITY:
            if now_s < spell.probed_s - ROUNDING_S:
                yield fact, f"{server} is to be left alone until {spell.probed_s:.3f} s"
            if now_s - last_s.get(server, -math.inf) < probing.first_s - ROUNDING_S:
                yield fact, f"{server} was asked {now_s - last_s[server]:.3f} s before"
            last_s[server] = now_s


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
    probing = history.config.policy.probing or Probing()
    spells: dict[str, list[Spell]] = {}
    failures: dict[str, tuple[int, float]] = {}  # how many in a row, and when the last one was
    for event in history.logged(schema.ServerStep):
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
    """How long (s) a server is left alone after a number of consecutive failures."""
    return min(10.0, 2.0 ** (failures - 2)) if failures > 1 else 0.0


def recovered(history: History) -> Iterator[Breach]:
    """A server that failed costs no time again until it has answered a call; once well it is back within bounds."""
    if history.config.policy.probing is None:
        return
    events = history.run.events
    yield from _trusted_too_soon(_answers_first(events) if history.flies_rows else events)
    yield from _left_unused(history)


def _answers_first(events: Iterable[Event]) -> list[Event]:
    """The events, with each call before what was decided in the same moment, as its place was free."""
    ordered = list[Event]()
    for event in events:
        place = len(ordered)
        if isinstance(event, schema.Call):
            while (
                place and isinstance(ordered[place - 1], schema.Decided) and ordered[place - 1].t == event.t
            ):
                place -= 1
        ordered.insert(place, event)
    return ordered


def _trusted_too_soon(events: Iterable[Event]) -> Iterator[Breach]:
    """Until a failed server answers an operation, calls of it are raced, and no call waits for the server."""
    doubted: dict[str, set[str]] = {}  # by failed server, the operations that it has answered since
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
    """A failed server that works again and stays in range does not stay blacklisted."""
    if history.position_jumps:
        return
    spells = spells_of(history)
    ends = (event.t for event in history.logged(schema.MissionEnded, schema.MissionCompleted))
    end_s = next(ends, history.run.events[-1].t)
    areas = true_areas(history.config)
    for server in _joinable(history):
        area = areas[server.name]
        outside_s = [
            event.t
            for event in history.logged(schema.PositionReport)
            if not area.contains(Position(event.east_m, event.north_m, event.altitude_m))
        ]
        pauses = [pause for pause in history.logged(schema.LeftOut) if pause.server == server.name]
        targets = server.name, f"link:{server.name}"
        faults = [fault for fault in history.config.faults if fault.target in targets]
        for spell in spells.get(server.name, []):
            since_s = max(
                spell.probed_s,
                *(t for t in outside_s if t < spell.until_s),
                *(pause.t + pause.pause_s for pause in pauses if pause.t <= spell.until_s),
                *(fault.to_s for fault in faults if fault.from_s < spell.until_s),
                0.0,
            )
            unused_s = min(spell.until_s, end_s) - since_s
            if unused_s > REST_S + _JOINING_S + 2 * ANSWER_S:
                yield None, f"{server.name} was well and in range for {unused_s:.3f} s, and still blacklisted"


def _joinable(history: History) -> Iterator[ServerConfig]:
    """The servers that serve this drone alone, with all services that it wants, within the time of a check."""
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
