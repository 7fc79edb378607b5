"""Flying on with an answer open, and coming back to its waypoint where it demands something.

    stay    wait, then act there
    go      the next leg; an answer on the way that demands something: brake, fly back, act, and set off again
            at the next waypoint: whatever comes before the next call, then wait, and one leg back where it demands it

Everything here runs in the mission's thread.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

from upwash.core.geo import Position, Waypoint
from upwash.core.planning.stay_or_go import Outlook, StayOrGo
from upwash.drone.pending import Calls, Demand, Pending
from upwash.eventlog import schema

T = TypeVar("T")
Place = Waypoint | Position


def index_of(place: Place | None) -> int | None:
    """Which waypoint a place is, if it is one."""
    return place.index if isinstance(place, Waypoint) else None


class Wings(Protocol):
    """What flies, as far as it matters here."""

    @property
    def place(self) -> Place | None:
        """Where it was last sent to."""

    @property
    def position(self) -> Position:
        """Where it is."""

    def _fly(self, place: Place, *, unless: Demand[Any] | None = None, back: bool = False) -> bool:
        """Flies there; False, at rest on the way, where the answer demands something before the arrival."""

    def _leave_open(self, answer: OpenAnswer[Any]) -> None:
        """The answer is settled by the verbs that follow."""


@dataclass(frozen=True, slots=True)
class Errand(Generic[T]):
    """What is to be done about an answer: `act`, at the place, where it makes `demands` true.

    An exception of the call goes to `failed` there, or to the mission where there is none.
    """

    pending: Pending[T]
    act: Callable[[T], object]
    demands: Callable[[T], object]
    failed: Callable[[Exception], object] | None
    place: Place | None

    @property
    def waypoint(self) -> int | None:
        """The waypoint that it is about, if it is one."""
        return index_of(self.place)


class OpenAnswer(Generic[T]):
    """One errand, from the call on until it is done."""

    def __init__(self, errand: Errand[T], wings: Wings, calls: Calls, rule: StayOrGo) -> None:
        self._errand = errand
        self._wings = wings
        self._calls = calls
        self._rule = rule
        self._demand = errand.pending.demands(errand.demands)
        self.is_away = False  # whether the drone has left the waypoint
        self.is_over = False

    def settle(self) -> None:
        """Waits for the answer; does what it demands, at its waypoint, and returns to where the drone is."""
        here, waited_s = self._wings.place, self._errand.pending._wait()
        if self.is_away and self._demand.holds():
            self._errand.pending._note_demand()
            self._come_back(waited_s)
            if here is not None:
                self._wings._fly(here)
        else:
            self._finish(waited_s)

    def fly_on(self, place: Place) -> None:
        """Flies one leg with the answer open; before another one the drone waits for it."""
        if self.is_away:
            self.settle()
            self._wings._fly(place)
            return
        self.is_away = True
        if not self._wings._fly(place, unless=self._demand):
            self._come_back(0.0)
            self._wings._fly(place)
        elif self._errand.pending.done():  # in the moment of the arrival, or demanding nothing
            self.settle()

    def _come_back(self, waited_s: float) -> None:
        errand = self._errand
        self._calls.note(schema.TurnedBack(waypoint=errand.waypoint, position=self._wings.position))
        if errand.place is not None:
            self._wings._fly(errand.place, back=True)
        self._finish(waited_s)

    def _finish(self, waited_s: float) -> None:
        """Takes the answer, and acts where it demands it; raises what the call raises."""
        self.is_over = True
        errand = self._errand
        demanded = self._demand.holds()
        self._rule.answered(demanded=demanded)
        errand.pending._take(waited_s, demanded=demanded)
        if not demanded:
            return
        try:
            answer = errand.pending._answer()
        except Exception as error:
            if errand.failed is None:
                raise
            errand.failed(error)
        else:
            errand.act(answer)
        self._calls.note(schema.Acted(waypoint=errand.waypoint))


class Errands:
    """Has each answer settled, at once or on the way, as the rule says; for the mission's thread."""

    def __init__(
        self, wings: Wings, calls: Calls, *, rule: StayOrGo, outlook: Callable[[], Outlook | None]
    ) -> None:
        self._wings = wings
        self._calls = calls
        self._rule = rule
        self._outlook = outlook

    def run(self, errand: Errand[Any]) -> None:
        """Waits for the answer and does what it demands, or leaves that open and returns."""
        answer = OpenAnswer(errand, self._wings, self._calls, self._rule)
        if self._goes(errand):
            self._wings._leave_open(answer)
        else:
            answer.settle()

    def _goes(self, errand: Errand[Any]) -> bool:
        if self._rule.manner == "stay" or errand.pending.done():
            return False
        verdict = self._calls.on_loop(lambda: self._rule.decide(self._outlook()))
        self._calls.note(
            schema.StayOrGo(
                waypoint=errand.waypoint,
                goes=verdict.goes,
                why=verdict.why,
                chance=verdict.chance,
                saved_s=verdict.saved_s,
                lost_s=verdict.lost_s,
            )
        )
        return verdict.goes
