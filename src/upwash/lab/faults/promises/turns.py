"""Promise 18: who asks a full server for a slot, and goes on asking, gets one; and a full server has not failed."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise

from upwash.config import ServerConfig, ServerTruth, server_truth
from upwash.core.admission.turns import ASK_AGAIN_S
from upwash.eventlog import schema
from upwash.eventlog.schema import Event
from upwash.lab.faults.promises.history import SLACK_S, Breach, History
from upwash.lab.observer import Seen
from upwash.rpc.protocol import AVAILABILITY, START

_FULL = "has no free slot"
_MISSED_S = 3 * ASK_AGAIN_S  # who is not heard for longer has lost its place


def turns(history: History) -> Iterator[Breach]:
    """A wait for a slot is bounded by the turns of those that wait too; no server is blamed for having none."""
    for event in history.run.events:
        if isinstance(event, (schema.CheckFailed, schema.CallFailedInRange)) and _FULL in event.why:
            yield event, f"{event.server} is blacklisted because it has no free slot"
    for server in history.config.servers:
        asked = [fact for fact in history.seen if fact.server == server.name and _is_question(fact)]
        for refusal, until_s in _waits(history, server.name):
            yield from _too_long(history, server, asked, refusal, until_s)


def _is_question(fact: Seen) -> bool:
    return fact.event == "answered" and fact.path in (AVAILABILITY, START)


def _waits(history: History, server: str) -> Iterator[tuple[schema.NoSlot, float]]:
    """Each time that the drone was refused, and until when it waited."""
    refusal: schema.NoSlot | None = None
    for event in history.run.events:
        if isinstance(event, schema.NoSlot) and event.server == server:
            refusal = event
        elif refusal is not None and _ends_wait(event, server):
            yield refusal, event.t
            refusal = None
    if refusal is not None and history.run.events:
        yield refusal, history.run.events[-1].t


def _ends_wait(event: Event, server: str) -> bool:
    return isinstance(event, (schema.ServerStep, schema.Joined)) and event.server == server


def _too_long(
    history: History, server: ServerConfig, asked: list[Seen], refusal: schema.NoSlot, until_s: float
) -> Iterator[Breach]:
    """Counts from the first of its questions that the daemon heard, none of which came too late."""
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
    """How long a drone may wait for a slot that so many others hold or want: each may have two turns before."""
    slots = 1 if truth.slots == "auto" else truth.slots
    rounds = math.ceil(max(1, others) / slots)
    return 2 * rounds * (truth.turn_s + ASK_AGAIN_S) + 2 * ASK_AGAIN_S + SLACK_S
