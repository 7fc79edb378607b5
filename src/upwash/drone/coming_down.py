"""Lands the vehicle: as the mission says, or by the safe end of a flight that cannot go on.

A return may end in a hover, as its parameters say or as its reports show: then the program lands the vehicle.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable, Mapping
from typing import Literal

from upwash.config.drone import SafeEnd
from upwash.core.geo import ground_distance_m, rounded
from upwash.core.vehicle.return_place import AT_PLACE_M
from upwash.core.vehicle.return_watch import ReturnWatch
from upwash.core.vehicle.way_home import UNKNOWN, WayDown
from upwash.errors import AutopilotError, AutopilotOverruled
from upwash.eventlog import schema
from upwash.ports import Autopilot, ComingDown, Journal
from upwash.support.background import first, now_s

_Action = SafeEnd | Literal["disarm"]
_KEEP_TRYING_S = 600.0  # about what a battery lasts that the mission has already used half of
_PAUSE_S = 2.0
_LOOK_S = 1.0
_SAME_RETURN_S = 5.0  # after the last look: a safe end goes on with the mission's return
_TELL_AGAIN_S = 60.0
_ON_GROUND_M = 1.0  # a hover is higher


class Homecoming:
    """Returns and lands one vehicle; `doing` is what the program does of both now, or None."""

    def __init__(self, autopilot: Autopilot, journal: Journal) -> None:
        self.doing: ComingDown | None = None
        self._autopilot = autopilot
        self._journal = journal
        self._way: WayDown | None = None
        self._watch: ReturnWatch | None = None
        self._looked_s = self._told_s = -math.inf
        self._lands_return = False  # as it hovers
        self._hurries = False

    @property
    def left_s(self) -> float | None:
        """Seconds to the ground; None unless the program brings its vehicle down, and it still comes nearer."""
        vehicle = self._autopilot
        if self._way is None or self.doing is None or vehicle.stands or not vehicle.control.is_ours:
            return None
        if self.doing == "return" and self._watch is not None and self._watch.no_nearer_s:
            return None
        return self._way.left_s(vehicle.position, now_s=now_s()) or None

    async def return_and_land(self) -> None:
        """Returns on touchdown; raises AutopilotError as the autopilot's verbs do."""
        watch = self._begin_return()
        try:
            if not self._lands_return:
                if not await first(self._autopilot.return_home_and_land(), self._look(watch)):
                    return
                self._tell_hover(watch)
            self._lands_return = True
            self._begin_landing()
            await self._autopilot.land()
        finally:
            self.doing, self._looked_s = None, now_s()

    async def land(self) -> None:
        """Lands where the vehicle is; returns on touchdown, raises AutopilotError."""
        self._watch = None
        self._begin_landing()
        try:
            await self._autopilot.land()
        finally:
            self.doing = None

    def hurry(self, why: str) -> None:
        """Lands a vehicle that hovers without a further wait, as the battery has reached the reserve."""
        if not self._hurries:
            self._hurries = True
            self._journal.record(schema.ReserveOnTheWayDown(why=why))
        if self._watch is not None:
            self._watch.hurries = True

    def landed(self) -> schema.Landed:
        """The event of a vehicle that has landed here; in doubt of its position without a name of the place."""
        here, facts = self._autopilot.position, self._autopilot.energy
        if not self._autopilot.position_is_sure:
            return schema.Landed(position=rounded(here))
        away_m = None if facts.home is None else round(ground_distance_m(here, facts.home), 1)
        place = facts.returns_to(here)
        near = facts.home is not None and ground_distance_m(here, place.position) <= AT_PLACE_M
        at_home = away_m is not None and away_m <= AT_PLACE_M
        name = "home" if at_home else place.name if near else ""
        return schema.Landed(position=rounded(here), at=name, from_home_m=away_m)

    def _begin_return(self) -> ReturnWatch:
        self.doing = "return"
        if self._watch is not None and now_s() - self._looked_s <= _SAME_RETURN_S:
            return self._watch
        facts, here = self._autopilot.energy, self._autopilot.position
        place = facts.returns_to(here)
        way = facts.way_to(place)
        self._way = WayDown(way, here, place.position)
        known = facts.way_home is not None and not facts.guessed
        self._watch = ReturnWatch(way, place, here, now_s=now_s(), known=known)
        self._lands_return, self._hurries, self._told_s = False, False, -math.inf
        return self._watch

    def _begin_landing(self) -> None:
        self.doing = "land"
        facts = self._autopilot.energy
        self._way = WayDown(facts.way_home or UNKNOWN, self._autopilot.position, None)

    async def _look(self, watch: ReturnWatch) -> bool:
        """Return True once the return hovers while the vehicle is the program's; tell a return that is in vain."""
        while not (watch.hovers and self._autopilot.control.is_ours):
            self._looked_s = now_s()
            watch.take(self._autopilot.position, self._looked_s)
            if watch.no_nearer_s and self._looked_s - self._told_s >= _TELL_AGAIN_S:
                self._told_s = self._looked_s
                away_m, for_s = round(watch.away_m, 1), round(watch.no_nearer_s, 1)
                self._journal.record(schema.NoNearer(to=watch.place.name, away_m=away_m, for_s=for_s))
            await asyncio.sleep(_LOOK_S)
        return True

    def _tell_hover(self, watch: ReturnWatch) -> None:
        here, where = rounded(self._autopilot.position), watch.place.name
        hovers = f"hovers {here.altitude_m:.0f} m above {where}"
        if here.altitude_m < _ON_GROUND_M:
            why = f"the vehicle rests at the height of {where} and does not report its landing"
        elif watch.hurries:
            why = f"the vehicle's return {hovers}, and the reserve is used up"
        else:
            why = f"the vehicle's return does not land: it {hovers}"
        self._journal.record(schema.ReturnHovers(why=why, position=here))


async def end_safely(
    autopilot: Autopilot, action: SafeEnd, journal: Journal, *, why: str, homecoming: Homecoming
) -> None:
    """Commands the vehicle to return and land, to land or to hold, again and again until it obeys.

    A vehicle on the ground is disarmed instead. Returns when the action is done, when the program no longer has the
    vehicle, or after the longest time of trying; the journal records which.
    """
    deadline_s, told, begun = now_s() + _KEEP_TRYING_S, "", ""
    verbs: Mapping[_Action, tuple[Callable[[], Awaitable[None]], Callable[[], schema.Event]]] = {
        "return": (homecoming.return_and_land, homecoming.landed),
        "land": (homecoming.land, homecoming.landed),
        "hold": (autopilot.hold, schema.LeftHovering),
        "disarm": (autopilot.disarm, schema.Disarmed),
    }
    while now_s() < deadline_s:
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
