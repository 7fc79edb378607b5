"""The mission ahead of a drone: its next places, when it reaches them, and its calls.

Every coming stop is expected to be like the last complete stop: the same operations after the same pauses. The
vehicle's agility is learnt from its legs. A mission that leaves its plan is expected to go on calling around its
present target, as nothing else is known.
"""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from statistics import fmean

from msgspec import Struct

from upwash.core.geo import Position, Reach, Via, Waypoint, distance_m, row_of
from upwash.core.knowledge.estimates import WINDOW_LENGTH
from upwash.core.knowledge.ranges import AreaIndex
from upwash.core.operation import Operation
from upwash.core.planning.legs import Leg, LegPart, Pace, acceleration_m_s2, entered_m

_MOST_ENTRIES = 10_000  # of the cache of legs


class StopCall(Struct, frozen=True):
    """A call of a stop, `pause_s` after the arrival there or after the call before."""

    operation: Operation
    pause_s: float


class ExpectedCall(Struct, frozen=True):
    """A coming call, `gap_s` after the end of the call before; the first, after now.

    `in_range_s` has for each server in range at the call the part of `gap_s`, up to the call, that it is in range.
    `position` is where the call is made; None: where the drone is. If the gap `hides` the call before, the gap
    counts from the begin of that call: the drone flies on meanwhile.
    """

    operation: Operation
    gap_s: float
    in_range_s: Mapping[str, float]
    position: Position | None = None
    hides: bool = False


@dataclass(slots=True)
class CallClock:
    """When coming calls begin and end, one after the other, in seconds."""

    at_s: float = 0.0
    reached_s: float = 0.0  # the place of the last call

    def begin(self, call: ExpectedCall) -> None:
        """Go on to the begin of the call."""
        self.reached_s = (self.reached_s if call.hides else self.at_s) + call.gap_s
        self.at_s = max(self.at_s, self.reached_s)

    def end(self, delay_s: float) -> None:
        """Go on to the end of the call."""
        self.at_s += delay_s


@dataclass(frozen=True, slots=True)
class MissionBeliefs:
    """What is expected of a mission before take-off: its plan, its speed and pace, and the calls of its first stop.

    After the plan's last waypoint the drone flies over `leaving`. An `assumed` pace is replaced by the vehicle's own,
    once known.
    """

    plan: Sequence[Waypoint] = ()
    ground_speed_m_s: float = 4.0
    pace: Pace = field(default_factory=Pace)
    stop: Sequence[StopCall] = ()
    assumed: bool = False
    leaving: Sequence[Via] = ()

    def pace_of(self, vehicle: Pace | None) -> Pace:
        """The pace to expect, with the vehicle's own if it is known."""
        return vehicle if self.assumed and vehicle is not None else self.pace


class PlannedLeg(Struct, frozen=True):
    """A leg between two places; the drone hovers for `hold_s` at a place without a call."""

    start: Position
    end: Position
    leg: Leg | LegPart
    hold_s: float = 0.0


class _Way(Struct, frozen=True):
    """A coming leg with the hold at its end, and when it enters the range of each server in range there.

    The time is None where the leg begins in the range.
    """

    duration_s: float
    entered_s: Mapping[str, float | None]


