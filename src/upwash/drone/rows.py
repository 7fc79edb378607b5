"""Rows that the drone flies without stopping, while answers to earlier photos are open; in the mission's thread.

    a row        One leg from its first spot to its end. The drone passes the other spots.
    its end      The drone sets off for the next waypoint of the plan, while the mission looks at the photo.
    an answer    Without a demand it is taken, while the drone flies on.
    a demand     The drone brakes, flies back and acts. Demands that are there by then are one detour, the nearest
                 first. Then the drone flies on from where it began to brake, or along the row of its last action.
                 An act that costs less further on is put off (late_acts.py): the drone rests at a waypoint for it.
    too many     With too many open answers the drone brakes and waits.
    other verbs  The drone brakes, and comes back to the last spot. Before most verbs every answer is in.
    a doubt      While the vehicle is not sure of its position no spot counts. It flies back to a spot that it passed
                 meanwhile, or too far beside, and then sets off from there.

With `policy.stay_or_go = "learn"` the drone rests at the next spot and waits for the answer, where frequent demands
make that faster.

A plan that stops at each waypoint is flown the same way if the mission calls a service that only servers run. Then
each leg ends at rest, and the drone leaves a waypoint as the mission says. The drone waits for the service's answers
where they come soon, and leaves them open elsewhere (server_calls.py). At the end it stops for calls that wait
(seeking.py).
"""

from __future__ import annotations

import asyncio
import itertools
import math
from collections.abc import Callable, Coroutine, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

from msgspec.structs import asdict

from upwash.core.geo import Position, Via, Waypoint, distance_m, part_way
from upwash.core.planning.stay_or_go import RowOutlook, StayRule, StayVerdict
from upwash.drone.late_acts import LateActs, Onwards
from upwash.drone.mission import MissionThread
from upwash.drone.pending import AnswerAction, Place, one_answered, position_of
from upwash.drone.seeking import Seeking
from upwash.drone.server_calls import ServerCalls
from upwash.eventlog import schema
from upwash.ports import Autopilot, Journal

_IN_TIME = 2  # open answers, at most, of a drone whose answers come before the next photos
_LEAST_S = 0.005  # between two looks at the position: 4 cm at 8 m/s
_FASTER = 1.25  # a vehicle may exceed the speed of its leg: a PX4 flew 4.4 m/s for 4
_THERE_M = 1.0  # from a photo's place, at rest
_BESIDE_M = 2.0  # by wind and GPS
_LATER = 2.0  # times what an answer is expected to take that the drone waits for
_LATE_M, _LATE_S = 1.0, 0.5  # a spot that was passed by more, at the speed of the row, is flown back to
_NEAR_M = 4.0  # of a spot that counts: an arrival is promised within 5 m, and a report may be a metre off
_UNSURE_S = 0.1  # between two looks while the position is in doubt


def lies_on(spot: Position, start: Position, end: Position) -> bool:
    """Whether a leg from the start to the end passes the spot."""
    length_m, from_start_m = distance_m(start, end), distance_m(start, spot)
    if length_m == 0:
        return from_start_m <= _BESIDE_M
    along_m = ahead_m(spot, start, start=start, end=end)
    beside_m = math.sqrt(max(0.0, from_start_m**2 - along_m**2))
    return beside_m <= _BESIDE_M and -_BESIDE_M <= along_m <= length_m + _BESIDE_M


def ahead_m(spot: Position, here: Position, *, start: Position, end: Position) -> float:
    """How far ahead the spot is from here, along the way from the start to the end; negative if it was passed."""
    return (
        (end.east_m - start.east_m) * (spot.east_m - here.east_m)
        + (end.north_m - start.north_m) * (spot.north_m - here.north_m)
        + (end.altitude_m - start.altitude_m) * (spot.altitude_m - here.altitude_m)
    ) / distance_m(start, end)


