"""Promises about servers: 11, 15, 18, 22."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from itertools import pairwise

import msgspec

from upwash.config.drone import ServerConfig
from upwash.config.truth import ServerTruth, server_truth
from upwash.config.world import FaultConfig
from upwash.core.admission.admission import AdmissionSettings
from upwash.core.admission.turns import ASK_AGAIN_S
from upwash.core.admission.watchdog import CALL_LIMIT_S, FIRST_PAUSE_S, FORGOTTEN_S, LONGEST_PAUSE_S
from upwash.drone.server_session import MOST_MOVES
from upwash.eventlog import schema
from upwash.eventlog.schema import Event
from upwash.lab.faults.history import ANSWER_S, ROUNDING_S, SLACK_S, Breach, History
from upwash.lab.field import daemon_address
from upwash.lab.observer import Observation
from upwash.rpc.protocol import AVAILABILITY, LEAVE, START
from upwash.support.text import counted

_LOOK_S = 1.0  # a daemon's period of looking for ended leases
_LEASE_S, _HOLD_S = AdmissionSettings().lease_s, AdmissionSettings().hold_s


def admission(history: History) -> Iterator[Breach]:
    """Of each server: one instance of a service, no more drones than slots, leases and held slots that end."""
    yield from _holds(history)
    for server in history.config.servers:
        facts = [fact for fact in history.seen if fact.server == server.name]
        yield from _instances(facts)
        if server.truth.slots != "auto":
            for fact in facts:
                if fact.event == "admitted" and len(fact.drones) > server.truth.slots:
                    slots = counted(server.truth.slots, "slot")
                    yield fact, f"{fact.server} serves {', '.join(fact.drones)}, and has {slots}"
        yield from _leases(facts, end_s=history.seen[-1].t if history.seen else 0.0)


def _instances(facts: Sequence[Observation]) -> Iterator[Breach]:
    running: set[str] = set()
    for fact in facts:
        if fact.event == "instance_started":
            if fact.service in running:
                yield fact, f"a second instance of {fact.service} on {fact.server}"
            running.add(fact.service)
        elif fact.event == "instance_ended":
            running.discard(fact.service)


def _holds(history: History) -> Iterator[Breach]:
    """Slots are held for peers only; each server that a drone visits holds one slot at a time for it elsewhere."""
    peers = {server.name: server.truth.peers for server in history.config.servers}
    holding: dict[tuple[str, str], tuple[str, float]] = {}  # by peer and drone: where, and until when
    for fact in history.seen:
        if fact.event != "held":
            continue
        by, drone, server = fact.by, fact.drone, fact.server
        if by not in peers[server]:
            yield fact, f"{server} holds a slot for {by}, which is no peer of it"
        where, until_s = holding.get((by, drone), (server, 0.0))
        if where != server and until_s > fact.t + ROUNDING_S:
            yield fact, f"{drone} has slots of {where} and of {server} held at the same time"
        holding[by, drone] = (server, fact.t + min(fact.for_s, _HOLD_S))


def _leases(facts: Sequence[Observation], *, end_s: float) -> Iterator[Breach]:
    """A drone that sends no request, and has no slot held, is not admitted after its lease ends."""
    asked_s: dict[str, float] = {}
    open_ones = set[str]()  # drones without the answer to their request
    held_until_s: dict[str, float] = {}
    admitted: dict[str, Observation] = {}  # by service, as last told to its instance
    over = Observation(event="over", t=end_s)
    for fact in (*facts, over):
        for told in admitted.values():
            for drone in told.drones:
                last_s = asked_s.get(drone, told.t)
                ends_s = max(last_s + _LEASE_S, held_until_s.get(drone, 0.0)) + _LOOK_S + SLACK_S
                if fact.t > max(ends_s, told.t):  # its cause may follow at the same moment
                    why = f"{drone} still has its lease at {fact.t:.3f} s; it was over at {ends_s:.3f} s"
                    yield told, why
        match fact.event:
            case "asked" | "answered" | "served":
                asked_s[fact.drone] = fact.t
                open_ones.discard(fact.drone)
                open_ones |= {fact.drone} if fact.event == "asked" else set()
            case "instance_started":  # which renews the leases of drones that wait for a start
                asked_s |= dict.fromkeys(open_ones, fact.t)
            case "held":
                held_until_s[fact.drone] = fact.t + min(fact.for_s, _HOLD_S)
            case "admitted":
                admitted[fact.service] = fact
            case "instance_ended":
                admitted.pop(fact.service, None)


_FULL, _QUEUED = "has no free slot", "of calls in its queue"
_MISSED_S = 3 * ASK_AGAIN_S  # who is not heard for longer has lost its place


def turns(history: History) -> Iterator[Breach]:
    """A wait for a slot is bounded by the turns of those that wait too; no server is blamed for its other drones."""
    for event in history.logged(schema.CheckFailed, schema.CallFailedInRange):
        if _FULL in event.why:
            yield event, f"{event.server} is blacklisted because it has no free slot"
        if _QUEUED in event.why:
            yield event, f"{event.server} is blacklisted because calls of others are before a call"
    for server in history.config.servers:
        asked = [
            fact
            for fact in history.seen
            if fact.server == server.name and fact.event == "answered" and fact.path in (AVAILABILITY, START)
        ]
        for refusal, until_s in _waits(history, server.name):
            yield from _too_long(history, server, asked, refusal, until_s)


def _waits(history: History, server: str) -> Iterator[tuple[schema.NoSlot, float]]:
    """Each refusal of the drone, and the end (s) of its wait."""
    refusal: schema.NoSlot | None = None
    for event in history.run.events:
        if isinstance(event, schema.NoSlot) and event.server == server:
            refusal = event
        elif refusal and isinstance(event, (schema.ServerStep, schema.Joined)) and event.server == server:
            yield refusal, event.t
            refusal = None
    if refusal is not None and history.run.events:
        yield refusal, history.run.events[-1].t


def _too_long(
    history: History, server: ServerConfig, asked: list[Observation], refusal: schema.NoSlot, until_s: float
) -> Iterator[Breach]:
    """Count from the drone's first question that the daemon received, if each next one came in time."""
    drone, truth = history.config.name, server_truth(server, history.config.services)
    heard_s = [fact.t for fact in asked if fact.drone == drone and refusal.t - SLACK_S <= fact.t <= until_s]
    begun_s = heard_s[0] if heard_s else math.inf
    for before_s, now_s in pairwise([*heard_s, until_s]):
        others = {fact.drone for fact in asked if begun_s - _MISSED_S <= fact.t <= now_s}
        if now_s - before_s > _MISSED_S:
            begun_s = now_s
        elif now_s - begun_s > (bound_s := _bound_s(truth, len(others - {drone}))):
            yield refusal, f"it waited for a slot of {server.name} for more than {bound_s:.1f} s"
            return


