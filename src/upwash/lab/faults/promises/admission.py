"""Promise 11: what a server gives to drones is bounded, and ends."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from upwash.core.admission.admission import AdmissionSettings
from upwash.lab.faults.promises.history import ROUNDING_S, SLACK_S, Breach, History
from upwash.lab.observer import Seen

_LOOK_S = 1.0  # a daemon looks no more often at what has come to its end
_LEASE_S, _HOLD_S = AdmissionSettings().lease_s, AdmissionSettings().hold_s


def admission(history: History) -> Iterator[Breach]:
    """Of each server: one instance of a service, no more drones than slots, leases and held slots that end."""
    yield from _holds(history)
    for server in history.config.servers:
        facts = [fact for fact in history.seen if fact.server == server.name]
        yield from _instances(facts)
        if server.truth.slots != "auto":
            yield from _slots(facts, server.truth.slots)
        yield from _leases(facts, end_s=history.seen[-1].t if history.seen else 0.0)


def _instances(facts: Sequence[Seen]) -> Iterator[Breach]:
    running: set[str] = set()
    for fact in facts:
        if fact.event == "instance_started":
            if fact.service in running:
                yield fact, f"a second instance of {fact.service} on {fact.server}"
            running.add(fact.service)
        elif fact.event == "instance_ended":
            running.discard(fact.service)


def _slots(facts: Sequence[Seen], slots: int) -> Iterator[Breach]:
    for fact in facts:
        if fact.event == "admitted" and len(fact.drones) > slots:
            yield fact, f"{fact.server} serves {', '.join(fact.drones)}, and has {slots} slots"


def _holds(history: History) -> Iterator[Breach]:
    """Slots are held for servers that are peers, and for a drone one at a time by each server that it visits."""
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


def _leases(facts: Sequence[Seen], *, end_s: float) -> Iterator[Breach]:
    """A drone that asks nothing, and for which nothing is held, is no longer admitted once its lease is over."""
    asked_s: dict[str, float] = {}
    held_until_s: dict[str, float] = {}
    admitted: dict[str, Seen] = {}  # by service, as last told to its instance
    over = Seen(event="over", t=end_s)
    for fact in (*facts, over):
        for told in admitted.values():
            for drone in told.drones:
                last_s = asked_s.get(drone, told.t)
                ends_s = max(last_s + _LEASE_S, held_until_s.get(drone, 0.0)) + _LOOK_S + SLACK_S
                if fact.t > max(ends_s, told.t):  # what it was told for may come after it, at one moment
                    yield (
                        told,
                        f"{drone} still has its lease at {fact.t:.3f} s; it was over at {ends_s:.3f} s",
                    )
        match fact.event:
            case "asked" | "answered" | "served":
                asked_s[fact.drone] = fact.t
            case "held":
                held_until_s[fact.drone] = fact.t + min(fact.for_s, _HOLD_S)
            case "admitted":
                admitted[fact.service] = fact
            case "instance_ended":
                admitted.pop(fact.service, None)