def is_missed(spot: Position, here: Position, *, start: Position, end: Position, speed_m_s: float) -> bool:
    """Whether a vehicle with this speed has passed a spot of a leg too far away, or is too far beyond it by now."""
    beyond_m = -ahead_m(spot, here, start=start, end=end)
    is_late = beyond_m > max(_LATE_M, _LATE_S * speed_m_s)
    return is_late or (beyond_m >= 0 and is_far(spot, here))


def is_far(spot: Position, here: Position) -> bool:
    """Whether the spot is too far from here to count as reached, altitude included."""
    return distance_m(here, spot) > _NEAR_M


def nearest_on(start: Position, end: Position, here: Position) -> Position:
    """The place of a leg that is nearest to here."""
    length_m = distance_m(start, end)
    if length_m == 0:
        return end
    left_m = ahead_m(end, here, start=start, end=end)
    return part_way(start, end, min(1.0, max(0.0, 1 - left_m / length_m)))


async def passed(
    autopilot: Autopilot, spot: Position, *, start: Position, end: Position, fastest_m_s: float
) -> None:
    """Return when the vehicle, sure of its position, has passed the spot from `start` to `end`.

    It flies at `fastest_m_s` at most.
    """
    while True:
        left_m = ahead_m(spot, autopilot.position, start=start, end=end)
        if left_m <= 0 and autopilot.position_is_sure:
            return
        velocity = autopilot.telemetry.velocity
        speed_m_s = max(fastest_m_s, velocity.speed_m_s if velocity else 0.0)
        ahead_s = left_m / (_FASTER * speed_m_s)
        await asyncio.sleep(max(_LEAST_S, ahead_s) if left_m > 0 else _UNSURE_S)


class LegVerbs(Protocol):
    """What flying rows does with the vehicle; the coroutines run on the loop."""

    def position(self) -> Position:
        """Where it is."""

    def left(self) -> Position:
        """The place of the last leg that is nearest to where it is."""

    def place(self) -> Place | None:
        """Where it was last sent to."""

    def fly(self, place: Place, *, back: bool = False) -> bool:
        """Fly to a place, from rest to rest."""

    def allows(self, start: Position, target: Position) -> bool:
        """Whether no fence forbids the straight way."""

    async def set_off(self, end: Position, ground_speed_m_s: float | None = None) -> None:
        """Set off for the end of a leg, and do not wait for the arrival."""

    def passes(self, place: Place) -> bool:
        """Whether the leg that is flown passes the place, or has just passed it; True too in doubt of its place."""

    def rests(self) -> bool:
        """Whether the last leg is over."""

    def head_for(self, place: Place, via: tuple[Via, ...] = ()) -> None:
        """Note that the place is the next one on the leg, or on those over `via`."""

    def turn(self, place: Place, via: tuple[Via, ...] = ()) -> None:
        """Note that the next leg on the way to the place begins."""

    async def fly_on(self, place: Place, answers: Sequence[AnswerAction[Any]]) -> bool:
        """Return True where it passes the place, or rests there at the end of the leg.

        Return False when one of the answers is there, or when it has missed the place.
        """

    async def fly_through(self, position: Position, answers: Sequence[AnswerAction[Any]]) -> bool:
        """As `fly_on`, of a place that is none of the mission's."""

    async def arrive(self) -> None:
        """Wait until it rests at the end of the leg."""

    async def stop(self) -> None:
        """Brake and end the leg, or fly it to its end if that is nearer."""


@dataclass(frozen=True, slots=True)
class RowRules:
    """When a drone stops on its rows: with `at_most` open answers, and where the rule finds that this saves time.

    If it `rests`, it stops at each waypoint. `seeking` finds stops where servers answer. `servers` are the calls that
    only servers compute, None if the mission has no service of servers alone.
    """

    at_most: int
    stay_or_go: StayRule
    ground_speed_m_s: float
    acceleration_m_s2: float
    photo_s: float
    seeking: Seeking
    rests: bool = False
    servers: ServerCalls | None = None


