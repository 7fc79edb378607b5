"""How a flight that cannot go on ends: by its safe end, and how a lost vehicle is followed."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from typing import Literal

from upwash.config.drone import SafeEnd
from upwash.drone.homecoming import Homecoming
from upwash.errors import AutopilotError, AutopilotOverruled
from upwash.eventlog import schema
from upwash.ports import Autopilot, Journal
from upwash.support.background import first

_Action = SafeEnd | Literal["disarm"]
_KEEP_TRYING_S = 600.0  # about what a battery lasts that the mission has already used half of
_PAUSE_S = 2.0


async def end_safely(
    autopilot: Autopilot, action: SafeEnd, journal: Journal, *, why: str, homecoming: Homecoming
) -> None:
    """Commands the vehicle to return and land, to land or to hold, again and again until it obeys.

    A vehicle on the ground is disarmed instead. Returns when the action is done, when the program no longer has the
    vehicle, or after the longest time of trying; the journal records which.
    """
    loop = asyncio.get_running_loop()
    deadline_s = loop.time() + _KEEP_TRYING_S
    told, begun = "", ""
    verbs: Mapping[_Action, tuple[Callable[[], Awaitable[None]], Callable[[], schema.Event]]] = {
        "return": (homecoming.return_and_land, homecoming.landed),
        "land": (homecoming.land, homecoming.landed),
        "hold": (autopilot.hold, schema.LeftHovering),
        "disarm": (autopilot.disarm, schema.Disarmed),
    }
    while loop.time() < deadline_s:
        doing: _Action = "disarm" if autopilot.stands else action
        if doing != begun:
            begun = doing
            journal.record(schema.SafeEnd(action=doing, why=why))
        verb, ended = verbs[doing]
        try:
            await verb()
        except AutopilotOverruled:
            return
        except AutopilotError as error:
            if str(error) != told:  # a lost link fails alike every time
                told = str(error)
                journal.record(schema.SafeEndFailed(action=doing, why=told))
            await asyncio.sleep(_PAUSE_S)
        else:
            journal.record(ended())
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
