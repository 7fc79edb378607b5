"""When the core is asked to look at servers again, on virtual time; the test says when something can have changed."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable, Sequence
from typing import Any

from upwash.core.geo import Circle
from upwash.core.selection.events import Tick
from upwash.drone.looks import Looks
from upwash.errors import AutopilotLost
from upwash.eventlog import schema
from upwash.sim.loop import run_virtually

PERIOD_S = 2.0


class Field:
    """The core, the vehicle and the journal."""

    def __init__(self) -> None:
        self.next_s = math.inf
        self.ticks_s: list[float] = []
        self.silences_s: list[float] = []
        self.borders: asyncio.Queue[Exception | None] = asyncio.Queue()
        this: Any = self
        self.looks = Looks(
            self.tell, lambda: self.next_s, [], period_s=PERIOD_S, autopilot=this, journal=this
        )

    def tell(self, event: object) -> None:
        assert event == Tick()
        self.ticks_s.append(now_s())
        self.looks.set_alarm()

    async def border_crossed(self, areas: Sequence[Circle]) -> None:
        if (error := await self.borders.get()) is not None:
            raise error

    def record(self, event: object) -> None:
        assert isinstance(event, schema.BorderWatchFailed)
        self.silences_s.append(now_s())


def now_s() -> float:
    return asyncio.get_running_loop().time()


def run(story: Callable[[Field], Awaitable[None]]) -> None:
    async def both() -> None:
        field = Field()
        tasks = [
            asyncio.create_task(field.looks.look()),
            asyncio.create_task(field.looks.watch_borders()),
        ]
        await asyncio.sleep(0.5)
        await story(field)
        assert not any(task.done() for task in tasks)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    run_virtually(both())


def test_it_looks_at_the_end_of_the_period_in_which_something_can_change() -> None:
    async def story(field: Field) -> None:
        await asyncio.sleep(100.0)
        assert field.ticks_s == [0.0], "nothing can change"
        field.next_s = 105.3
        field.looks.set_alarm()
        await asyncio.sleep(10.0)
        assert field.ticks_s[:2] == [0.0, 106.0]
        assert field.ticks_s[2:] == [108.0, 110.0], "what can change already has each period"
        field.next_s = math.inf
        field.looks.set_alarm()
        await asyncio.sleep(10.0)
        assert len(field.ticks_s) == 4

    run(story)


def test_it_looks_at_once_after_a_server_was_left() -> None:
    async def story(field: Field) -> None:
        field.looks.again.set()
        await asyncio.sleep(0.1)
        field.next_s = 1.0
        field.looks.set_alarm()
        await asyncio.sleep(2.0)
        assert field.ticks_s == [0.0, 0.5, 2.5], "periods count from the last look"

    run(story)


def test_a_border_is_told_at_once_and_a_silent_vehicle_may_cross_it_unseen() -> None:
    async def story(field: Field) -> None:
        field.borders.put_nowait(None)
        await asyncio.sleep(0.1)
        assert field.ticks_s == [0.0, 0.5]
        for _ in range(3):
            field.borders.put_nowait(AutopilotLost("watch", "silent"))
        await asyncio.sleep(3 * PERIOD_S)
        assert field.silences_s == [0.6]
        assert field.ticks_s[2:] == [2.0, 4.0, 6.0]
        await asyncio.sleep(1.0)
        field.borders.put_nowait(None)
        await asyncio.sleep(10.0)
        assert field.ticks_s[5:] == [7.6]
        field.borders.put_nowait(AutopilotLost("watch", "silent"))
        await asyncio.sleep(0.1)
        assert field.silences_s == [0.6, 17.6]

    run(story)
