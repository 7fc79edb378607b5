"""How a flight ends that cannot go on."""

from __future__ import annotations

import asyncio

from upwash.config import SafeEnd
from upwash.errors import AutopilotError, AutopilotOverruled
from upwash.ports import Autopilot, Journal

_KEEP_TRYING_S = 600.0  # about what a battery lasts that the mission has already used half of
_PAUSE_S = 2.0
_LOOK_S = 1.0
_SILENT_LOOKS = 10  # the battery is among the last things that a vehicle reports after a start


async def end_safely(autopilot: Autopilot, action: SafeEnd, journal: Journal, *, why: str) -> None:
    """Has the vehicle return and land, land or hold, again and again while it does not obey.

    Returns when that is so, when the pilot or a fail-safe has taken over, or when it has tried for long enough;
    the journal tells which.
    """
    journal.record("safe_end", action=action, why=why)
    loop = asyncio.get_running_loop()
    deadline_s = loop.time() + _KEEP_TRYING_S
    told = ""
    while loop.time() < deadline_s:
        try:
            await _carry_out(action, autopilot)
        except AutopilotOverruled as error:
            journal.record("left_to_pilot", why=str(error))
            return
        except AutopilotError as error:
            if str(error) != told:  # a lost link fails alike every time
                told = str(error)
                journal.record("safe_end_failed", action=action, why=told)
            await asyncio.sleep(_PAUSE_S)
        else:
            journal.record("left_hovering" if action == "hold" else "landed")
            return
    why = f"the vehicle has not obeyed for {_KEEP_TRYING_S:.0f} s; only the pilot and its fail-safes can end this"
    journal.record("left_to_pilot", why=why)


async def reserve_reached(autopilot: Autopilot, reserve_percent: float, journal: Journal) -> float:
    """Returns what is left in the battery once that is less than the reserve."""
    silent = 0
    while True:
        percent = autopilot.battery_percent
        if percent is not None and percent < reserve_percent:
            return percent
        silent += percent is None
        if silent == _SILENT_LOOKS:
            journal.record("battery_watch_failed", why="the vehicle does not report its battery")
        await asyncio.sleep(_LOOK_S)


async def _carry_out(action: SafeEnd, autopilot: Autopilot) -> None:
    match action:
        case "return":
            await autopilot.return_home_and_land()
        case "land":
            await autopilot.land()
        case "hold":
            await autopilot.hold()
