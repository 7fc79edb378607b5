"""The drone's decisions about servers and calls: made by the core, logged, and carried out by the radios.

`Background` has the core consider servers again once a period, and at each border of a range. It skips the times at
which, by `next_look_s`, nothing can have changed.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, NoReturn

from msgspec.structs import asdict

from upwash.core.geo import Circle, Position
from upwash.core.knowledge.servers import Change
from upwash.core.operation import Operation
from upwash.core.planning.answering import ServerBelief
from upwash.core.planning.stay_or_go import Outlook
from upwash.core.policies.policy import Decision, Lightened, Local, Remote, Wait
from upwash.core.selection.call_placement import Place
from upwash.core.selection.commands import (
    Command,
    Effect,
    ExpectedTimes,
    Full,
    Mapped,
    Preferred,
    ServerPaused,
)
from upwash.core.selection.events import PartFailed, SelectionEvent, Tick
from upwash.core.selection.lanes import InLine
from upwash.core.selection.selection import Selection
from upwash.core.selection.settings import TwoAnswers
from upwash.errors import AutopilotLost
from upwash.eventlog import schema
from upwash.ports import Journal, Whereabouts
from upwash.support.background import first

_NAMES: Mapping[type[Decision], Literal["local", "remote", "wait"]] = {
    Local: "local",
    Remote: "remote",
    Wait: "wait",
}


class Decisions:
    """Tells the core what happens, asks it where calls run, and passes its commands on by `send`."""

    def __init__(
        self,
        selection: Selection,
        *,
        autopilot: Whereabouts,
        journal: Journal,
        send: Callable[[Command], None],
    ) -> None:
        self.server_left = asyncio.Event()  # by a decision on a call, which selects no other server
        self.looked_after: Callable[[], object] = lambda: None  # called when the next look may have moved
        self.selection = selection
        self._autopilot = autopilot
        self._journal = journal
        self._send = send
        self._told = asyncio.Event()  # set and replaced at each event
        self._changed = asyncio.Event()  # set and replaced at each effect

    @property
    def position(self) -> Position:
        """The drone's position."""
        return self._autopilot.position

    def next_look_s(self) -> float:
        """The time before which the core need not consider servers again; as `Selection.next_look_s`."""
        return self.selection.next_look_s(now_s=now_s())

    def outlook(self) -> Outlook | None:
        """What flying on before the open call is over would save and cost; None if nothing is known."""
        return self.selection.outlook(now_s=now_s(), position=self._autopilot.position)

    def reach_s(self, operation: Operation) -> float | None:
        """Seconds until a server in range answers a call that only servers compute; None where none can."""
        return self.selection.reach_s(operation, now_s=now_s(), position=self._autopilot.position)

    def believed(self, operations: Sequence[Operation]) -> Mapping[str, ServerBelief]:
        """The servers that may compute these operations, and the mean seconds of a call at each."""
        return self.selection.believed(operations, now_s=now_s(), position=self._autopilot.position)

    def tell(self, event: SelectionEvent) -> None:
        """Pass the event to the core, and carry out its effects."""
        effects = self.selection.handle(event, now_s=now_s(), position=self._autopilot.position)
        self._perform(effects)
        self.wake()
        self.looked_after()

    def next_in_line(self) -> tuple[InLine, Place] | None:
        """The call to be decided now, of those in line, and where; None while all wait for a place."""
        return self.selection.next_in_line(now_s=now_s(), position=self._autopilot.position)

    def hold(self, computing: asyncio.Task[Any], place: str, takes_s: float | None) -> None:
        """Hold the lane of the place until the task is over, which is expected to take that long."""
        lanes = self.selection.lanes
        lanes.hold(computing, place, now_s() + (takes_s or 0.0))

        def release(_: object) -> None:
            lanes.release(computing)
            self.wake()

        computing.add_done_callback(release)

    async def told(self) -> None:
        """Return after the next event of the core, or `wake`."""
        await self._told.wait()

    def wake(self) -> None:
        """Have those that wait for events of the core look again."""
        self._told.set()
        self._told = asyncio.Event()

    def decide(
        self,
        operation: Operation,
        *,
        waypoint: int | None = None,
        on_drone: bool = False,
        drone_is_busy: bool = False,
    ) -> Decision:
        """Decide where the call that the mission makes now runs, and whether lighter; log the decision."""
        position = self._autopilot.position
        decision, effects = self.selection.decide(
            operation, now_s=now_s(), position=position, on_drone=on_drone, drone_is_busy=drone_is_busy
        )
        lightened = decision.inputs.lightened
        self._decided(lightened.operation if lightened else operation, decision, effects, position, waypoint)
        return decision

    def may_send(self, server: str, check: int) -> bool:
        """Whether a call that was decided for the server, READY since that check, may still go there."""
        return self.selection.may_send(server, check, now_s=now_s(), position=self._autopilot.position)

    def may_queue_s(self, server: str, operation: Operation, deadline_s: float) -> float:
        """The seconds within which the server has to begin a call that is sent now, to answer it by its deadline."""
        return self.selection.may_queue_s(server, operation, deadline_s, now_s=now_s())

    def part_failed(self, operation: Operation, why: str) -> None:
        """Tell the core that the part before sending failed, and log it."""
        self.tell(PartFailed(operation.service))
        again = self.selection.estimates.tries_part(operation.service)
        self._journal.record(schema.SentWhole(operation=str(operation), why=why, given_up=not again))

    def fall_back(self, operation: Operation) -> Lightened | None:
        """The lighter operation of a call that the drone computes after its server failed; None: as asked."""
        return self.selection.fall_back(operation, now_s=now_s(), position=self._autopilot.position)

    async def wait(self, operation: Operation, wait: Wait, *, waypoint: int | None = None) -> Decision:
        """Wait for the server as decided; return where the call runs then."""
        check = self.selection.servers[wait.server].check
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(wait.at_most_s):
                while self.selection.is_awaited(check):
                    await self._changed.wait()
        position = self._autopilot.position
        decision, effects = self.selection.decide_after_wait(
            operation, check, now_s=now_s(), position=position
        )
        self._decided(operation, decision, effects, position, waypoint)
        return decision

    def overtake(
        self, operation: Operation, *, began_s: float, waypoint: int | None = None
    ) -> tuple[Remote | None, float]:
        """The READY server expected to answer before the drone, logged, or None; and when to ask again."""
        position = self._autopilot.position
        decision, again_s = self.selection.overtake(
            operation, began_s=began_s, now_s=now_s(), position=position
        )
        if decision is not None:
            self._decided(operation, decision, (), position, waypoint)
        return decision, again_s

    def two_answers(self, operation: Operation) -> TwoAnswers | None:
        """What the drone computes at once of a call with two answers; None for a call with one."""
        return self.selection.two_answers(operation)

    def better(
        self, operation: Operation, *, by_s: float, is_next: bool, waypoint: int | None = None
    ) -> tuple[Remote | None, bool]:
        """The READY server for a call's better answer, logged, or None; and whether one may become of use by then."""
        position = self._autopilot.position
        decision, may_come = self.selection.better(
            operation, by_s=by_s, is_next=is_next, now_s=now_s(), position=position
        )
        if decision is not None:
            self._decided(operation, decision, (), position, waypoint)
        return decision, may_come

    def second(self, operation: Operation, *, beside: str, begins: bool = False) -> str | None:
        """The other READY server, for calls that the one `beside` it answers late; None without one."""
        server = self.selection.second(
            operation, beside=beside, begins=begins, now_s=now_s(), position=self._autopilot.position
        )
        return None if server is None else server.name

    async def until_told(self, unless: asyncio.Task[object], *, until_s: float) -> None:
        """Return after the next event of the core, at `until_s`, or when the task `unless` is done."""
        left_s = until_s - now_s() if until_s < math.inf else None
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(left_s):
                await first(asyncio.wait([unless]), self._told.wait())

    def _decided(
        self,
        operation: Operation,
        decision: Decision,
        effects: Sequence[Effect],
        position: Position,
        waypoint: int | None,
    ) -> None:
        self._perform(effects)
        if effects:
            self.server_left.set()
        self.looked_after()
        self._journal.record(
            schema.Decided(
                waypoint=waypoint,
                operation=str(operation),
                decision=_NAMES[type(decision)],
                server=None if isinstance(decision, Local) else decision.server,
                deadline_s=decision.deadline_s if isinstance(decision, Remote) else None,
                at_most_s=decision.at_most_s if isinstance(decision, Wait) else None,
                raced=isinstance(decision, Remote) and decision.raced,
                why=decision.why,
                position=position,
                **decision.inputs.facts,
            )
        )

    def _perform(self, effects: Sequence[Effect]) -> None:
        for effect in effects:
            match effect:
                case Change():
                    self._record_change(effect)
                case Full():
                    self._journal.record(schema.NoSlot(**asdict(effect)))
                case Preferred():
                    self._journal.record(schema.Preferred(**asdict(effect)))
                case ServerPaused():
                    self._journal.record(schema.LeftOut(**asdict(effect)))
                case Mapped(server, place):
                    self._journal.record(
                        schema.PlaceMeasured(server=server, place=schema.MeasuredRecord.of(place))
                    )
                case ExpectedTimes(reached_s):
                    facts = asdict(effect) | {"reached_s": [round(each_s, 1) for each_s in reached_s]}
                    self._journal.record(schema.Foreseen(**facts))
                case _:
                    self._send(effect)
        if effects:
            self._changed.set()
            self._changed = asyncio.Event()

    def _record_change(self, change: Change) -> None:
        estimates, servers = self.selection.estimates, self.selection.in_range
        self._journal.record(
            schema.STEPS[change.event](
                server=change.server,
                before=change.before,
                after=change.after,
                why=change.why,
                check=change.check,
                local_mean_call_s=estimates.mean_call_s(),
                mean_call_s={server.name: estimates.mean_call_s(server.name) for server in servers},
                position=self._autopilot.position,
            )
        )


