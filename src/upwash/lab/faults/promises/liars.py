"""Promise 15: whom a drone calls, how often, and what its log can hold is not for a server to choose."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Iterator

import msgspec

from upwash.drone.server_session import MOST_MOVES
from upwash.eventlog import schema
from upwash.eventlog.schema import Event
from upwash.lab.faults.promises.history import ANSWER_S, Breach, History
from upwash.lab.field import daemon_address
from upwash.rpc.protocol import AVAILABILITY

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
    moves = deque(event for event in history.run.events if isinstance(event, schema.ServiceMoved))
    moved = Counter((event.server, event.check, event.service) for event in moves)
    for (server, check, service), times in moved.items():
        if times > MOST_MOVES:
            yield moves[0], f"{server} had {service} move {times} times in check {check}"
    turns_over = deque(event for event in history.run.events if isinstance(event, schema.TurnOver))
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
            yield (
                fact,
                f"{server} had the drone call {dialled[server]} addresses instead of {allowed[server]}",
            )


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
        if (
            name != "trace"
            and isinstance(fact, str)
            and not (fact.isprintable() and len(fact) <= _LONGEST_TEXT)
        ):
            yield None, f"{event.kind} at {event.t} s: its {name} is {len(fact)} characters: {fact!r:.100}"