class Rows:
    """Flies a plan of rows, and meets the demands of answers meanwhile."""

    def __init__(
        self,
        vehicle: LegVerbs,
        thread: MissionThread,
        journal: Journal,
        *,
        plan: Sequence[Waypoint],
        way: Sequence[Position] = (),
        rules: RowRules,
        late: LateActs,
    ) -> None:
        self._vehicle = vehicle
        self._thread = thread
        self._journal = journal
        self._following = dict(itertools.pairwise(plan))
        self._rules = rules
        self._late = late
        self._open: list[AnswerAction[Any]] = []
        self._end: Position | None = None  # of the leg that is flown
        self._leg_m_s: float | None = None
        self._last: Waypoint | None = None  # that the mission flew to
        self._way = way  # where a ground station's plan turns
        self._left_at: Position | None = None  # where the last leg ends, if nothing else was flown since
        self._stays = False  # at rest, until its answer is there
        self._rest: Position | None = None  # on the row, as demands are frequent there
        self._acts = False

    @property
    def rests_always(self) -> bool:
        """Whether the drone stops at each waypoint."""
        return self._rules.rests

    def goto(self, place: Place) -> None:
        """Fly to a place, or on along a row until it is passed."""
        if self._acts:
            self._vehicle.fly(place)
            return
        self._before_leaving(place)
        flown = self.fly_over(place)
        ends = position_of(place), self._rest, place.row_end if isinstance(place, Waypoint) else None
        if self._end not in ends or not self._vehicle.passes(place):
            self.stop()
        if self._end is None:
            self.fly_around(position_of(place))
            end = None if self._stays else self._end_of_leg(place)
            speed_m_s = place.ground_speed_m_s if isinstance(place, Waypoint) else None
            self._set_off(end or position_of(place), speed_m_s)
        notes = self._vehicle.turn if flown else self._vehicle.head_for
        self._thread.post(partial(notes, place))
        self._reach(
            place,
            partial(self._vehicle.fly_on, place, self._open),
            partial(self._vehicle.head_for, place),
        )
        self._last = place if isinstance(place, Waypoint) else self._last
        if self._end == position_of(place) or self._vehicle.rests():
            self._end, self._left_at = None, position_of(place)
            self._stays = isinstance(place, Waypoint) and self._rests_at(place)
            hold_s = place.hold_s if isinstance(place, Waypoint) else 0.0
            if not (self._stays or hold_s or self._rules.rests or self._late.waits_after(place)):
                self._set_off_for_next(place)
            if self._end is None:
                self._thread.call(self._vehicle.arrive())
                self._hover(hold_s)

    def fly_over(self, place: Place) -> bool:
        """Fly to the places without a photo on the way to a waypoint from the one before; False if there are none."""
        if not isinstance(place, Waypoint) or self._acts:
            return False
        if self._last is not None and self._following.get(self._last) != place:
            return False
        for number, via in enumerate(place.via):
            notes = self._vehicle.turn if number else self._vehicle.head_for
            fly_on = partial(self._vehicle.fly_through, via.position, self._open)
            self._fly_to(via, fly_on, partial(notes, place, place.via[number:]))
        return bool(place.via)

    def leave(self, places: Sequence[Via]) -> None:
        """Fly to the places after the last waypoint."""
        for via in places:
            fly_on = partial(self._vehicle.fly_on, via.position, self._open)
            self._fly_to(via, fly_on, partial(self._vehicle.head_for, via.position))

    def _fly_to(
        self, via: Via, fly_on: Callable[[], Coroutine[Any, Any, bool]], notes: Callable[[], None]
    ) -> None:
        """Fly a leg to a place without a photo."""
        position = via.position
        if self._end != position or not self._vehicle.passes(position):
            self.stop()
        if self._end is None:
            self.fly_around(position)
            self._set_off(position, via.ground_speed_m_s)
        self._thread.post(notes)
        self._reach(position, fly_on, notes)
        self._end, self._left_at = None, position
        if via.hold_s:
            self._thread.call(self._vehicle.arrive())
            self._hover(via.hold_s)

    def _hover(self, hold_s: float) -> None:
        if hold_s:
            self._thread.call(asyncio.sleep(hold_s))

    def _reach(
        self, place: Place, fly_on: Callable[[], Coroutine[Any, Any, bool]], goes_on: Callable[[], None]
    ) -> None:
        """Fly on until the place is passed, or fly back to it; meet the demands that come meanwhile."""
        if due := self._due(self._onwards(place)):
            self._detour(due, place, goes_on)
        while not self._thread.call(fly_on()):
            if demanding := self._wanted_now(self._onwards(place), self._taken()):
                self._detour(demanding, place, goes_on)
            elif not self._vehicle.passes(place):
                self._fly_back(place)
                return

    def leave_open(self, answer: AnswerAction[Any]) -> None:
        """Meet the answer's demand once it is there; stop and wait if too many answers are open."""
        self._open.append(answer)
        if answer.needs_server:
            if not answer.only_tells:
                self._wait_if_soon(answer)
            return
        if self._stays and not answer.only_tells:
            self._wait_below(1)
        if (waiting := self._unheard) >= self._rules.at_most:
            self._note(schema.PhotosWait(waiting=waiting))
            self.stop()
            self._wait_below(self._rules.at_most)

    def owe(self, act: AnswerAction[Any]) -> None:
        """Do the act, whose answer is there, or put it off."""
        self._open.append(act)

    @property
    def _unheard(self) -> int:
        """How many open answers are not there and come without a server too; of two the first counts."""
        return sum(not (answer.demand.is_heard or answer.needs_server) for answer in self._open)

    def _wait_if_soon(self, answer: AnswerAction[Any]) -> None:
        """Wait at a waypoint where the drone rests for an answer that a server gives soon."""
        rules, operation = self._rules, answer.pending.operation
        if rules.servers is None or not rules.rests or rules.stay_or_go.manner == "go":
            return
        if (soon_s := self._thread.call(rules.servers.soon_s(operation))) is not None:
            waited_s = self._thread.call(_timed(one_answered([answer], within_s=_LATER * soon_s)))
            self._take_here(answer, waited_s)

    def _take_here(self, answer: AnswerAction[Any], waited_s: float) -> None:
        """Take an answer that is there, and meet its demand at once; the demands of others wait."""
        if answer.pending.done():
            self._open = [other for other in self._open if other is not answer]
            answer.demands()
            answer.finish(waited_s)

    def _before_leaving(self, place: Place) -> None:
        """Do what was put off to here; stop in the last range of the way if calls wait for a server."""
        rules = self._rules
        if due := self._late.due_after(self._last):
            self.stop()  # behind a last spot that is not the row's end
            self._open += due
            self._meet(due, self._onwards(place))
        if rules.servers is None or not isinstance(place, Waypoint) or not self._open:
            return
        seeking, here = rules.seeking, self._vehicle.position()
        if self._thread.call(seeking.leads_away(here, place)):
            self.stop()
            self._thread.call(seeking.wait_here(here))
        onwards = self._onwards(place)
        if self._end is None and (demanding := self._wanted_now(onwards, self._taken())):
            self._meet(demanding, onwards)

    def seek_answers(self) -> None:
        """Before the way home, fly to a place where servers answer waiting calls, if the detour pays."""
        if self._rules.servers is None or not self._open:
            return
        seeking, here = self._rules.seeking, self._vehicle.position()
        place = self._thread.call(seeking.beside_way_home(here, self._vehicle.allows))
        if place is None:
            return
        if distance_m(here, place) > _THERE_M:
            self._vehicle.fly(place)
        self._thread.call(seeking.wait_here(place, here))
        if demanding := self._taken():
            self._meet(demanding)

    def after_landing(self) -> None:
        """Wait for the answers that servers give at home, and take all; the others have none."""
        if self._rules.servers is None:
            return
        self._thread.call(self._rules.seeking.after_landing())
        while self._open:
            self._thread.call(one_answered(self._open))
            for answer in self._taken():
                self._open.remove(answer)
                answer.finish_on_ground()

    def _wait_below(self, count: int) -> None:
        """Wait at rest until fewer answers are open, and meet their demands; come back where a plan has the way.

        A place off the leg, as in doubt of the position, is not come back to.
        """
        here, was_away, sought = self._vehicle.position(), False, set[str]()
        is_on_way = bool(self._way) and (self._acts or self._vehicle.passes(here))
        while self._unheard >= count:
            if self._seeks(sought, following=self._following.get(self._last) if self._last else None):
                was_away, count = True, 1  # there it waits for all
            else:
                was_away |= self._take_next()
        if was_away and is_on_way:
            self.fly_around(here)
            self._vehicle.fly(here)

    def _seeks(self, sought: set[str], *, back: bool = True, following: Waypoint | None = None) -> bool:
        """Fly to a range where the open answers come sooner than here; return whether the drone flew.

        Answers that are there are taken first.
        """
        seeking, here = self._rules.seeking, self._vehicle.position()
        unheard = [answer for answer in self._open if not (answer.demand.is_heard or answer.needs_server)]
        if not unheard:
            return False
        self._thread.call(asyncio.sleep(0))  # the loop begins the last call
        if any(answer.demand.is_due for answer in unheard):
            return False
        waiting = [answer.pending.operation for answer in unheard]
        allows = self._vehicle.allows
        sooner = seeking.sooner(waiting, here, allows, following=following, back=back, but=sought)
        if (place := self._thread.call(sooner)) is None:
            return False
        self._vehicle.fly(place)
        return True

    def stop(self) -> None:
        """Brake, if a leg is flown."""
        if self._end is not None:
            self._end = self._left_at = None
            self._thread.call(self._vehicle.stop())

    def rest(self) -> None:
        """Brake, and come back to the last place."""
        if self._end is not None and not self._acts:
            self.stop()
            self._come_back(self._vehicle.place())

    def settle(self, *, comes_back: bool = True) -> None:
        """Wait at rest for every answer, and meet its demand; come back to the last place, or do not."""
        if self._acts:
            return
        here, was_away, sought = self._vehicle.place(), self._end is not None, set[str]()
        self.stop()
        if due := self._late.all():
            self._open += due
            was_away = self._meet(due) is not None
        while any(not answer.needs_server for answer in self._open):
            was_away |= self._seeks(sought, back=comes_back) or self._take_next(waits=True)
        if self._open:
            self._thread.call(asyncio.sleep(0))  # the loop begins the last call
            if demanding := self._taken():
                was_away = self._meet(demanding) is not None
        if was_away and comes_back:
            self._come_back(here)

    def _come_back(self, place: Place | None) -> None:
        if place is not None:
            self._vehicle.fly(place, back=True)
            self._left_at = position_of(place)

    def _set_off(self, end: Position, ground_speed_m_s: float | None) -> None:
        self._thread.call(self._vehicle.set_off(end, ground_speed_m_s))
        self._end, self._leg_m_s = end, ground_speed_m_s

    def _set_off_for_next(self, place: Place) -> None:
        """Set off along the row for its last spots, or for the next waypoint of the plan."""
        following = self._following.get(place) if isinstance(place, Waypoint) else None
        if following is None:
            return
        end, speed_m_s = following.position, following.ground_speed_m_s
        if following.via:
            end, speed_m_s = following.via[0].position, following.via[0].ground_speed_m_s
        else:
            end = self._end_of_leg(following) or end
        if not self._way or self._vehicle.allows(position_of(place), end):
            self._set_off(end, speed_m_s)

    def _row_end_from_here(self, place: Place) -> Position | None:
        """The end of the place's row, if the drone is on that row, and passes the place on its way there."""
        if isinstance(place, Waypoint) and place.row_start is not None and place.row_start == self._left_at:
            return place.row_end
        last = self._vehicle.place()
        if not (isinstance(place, Waypoint) and isinstance(last, Waypoint) and place.row_end is not None):
            return None
        is_on_row = last.row_end == place.row_end and lies_on(place.position, last.position, place.row_end)
        here, end = self._vehicle.position(), place.row_end
        is_ahead = distance_m(here, end) >= distance_m(place.position, end)
        return end if is_on_row and is_ahead and lies_on(place.position, here, end) else None

    def _end_of_leg(self, place: Place) -> Position | None:
        """The end of the place's row, or the first spot on the way where the drone rests for acts or their demands.

        None if the drone does not pass the place on its way there.
        """
        end, spot = self._row_end_from_here(place), place if isinstance(place, Waypoint) else None
        self._rest = None
        while end is not None and spot is not None and spot.row_end == end:
            if self._late.waits_after(spot) or self._is_often_demanded(spot):
                self._rest = spot.position
                return self._rest
            spot = self._following.get(spot)
        return end

    def _is_often_demanded(self, spot: Waypoint) -> bool:
        """Whether a map of demands has the drone rest at a spot of a row."""
        if self._rules.stay_or_go.demand_map is None:
            return False
        verdict = self._verdict(spot, rests_anyway=False)
        return verdict is not None and not verdict.goes

    def _rests_at(self, spot: Waypoint) -> bool:
        """Whether the drone waits at this spot, where it rests, for the answer."""
        verdict = self._verdict(spot, rests_anyway=spot.position == spot.row_end)
        if verdict is None:
            return False
        self._note(schema.StayOrGo(waypoint=spot.index, **asdict(verdict)))
        return not verdict.goes

    def _verdict(self, spot: Waypoint, *, rests_anyway: bool) -> StayVerdict | None:
        """Whether to fly on from the spot before its answer; None where the drone does in any case."""
        rules, rule = self._rules, self._rules.stay_or_go
        if rule.manner != "learn" or rule.answer_s is None or spot not in self._following:
            return None
        if self._unheard > _IN_TIME:  # late answers share detours, which cost less
            return None
        return rule.decide(
            RowOutlook(
                rules.ground_speed_m_s,
                rules.acceleration_m_s2,
                rule.answer_s,
                rules.photo_s,
                rests_anyway=rests_anyway,
            ),
            spot.position,
        )

    def _note(self, event: schema.Event) -> None:
        self._thread.post(lambda: self._journal.record(event))

    def _taken(
        self, waited_s: float = 0.0, *, but: Sequence[AnswerAction[Any]] = ()
    ) -> list[AnswerAction[Any]]:
        """The open answers that are there and have a demand, the nearest first; others that are there are taken."""
        demanding, seen, here = [], list(but), self._vehicle.position()
        while due := [answer for answer in self._open if answer.demand.is_due and answer not in seen]:
            for answer in due:  # those that are taken may owe acts
                seen.append(answer)
                if answer.is_held:
                    continue
                if answer.demands():
                    demanding.append(answer)
                elif answer.pending.done():
                    self._open.remove(answer)
                    answer.finish(waited_s)
                    waited_s = 0.0
        return sorted(demanding, key=lambda answer: answer.away_m(here))

    def _fly_back(self, spot: Place) -> None:
        """Brake, fly to a spot that was missed, and set off again for the end of the leg."""
        end = self._end
        assert end is not None  # noqa: S101 - a leg is flown
        self.stop()
        self.fly_around(position_of(spot))
        self._vehicle.fly(spot)
        if position_of(spot) != end:
            self._set_off(end, self._leg_m_s)

    def _onwards(self, place: Place) -> Onwards:
        """What follows for the drone on its leg to the place, or over it."""
        ahead = position_of(place) if self._end in (None, position_of(place)) else self._vehicle.left()
        return Onwards(place, ahead, self._end, rests=self._end is None)

    def _wanted_now(
        self, onwards: Onwards, demanding: Sequence[AnswerAction[Any]]
    ) -> list[AnswerAction[Any]]:
        """The answers whose demands the drone meets before it goes on; the acts of others are put off."""
        allows, now = self._vehicle.allows, []
        for answer in demanding:
            if self._thread.call(self._late.puts_off(answer, onwards, allows)):
                self._open.remove(answer)
                answer.put_off()
            else:
                now.append(answer)
        return now

    def _due(self, onwards: Onwards) -> list[AnswerAction[Any]]:
        """The acts that were put off, and that the drone does before it goes on."""
        due = self._thread.call(self._late.due(onwards)) if self._late else []
        self._open += due
        return due

    def _detour(self, demanding: list[AnswerAction[Any]], place: Place, goes_on: Callable[[], None]) -> None:
        end, left, spot, onwards = self._end, self._vehicle.left(), position_of(place), self._onwards(place)
        assert end is not None  # noqa: S101 - a leg is flown
        self.stop()
        last = self._meet(demanding, onwards._replace(rests=True))
        ahead = left if spot == end else spot
        is_on_row = last is not None and lies_on(ahead, position_of(last), end)
        if (spot != end or self._way) and not is_on_row:
            self.fly_around(left)
            self._vehicle.fly(left)
        self._set_off(end, self._leg_m_s)
        self._thread.post(goes_on)

    def _meet(self, demanding: list[AnswerAction[Any]], onwards: Onwards | None = None) -> Place | None:
        """Act on the answers in their order, and on those that come meanwhile; return where the last was.

        Where it is known what follows, some of those that come are put off, and some that were put off are met too.
        """
        acted, self._acts, self._left_at = self._acts, True, None
        try:
            while demanding:
                here, (answer, *demanding) = self._vehicle.position(), demanding
                self._open.remove(answer)
                if answer.away_m(here) < _THERE_M or not answer.demands():
                    answer.finish(0.0)
                else:
                    answer.come_back(0.0)
                come = self._taken(but=demanding)
                demanding += come if onwards is None else self._wanted_now(onwards, come) + self._due(onwards)
                demanding = [answer for answer in demanding if answer in self._open]  # an act may meet others
        finally:
            self._acts = acted
        return answer.place

    def fly_around(self, target: Position) -> None:
        """Fly towards a place along the way of the plan, where a fence forbids the straight way there."""
        here = self._vehicle.position()
        if not self._way or self._vehicle.allows(here, target):
            return
        places = [here, *self._turns(here, target), target]
        number = 0
        while not self._vehicle.allows(places[number], target):
            ahead = range(len(places) - 2, number, -1)
            number = next((far for far in ahead if self._vehicle.allows(places[number], places[far])), 0)
            if not number:
                return
            self._vehicle.fly(places[number])

    def _turns(self, here: Position, target: Position) -> Sequence[Position]:
        """Where the plan turns between two places."""
        way, last = self._way, self._leg_over(target)
        if last is None:
            return ()
        first = self._leg_over(here)
        if first is not None:
            return way[last:first][::-1] if first > last else way[first:last]
        near = sorted(range(len(way)), key=lambda turn: distance_m(here, way[turn]))
        turn = next((turn for turn in near if self._vehicle.allows(here, way[turn])), 0)
        return way[last : turn + 1][::-1] if turn >= last else way[turn:last]

    def _leg_over(self, place: Position) -> int | None:
        """The number of the plan's last leg that passes the place."""
        legs = range(len(self._way) - 1, 0, -1)
        return next((leg for leg in legs if lies_on(place, self._way[leg - 1], self._way[leg])), None)

    def _take_next(self, *, waits: bool = False) -> bool:
        """Wait at rest for an answer and meet its demand; return whether the drone left its place.

        With `waits` it rests here until every answer is in.
        """
        answers = [answer for answer in self._open if not (answer.is_held or (waits and answer.needs_server))]
        waited_s = self._thread.call(_timed(one_answered(answers, waits=waits)))
        demanding = self._taken(waited_s)
        if demanding:
            self._meet(demanding)
        return bool(demanding)


async def _timed(wait: Coroutine[Any, Any, None]) -> float:
    """The seconds that the wait takes."""
    begun_s = asyncio.get_running_loop().time()
    await wait
    return asyncio.get_running_loop().time() - begun_s
