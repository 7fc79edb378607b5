"""Defects planted in the calls that servers compute, alone or for several drones: `planted.py` lists them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from tests.sim.planting import planted

from upwash.core.selection.events import RemoteCallFailed, RemoteCallQueued, SelectionEvent
from upwash.drone import api, flight
from upwash.drone.calling import Invocation
from upwash.drone.decisions import Decisions
from upwash.drone.pending import Hearing
from upwash.drone.server_calls import ServerCalls
from upwash.rpc.service import NoAnswer, Patience


@planted("an instance that only servers run starts on the drone", flight, "onboard_services")
def starts_all(services: Any, config: Any, specs: Any, *others: Any) -> Any:
    return services(config, {name: replace(spec, where="anywhere") for name, spec in specs.items()}, *others)


@planted("a call waits beyond the deadline that the mission chose", api, "make_stub")
def forgets_deadlines(make_stub: Any, cls: type, invoke: Any, patience: Patience | None = None) -> Any:
    return make_stub(cls, invoke, patience and replace(patience, within_s=None))


@planted("a call that no server answered is not in the log", ServerCalls, "unanswered")
def says_nothing(_: Any, self: ServerCalls, asked: Invocation, why: str, asked_s: float) -> NoAnswer:
    return NoAnswer(why)


@planted("a call that was answered ends without an answer too", ServerCalls, "answer")
async def ends_twice(answer: Any, self: ServerCalls, asked: Invocation, hearing: Hearing, **more: Any) -> Any:
    reply = await answer(self, asked, hearing, **more)
    if not isinstance(reply, NoAnswer):
        self.unanswered(asked, "late", 0.0)
    return reply


@planted("a queue counts as a failure", Decisions, "tell")
def blamed_for_a_queue(tell: Any, self: Decisions, event: SelectionEvent) -> None:
    if isinstance(event, RemoteCallQueued):
        check = self.selection.servers[event.server].check
        event = RemoteCallFailed(event.server, check, event.why, event.late)
    tell(self, event)
