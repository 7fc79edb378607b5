"""How defects are planted in the programs for a while; `DEFECTS` has all that were declared, in their order."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial, wraps
from typing import Any
from unittest.mock import patch

Planting = contextlib.AbstractContextManager[object]


@dataclass(frozen=True, slots=True)
class Defect:
    """What is wrong, and how it is put into the programs for a while."""

    what: str
    plant: Callable[[], Planting]


DEFECTS: list[Defect] = []

# By `python -m tests.sim.planted`; a search from 1 would spend minutes in worlds that keep their promises.
FOUND_BY_SEED = {
    "a server with a call of the drone overtakes another": 529,
    "a free place takes the last call of the line": 30,
    "a queue counts as a failure": 185,
    "a resting drone flies from range to range": 405,
    "every call has the patience of a first one": 133,
    "a drone is served after its turn": 34,
    "a drone without a slot asks without pause": 10,
    "services that nobody wants are dialled": 224,
    "a silent vehicle ends the watch over ranges": 45,
    "an autopilot that restarted is flown on": 179,
    "a restart is taken for the pilot's act": 45,
    "a failed server is probed without pause": 99,
    "an instance of no use is never replaced": 59,
    "calls go to the server in preparation": 273,
    "a transition of the server table is skipped": 338,
    "turns never end": 431,
    "a slot is held until the drone comes": 301,
    "a drone has several slots held at a time": 301,
    "a slot is held for a server that is no peer": 825,
    "an arrival counts though the position jumped": 96,
    "a restart on the ground ends the flight": 1307,
    "another program's heartbeat is believed": 237,
    "hedging has no budget": 374,
    "the bounds of a reply's fields are not checked": 99,
    "a lease may be as short as a server likes": 99,
    "what a server says was raised is logged as it is": 176,
    "a failed server is probed only once": 1313,
    "a server that keeps failing is not left alone for longer": 173,
    "a service that does not start is tried without pause": 229,
    "a drone ignores the pause that a server names": 217,
    "a photo whose demand was met is taken again": 1109,
    "the first answer counts where a better one came": 1053,
    "the demand of a better answer is not met": 1053,
    "the demand of each of two answers is met": 109,
    "an instance that only servers run starts on the drone": 45,
    "a call waits beyond the deadline that the mission chose": 146,
    "a call that no server answered is not in the log": 89,
    "a call that was answered ends without an answer too": 45,
    "a part that fails is tried for ever": 133,
    "a server that was left meanwhile gets the smaller request": 2280,
    "a second server gets a call before it is ready": 14,
    "a server that failed gets a call without a trial": 85,
    "altitudes follow a home that is moved": 96,
    "a part takes as long as it likes": 73,
    "a call fails with its part": 73,
    "a part changes the types of arguments": 73,
    "a call that the mission waits for joins the line": 105,
    "the drone sets off for home with open answers": 37,
    "the line is left from its other end": 37,
    "the line knows no busy place": 37,
    "a spot that was passed during a call is not flown back to": 37,
    "on a row a spot counts however far beside it the drone passes": 212,
    "on a row a spot counts in doubt of the position": 212,
    "of several demands on a row one is met": 37,
    "on a row an action is done where the drone is": 37,
    "an act that was put off is forgotten": 37,
    "an act is put off to where it costs more": 37,
    "every landing is said to be at home": 48,
    "the way home counts as one to home alone": 48,
    "the time until a hover is seen is not counted": 152,
    "the first battery alone counts": 129,
    "each finding of an object has an act": 61,
    "an act on an object is done at the waypoint of its photo": 61,
    "findings are placed by the last photo": 85,
    "the user gets all answers at the end of the way": 61,
    "a server that was found stopped counts as running, and nothing bounds the pace of selections": 1394,
}


def plant(what: str, target: object, name: str, stand_in: object) -> None:
    """A defect: the stand-in takes the place of the target's attribute."""
    DEFECTS.append(Defect(what, partial(patch.object, target, name, stand_in)))


def planted(what: str, target: object, name: str) -> Callable[[Callable[..., Any]], Callable[[], Planting]]:
    """A defect: the decorated function takes the place of the target's, and gets that one first."""

    def put(stand_in: Callable[..., Any]) -> Callable[[], Planting]:
        original = getattr(target, name)

        @wraps(stand_in)
        def called(*arguments: Any, **more: Any) -> Any:
            return stand_in(original, *arguments, **more)

        plant(what, target, name, called)
        return DEFECTS[-1].plant

    return put


def planting(what: str) -> Callable[[Callable[[], Planting]], None]:
    """A defect: the decorated function plants it."""
    return lambda plants: DEFECTS.append(Defect(what, plants))
