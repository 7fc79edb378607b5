"""Rows that the drone flies without stopping, while answers to earlier photos are open; in the mission's thread.

    a row        One leg from its first spot to its end. The drone passes the other spots.
    its end      The drone sets off for the next waypoint of the plan, while the mission looks at the photo.
    a demand     (several.py) After the act the drone flies on from where it began to brake, or along the row of its
                 last action. The drone rests at a waypoint for an act that was put off.
    other verbs  The drone brakes, and comes back to the last spot. Before most verbs every answer is in.
    a doubt      While the vehicle is not sure of its position no spot counts. It flies back to a spot that it passed
                 meanwhile, or too far beside, and then sets off from there.

With `policy.stay_or_go = "learn"` the drone rests at the next spot and waits for the answer, where frequent demands
make that faster.

A plan that stops at each waypoint is flown the same way if the mission calls a service that only servers run. Then
each leg ends at rest, and the drone leaves a waypoint as the mission says.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from msgspec.structs import asdict

from upwash.core.geo import Position, Via, Waypoint, distance_m, first_on_way
from upwash.core.planning.stay_or_go import RowOutlook, StayVerdict
from upwash.drone.answers import AnswerAction
from upwash.drone.late_acts import Onwards
from upwash.drone.pending import Demand
from upwash.drone.places import Place, lies_on, position_of
from upwash.drone.several import Several
from upwash.eventlog import schema

_IN_TIME = 2  # open answers, at most, of a drone whose answers come before the next photos


@dataclass(kw_only=True, eq=False)
class Rows(Several):
    """Flies a plan of rows."""

    _leg_m_s: float | None = field(default=None, init=False)
    _rest: Position | None = field(default=None, init=False)  # on the row, as demands are frequent there

    def goto(self, place: Place, *, unless: Demand[Any] | None = None) -> bool:
        """Fly to a place, or on along a row until it is passed; with `unless` from rest to rest."""
        if unless is not None:
            self._fly_over(place)
            self.stop()
            return self.fly_unless(place, unless)
        if self._acts:
            self.fly(place)
            return True
        self._before_leaving(place)
        flown = self._fly_over(place)
        ends = position_of(place), self._rest, place.row_end if isinstance(place, Waypoint) else None
        if self._end not in ends or not self.legs.passes(place):
            self.stop()
        if self._end is None:
            self.fly_around(position_of(place))
            end = None if self._stays else self._end_of_leg(place)
            speed_m_s = place.ground_speed_m_s if isinstance(place, Waypoint) else None
            self._set_off(end or position_of(place), speed_m_s)
        notes = self.legs.turn if flown else self.legs.head_for
        self.thread.post(partial(notes, place))
        self._reach(place, partial(self.legs.fly_on, place, self._open), partial(self.legs.head_for, place))
        self._last = place if isinstance(place, Waypoint) else self._last
        if self._end == position_of(place) or self.legs.rests:
            self._end, self._left_at = None, position_of(place)
            self._stays = isinstance(place, Waypoint) and self._rests_at(place)
            hold_s = place.hold_s if isinstance(place, Waypoint) else 0.0
            if not (self._stays or hold_s or self.rests or self.late.waits_after(place)):
                self._set_off_for_next(place)
            if self._end is None:
                self._arrive(hold_s)
        return True

    def leave(self) -> None:
        """Fly to the places after the last waypoint; not to return when there was no photo left to take."""
        site = self.legs.site
        for via in site.leaving if site.waypoints or site.ending == "land" else ():
            fly_on = partial(self.legs.fly_on, via.position, self._open)
            self._fly_to(via, fly_on, partial(self.legs.head_for, via.position))

    def _fly_over(self, place: Place) -> bool:
        """Fly to the places without a photo on the way to a waypoint from the one before; False if there are none."""
        if not isinstance(place, Waypoint) or self._acts:
            return False
        if self._last is not None and self._following.get(self._last) != place:
            return False
        for number, via in enumerate(place.via):
            notes = self.legs.turn if number else self.legs.head_for
            fly_on = partial(self.legs.fly_through, via.position, self._open)
            self._fly_to(via, fly_on, partial(notes, place, place.via[number:]))
        return bool(place.via)

    def _fly_to(
        self, via: Via, fly_on: Callable[[], Coroutine[Any, Any, bool]], notes: Callable[[], None]
    ) -> None:
        position = via.position
        if self._end != position or not self.legs.passes(position):
            self.stop()
        if self._end is None:
            self.fly_around(position)
            self._set_off(position, via.ground_speed_m_s)
        self.thread.post(notes)
        self._reach(position, fly_on, notes)
        self._end, self._left_at = None, position
        if via.hold_s:
            self._arrive(via.hold_s)

    def _arrive(self, hold_s: float) -> None:
        self.thread.call(self.legs.arrive())
        if hold_s:
            self.thread.call(asyncio.sleep(hold_s))

    def _reach(
        self, place: Place, fly_on: Callable[[], Coroutine[Any, Any, bool]], goes_on: Callable[[], None]
    ) -> None:
        """Fly on until the place is passed, or fly back to it; meet the demands that come meanwhile."""
        if due := self._due(self._onwards(place)):
            self._detour(due, place, goes_on)
        while not self.thread.call(fly_on()):
            if demanding := self._wanted_now(self._onwards(place), self._taken()):
                self._detour(demanding, place, goes_on)
            elif not self.legs.passes(place):
                self._fly_back(place)
                return

    def _before_leaving(self, place: Place) -> None:
        if due := self.late.due_after(self._last):
            self.stop()  # behind a last spot that is not the row's end
            self._open += due
            self.meet(due, self._onwards(place))
        if not (self.asks_servers and self._open and isinstance(place, Waypoint)):
            return
        here = self.legs.position
        if self.thread.call(self.seeking.leads_away(place)):
            self.stop()
            self.thread.call(self.seeking.wait_here(here))
        onwards = self._onwards(place)
        if self._end is None and (demanding := self._wanted_now(onwards, self._taken())):
            self.meet(demanding, onwards)

    def _set_off(self, end: Position, ground_speed_m_s: float | None) -> None:
        self.thread.call(self.legs.set_off(end, ground_speed_m_s))
        self._end, self._leg_m_s = end, ground_speed_m_s

    def _set_off_for_next(self, place: Place) -> None:
        """Set off along the row for its last spots, or for the next waypoint of the plan."""
        following = self._following.get(place) if isinstance(place, Waypoint) else None
        if following is None:
            return
        first = first_on_way(following)
        end = (None if following.via else self._end_of_leg(following)) or first.position
        if not self.legs.site.way or self.legs.allows(position_of(place), end):
            self._set_off(end, first.ground_speed_m_s)

    def _row_end_from_here(self, place: Waypoint) -> Position | None:
        """The end of the place's row, if the drone is on that row, and passes the place on its way there."""
        if place.row_start is not None and place.row_start == self._left_at:
            return place.row_end
        last = self.legs.place
        if not isinstance(last, Waypoint) or place.row_end is None:
            return None
        is_on_row = last.row_end == place.row_end and lies_on(place.position, last.position, place.row_end)
        here, end = self.legs.position, place.row_end
        is_ahead = distance_m(here, end) >= distance_m(place.position, end)
        return end if is_on_row and is_ahead and lies_on(place.position, here, end) else None

    def _end_of_leg(self, place: Place) -> Position | None:
        """The end of the place's row, or the first spot on the way where the drone rests for acts or their demands.

        None if the drone does not pass the place on its way there.
        """
        self._rest = None
        if not isinstance(place, Waypoint):
            return None
        end = self._row_end_from_here(place)
        spot: Waypoint | None = place
        while end is not None and spot is not None and spot.row_end == end:
            if self.late.waits_after(spot) or self._is_often_demanded(spot):
                self._rest = spot.position
                return self._rest
            spot = self._following.get(spot)
        return end

    def _is_often_demanded(self, spot: Waypoint) -> bool:
        if self.rule.demand_map is None:
            return False
        verdict = self._verdict(spot, rests_anyway=False)
        return verdict is not None and not verdict.goes

    def _rests_at(self, spot: Waypoint) -> bool:
        verdict = self._verdict(spot, rests_anyway=spot.position == spot.row_end)
        if verdict is None:
            return False
        self._note(schema.StayOrGo(waypoint=spot.index, **asdict(verdict)))
        return not verdict.goes

    def _verdict(self, spot: Waypoint, *, rests_anyway: bool) -> StayVerdict | None:
        """Whether to fly on from the spot before its answer; None where the drone does in any case."""
        rule = self.rule
        if rule.manner != "learn" or rule.answer_s is None or spot not in self._following:
            return None
        if self.unheard > _IN_TIME:  # late answers share detours, which cost less
            return None
        outlook = RowOutlook(
            self.config.mission.ground_speed_m_s,
            self.seeking.reserve.pace.acceleration_m_s2,
            rule.answer_s,
            self.config.camera.photo_s,
            rests_anyway=rests_anyway,
        )
        return rule.decide(outlook, spot.position)

    def _fly_back(self, spot: Place) -> None:
        end = self._end
        assert end is not None  # noqa: S101 - a leg is flown
        self.stop()
        self.fly_around(position_of(spot))
        self.fly(spot)
        if position_of(spot) != end:
            self._set_off(end, self._leg_m_s)

    def _onwards(self, place: Place) -> Onwards:
        ahead = position_of(place) if self._end in (None, position_of(place)) else self.legs.left()
        return Onwards(place, ahead, self._end, rests=self._end is None)

    def _detour(self, demanding: list[AnswerAction[Any]], place: Place, goes_on: Callable[[], None]) -> None:
        end, left, spot, onwards = self._end, self.legs.left(), position_of(place), self._onwards(place)
        assert end is not None  # noqa: S101 - a leg is flown
        self.stop()
        last = self.meet(demanding, onwards._replace(rests=True))
        ahead = left if spot == end else spot
        is_on_row = last is not None and lies_on(ahead, position_of(last), end)
        if (spot != end or self.legs.site.way) and not is_on_row:
            self.fly_around(left)
            self.fly(left)
        self._set_off(end, self._leg_m_s)
        self.thread.post(goes_on)