def _bound_s(truth: ServerTruth, others: int) -> float:
    """How long (s) a drone may wait for a slot: each other drone may have two turns first."""
    slots = 1 if truth.slots == "auto" else truth.slots
    rounds = math.ceil(max(1, others) / slots)
    return 2 * rounds * (truth.turn_s + ASK_AGAIN_S) + 2 * ASK_AGAIN_S + SLACK_S


_WATCH_S, _DRAIN_S = 5.0, 2.0  # of a daemon
_FATAL = ("crash", "power-cut", "hung", "poisoned", "unstartable")  # for instances
_IDLE_S = AdmissionSettings().idle_stop_s


def replaced(history: History) -> Iterator[Breach]:
    """A hung instance ends in time, no other ends; starts that fail are rare, and drones respect the pauses."""
    yield from _asked_in_a_pause(history)
    flights_over_s = max((fact.t for fact in history.seen if fact.event == "flight_over"), default=0.0)
    for server in history.config.servers:
        faults = [fault for fault in history.config.faults if fault.target == server.name]
        of_server = [fact for fact in history.seen if fact.server == server.name and fact.service]
        for service in sorted({fact.service for fact in of_server}):
            facts = [fact for fact in of_server if fact.service == service and fact.t < flights_over_s]
            yield from _still_hung(facts, faults, end_s=flights_over_s)
            yield from _ended_without_cause(facts, faults)
            yield from _started_too_soon(facts)


def _still_hung(
    facts: Sequence[Observation], faults: Sequence[FaultConfig], *, end_s: float
) -> Iterator[Breach]:
    """A hung instance is gone after the limit of a call, one look of the daemon and a drain."""
    hung_s: float | None = None
    for fact in (*facts, Observation(event="over", t=end_s)):
        if hung_s is not None and fact.t > hung_s + CALL_LIMIT_S + _WATCH_S + _DRAIN_S + SLACK_S:
            yield fact, f"an instance that was hung at {hung_s:.3f} s is still not replaced"
            return
        if fact.event == "instance_ended":
            hung_s = None
        elif fact.event == "served" and hung_s is None and _kind(faults, fact.t) == "hung":
            hung_s = fact.t


def _ended_without_cause(facts: Sequence[Observation], faults: Sequence[FaultConfig]) -> Iterator[Breach]:
    used_s = 0.0
    for fact in facts:
        if fact.event in ("instance_started", "served"):
            used_s = fact.t
        elif fact.event == "instance_ended" and fact.t - used_s < _IDLE_S:
            if any(fault.kind in _FATAL and fault.from_s <= fact.t for fault in faults):
                continue
            yield fact, f"an instance of {fact.service} ended, and nothing was wrong with it"


