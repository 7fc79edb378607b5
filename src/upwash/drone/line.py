"""The line of calls that are open at the same time: one is computed on the drone, and one on a server.

    in line         the oldest call is first, or the newest, as configured; a call that the mission waits for is
                    before all others; a call that only servers compute is before calls that the drone could compute
    its place       the policy chooses it. By default a free place takes the first call that it would answer before
                    the other place gets to it (core/planning/earliest.py). The drone takes a call that runs once.
                    Once deciding has failed, the drone takes all calls in line.
    decided         once its place is free, as any call is; then the next call is decided

A call holds the lane of its place from the decision until its answer, wherever it is computed in the end. Each other
call of the drone that is computed there holds the lane too (core/selection/lanes.py).
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Literal

from upwash.core.operation import ON_DRONE, Operation, name_of
from upwash.core.policies.policy import Decision, Local, Remote
from upwash.core.selection.call_placement import Place
from upwash.core.selection.lanes import InLine
from upwash.drone.decisions import Decisions, now_s
from upwash.drone.own_policy import PolicyDefect


@dataclass(frozen=True, slots=True)
class Turn:
    """The turn of a call to be decided; `take` gets the decision, None for the drone without one.

    With `on_drone` only the drone is free for it, and with `drone_is_busy` only a server. `leave` frees its place
    before the call is answered, and `on_drone_instead` exchanges it for the drone. `is_next(server, by_s)` tells
    whether the server is free for its better answer, of the calls that it can answer by their times; `sends` notes
    that it is sent there.
    """

    take: Callable[[Decision | None], None]
    on_drone: bool = False
    drone_is_busy: bool = False
    leave: Callable[[], None] = lambda: None
    on_drone_instead: Callable[[], contextlib.AbstractAsyncContextManager[object]] = contextlib.nullcontext
    is_next: Callable[[str, float], bool] = lambda *_: True
    sends: Callable[[], object] = lambda: None


@dataclass(slots=True, eq=False)
class _Waiting(InLine):
    """A call in line; `has_news` is set when it is first, or may be decided."""

    has_news: asyncio.Event = field(default_factory=asyncio.Event)


LONGEST_UNUSED_S = 60.0  # that a policy may leave both lanes free beside a line
AT_ONCE = Turn(lambda _: None)  # of a call that waits for no other


class CallLine:
    """Lets calls be decided one after the other, each once a place is free for it."""

    def __init__(self, decisions: Decisions, *, first: Literal["oldest", "newest"]) -> None:
        self._decisions = decisions
        self._lanes = decisions.selection.lanes
        self._lanes.newest_first, self._lanes.has_line = first == "newest", True
        self._is_deciding = False
        self._wanted: dict[object, float] = {}  # calls for a better answer, and by when each must be sent
        self._only_on_drone = False
        self._unused_since_s: float | None = None  # both lanes, beside calls that the drone could compute

    @contextlib.asynccontextmanager
    async def turn(
        self, operation: Operation, *, urgent: bool, on_drone: bool = False, since_s: float | None = None
    ) -> AsyncIterator[Turn]:
        """Enter the line; the block begins when the call may be decided, and ends when it is answered.

        With `on_drone` the call runs nowhere else. `since_s` is when a call was made that is in line again.
        """
        made_s = now_s() if since_s is None else since_s
        call = _Waiting(operation, made_s, urgent, self._needs_server(operation), on_drone)
        self._lanes.enter(call)
        try:
            while (place := self._place_of(call)) is None:
                if call is self._lanes.first:
                    await self._news()
                else:
                    call.has_news.clear()
                    await call.has_news.wait()
        finally:
            self._lanes.leave(call)
            self._have_look(self._lanes.first)
            self._decisions.wake()  # another is first now
        self._is_deciding, self._unused_since_s = True, None

        is_placed = False

        def take(decision: Decision | None) -> None:
            nonlocal is_placed
            is_placed = True
            self._lanes.hold(call, *self._place(operation, decision))
            self._go_on()

        def leave() -> None:
            self._lanes.release(call)
            self._decisions.wake()

        @contextlib.asynccontextmanager
        async def on_drone_instead() -> AsyncIterator[None]:
            leave()
            async with self.turn(operation, urgent=urgent, on_drone=True, since_s=made_s) as turn:
                turn.take(Local("the server has not begun it"))
                yield

        try:
            yield Turn(
                take,
                on_drone=place == "drone",
                drone_is_busy=not self._lanes.is_free(ON_DRONE),
                leave=leave,
                on_drone_instead=on_drone_instead,
                is_next=partial(self._is_next, call, operation),
                sends=partial(self._wanted.pop, call, None),
            )
        finally:
            if not is_placed:
                self._is_deciding = False
            self._wanted.pop(call, None)
            leave()

    async def _news(self) -> None:
        """Return when a call in line may have a place; raises PolicyDefect if no lane is used for too long."""
        only_servers = all(call.needs_server for call in self._lanes.line)
        if only_servers or self._is_deciding or not self._lanes.are_free:
            self._unused_since_s = None
            await self._decisions.told()
            return
        if self._unused_since_s is None:
            self._unused_since_s = now_s()
        left_s = self._unused_since_s + LONGEST_UNUSED_S - now_s()
        if left_s <= 0:
            policy = self._decisions.selection.policy.name
            raise PolicyDefect(f"policy {policy}: place_in_line used no lane for {LONGEST_UNUSED_S:g} s")
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(left_s):
                await self._decisions.told()

    def _is_next(self, call: object, operation: Operation, server: str, by_s: float) -> bool:
        """Whether the call is the next for a better answer of the server, which is free."""
        self._wanted[call] = by_s - self._takes_s(server, operation)
        if self._is_deciding or not self._lanes.is_free(server):
            return False
        in_time = [wanted for wanted, latest_s in self._wanted.items() if latest_s >= now_s()]
        return bool(in_time) and in_time[-1 if self._lanes.newest_first else 0] is call

    def _takes_s(self, server: str, operation: Operation) -> float:
        return self._decisions.selection.estimates.remote_s(server, operation) or 0.0

    def keep_on_drone(self) -> None:
        """From now on have every call run on the drone."""
        self._only_on_drone = True
        self._decisions.wake()

    def _place_of(self, call: InLine) -> Place | None:
        """Where the call may be decided now; None while it waits, and another that may be decided has a look."""
        if self._is_deciding or (following := self._next()) is None:
            return None
        chosen, place = following
        if chosen is call:
            return place
        self._have_look(chosen)
        return None

    def _next(self) -> tuple[InLine, Place] | None:
        if not self._only_on_drone:
            return self._decisions.next_in_line()
        calls = (call for call in self._lanes.line if not call.needs_server)
        call = next(calls, None) if self._lanes.is_free(ON_DRONE) else None
        return None if call is None else (call, "drone")

    def _have_look(self, call: InLine | None) -> None:
        if isinstance(call, _Waiting):
            call.has_news.set()

    def _needs_server(self, operation: Operation) -> bool:
        return self._decisions.selection.estimates.needs_server(operation)

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
            takes_s = self._lanes.queue_s(server, now_s()) + (estimates.remote_s(server, operation) or 0.0)
        return name_of(server), now_s() + (takes_s or 0.0)

    def _computed(self, operation: Operation) -> Operation:
        """What the drone computes of a call of the operation."""
        two = self._decisions.two_answers(operation)
        return operation if two is None else two.first
