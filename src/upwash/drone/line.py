"""The line of calls that are open at the same time: one is computed on the drone, and one on a server.

    first in line   the oldest call, or the newest, as configured; a call that the mission waits for comes before all
    its place       where it is expected to be answered soonest (core/selection): it waits until that place is free;
                    the drone, for a call that runs once, and for all calls once deciding has failed
    decided         once its place is free, as any call is; then the next call is first

A place is busy from the decision on until the call is answered, wherever it is computed in the end.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import AsyncIterator, Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Literal

from upwash.core.operation import ON_DRONE, Operation, name_of
from upwash.core.policies.policy import Decision, Remote
from upwash.core.selection.call_placement import Place
from upwash.drone.decisions import Decisions, now_s


@dataclass(frozen=True, slots=True)
class Turn:
    """The turn of a call to be decided; `take` gets the decision, None for the drone without one.

    With `on_drone` only the drone is free for it. `leave` frees its place before the call is answered. `at_server` is
    a block with the server as a further place, for a better answer; `is_next(server, by_s)` tells whether the server
    is free for it, of the calls that it can answer by their times.
    """

    take: Callable[[Decision | None], None]
    on_drone: bool = False
    leave: Callable[[], None] = lambda: None
    is_next: Callable[[str, float], bool] = lambda *_: True
    at_server: Callable[[str], contextlib.AbstractContextManager[object]] = contextlib.nullcontext


AT_ONCE = Turn(lambda _: None)  # of a call that waits for no other


class CallLine:
    """Lets calls be decided one after the other, each once a place is free for it.

    `is_computing(service)` is whether the drone's own service is busy, perhaps with a call that a server answered.
    """

    def __init__(
        self,
        decisions: Decisions,
        is_computing: Callable[[str], bool],
        *,
        first: Literal["oldest", "newest"],
    ) -> None:
        self._decisions = decisions
        self._is_computing = is_computing
        self._first = 0 if first == "oldest" else -1
        self._urgent: list[asyncio.Event] = []  # of each call, set once it is the first
        self._others: list[asyncio.Event] = []
        self._is_deciding = False
        self._placed: dict[object, tuple[str, float]] = {}  # calls, with the place and its expected end
        self._wanted: dict[object, float] = {}  # calls for a better answer, and by when each must be sent
        self._only_on_drone = False

    @contextlib.asynccontextmanager
    async def turn(
        self, operation: Operation, *, urgent: bool, on_drone: bool = False
    ) -> AsyncIterator[Turn]:
        """Enter the line; the block begins when the call may be decided, and ends when it is answered.

        With `on_drone` the call runs nowhere else.
        """
        call, line = asyncio.Event(), self._urgent if urgent else self._others
        line.append(call)
        try:
            while not (free := self._free_place(call, operation, on_drone=on_drone)):
                if call is self._first_in_line:
                    await self._decisions.told()
                else:
                    call.clear()
                    await call.wait()
        finally:
            line.remove(call)
            if self._urgent or self._others:
                self._first_in_line.set()
            self._decisions.wake()  # another is first now
        self._is_deciding = True

        is_placed = False

        def take(decision: Decision | None) -> None:
            nonlocal is_placed
            is_placed = True
            self._placed[call] = self._place(operation, decision)
            self._go_on()

        def leave() -> None:
            self._placed.pop(call, None)
            self._decisions.wake()

        try:
            yield Turn(
                take,
                on_drone=free == "drone",
                leave=leave,
                is_next=partial(self._is_next, call, operation),
                at_server=partial(self._at_server, call, operation),
            )
        finally:
            if not is_placed:
                self._is_deciding = False
            self._wanted.pop(call, None)
            leave()

    def _is_next(self, call: object, operation: Operation, server: str, by_s: float) -> bool:
        """Whether the call is the next for a better answer of the server, which is free."""
        self._wanted[call] = by_s - self._takes_s(server, operation)
        if self._is_deciding or server in self._busy_places:
            return False
        in_time = [wanted for wanted, latest_s in self._wanted.items() if latest_s >= now_s()]
        return bool(in_time) and in_time[self._first] is call

    def _takes_s(self, server: str, operation: Operation) -> float:
        return self._decisions.selection.estimates.remote_s(server, operation) or 0.0

    @contextlib.contextmanager
    def _at_server(self, call: object, operation: Operation, server: str) -> Iterator[None]:
        """The server as the place of a call that the drone has computed, or computes."""
        self._wanted.pop(call, None)
        place = object()
        self._placed[place] = server, now_s() + self._takes_s(server, operation)
        try:
            yield
        finally:
            del self._placed[place]
            self._decisions.wake()

    @property
    def _busy_places(self) -> set[str]:
        return {place for place, _ in self._placed.values()}

    @property
    def _first_in_line(self) -> asyncio.Event:
        return self._urgent[0] if self._urgent else self._others[self._first]

    def keep_on_drone(self) -> None:
        """From now on have every call run on the drone."""
        self._only_on_drone = True
        self._decisions.wake()

    def _free_place(self, call: object, operation: Operation, *, on_drone: bool) -> Place:
        if self._is_deciding or call is not self._first_in_line:
            return ""
        if on_drone or self._only_on_drone:
            return "" if ON_DRONE in self._busy_places or self._is_computing(operation.service) else "drone"
        return self._decisions.free_place(operation, self._busy(operation))

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

    def _busy(self, operation: Operation) -> dict[str, float]:
        busy = dict(self._placed.values())
        if ON_DRONE not in busy and self._is_computing(operation.service):
            local_s = self._decisions.selection.estimates.local_s(self._computed(operation))
            busy[ON_DRONE] = now_s() + (local_s or 0.0)
        return busy

    def _computed(self, operation: Operation) -> Operation:
        """What the drone computes of a call of the operation."""
        two = self._decisions.two_answers(operation)
        return operation if two is None else two.first
