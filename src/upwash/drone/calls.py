"""Makes a mission's calls: one at a time, or several at the same time, with an answer at once or later."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from dataclasses import dataclass, field
from functools import partial
from typing import Any, ParamSpec, TypeVar

from upwash.core.operation import Operation
from upwash.drone.answered_photos import AnsweredPhotos
from upwash.drone.mission import MissionThread
from upwash.drone.offloading import Offloading
from upwash.drone.pending import Hearing, OpenCall, Pending
from upwash.errors import UsageError
from upwash.eventlog import schema
from upwash.ports import Journal
from upwash.rpc.service import Method, request_of
from upwash.support.background import end

P = ParamSpec("P")
T = TypeVar("T")


@dataclass(eq=False)
class MissionCalls:
    """Makes the mission's calls, from its thread; `waypoint` returns the drone's waypoint, None off the plan.

    Several may be open at the same time if they stand in line.
    """

    thread: MissionThread
    offloading: Offloading
    journal: Journal
    waypoint: Callable[[], int | None]
    photos: AnsweredPhotos
    # The last one, and others that are not over.
    _started: list[OpenCall] = field(default_factory=list, init=False)

    def call(
        self, operation: Operation, method: Method, request: bytes, arguments: tuple[object, ...]
    ) -> Any:
        """Makes a call and waits for its decoded reply; UsageError while another call is pending."""
        waypoint, run = self._prepared(operation, method, request, urgent=True)
        photo = self.photos.of_call(arguments)
        self.photos.hand_over(photo)

        async def wait() -> Any:
            hearing = self._hearing(waypoint)
            hearing.waits.set()
            return await run(hearing)

        reply = self.thread.call(wait())
        self.photos.answered(getattr(reply, "value", None), photo)
        return reply

    def start(self, call: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> Pending[T]:
        """Makes a call of a service's method with these arguments, and does not wait.

        Raises UsageError while another call is pending, or if `call` is no method of an object from `Drone.service`.
        """
        operation, method, request = request_of(call, args, kwargs)
        waypoint, run = self._prepared(operation, method, request)
        started = OpenCall(
            operation=operation,
            method=method,
            thread=self.thread,
            journal=self.journal,
            photos=self.photos,
            waypoint=waypoint,
            photo=self.photos.of_call((*args, *kwargs.values())),
            is_alone=not self._several,
        )

        def begin() -> None:
            self.journal.record(schema.CallStarted(operation=str(operation), waypoint=waypoint))
            hearing = self._hearing(waypoint)
            started.begin(run(hearing), hearing)

        self._started = [call for call in self._started if not call.is_over] + [started]
        self.thread.post(begin)
        return Pending(started)

    async def close(self) -> None:
        """Ends calls that are still under way; for the loop, after the mission's last call."""
        await end(*(call.task for call in self._started))

    @property
    def _several(self) -> bool:
        return self.offloading.several

    def _prepared(
        self, operation: Operation, method: Method, request: bytes, *, urgent: bool = False
    ) -> tuple[int | None, Callable[[Hearing], Coroutine[Any, Any, Any]]]:
        """The call's waypoint and its work, which waits for the end of a last call that was dropped."""
        self.thread.require_turn()
        last, waypoint = self._started[-1] if self._started else None, self.waypoint()
        after = last if last is not None and last.is_dropped else None
        if not (self._several or last is None or after or last.is_over):
            raise UsageError(
                f"{operation} cannot be called yet: another call is pending, and a drone makes one at a time; take "
                "its answer first, with its result(), or drop it with cancel()"
            )

        async def run(hearing: Hearing) -> Any:
            if after is not None:
                await after.over()
            invoke = partial(self.offloading.invoke, operation, method, request, hearing=hearing)
            return await (invoke(waypoint, urgent=urgent) if self._several else invoke())

        return waypoint, run

    def _hearing(self, waypoint: int | None) -> Hearing:
        def note_first(operation: Operation, delay_s: float) -> None:
            self.journal.record(
                schema.FirstAnswer(waypoint=waypoint, operation=str(operation), delay_s=delay_s)
            )

        return Hearing(note_first)
