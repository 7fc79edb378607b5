"""How a flight that cannot go on ends, and how much longer a return or a landing takes."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from typing import Literal

from upwash.config import SafeEnd
from upwash.core.geo import Position
from upwash.core.vehicle.way_home import UNKNOWN, WayDown
from upwash.errors import AutopilotError, AutopilotOverruled
from upwash.eventlog import schema
from upwash.ports import Autopilot, Journal
from upwash.support.background import first

_Action = SafeEnd | Literal["disarm"]
_ENDED: Mapping[_Action, type[schema.Landed | schema.LeftHovering | schema.Disarmed]] = {
    "return": schema.Landed,
    "land": schema.Landed,
    "hold": schema.LeftHovering,
    "disarm": schema.Disarmed,
}
_KEEP_TRYING_S = 600.0  # about what a battery lasts that the mission has already used half of
_PAUSE_S = 2.0


async def end_safely(autopilot: Autopilot, action: SafeEnd, journal: Journal, *, why: str) -> None:
    """Commands the vehicle to return and land, to land or to hold, again and again until it obeys.

    A vehicle on the ground is disarmed instead. Returns when the action is done, when the program no longer has the
    vehicle, or after the longest time of trying; the journal records which.
    """
    loop = asyncio.get_running_loop()
    deadline_s = loop.time() + _KEEP_TRYING_S
    told, begun = "", ""
    verbs: Mapping[_Action, Callable[[], Awaitable[None]]] = {
        "return": autopilot.return_home_and_land,
        "land": autopilot.land,
        "hold": autopilot.hold,
        "disarm": autopilot.disarm,
    }
    while loop.time() < deadline_s:
        doing: _Action = "disarm" if autopilot.stands else action
        if doing != begun:
            begun = doing
            journal.record(schema.SafeEnd(action=doing, why=why))
        try:
            await verbs[doing]()
        except AutopilotOverruled:
            return
        except AutopilotError as error:
            if str(error) != told:  # a lost link fails alike every time
                told = str(error)
                journal.record(schema.SafeEndFailed(action=doing, why=told))
            await asyncio.sleep(_PAUSE_S)
        else:
            journal.record(_ENDED[doing]())
            return
    why = f"the vehicle has not obeyed for {_KEEP_TRYING_S:.0f} s; only the pilot and its fail-safes can end this"
    journal.record(schema.LeftToPilot(why=why))


async def follow(autopilot: Autopilot, journal: Journal, *, until: asyncio.Event) -> None:
    """Follows a lost vehicle, without a command, until it stands, is silent, or `until` is set."""
    control = autopilot.control
    journal.record(
        schema.LeftToPilot(why=f"{control}; the log continues until the vehicle stands, or Ctrl-C")
    )
    try:
        stopped = await first(autopilot.stood(), until.wait())
    except AutopilotError as error:
        journal.record(schema.FollowingEnded(why=str(error)))
        return
    if stopped:
        journal.record(schema.FollowingEnded(why="the program was stopped"))
    else:
        journal.record(schema.Stood(position=autopilot.position))


ComingDown = Literal["return", "land"]
_HOME = Position(0.0, 0.0)


class Descent:
    """Follows the vehicle's way down; `doing` returns whether the program returns, lands, or does neither."""

    def __init__(self, autopilot: Autopilot, *, doing: Callable[[], ComingDown | None]) -> None:
        self._autopilot = autopilot
        self._doing = doing
        self._begun: ComingDown | None = None
        self._way: WayDown | None = None

    @property
    def left_s(self) -> float | None:
        """Seconds to the ground; None unless the program has the vehicle and brings it down."""
        vehicle = self._autopilot
        doing = self._doing() if vehicle.control.is_ours and not vehicle.stands else None
        if doing != self._begun:
            self._begun, self._way = doing, None if doing is None else self._begin(doing)
        if self._way is None:
            return None
        return self._way.left_s(vehicle.position, now_s=asyncio.get_running_loop().time())

    def _begin(self, doing: ComingDown) -> WayDown:
        facts, here = self._autopilot.energy, self._autopilot.position
        home = None if doing == "land" else facts.home or _HOME
        return WayDown(facts.way_home or UNKNOWN, here, home)