def _started_too_soon(facts: Sequence[Observation]) -> Iterator[Breach]:
    """The pause after each failed start grows."""
    failed, ended_s, is_ready = 0, 0.0, False
    for fact in facts:
        match fact.event:
            case "instance_started":
                pause_s = min(LONGEST_PAUSE_S, FIRST_PAUSE_S * 2.0 ** (failed - 1)) if failed else 0.0
                if fact.t < ended_s + pause_s - ROUNDING_S:
                    often = f"{counted(failed, 'time')} in a row, last at {ended_s:.3f} s"
                    yield fact, f"{fact.service} failed to start {often}"
                if fact.t - ended_s - pause_s > FORGOTTEN_S - SLACK_S:
                    failed = 0
                is_ready = False
            case "admitted":  # an instance hears of drones once it is ready
                is_ready, failed = True, 0
            case "instance_ended" if not is_ready:
                failed, ended_s = failed + 1, fact.t


def _asked_in_a_pause(history: History) -> Iterator[Breach]:
    pauses = list(history.logged(schema.LeftOut))
    for fact in history.own("sent") if pauses else ():
        for pause in pauses:
            until_s = pause.t + pause.pause_s
            is_left_out = pause.t + ROUNDING_S < fact.t < until_s - ROUNDING_S
            if pause.server == fact.server and fact.path != LEAVE and is_left_out:
                yield fact, f"{fact.server} was left out until {until_s:.3f} s, as the server said"


def _kind(faults: Sequence[FaultConfig], now_s: float) -> str:
    return next((fault.kind for fault in faults if fault.from_s <= now_s < fault.to_s), "")


_MOST_ASKED = 10  # in a second, by a drone that renews a lease of 2 s and checks again and again
_LONGEST_TEXT = 3000  # of a log, where reasons are put together


def unswayed(history: History) -> Iterator[Breach]:
    """Whom the drone calls, how often it asks, and what its log can hold is not for a server to choose."""
    yield from _dialled_elsewhere(history)
    yield from _asked_too_often(history)
    for event in history.run.events:
        if not isinstance(event, schema.Notified):  # which is the mission's own
            yield from _unfit_texts(event)


def _dialled_elsewhere(history: History) -> Iterator[Breach]:
    """At each visit, probe, or turn, the daemon, and a port of its host for each service that is wanted.

    And one more for each move of a service, whose moves are bounded.
    """
    services = len(history.config.services)
    moves = deque(history.logged(schema.ServiceMoved))
    moved = Counter((event.server, event.check, event.service) for event in moves)
    for (server, check, service), times in moved.items():
        if times > MOST_MOVES:
            yield moves[0], f"{server} had {service} move {counted(times, 'time')} in check {check}"
    turns_over = deque(history.logged(schema.TurnOver))
    dialled: Counter[str] = Counter()  # of a server, since its daemon was
    allowed: Counter[str] = Counter()
    last_s: dict[str, float] = {}
    for fact in history.own("dialled"):
        server, address = fact.server, fact.address
        while turns_over and turns_over[0].t <= fact.t:
            allowed[turns_over.popleft().server] += services  # its daemon is not dialled again
        while moves and moves[0].t <= fact.t:
            allowed[moves.popleft().server] += 1
        if address == daemon_address(server):
            if fact.t - last_s.get(server, -math.inf) > ANSWER_S:  # else an earlier probe may be under way
                dialled[server] = allowed[server] = 0
            last_s[server] = fact.t
            allowed[server] += services
            continue
        host, _, port = address.rpartition(":")
        if host != daemon_address(server).rpartition(":")[0] or not port.isdecimal():
            yield fact, f"{server} had the drone call {address!r:.100}"
        dialled[server] += 1
        if dialled[server] > allowed[server]:
            why = f"{server} had the drone call {dialled[server]} addresses instead of {allowed[server]}"
            yield fact, why


def _asked_too_often(history: History) -> Iterator[Breach]:
    asked: dict[str, deque[float]] = {}  # the last times, by server
    for fact in history.own("sent"):
        if fact.path != AVAILABILITY:
            continue
        times = asked.setdefault(fact.server, deque(maxlen=_MOST_ASKED))
        times.append(fact.t)
        if len(times) == _MOST_ASKED and times[-1] - times[0] < 1.0:
            yield fact, f"{fact.server} was asked {_MOST_ASKED} times within a second"


def _unfit_texts(event: Event) -> Iterator[Breach]:
    for name, fact in msgspec.structs.asdict(event).items():
        if name == "trace" or not isinstance(fact, str):
            continue
        if not fact.isprintable() or len(fact) > _LONGEST_TEXT:
            yield None, f"{event.kind} at {event.t} s: its {name} is {len(fact)} characters: {fact!r:.100}"
