"""The line of calls that are open at the same time: one is computed on the drone, and one on a server.

    first in line   the oldest call, or the newest, as configured; a call that the mission waits for comes before all
    its place       where it is expected to be answered soonest (core/selection): it waits until that place is free;
                    the drone, for a call that runs once, and for all calls once deciding has failed
    decided         once its place is free, as any call is; then the next call is first
    only servers    the calls of each service that no drone can run have a line of their own, and hold up no others; a
                    free server takes them before calls that the drone could compute

The lane of a place is held from the decision on until the call is answered, wherever it is computed in the end, and
for as long as any other call of the drone is computed there (core/selection/lanes.py).
"""

from __future__ import annotations

import asyncio
import bisect
import contextlib
import math
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Literal

from upwash.core.operation import ON_DRONE, Operation, name_of
from upwash.core.policies.policy import Decision, Remote
from upwash.core.selection.call_placement import Place
from upwash.drone.decisions import Decisions, now_s


@dataclass(frozen=True, slots=True)
class Turn:
    """The turn of a call to be decided; `take` gets the decision, None for the drone without one.

    With `on_drone` only the drone is free for it, and with `drone_is_busy` only a server. `leave` frees its place
    before the call is answered. `is_next(server, by_s)` tells whether the server is free for its better answer, of
    the calls that it can answer by their times; `sends` notes that it is sent there.
    """

    take: Callable[[Decision | None], None]
    on_drone: bool = False
    drone_is_busy: bool = False
    leave: Callable[[], None] = lambda: None
    is_next: Callable[[str, float], bool] = lambda *_: True
    sends: Callable[[], object] = lambda: None


@dataclass(slots=True, eq=False)
class _InLine:
    """A call in line."""

    operation: Operation
    since_s: float
    is_first: asyncio.Event = field(default_factory=asyncio.Event)  # set once it may be


class _Line:
    """Calls one behind the other; those that the mission waits for come before all others."""

    def __init__(self, first: int) -> None:
        self._first = first
        self.urgent: list[_InLine] = []
        self.others: list[_InLine] = []

    @property
    def first(self) -> _InLine | None:
        """The first in line."""
        return self.urgent[0] if self.urgent else self.others[self._first] if self.others else None

    def enter(self, call: _InLine, *, urgent: bool) -> None:
        """Put the call behind all that were made before it."""
        line = self.urgent if urgent else self.others
        bisect.insort(line, call, key=lambda call: call.since_s)

    def leave(self, call: _InLine) -> None:
        """Take the call out, and wake the first of the others."""
        (self.urgent if call in self.urgent else self.others).remove(call)
        if self.first is not None:
            self.first.is_first.set()


AT_ONCE = Turn(lambda _: None)  # of a call that waits for no other


class CallLine:
    """Lets calls be decided one after the other, each once a place is free for it."""

    def __init__(self, decisions: Decisions, *, first: Literal["oldest", "newest"]) -> None:
        self._decisions = decisions
        self._lanes = decisions.selection.lanes
        self._first = 0 if first == "oldest" else -1
        self._lines: dict[str, _Line] = {
            "": _Line(self._first)
        }  # by the service, of those that only servers run
        self._is_deciding = False
        self._wanted: dict[object, float] = {}  # calls for a better answer, and by when each must be sent
        self._only_on_drone = False

    @contextlib.asynccontextmanager
    async def turn(
        self, operation: Operation, *, urgent: bool, on_drone: bool = False, since_s: float = math.inf
    ) -> AsyncIterator[Turn]:
        """Enter the line; the block begins when the call may be decided, and ends when it is answered.

        With `on_drone` the call runs nowhere else. `since_s` is when a call was made that is in line again.
        """
        call, needs_server = _InLine(operation, since_s), self._needs_server(operation)
        line = self._lines.setdefault(operation.service if needs_server else "", _Line(self._first))
        line.enter(call, urgent=urgent)
        try:
            while not (free := self._free_place(call, line, on_drone=on_drone)):
                if call is line.first:
                    await self._decisions.told()
                else:
                    call.is_first.clear()
                    await call.is_first.wait()
        finally:
            line.leave(call)
            self._decisions.wake()  # another is first now
        self._is_deciding = True

        is_placed = False

        def take(decision: Decision | None) -> None:
            nonlocal is_placed
            is_placed = True
            self._lanes.hold(call, *self._place(operation, decision))
            self._go_on()

        def leave() -> None:
            self._lanes.release(call)
            self._decisions.wake()

        try:
            yield Turn(
                take,
                on_drone=free == "drone",
                drone_is_busy=not self._lanes.is_free(ON_DRONE),
                leave=leave,
                is_next=partial(self._is_next, call, operation),
                sends=partial(self._wanted.pop, call, None),
            )
        finally:
            if not is_placed:
                self._is_deciding = False
            self._wanted.pop(call, None)
            leave()

    def _is_next(self, call: object, operation: Operation, server: str, by_s: float) -> bool:
        """Whether the call is the next for a better answer of the server, which is free."""
        self._wanted[call] = by_s - self._takes_s(server, operation)
        if self._is_deciding or not self._lanes.is_free(server):
            return False
        in_time = [wanted for wanted, latest_s in self._wanted.items() if latest_s >= now_s()]
        return bool(in_time) and in_time[self._first] is call

    def _takes_s(self, server: str, operation: Operation) -> float:
        return self._decisions.selection.estimates.remote_s(server, operation) or 0.0

    def keep_on_drone(self) -> None:
        """From now on have every call run on the drone."""
        self._only_on_drone = True
        self._decisions.wake()

    def _free_place(self, call: _InLine, line: _Line, *, on_drone: bool) -> Place:
        operation = call.operation
        if self._is_deciding or call is not line.first:
            return ""
        if self._needs_server(operation):
            return self._decisions.free_place(operation)
        if on_drone or self._only_on_drone:
            return "drone" if self._lanes.is_free(ON_DRONE) else ""
        is_wanted = call not in line.urgent and self._is_wanted()
        return self._decisions.free_place(operation, is_wanted=is_wanted)

    def _needs_server(self, operation: Operation) -> bool:
        return self._decisions.selection.estimates.needs_server(operation)

    def _is_wanted(self) -> bool:
        """Whether the server in use is free for a call that only servers compute."""
        heads = [line.first.operation for line in self._lines.values() if line.first is not None]
        return any(
            self._needs_server(operation) and self._decisions.free_place(operation) for operation in heads
        )

    def _go_on(self) -> None:
        self._is_deciding = False
        self._decisions.wake()

    def _place(self, operation: Operation, decision: Decision | None) -> tuple[str, float]:
        if decision is None:
            return ON_DRONE, math.inf
        estimates = self._decisions.selection.estimates
        server = decision.server if isinstance(decision, Remote) and not decision.raced else None
        if server is None:
            takes_s = estimates.local_s(self._computed(operation))
        else:
            takes_s = estimates.remote_s(server, operation)
        return name_of(server), now_s() + (takes_s or 0.0)

    def _computed(self, operation: Operation) -> Operation:
        """What the drone computes of a call of the operation."""
        two = self._decisions.two_answers(operation)
        return operation if two is None else two.first
