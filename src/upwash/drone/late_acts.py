"""The acts of late answers: done at once, or put off to where they cost least on the rest of the way.

An act is done at once where no gap further on costs less (core/planning/acts.py), and where it could not begin there
within `policy.act_within_s` of its answer, or with the reserve of the battery. Each waypoint is another occasion:
what would be late is done then, and what is cheaper now, as beside another act.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeAlias

from upwash.core.geo import Position, Waypoint
from upwash.core.planning.acts import Acts, PutOff, Way
from upwash.drone.pending import AnswerAction, Place, position_of
from upwash.eventlog import schema
from upwash.ports import Autopilot, Journal

Allows: TypeAlias = Callable[[Position, Position], bool]  # whether no fence forbids the straight way
Answer: TypeAlias = AnswerAction[Any]


class Onwards(NamedTuple):
    """What follows for a drone: its target on the way, where it has to be after an act, and the end of its leg.

    It is on that leg, or it `rests`.
    """

    target: Place
    ahead: Position
    end: Position | None = None
    rests: bool = True


class LateActs:
    """Decides when acts are done, and keeps those that are put off; on the loop.

    An act begins `within_s` of its answer. `home_s` has the seconds from a place to the ground, and `spare_s` those
    of flight that the reserve leaves, None if unknown.
    """

    def __init__(
        self,
        autopilot: Autopilot,
        journal: Journal,
        *,
        plan: Sequence[Waypoint],
        acts: Acts[Answer],
        within_s: float,
        home_s: Callable[[Position], float],
        spare_s: Callable[[], float | None],
    ) -> None:
        self._autopilot = autopilot
        self._journal = journal
        self._plan = plan
        self._numbers = {waypoint: number for number, waypoint in enumerate(plan)}
        self._acts = acts
        self._within_s = within_s
        self._home_s = home_s
        self._spare_s = spare_s
        self._begin_by_s: dict[Answer, float] = {}

    def waits_after(self, place: Place | None) -> bool:
        """Whether an act is put off to the gap after that waypoint."""
        return isinstance(place, Waypoint) and self._acts.waits_after(self._numbers.get(place, -1))

    def due_after(self, place: Place | None) -> list[Answer]:
        """Take the acts of the gap after that waypoint, in their order."""
        return self._acts.due_after(self._numbers.get(place, -1)) if isinstance(place, Waypoint) else []

    def all(self) -> list[Answer]:
        """Take all acts, in the order of the way."""
        return self._acts.all()

    async def puts_off(self, answer: Answer, onwards: Onwards, allows: Allows) -> bool:
        """Put the act off if it costs less further on; return whether it is put off."""
        way, place = self._way(onwards), answer.place
        if way is None or place is None:
            return False
        self._begin_by_s.setdefault(answer, _time_s() + self._within_s)
        within_s = self._left_s(position_of(place), answer)
        put_off = self._acts.put_off(answer, position_of(place), way, within_s=within_s, allows=allows)
        if put_off is None:
            return False
        self._journal.record(
            schema.PutOff(
                waypoint=answer.waypoint,
                extra_s=round(put_off.extra_s, 1),
                at_once_s=round(put_off.at_once_s, 1),
                in_s=round(put_off.in_s, 1),
            )
        )
        return True

    async def due(self, onwards: Onwards) -> list[Answer]:
        """Take the acts that would be late further on, and those that cost no more now."""
        way = self._way(onwards)

        def is_due(put_off: PutOff[Answer]) -> bool:
            is_late = put_off.in_s > self._left_s(put_off.place, put_off.act)
            return is_late or put_off.at_once_s <= put_off.extra_s

        return [] if way is None else self._acts.take(way, is_due)

    def _way(self, onwards: Onwards) -> Way | None:
        """None of a drone off its plan."""
        target, ahead, end, rests = onwards
        number = self._numbers.get(target) if isinstance(target, Waypoint) else None
        vehicle = self._autopilot
        if number is None:
            return None
        return Way(vehicle.position, number, ahead, end, None if rests else vehicle.stopping_place)

    def _left_s(self, place: Position, answer: Answer) -> float:
        """The seconds until the act at the place must begin, by its limit and the reserve."""
        spare_s, left_s = self._spare_s(), self._begin_by_s[answer] - _time_s()
        if spare_s is None:
            return left_s
        return min(left_s, spare_s + self._home_s(self._autopilot.position) - self._home_s(place))


def _time_s() -> float:
    return asyncio.get_running_loop().time()