class MissionModel:
    """Follows one mission over its legs and calls, and foresees the next calls."""

    def __init__(
        self, beliefs: MissionBeliefs, areas: Mapping[str, Reach], index: AreaIndex | None = None
    ) -> None:
        self._plan = beliefs.plan
        self._areas = list(areas.items())
        self._index_of_areas = index or AreaIndex(list(areas.values()))
        self._ground_speed_m_s = beliefs.ground_speed_m_s
        self._beliefs = beliefs
        self._routine = tuple(beliefs.stop)
        self._leaving_s = 0.0  # from the last call of a stop to the next leg
        self._place: Position | None = None  # where it is or flies to, as far as is known
        self._index: int | None = None  # of that place in the plan
        self._way: PlannedLeg | None = None
        self._then: list[PlannedLeg] = []  # the legs after it, to the same target
        self._begun_s = 0.0  # when the first of them was begun
        self._last_leg_m = 0.0
        self._here: list[StopCall] = []
        self._flies_on = any(waypoint.row_end is not None for waypoint in beliefs.plan)  # before its answers
        self._row_starts = list(_row_starts(beliefs.plan))
        self._is_back = False  # or on the way back: the stop teaches nothing
        self._free_s = 0.0  # since when nothing is known to go on, or until when the call under way goes on
        self._entries: dict[tuple[Position, Position], Mapping[str, float]] = {}
        self.begun(None)

    def begun(self, vehicle: Pace | None) -> None:
        """Begin the mission with a vehicle of that pace; None if unknown."""
        pace = self._beliefs.pace_of(vehicle)
        self._accelerations_m_s2 = deque([pace.acceleration_m_s2], maxlen=WINDOW_LENGTH)
        self._settling_s = pace.settling_s
        self._ways: dict[tuple[int, float], _Way] = {}  # by waypoint and ground speed, at the present agility

    def leg_begun(
        self,
        start: Position,
        target: Position,
        ground_speed_m_s: float | None,
        *,
        now_s: float,
        back: bool = False,
        via: Sequence[Via] = (),
    ) -> None:
        """Note that the mission leaves for `target`, by way of `via`; `back` if the calls there are over already."""
        if self._place is not None and self._way is None and not self._is_back and not self._flies_on:
            self._routine = tuple(self._here)
            self._leaving_s = max(0.0, now_s - self._free_s)
        self._is_back = back
        if ground_speed_m_s is not None:
            self._ground_speed_m_s = ground_speed_m_s
        if self._way is None or self._place != target or self._index is None:
            following = 0 if self._index is None else self._index + 1
            ahead, behind = range(following, len(self._plan)), range(following)
            order = itertools.chain(reversed(behind), ahead) if back else itertools.chain(ahead, behind)
            self._index = next((index for index in order if self._plan[index].position == target), None)
        self._place, self._here = target, []
        self._last_leg_m, self._begun_s = distance_m(start, target), now_s
        self._way, *self._then = self._legs_to(None if back else self._index, start, target, via)

    def arrived(self, *, now_s: float) -> None:
        """Note that the leg is over; learn the vehicle's acceleration from it."""
        if self._way is not None and not self._then and isinstance(leg := self._way.leg, Leg):
            moved_s = now_s - self._begun_s - leg.settling_s
            found = acceleration_m_s2(leg.length_m, leg.ground_speed_m_s, moved_s)
            if found is not None:
                self._accelerations_m_s2.append(found)
                self._ways.clear()
        self._way, self._then, self._free_s = None, [], now_s + self._hold_s()

    def lost(self) -> None:
        """Forget where the mission goes next."""
        self._place = self._way = None

    def call_begun(self, operation: Operation, *, now_s: float) -> None:
        """Note that the mission calls the operation."""
        self._here.append(StopCall(operation, max(0.0, now_s - self._free_s)))
        self._free_s = now_s

    def call_ends(self, ends_s: float) -> None:
        """Set the expected or known end of the call under way."""
        self._free_s = ends_s

    @property
    def photo_s(self) -> float:
        """Seconds from an arrival to the first call, at this stop or else at the last one."""
        steps = self._here or self._routine
        return steps[0].pause_s if steps else 0.0

    def open_s(self, now_s: float) -> float:
        """The expected seconds until the call under way is over."""
        return max(0.0, self._free_s - now_s)

    def next_leg(self) -> PlannedLeg | None:
        """The leg to the next waypoint of the plan; None at the last waypoint, during a leg, and off the plan."""
        if self._place is None or self._way is not None or self._index is None:
            return None
        if self._index + 1 == len(self._plan):
            return None
        waypoint = self._plan[self._index + 1]
        leg = self._leg(distance_m(self._place, waypoint.position), waypoint.ground_speed_m_s)
        return PlannedLeg(self._place, waypoint.position, leg)

    def leaving_s(self) -> float:
        """The seconds from the plan's last waypoint over the places after it, at the pace of now."""
        legs = self._via_legs(len(self._plan) - 1, self._plan[-1].position, self._beliefs.leaving)
        return sum(leg.leg.duration_s + leg.hold_s for leg in legs)

    def coming(self, position: Position, *, now_s: float, count: int) -> list[ExpectedCall]:
        """The next calls, at most `count`; empty if nothing is known."""
        if self._place is None or not self._routine:
            return []
        return list(itertools.islice(self._calls(self._place, position, now_s), count))

    def rest(self, position: Position, *, now_s: float) -> list[ExpectedCall]:
        """The coming calls up to the end of the plan; empty if nothing is known, or the mission has left its plan."""
        if self._place is None or self._index is None:
            return []
        return list(self._calls(self._place, position, now_s))

    def _calls(self, place: Position, position: Position, now_s: float) -> Iterator[ExpectedCall]:
        if (way := self._way) is not None:
            flown_s = way.leg.reached_s(way.leg.length_m - distance_m(position, way.end))
            whole = self._way_of([way, *self._then])
            steps, gap_s = self._routine, whole.duration_s - flown_s + self._hold_s()
            in_range_s = {
                server: None if way_s is None else gap_s - max(0.0, way_s - flown_s)
                for server, way_s in whole.entered_s.items()
            }
        elif self._flies_on:  # its call is made, and it flies on now
            steps, gap_s, in_range_s = (), 0.0, {}
        else:
            steps, gap_s = self._routine[len(self._here) :], self._free_s - now_s
            in_range_s = dict.fromkeys(self._entered(place, place))
        yield from self._calls_of(steps, place, gap_s, in_range_s)
        free_s = 0.0 if steps else gap_s
        for end, coming in self._ways_after(place):
            leaving_s = max(0.0, free_s + self._leaving_s)
            gap_s = leaving_s + coming.duration_s
            in_range_s = {
                server: None if way_s is None else gap_s - leaving_s - way_s
                for server, way_s in coming.entered_s.items()
            }
            yield from self._calls_of(self._routine, end, gap_s, in_range_s)
            free_s = 0.0

    def _calls_of(
        self, steps: Sequence[StopCall], place: Position, gap_s: float, in_range_s: Mapping[str, float | None]
    ) -> Iterator[ExpectedCall]:
        """The calls at an arrival, `gap_s` after the call before.

        `in_range_s` has for each server there how long it is in range at the arrival; None for the whole gap.
        """
        for number, step in enumerate(steps):
            if number > 0:
                gap_s, in_range_s = 0.0, dict.fromkeys(self._entered(place, place))
            whole_s = gap_s if self._flies_on else max(0.0, gap_s + step.pause_s)
            known_s = {
                server: whole_s if time_s is None else max(0.0, time_s + step.pause_s)
                for server, time_s in in_range_s.items()
            }
            yield ExpectedCall(step.operation, whole_s, known_s, place, hides=self._flies_on)

    def _ways_after(self, place: Position) -> Iterator[tuple[Position, _Way]]:
        if self._index is None:
            around = self._way_of([PlannedLeg(place, place, self._leg(self._last_leg_m))])
            while True:
                yield place, around
        speed_m_s = self._ground_speed_m_s
        for index in range(self._index + 1, len(self._plan)):
            waypoint = self._plan[index]
            speed_m_s = waypoint.ground_speed_m_s or speed_m_s
            way = self._ways.get((index, speed_m_s))
            if way is None:
                if len(self._ways) >= _MOST_ENTRIES:
                    self._ways.clear()
                way = self._way_of(self._legs_to(index, place, waypoint.position, waypoint.via, speed_m_s))
                held_s = self.photo_s if self._flies_on and index and self._plan[index - 1].hold_s else 0.0
                way = _Way(held_s + way.duration_s + waypoint.hold_s, way.entered_s)
                self._ways[index, speed_m_s] = way
            yield waypoint.position, way
            place = waypoint.position

    def _legs_to(
        self,
        index: int | None,
        start: Position,
        target: Position,
        via: Sequence[Via] = (),
        ground_speed_m_s: float | None = None,
    ) -> list[PlannedLeg]:
        """The legs to the target, the waypoint of that index if it is one, by way of `via`; at least one."""
        legs = self._via_legs(index - 1 if index else None, start, via)
        if legs:
            start = legs[-1].end
            if index is not None:
                ground_speed_m_s = ground_speed_m_s or self._plan[index].ground_speed_m_s
        leg: Leg | LegPart = self._leg(distance_m(start, target), ground_speed_m_s)
        if index is not None and (row_end := self._plan[index].row_end) is not None:
            first, row_start = self._row_starts[index]
            if row_start != self._plan[index].position:  # else the leg begins at rest there
                whole = self._leg(distance_m(row_start, row_end), ground_speed_m_s)
                before = row_start if first == index else self._plan[index - 1].position
                to_m = distance_m(before, self._plan[index].position)
                leg = LegPart(whole, distance_m(row_start, before), to_m)
        return [*legs, PlannedLeg(start, target, leg)]

    def _via_legs(self, index: int | None, start: Position, via: Sequence[Via]) -> list[PlannedLeg]:
        """The legs over these places, from the waypoint of that index if it is one."""
        legs: list[PlannedLeg] = []
        for place in via:
            leg: Leg | LegPart = self._leg(distance_m(start, place.position), place.ground_speed_m_s)
            if index is not None and not legs and self._plan[index].row_end == place.position:
                row_start = self._row_starts[index][1]
                whole = self._leg(distance_m(row_start, place.position), place.ground_speed_m_s)
                flown_m = distance_m(row_start, self._plan[index].position)
                leg = LegPart(whole, flown_m, whole.length_m - flown_m)
            legs.append(PlannedLeg(start, place.position, leg, place.hold_s))
            start = place.position
        return legs

    def _way_of(self, legs: Sequence[PlannedLeg]) -> _Way:
        """The legs as one way."""
        begins_s = list(itertools.accumulate((leg.leg.duration_s + leg.hold_s for leg in legs), initial=0.0))
        entries = [self._entered(leg.start, leg.end) for leg in legs]
        entered_s: dict[str, float | None] = dict.fromkeys(entries[-1])
        for server in entered_s:
            for begun_s, leg, found in zip(begins_s[-2::-1], reversed(legs), reversed(entries), strict=True):
                way_m = found.get(server, leg.leg.length_m)  # or it is entered as the next leg begins
                if way_m or server not in found:
                    entered_s[server] = begun_s + leg.leg.reached_s(way_m)
                    break
        return _Way(begins_s[-1], entered_s)

    def _leg(self, length_m: float, ground_speed_m_s: float | None = None) -> Leg:
        speed_m_s = ground_speed_m_s or self._ground_speed_m_s
        return Leg(length_m, speed_m_s, fmean(self._accelerations_m_s2), self._settling_s)

    def _hold_s(self) -> float:
        return 0.0 if self._index is None or self._is_back else self._plan[self._index].hold_s

    def _entered(self, start: Position, end: Position) -> Mapping[str, float]:
        """For each server in range at the end of a leg, where the leg enters its range; 0 where it begins there."""
        entries = self._entries.get((start, end))
        if entries is None:
            if len(self._entries) >= _MOST_ENTRIES:
                self._entries.clear()
            near = (self._areas[number] for number in self._index_of_areas.near(end))
            ways_m = ((server, entered_m(start, end, area)) for server, area in near)
            entries = {server: way_m for server, way_m in ways_m if way_m is not None}
            self._entries[start, end] = entries
        return entries


def _row_starts(plan: Sequence[Waypoint]) -> Iterator[tuple[int, Position]]:
    """For each waypoint of the plan, the index of the first waypoint of its row, and where the leg over it begins."""
    first, start, before = 0, Position(0.0, 0.0), None
    for index, waypoint in enumerate(plan):
        row = None if before is None or waypoint.via else row_of(before)
        if row is None or row != row_of(waypoint):
            rests_at = waypoint.via[-1] if waypoint.via else before
            first, start = index, waypoint.position
            if waypoint.row_start is not None and rests_at and waypoint.row_start == rests_at.position:
                start = waypoint.row_start
        yield first, start
        before = waypoint
