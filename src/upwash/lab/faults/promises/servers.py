"""Promises about the choice of servers: 5, one selection, 6, ranges, and 7, respect for those that failed."""

from __future__ import annotations

import math
from collections.abc import Iterator

from upwash.config import ProbeConfig, true_areas
from upwash.core.knowledge.servers import SELECTED, TRANSITIONS, State, Trigger
from upwash.eventlog import schema
from upwash.lab.faults.promises.history import ROUNDING_S, Breach, History
from upwash.lab.faults.promises.recovery import spells_of
from upwash.lab.observer import Seen
from upwash.rpc.protocol import AVAILABILITY, DENY, HEALTH_CHECK, LEAVE

_SERVICE_PATH = "/upwash.service."


def one_selection(history: History) -> Iterator[Breach]:
    """Each change starts where the last one ended and is the table's; one server and one network for each radio.

    Of two servers that are selected the one in use was there first: calls go there.
    """
    radios = history.config.network.radios
    states: dict[str, State] = {}
    for event in history.run.events:
        if not isinstance(event, schema.ServerStep):
            continue
        name, before, after = event.server, event.before, event.after
        if states.get(name, State.AVL) is not before:
            yield event, f"{name} was {states.get(name, State.AVL)} before"
        if TRANSITIONS.get((before, Trigger(event.kind))) is not after:
            yield event, f"{event.kind} does not lead from {before} to {after}"
        states[name] = after
        selected = [each for each, state in states.items() if state in SELECTED]
        if len(selected) > radios:
            yield event, f"{' and '.join(selected)} are selected at the same time"
    yield from _used_out_of_turn(history)
    joined: dict[int, str] = {}  # by radio
    for fact in history.own("joined", "left"):
        if fact.event == "joined" and joined.get(fact.radio):
            yield fact, f"{joined[fact.radio]} is still joined"
        joined[fact.radio] = fact.network if fact.event == "joined" else ""


def _used_out_of_turn(history: History) -> Iterator[Breach]:
    """A call goes to the server that was selected first of those that are."""
    selected: list[str] = []
    for event in history.run.events:
        if isinstance(event, schema.ServerStep):
            if event.server in selected and event.after not in SELECTED:
                selected.remove(event.server)
            elif event.server not in selected and event.after in SELECTED:
                selected.append(event.server)
        elif (
            isinstance(event, schema.Decided) and event.decision != "local" and [event.server] != selected[:1]
        ):
            yield event, f"{event.server} is not the one in use of {' and '.join(selected)}"


def in_range(history: History) -> Iterator[Breach]:
    """No call is sent from outside the server's range."""
    areas = true_areas(history.config)
    remote = (
        each for each in history.run.events if isinstance(each, schema.Decided) and each.decision == "remote"
    )
    sent = (each for each in history.own("sent") if each.path.startswith(_SERVICE_PATH))
    calls: list[schema.Decided | Seen] = [*remote, *sent]
    for call in calls:
        if call.server and call.position and not areas[call.server].contains(call.position):
            yield call, f"a call was sent to {call.server}, which is out of range"


def respect(history: History) -> Iterator[Breach]:
    """A blacklisted server is left alone, but for the farewell and probes; a call goes to a server that is READY."""
    for event in history.run.events:
        if isinstance(event, schema.Decided) and event.decision == "remote" and event.state != State.READY:
            yield event, f"{event.selected} is {event.state}"
    if history.config.policy.probing is not None:
        yield from _probed_too_much(history)
    else:
        yield from _contacted_too_soon(history)


def _contacted_too_soon(history: History) -> Iterator[Breach]:
    """A server that is not probed is left alone for the time that was set."""
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
    """Failed servers are asked for a sign of life alone, at the pace that was set, and by how often they failed."""
    probing, spells = history.config.policy.probing or ProbeConfig(), spells_of(history)
    last_s: dict[str, float] = {}
    for fact in history.own("sent"):
        server, now_s = fact.server, fact.t
        spell = next(
            (each for each in spells.get(server, []) if each.from_s + ROUNDING_S < now_s < each.until_s),
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
