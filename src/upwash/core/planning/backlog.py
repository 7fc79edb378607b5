"""Where a resting drone waits best for the answers to a line of photos: here, or in a range that it flies to.

The line is answered as in answering.py, also on the way; nothing fails. What counts is when the drone is where it has
to be afterwards, home or on its way.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping

from msgspec import Struct

from upwash.core.geo import Circle, Position, distance_m
from upwash.core.planning.answer_stops import AnswerStops
from upwash.core.planning.answering import Answering, ServerBelief
from upwash.core.planning.legs import Leg, Pace
from upwash.core.planning.motion import Motion, stay_in

LEAST_GAIN_S = 1.0


class Backlog(Struct, frozen=True, kw_only=True):
    """`photos` without an answer, each of `local_s` on the drone, and the servers that may answer them.

    After the last answer the drone flies to `after`; None: it stays where it is. Where the vehicle returns by itself,
    `home_s` has the seconds from a place to the ground at home.
    """

    photos: int
    local_s: float
    servers: Mapping[str, ServerBelief]
    gain_switch: float
    ground_speed_m_s: float
    pace: Pace
    after: Position | None
    home_s: Callable[[Position], float] | None = None

    def ends_s(self, here: Position, place: Position) -> float:
        """The seconds until the drone, which waits at the place, has all answers and is where it has to be."""
        leg = self._leg(here, place)
        motion = Motion(here, place, leg, 0.0)
        answering = Answering(self.local_s, self.servers, gain_switch=self.gain_switch)
        stays = {name: stay_in(motion, server.area) for name, server in answering.servers.items()}
        answering.moves({name: stay for name, stay in stays.items() if stay is not None})
        for photo in range(self.photos):
            answering.take(photo, 0.0)
        while answering.next_answer(math.inf) is not None:
            pass
        answered_s = max(leg.duration_s, answering.now_s)
        return answered_s + self.onwards_s(place)

    def onwards_s(self, place: Position) -> float:
        """The seconds from the place to where the drone has to be afterwards."""
        if self.home_s is not None:
            return self.home_s(place)
        return 0.0 if self.after is None else self._leg(place, self.after).duration_s

    def best(self, here: Position, may: Callable[[Position], bool]) -> tuple[str, Position] | None:
        """The server and the place in its range where it waits best, of those where it `may`; None for here."""
        places = [each for each in self._places(here) if may(each[1])]
        if not places:
            return None
        name, place = min(places, key=lambda each: self.ends_s(here, each[1]))
        return (name, place) if self.ends_s(here, place) < self.ends_s(here, here) - LEAST_GAIN_S else None

    def _places(self, here: Position) -> Iterator[tuple[str, Position]]:
        for name, server in self.servers.items():
            if server.call_s < self.local_s and isinstance(server.area, Circle):
                place = AnswerStops([server.area]).beside(here, self.after or here)
                if place is not None and place != here:
                    yield name, place

    def _leg(self, start: Position, end: Position) -> Leg:
        pace = self.pace
        length_m = distance_m(start, end.at_altitude(start.altitude_m))
        return Leg(length_m, self.ground_speed_m_s, pace.acceleration_m_s2, pace.settling_s)
