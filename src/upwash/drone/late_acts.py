"""The acts of late answers: done at once, or put off to where they cost least on the rest of the way.

The policy has an act done at once, or in a gap further on; by default where it costs least (core/planning/acts.py).
There it begins within `policy.act_within_s` of its answer, and before the reserve of the battery is reached. Each
waypoint is another occasion: what would be late is done then, and what the policy would not put off again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeAlias

from upwash.core.geo import Position, Waypoint
from upwash.core.planning.acts import Acts, LateAct, WayAhead
from upwash.drone.answers import AnswerAction
from upwash.drone.legs import Legs
from upwash.drone.places import Place, position_of
from upwash.eventlog import schema
from upwash.support.background import now_s

Answer: TypeAlias = AnswerAction[Any]


class Onwards(NamedTuple):
    """What a drone does next: it flies to its target, over a place `ahead` where it has to be after an act.

    It is on a leg to `end`, or it `rests`.
    """

    target: Place
    ahead: Position
    end: Position | None = None
    rests: bool = True

    @classmethod
    def straight_to(cls, place: Place, *, rests: bool) -> Onwards:
        """A leg to the place and no farther, which is flown, or over."""
        end = position_of(place)
        return cls(place, end, end, rests)


@dataclass(eq=False)
class LateActs:
    """Decides when acts are done, and keeps those that are put off; on the loop.

    `when_to_act` asks the policy. An act begins `within_s` of its answer. `home_s` has the seconds from a place to
    the ground, and `spare_s` the seconds of flight that the reserve leaves; None while these are unknown.
    """

    legs: Legs
    acts: Acts[Answer]
    when_to_act: Callable[[LateAct], int | None]
    within_s: float
    home_s: Callable[[Position], float]
    spare_s: Callable[[], float | None]
    _begin_by_s: dict[Answer, float] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        self._numbers = {waypoint: number for number, waypoint in enumerate(self.legs.site.waypoints)}

    def waits_after(self, place: Place | None) -> bool:
        """Whether an act is put off to the gap after that waypoint."""
        return isinstance(place, Waypoint) and self.acts.waits_after(self._numbers.get(place, -1))

    def due_after(self, place: Place | None) -> list[Answer]:
        """Take the acts of the gap after that waypoint, in their order."""
        return self.acts.due_after(self._numbers.get(place, -1)) if isinstance(place, Waypoint) else []

    async def puts_off(self, answer: Answer, onwards: Onwards) -> bool:
        """Put the act off if the policy does; return whether it is put off."""
        way, place = self._way(onwards), answer.place
        if way is None or place is None:
            return False
        self._begin_by_s.setdefault(answer, now_s() + self.within_s)
        within_s = self._left_s(position_of(place), answer)
        late = self.acts.choice(position_of(place), way, within_s=within_s, allows=self.legs.allows)
        if not late.gaps or (chosen := self.when_to_act(late)) is None:
            return False
        gap = late.gaps[chosen]
        self.acts.put_off(answer, position_of(place), gap)
        self.legs.journal.record(
            schema.PutOff(
                waypoint=answer.waypoint,
                extra_s=round(gap.extra_s, 1),
                at_once_s=round(late.at_once_s, 1),
                in_s=round(gap.in_s, 1),
                object=answer.object,
            )
        )
        return True

    async def due(self, onwards: Onwards) -> list[Answer]:
        """Take the acts that would be late further on, and those that the policy would not put off again."""
        way = self._way(onwards)

        def is_due(answer: Answer, late: LateAct) -> bool:
            is_late = late.gaps[0].in_s > self._left_s(late.place, answer)
            return is_late or self.when_to_act(late) is None

        return [] if way is None else self.acts.take(way, is_due)

    def _way(self, onwards: Onwards) -> WayAhead | None:
        target, ahead, end, rests = onwards
        number = self._numbers.get(target) if isinstance(target, Waypoint) else None
        vehicle = self.legs.autopilot
        if number is None:
            return None
        return WayAhead(vehicle.position, number, ahead, end, None if rests else vehicle.stopping_place)

    def _left_s(self, place: Position, answer: Answer) -> float:
        """The seconds until the act at the place must begin, by its limit and the reserve."""
        spare_s, left_s = self.spare_s(), self._begin_by_s[answer] - now_s()
        if spare_s is None:
            return left_s
        return min(left_s, spare_s + self.home_s(self.legs.position) - self.home_s(place))
