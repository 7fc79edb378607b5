"""Several open answers, and their demands: what the drone does about them; in the mission's thread.

an answer    Without a demand it is taken, while the drone flies on.
a demand     The drone brakes, flies back and acts. Demands that are there by then are one detour, the nearest
             first. An act that costs less further on is put off (late_acts.py).
too many     With too many open answers the drone brakes and waits.
a server's   The drone waits for it where it comes soon, and leaves it open elsewhere. At the end it stops for calls
             that wait (seeking.py).
"""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Coroutine, Sequence
from dataclasses import dataclass, field
from typing import Any

from upwash.config.drone import DroneConfig
from upwash.core.geo import Position, Waypoint, distance_m
from upwash.drone.answers import AnswerAction, one_answered
from upwash.drone.late_acts import Onwards
from upwash.drone.places import Place, position_of, turns_around
from upwash.drone.seeking import Seeking
from upwash.drone.settling import Settling
from upwash.eventlog import schema
from upwash.support.background import now_s

_THERE_M = 1.0  # from a photo's place, at rest
_LATER = 2.0  # times what an answer is expected to take that the drone waits for


@dataclass(kw_only=True, eq=False)
class Several(Settling):
    """Settles several open answers, each when it comes.

    `seeking` finds stops where servers answer. The mission `asks_servers` if it has a service of servers alone.
    """

    config: DroneConfig
    seeking: Seeking
    asks_servers: bool
    _open: list[AnswerAction[Any]] = field(default_factory=list, init=False)
    _stays: bool = field(default=False, init=False)  # at rest, until its answer is there
    _acts: bool = field(default=False, init=False)
    _end: Position | None = field(default=None, init=False)  # of the leg that is flown
    _last: Waypoint | None = field(default=None, init=False)  # that the mission flew to
    # Where the last leg ends, if nothing else was flown since.
    _left_at: Position | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        self._following = dict(itertools.pairwise(self.legs.site.waypoints))

    @property
    def rests(self) -> bool:
        """Whether the drone stops at each waypoint."""
        return self.config.mission.photos is None

    def stop(self) -> None:
        """Brake, if a leg is flown."""
        if self._end is not None:
            self._end = self._left_at = None
            self.thread.call(self.legs.stop())

    def rest(self) -> None:
        """Brake, and come back to the last place."""
        if self._end is not None and not self._acts:
            self.stop()
            self._return_to(self.legs.place)

    def _return_to(self, place: Place | None) -> None:
        if place is not None:
            self.fly(place, back=True)
            self._left_at = position_of(place)

    def fly(self, place: Place, *, back: bool = False) -> None:
        """Fly from rest to rest, `back` along the way of the plan."""
        if back:
            self.fly_around(position_of(place))
        super().fly(place, back=back)

    def fly_around(self, target: Position) -> None:
        """Fly towards a place along the way of the plan, where a fence forbids the straight way there."""
        for turn in turns_around(self.legs.site.way, self.legs.position, target, self.legs.allows):
            self.fly(turn)

    def take_up(self, answer: AnswerAction[Any]) -> None:
        """Leave the answer open; if the drone rests at each waypoint, as in general."""
        if self.rests:
            super().take_up(answer)
        else:
            self.leave_open(answer)

    def leave_open(self, answer: AnswerAction[Any]) -> None:
        """Meet the answer's demand once it is there; stop and wait if too many answers are open."""
        self._open.append(answer)
        if answer.call.needs_server:
            if not answer.only_tells:
                self._wait_if_soon(answer)
            return
        if self._stays and not answer.only_tells:
            self._wait_below(1)
        photos = self.config.mission.photos
        at_most = photos.at_most if photos else len(self.legs.site.waypoints) + 1
        if (waiting := self.unheard) >= at_most:
            self._note(schema.PhotosWait(waiting=waiting))
            self.stop()
            self._wait_below(at_most)

    def owe(self, act: AnswerAction[Any]) -> None:
        """Do the act, whose answer is there, or put it off."""
        self._open.append(act)

    def settle(self, *, comes_back: bool = True) -> None:
        """Wait at rest for every answer, and meet its demand; come back to the last place, or do not."""
        self.thread.require_turn()
        if self._acts:
            return
        here, was_away, sought = self.legs.place, self._end is not None, set[str]()
        self.stop()
        if due := self.late.acts.all():
            self._open += due
            was_away = self.meet(due) is not None
        while any(not answer.call.needs_server for answer in self._open):
            was_away |= self._seeks(sought, back=comes_back) or self._take_next(waits=True)
        if self._open:
            self.thread.call(asyncio.sleep(0))  # the loop begins the last call
            if demanding := self._taken():
                was_away = self.meet(demanding) is not None
        if was_away and comes_back:
            self._return_to(here)

    def seek_answers(self) -> None:
        """Before the way home, fly to a place where servers answer waiting calls, if the detour pays."""
        if not (self.asks_servers and self._open):
            return
        here, place = self.legs.position, self.thread.call(self.seeking.beside_way_home())
        if place is None:
            return
        if distance_m(here, place) > _THERE_M:
            self.fly(place)
        self.thread.call(self.seeking.wait_here(place, here))
        if demanding := self._taken():
            self.meet(demanding)

    def after_landing(self) -> None:
        """Wait for the answers that servers give at home, and take all; the others have none."""
        if not self.asks_servers:
            return
        self.thread.call(self.seeking.after_landing())
        while self._open:
            self.thread.call(one_answered(self._open))
            for answer in self._taken():
                self._open.remove(answer)
                answer.finish_on_ground()

    @property
    def unheard(self) -> int:
        """How many open answers are not there and come without a server too; of two the first counts."""
        return sum(not (answer.is_heard or answer.call.needs_server) for answer in self._open)

    def meet(self, demanding: list[AnswerAction[Any]], onwards: Onwards | None = None) -> Place | None:
        """Act on the answers in their order, and on those that come meanwhile; return where the last was.

        Where it is known what follows, some of those that come are put off, and some that were put off are met too.
        """
        acted, self._acts, self._left_at = self._acts, True, None
        try:
            while demanding:
                here, (answer, *demanding) = self.legs.position, demanding
                self._open.remove(answer)
                if answer.away_m(here) < _THERE_M or not answer.demands():
                    answer.finish(0.0)
                else:
                    self.come_back(answer)
                come = self._taken(but=demanding)
                demanding += come if onwards is None else self._wanted_now(onwards, come) + self._due(onwards)
                demanding = [answer for answer in demanding if answer in self._open]  # an act may meet others
        finally:
            self._acts = acted
        return answer.place

    def _taken(
        self, waited_s: float = 0.0, *, but: Sequence[AnswerAction[Any]] = ()
    ) -> list[AnswerAction[Any]]:
        """The open answers that are there and have a demand, the nearest first; others that are there are taken."""
        demanding, seen, here = [], list(but), self.legs.position
        while due := [answer for answer in self._open if answer.is_due and answer not in seen]:
            for answer in due:  # those that are taken may owe acts
                seen.append(answer)
                if answer.is_held:
                    continue
                if answer.demands():
                    demanding.append(answer)
                elif answer.call.is_over:
                    self._open.remove(answer)
                    answer.finish(waited_s)
                    waited_s = 0.0
        return sorted(demanding, key=lambda answer: answer.away_m(here))

    def _wanted_now(
        self, onwards: Onwards, demanding: Sequence[AnswerAction[Any]]
    ) -> list[AnswerAction[Any]]:
        """The answers whose demands the drone meets before it goes on; the acts of others are put off."""
        now = []
        for answer in demanding:
            if self._is_put_off(answer, onwards):
                self._open.remove(answer)
            else:
                now.append(answer)
        return now

    def _due(self, onwards: Onwards) -> list[AnswerAction[Any]]:
        due = self.thread.call(self.late.due(onwards)) if self.late.acts else []
        self._open += due
        return due

    def _take_next(self, *, waits: bool = False) -> bool:
        """Wait at rest for an answer and meet its demand; return whether the drone left its place.

        With `waits` it rests here until every answer is in.
        """
        answers = [
            answer for answer in self._open if not (answer.is_held or (waits and answer.call.needs_server))
        ]
        demanding = self._taken(self.thread.call(_timed(one_answered(answers, waits=waits))))
        if demanding:
            self.meet(demanding)
        return bool(demanding)

    def _wait_below(self, count: int) -> None:
        """Wait at rest until fewer answers are open, and meet their demands; come back where a plan has the way.

        A place off the leg, as in doubt of the position, is not come back to.
        """
        here, was_away, sought = self.legs.position, False, set[str]()
        following = self._following.get(self._last) if self._last else None
        is_on_way = bool(self.legs.site.way) and (self._acts or self.legs.passes(here))
        while self.unheard >= count:
            if self._seeks(sought, following=following):
                was_away, count = True, 1  # there it waits for all
            else:
                was_away |= self._take_next()
        if was_away and is_on_way:
            self.fly_around(here)
            self.fly(here)

    def _wait_if_soon(self, answer: AnswerAction[Any]) -> None:
        """Wait at a waypoint where the drone rests for an answer that a server gives soon; meet its demand at once.

        The demands of others wait.
        """
        if not (self.asks_servers and self.rests) or self.rule.manner == "go":
            return
        if (soon_s := self.thread.call(self.seeking.soon_s(answer.call.operation))) is not None:
            waited_s = self.thread.call(_timed(one_answered([answer], within_s=_LATER * soon_s)))
            if answer.call.is_over:
                self._open.remove(answer)
                answer.demands()
                answer.finish(waited_s)

    def _seeks(self, sought: set[str], *, back: bool = True, following: Waypoint | None = None) -> bool:
        """Fly to a range where the open answers come sooner than here; return whether the drone flew.

        Answers that are there are taken first.
        """
        unheard = [answer for answer in self._open if not (answer.is_heard or answer.call.needs_server)]
        if not unheard:
            return False
        self.thread.call(asyncio.sleep(0))  # the loop begins the last call
        if any(answer.is_due for answer in unheard):
            return False
        waiting = [answer.call.operation for answer in unheard]
        sooner = self.seeking.sooner(waiting, following=following, back=back, but=sought)
        if (place := self.thread.call(sooner)) is None:
            return False
        self.fly(place)
        return True


async def _timed(wait: Coroutine[Any, Any, None]) -> float:
    begun_s = now_s()
    await wait
    return now_s() - begun_s
