"""What a simulated mission did between its calls, however long it waited for them and wherever it turned back."""

from __future__ import annotations

from dataclasses import dataclass

from upwash.core.planning.bound import Onward
from upwash.eventlog import schema
from upwash.eventlog.progress import CallPlaces
from upwash.eventlog.schema import Event


@dataclass(slots=True)
class _Way:
    """From one call that the mission started to the next one, or to what waits for its answer."""

    waypoint: int | None
    begun_s: float
    left_out_s: float = 0.0  # what the mission waited, did about the answer, and flew in vain
    departed_s: float | None = None
    leg_s: float = 0.0
    demanded: bool = False
    ended_s: float | None = None


@dataclass(frozen=True, slots=True)
class Passage:
    """What follows a call; the drone departs for the next one at `departed_s`, or does not."""

    onward: Onward
    departed_s: float | None
    ended_s: float


class Ways:
    """Follows a mission event by event. Calls have their numbers in the log, from 0 on.

    `waited_s` is how long the mission waited for each answer that it had not waited for at once, and `in_vain_s` how
    long it flew back, with the legs that it flew twice or in vain for that.
    """

    def __init__(self) -> None:
        self.waited_s: dict[int, float] = {}
        self.in_vain_s = 0.0
        self._whereabouts = CallPlaces()
        self._ways: dict[int, _Way] = {}
        self._way: _Way | None = None
        self._started = 0  # calls that are not over
        self._leg_begun_s: float | None = None
        self._turned_s: float | None = None
        self._again = False  # whether the next leg was flown before
        self._taken_s = 0.0

    def take(self, event: Event) -> None:
        """Takes in the next event."""
        self._whereabouts.take(event)
        match event:
            case schema.CallStarted(waypoint=waypoint):
                self._end(event.t)
                self._way = _Way(waypoint, event.t)
                self._started += 1
            case schema.Call() if self._started:
                self._started -= 1
            case schema.Call(at_s=begun_s):
                self._end(begun_s)
            case schema.Returning() | schema.Landing() | schema.Holding():
                self._end(event.t)
            case schema.AnswerTaken():
                self._take_answer(event)
            case schema.Acted():
                self._leave_out(event.t - self._taken_s)
            case schema.SetOff():
                self._leg_begun_s = event.t
                if self._way is not None and self._way.departed_s is None:
                    self._way.departed_s = event.t
            case schema.TurnedBack():
                self._again = self._leg_begun_s is None
                self._fly_in_vain(event.t, since_s=self._leg_begun_s)
                self._turned_s = event.t
            case schema.Arrived():
                self._arrive(event.t)

    def after(self, number: int) -> Passage | None:
        """What follows the call of that number; None for one that the mission waited for at once."""
        way = self._ways.get(number)
        if way is None or way.ended_s is None:
            return None
        onward = Onward(way.ended_s - way.begun_s - way.left_out_s, way.leg_s, way.demanded)
        return Passage(onward, way.departed_s, way.ended_s)

    def _take_answer(self, event: schema.AnswerTaken) -> None:
        self._taken_s = event.t
        self._leave_out(event.waited_s)
        self._started -= bool(event.failed)
        if (number := self._whereabouts.answered) is not None:
            self.waited_s[number] = event.waited_s
            if self._way is not None and self._way.waypoint == event.waypoint:
                self._ways[number] = self._way
                self._way.demanded = event.demanded

    def _arrive(self, at_s: float) -> None:
        begun_s, self._leg_begun_s = self._leg_begun_s, None
        if self._turned_s is not None:
            self._fly_in_vain(at_s, since_s=self._turned_s)
            self._turned_s = None
        elif self._again:
            self._fly_in_vain(at_s, since_s=begun_s)
            self._again = False
        elif self._way is not None and begun_s is not None and not self._way.leg_s:
            self._way.leg_s = at_s - begun_s

    def _fly_in_vain(self, now_s: float, *, since_s: float | None) -> None:
        if since_s is not None:
            self.in_vain_s += now_s - since_s
            self._leave_out(now_s - since_s)

    def _leave_out(self, duration_s: float) -> None:
        if self._way is not None:
            self._way.left_out_s += duration_s

    def _end(self, at_s: float) -> None:
        if self._way is not None:
            self._way.ended_s = at_s
            self._way = None
