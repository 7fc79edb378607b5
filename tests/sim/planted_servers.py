"""Defects planted in the calls that servers compute, alone or for several drones: `planted.py` lists them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from tests.sim.planting import planted

from upwash.core.call.call import Call
from upwash.core.call.calls import Calls
from upwash.core.selection.events import RemoteCallFailed, RemoteCallQueued, SelectionEvent
from upwash.drone import api, preparation
from upwash.eventlog import schema
from upwash.rpc.service import Patience


@planted("an instance that only servers run starts on the drone", preparation, "onboard_services")
def starts_all(services: Any, config: Any, specs: Any, *others: Any) -> Any:
    return services(config, {name: replace(spec, where="anywhere") for name, spec in specs.items()}, *others)


@planted("a call waits beyond the deadline that the mission chose", api, "make_stub")
def forgets_deadlines(make_stub: Any, cls: type, invoke: Any, patience: Patience | None = None) -> Any:
    return make_stub(cls, invoke, patience and replace(patience, within_s=None))


@planted("a call that no server answered is not in the log", Calls, "do")
def says_nothing(do: Any, self: Calls, step: Any) -> None:
    if not isinstance(step, schema.Unanswered):
        do(self, step)


@planted("a call that was answered ends without an answer too", Call, "end")
def ends_twice(end: Any, self: Call, source: Any) -> None:
    calls = self.calls
    end(self, source)
    if self.asked.on_servers:
        about, operation = self.asked.waypoint, str(self.asked.operation)
        calls.do(
            schema.Unanswered(waypoint=about, operation=operation, at_s=0.0, waited_s=calls.now_s, why="late")
        )


@planted("a queue counts as a failure", Calls, "tell")
def blamed_for_a_queue(tell: Any, self: Calls, event: SelectionEvent) -> None:
    if isinstance(event, RemoteCallQueued):
        check = self.selection.servers[event.server].check
        event = RemoteCallFailed(event.server, check, event.why, event.late)
    tell(self, event)
