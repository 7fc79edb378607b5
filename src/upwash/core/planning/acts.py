"""Where an act costs least: at once, after a waypoint further on, or before the way home.

    an act     at a place, as an answer demands it
    a gap      after a waypoint of the plan, before the next one or the way home
    its cost   the seconds that the way gets longer, beside the acts that are put off already

Legs are flown from rest to rest. For an act between two spots of a row the drone rests at the first of them.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Generic, NamedTuple, TypeVar

from msgspec import Struct

from upwash.core.geo import Position, Waypoint, distance_m, first_on_way, row_of
from upwash.core.planning.legs import Pace, passes

T = TypeVar("T")
_LEAST_GAIN_S = 0.5  # of an act that is put off


class WayAhead(NamedTuple):
    """A drone before the `target`th waypoint of its plan, which has to be `ahead` after an act.

    It is `here`, on a leg to `end` where it rests at `rest` if it brakes now. Without a `rest` it rests here.
    """

    here: Position
    target: int
    ahead: Position
    end: Position | None = None
    rest: Position | None = None


class Gap(Struct, frozen=True):
    """The gap after the plan's waypoint of that `number`, and the `order` of an act there.

    The act costs `extra_s` there, and begins in `in_s` at the earliest.
    """

    number: int
    order: int
    extra_s: float
    in_s: float


class LateAct(Struct, frozen=True):
    """An act at a place, what it costs at once, and the gaps further on, the last one before the way home.

    Gaps that cost more for sure are left out, and those that come too late or that a fence forbids.
    """

    place: Position
    at_once_s: float
    gaps: Sequence[Gap]


def cheapest(act: LateAct) -> int | None:
    """The number of the gap, of those given, that costs least; None for at once."""
    extras_s = [gap.extra_s for gap in act.gaps]
    least_s = min(extras_s, default=math.inf)
    return extras_s.index(least_s) if least_s < act.at_once_s - _LEAST_GAIN_S else None


class Acts(Generic[T]):
    """The acts that are put off, in the gaps of a plan.

    The drone flies over the places `leaving` after the last waypoint. `home_s` has the seconds from a place to the
    ground; None: the drone ends its way at the last place. A photo at rest takes `photo_s`.
    """

    def __init__(
        self,
        plan: Sequence[Waypoint],
        *,
        leaving: Sequence[Position] = (),
        ground_speed_m_s: float,
        pace: Pace,
        photo_s: float,
        home_s: Callable[[Position], float] | None,
    ) -> None:
        self._plan = plan
        self._last = [*(waypoint.position for waypoint in plan), *leaving][-1:]
        self._ground_speed_m_s = ground_speed_m_s
        self._pace = pace
        self._photo_s = photo_s
        self._home_s = home_s or (lambda place: self._leg_s(place, self._last[0]))
        self._gaps: dict[int, list[tuple[Position, T]]] = {}
        self._reached_s = list(self._reaching_s())

    def choice(
        self,
        place: Position,
        way: WayAhead,
        *,
        within_s: float = math.inf,
        allows: Callable[[Position, Position], bool] = lambda *_: True,
    ) -> LateAct:
        """What an act costs at once, and in the gaps where it begins `within_s` and the straight ways are allowed."""
        at_once_s, gaps, first = self._at_once_s(place, way), [], way.target
        while way.end is not None and self._is_inside(first) and self._plan[first].position != way.end:
            first += 1  # up to the last waypoint that its leg passes
        for number in range(first, len(self._plan)):
            if self._least_s(number, place) >= at_once_s or self._in_s(number, place, way) > within_s:
                continue
            others = [each for each, _ in self._gaps.get(number, ())]
            orders = range(len(others) + 1)
            ways_s = [self._longer_s(number, [*others[:at], place, *others[at:]]) for at in orders]
            order = min(orders, key=ways_s.__getitem__)
            start, ahead = self._ends(number)
            before = others[order - 1] if order else start
            after = others[order] if order < len(others) else ahead
            if allows(before, place) and (after is None or allows(place, after)):
                extra_s = ways_s[order] - self._longer_s(number, others)
                gaps.append(Gap(number, order, extra_s, self._in_s(number, place, way)))
        return LateAct(place, at_once_s, gaps)

    def put_off(self, act: T, place: Position, gap: Gap) -> None:
        """Put the act off to that gap."""
        self._gaps.setdefault(gap.number, []).insert(gap.order, (place, act))

    def __bool__(self) -> bool:
        """Whether an act is put off."""
        return bool(self._gaps)

    def waits_after(self, number: int) -> bool:
        """Whether an act is put off to the gap after that waypoint."""
        return number in self._gaps

    def due_after(self, number: int) -> list[T]:
        """Take the acts of the gap after that waypoint, in their order."""
        return [act for _, act in self._gaps.pop(number, ())]

    def all(self) -> list[T]:
        """Take all acts, in the order of the way."""
        return [act for number in sorted(self._gaps) for act in self.due_after(number)]

    def take(self, way: WayAhead, wanted: Callable[[T, LateAct], bool]) -> list[T]:
        """Take the acts that are wanted now, each with its gap alone, and those of gaps that lie behind."""
        taken = []
        for number in sorted(self._gaps):
            for order in reversed(range(len(acts := self._gaps[number]))):
                place, act = acts[order]
                places = [each for each, _ in acts]
                extra_s = self._longer_s(number, places)
                extra_s -= self._longer_s(number, [*places[:order], *places[order + 1 :]])
                gap = Gap(number, order, extra_s, self._in_s(number, place, way))
                if number < way.target or wanted(act, LateAct(place, self._at_once_s(place, way), [gap])):
                    taken.append(act)
                    del acts[order]
            if not acts:
                del self._gaps[number]
        return taken

    def _at_once_s(self, place: Position, way: WayAhead) -> float:
        """What an act costs that is done at once."""
        if way.end is None or way.rest is None:
            return (
                self._leg_s(way.here, place)
                + self._leg_s(place, way.ahead)
                - self._leg_s(way.here, way.ahead)
            )
        braking_m = distance_m(way.here, way.rest)  # less by a vehicle that is slower than it will be
        braking_s = max(
            2 * braking_m / self._ground_speed_m_s, math.sqrt(2 * braking_m / self._pace.acceleration_m_s2)
        )
        twice_m = 2 * distance_m(way.here, way.end)
        ends_s = self._pace.leg(twice_m, self._ground_speed_m_s).duration_s / 2  # at its speed already
        back_s = self._onwards_s(place, way.ahead, way.end)
        return braking_s + self._leg_s(way.rest, place) + back_s - ends_s

    def _longer_s(self, number: int, places: Sequence[Position]) -> float:
        """The seconds that the way gets longer with acts at these places, in their order."""
        if not places:
            return 0.0
        start, ahead = self._ends(number)
        acting_s = sum(itertools.starmap(self._leg_s, itertools.pairwise([start, *places])))
        if ahead is None:
            return acting_s + self._home_s(places[-1]) - self._home_s(start)
        if not self._is_inside(number):
            return acting_s + self._leg_s(places[-1], ahead) - self._leg_s(start, ahead)
        first, last = self._run(number)
        resting_s = self._leg_s(first, start) + self._photo_s
        return resting_s + acting_s + self._onwards_s(places[-1], ahead, last) - self._leg_s(first, last)

    def _ends(self, number: int) -> tuple[Position, Position | None]:
        """Where the gap begins, and where it ends; None: on the ground."""
        if number + 1 == len(self._plan):
            return self._last[0], None
        return self._plan[number].position, first_on_way(self._plan[number + 1]).position

    def _is_inside(self, number: int) -> bool:
        """Whether the gap is between two spots of a row."""
        row = row_of(self._plan[number]) if number + 1 < len(self._plan) else None
        return row is not None and row == row_of(self._plan[number + 1])

    def _run(self, number: int) -> tuple[Position, Position]:
        """The places on a row, around a gap, where the drone rests in any case."""
        first, last = number, number + 1
        while first and self._is_inside(first - 1) and first - 1 not in self._gaps:
            first -= 1
        while self._is_inside(last) and last not in self._gaps:
            last += 1
        return self._plan[first].position, self._plan[last].position

    def _onwards_s(self, start: Position, ahead: Position, end: Position) -> float:
        """The seconds to the end of a leg, over a place ahead: it is passed if it lies on the straight way."""
        if passes(start, end, ahead):
            return self._leg_s(start, end)
        return self._leg_s(start, ahead) + self._leg_s(ahead, end)

    def _least_s(self, number: int, place: Position) -> float:
        """A bound of the cost of a gap without acts, quick to compute; 0 for others."""
        start, ahead = self._ends(number)
        if ahead is None or number in self._gaps:
            return 0.0
        longer_m = distance_m(start, place) + distance_m(place, ahead) - distance_m(start, ahead)
        return longer_m / self._ground_speed_m_s

    def _in_s(self, number: int, place: Position, way: WayAhead) -> float:
        """The seconds until an act in the gap begins, at the earliest."""
        first = min(way.target, number)
        to_first_s = distance_m(way.here, self._plan[first].position) / self._ground_speed_m_s
        on_way_s = self._reached_s[number] - self._reached_s[first]
        return to_first_s + on_way_s + self._leg_s(self._ends(number)[0], place)

    def _reaching_s(self) -> Iterator[float]:
        """The seconds of flight from the first waypoint to each."""
        now_s = 0.0
        for number, waypoint in enumerate(self._plan):
            if number and not self._is_inside(number - 1):
                places = [self._plan[number - 1].position, *(via.position for via in waypoint.via)]
                places.append(waypoint.position)
                now_s += sum(itertools.starmap(self._leg_s, itertools.pairwise(places)))
                now_s += waypoint.hold_s + sum(via.hold_s for via in waypoint.via)
            elif number:
                gone_m = distance_m(self._plan[number - 1].position, waypoint.position)
                now_s += gone_m / self._ground_speed_m_s
            yield now_s

    def _leg_s(self, start: Position, end: Position) -> float:
        return self._pace.leg(distance_m(start, end), self._ground_speed_m_s).duration_s