def now_s() -> float:
    """The time of the running event loop, in seconds."""
    return asyncio.get_running_loop().time()


_ROUNDING_S = 1e-6  # a look may be early by this, rather than late by a period


class Background:
    """Has the core consider servers again and again, until its tasks are cancelled."""

    def __init__(
        self,
        decisions: Decisions,
        areas: Sequence[Circle],
        *,
        period_s: float,
        autopilot: Whereabouts,
        journal: Journal,
    ) -> None:
        self._decisions = decisions
        self._areas = areas
        self._period_s = period_s
        self._autopilot = autopilot
        self._journal = journal
        self._silent = False  # the vehicle is, so that borders may be crossed unseen
        self._looked_s = 0.0
        self._due_s = -math.inf  # of the next possible change
        self._alarm: asyncio.TimerHandle | None = None  # at the first look from then on

    async def look(self) -> NoReturn:
        """Tick the core after each period in which its inputs can have changed, at once after a server was left."""
        again, loop = self._decisions.server_left, asyncio.get_running_loop()
        self._decisions.looked_after = self._set_alarm
        try:
            while True:
                self._decisions.tell(Tick())
                again.clear()
                self._looked_s = loop.time()
                self._stop_alarm()
                self._set_alarm()
                await again.wait()
        finally:
            self._decisions.looked_after = lambda: None
            self._stop_alarm()

    async def watch_borders(self) -> NoReturn:
        """Tell the core at once when a border is crossed; once a period while the vehicle is silent."""
        while True:
            try:
                await self._autopilot.border_crossed(self._areas)
            except AutopilotLost as error:
                if not self._silent:
                    self._journal.record(schema.BorderWatchFailed(why=str(error)))
                self._silent = True
                self._set_alarm()
                await asyncio.sleep(self._period_s)
            else:
                self._silent = False
                self._decisions.tell(Tick())

    def _set_alarm(self) -> None:
        """Schedule the next tick at the end of the first period in which the core's inputs can have changed."""
        due_s = -math.inf if self._silent else self._decisions.next_look_s() - _ROUNDING_S
        if due_s == self._due_s and self._alarm is not None:
            return
        self._stop_alarm()
        self._due_s = due_s
        if due_s < math.inf:
            loop = asyncio.get_running_loop()
            self._alarm = loop.call_at(self._look_s(max(due_s, loop.time())), self._decisions.server_left.set)

    def _look_s(self, due_s: float) -> float:
        look_s = self._looked_s + self._period_s
        while look_s < due_s:
            look_s += self._period_s
        return look_s

    def _stop_alarm(self) -> None:
        if self._alarm is not None:
            self._alarm.cancel()
            self._alarm = None
