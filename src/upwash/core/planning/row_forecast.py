"""How long a mission of rows takes at a ground speed, and whether its answers keep up with its photos.

The drone flies as drone/rows.py has it: each row is one leg, from rest to rest; with too many open answers it stops
until there are fewer; a demand turns it back, at once or where that costs least (acts.py). At the end it waits in a
range where that is sooner (backlog.py). Photos are answered as in answering.py.

Left out: heat, noise, faults, other drones, and stops that `policy.stay_or_go = "learn"` would make.
"""

from __future__ import annotations

import copy
import itertools
import math
import operator
from collections.abc import Callable, Mapping, Sequence

from msgspec import Struct

from upwash.core.geo import Circle, Position, Via, Waypoint, distance_m, first_on_way, row_of
from upwash.core.planning.acts import Acts, Way, cheapest
from upwash.core.planning.answer_stops import AnswerStops
from upwash.core.planning.answering import Answering, ServerBelief
from upwash.core.planning.backlog import LEAST_GAIN_S
from upwash.core.planning.legs import Motion, Pace, passes

_THERE_M = 1.0  # from a place that need not be flown to
_ANY_M_S = 1000.0


class RowMission(Struct, frozen=True, kw_only=True):
    """What is known of a mission of rows before take-off.

    The vehicle starts over `start`. A photo takes `photo_s`, and its answer `local_s` on the drone. The answers to
    the `demanding` photos turn the drone back, each for an action of `action_s` that begins `act_within_s`. With
    `at_most` open answers it stops. After the last photo it flies over `leaving`. `home_s` has the seconds from a
    place to the ground; a vehicle that does not return lands at the last one.
    """

    plan: Sequence[Waypoint]
    leaving: Sequence[Via] = ()
    start: Position
    pace: Pace
    takeoff_s: float
    home_s: Callable[[Position], float]
    returns: bool = True
    photo_s: float
    local_s: float
    servers: Mapping[str, ServerBelief] = {}
    gain_switch: float = 0.25
    newest: bool = False
    at_most: int = 100
    demanding: frozenset[int] = frozenset()
    action_s: float = 0.0
    act_within_s: float = math.inf


class RowAnswers(Struct, frozen=True, kw_only=True):
    """One row: its photos, those taken a second, answers that could be given a second, and the most open answers."""

    row: int
    photos: int
    photos_per_s: float
    answers_per_s: float
    most_open: int


class RowForecast(Struct, frozen=True, kw_only=True):
    """A forecast at one ground speed: the mission's time, each row, and how often the drone stops for answers.

    `waited_s` is the time that it waits for answers, at these stops and at the end.
    """

    ground_speed_m_s: float
    mission_s: float
    rows: tuple[RowAnswers, ...]
    stops: int
    waited_s: float
    turns_back: int

    @property
    def most_open(self) -> int:
        """The most open answers on any row."""
        return max(row.most_open for row in self.rows)

    @property
    def photos_per_s(self) -> float:
        """Photos that are taken a second on the rows, on average."""
        return self._over_rows([row.photos_per_s for row in self.rows])

    @property
    def answers_per_s(self) -> float:
        """Answers a second that the drone and its servers could give on the rows, on average."""
        return self._over_rows([row.answers_per_s for row in self.rows])

    @property
    def keeps_up_m_s(self) -> float:
        """The highest ground speed with no more photos a second than answers; infinite if any speed has."""
        taken_per_s, answered_per_s = self.photos_per_s, self.answers_per_s
        speed_m_s = self.ground_speed_m_s * answered_per_s / taken_per_s if taken_per_s > 0 else math.inf
        return speed_m_s if speed_m_s < _ANY_M_S else math.inf

    def _over_rows(self, rates_per_s: Sequence[float]) -> float:
        """The mean of rates, each row by its photos."""
        legs = [row.photos - 1 for row in self.rows]
        return sum(map(operator.mul, rates_per_s, legs)) / sum(legs) if any(legs) else 0.0


def forecast_rows(mission: RowMission, ground_speed_m_s: float) -> RowForecast:
    """The forecast of a mission with at least one row."""
    return _Flight(mission, ground_speed_m_s).flown()


class _Flight:
    """One mission, flown step by step."""

    def __init__(self, mission: RowMission, ground_speed_m_s: float) -> None:
        self._mission = mission
        self._speed_m_s = ground_speed_m_s
        self._answering = Answering(
            mission.local_s, mission.servers, gain_switch=mission.gain_switch, newest=mission.newest
        )
        self._gives_answers = mission.local_s < math.inf  # so that the drone may wait for its own answers
        self._here = mission.start
        self._motion: Motion | None = None
        self._open: set[int] = set()
        self._demanding: list[int] = []  # photos whose answers are there
        self._target = 0  # the next photo
        self._acts = Acts[int](
            mission.plan,
            leaving=[via.position for via in mission.leaving],
            ground_speed_m_s=ground_speed_m_s,
            pace=mission.pace,
            photo_s=mission.photo_s,
            home_s=mission.home_s if mission.returns else None,
        )
        self._row_open = self._stops = self._turns_back = 0
        self._waited_s = 0.0

    def flown(self) -> RowForecast:
        plan = self._mission.plan
        self._hover(self._mission.takeoff_s)
        spots = itertools.groupby(range(len(plan)), key=lambda index: row_of(plan[index]) or index)
        rows = [self._flown_row(number, list(row)) for number, (_, row) in enumerate(spots)]
        self._target = len(plan)
        self._fly_over(self._mission.leaving)
        self._brake()  # behind a last spot that is not the row's end
        last = self._here
        self._demanding += self._acts.all()
        self._meet()
        if self._gives_answers:
            self._wait_where_best()
        if not self._mission.returns:
            self._fly(last)
        return RowForecast(
            ground_speed_m_s=self._speed_m_s,
            mission_s=self._now_s + self._mission.home_s(self._here),
            rows=tuple(rows),
            stops=self._stops,
            waited_s=self._waited_s,
            turns_back=self._turns_back,
        )

    def _flown_row(self, number: int, row: Sequence[int]) -> RowAnswers:
        """Fly a row of waypoints."""
        plan, marks = self._mission.plan, list[tuple[float, float]]()
        for index in row:
            self._reach(index)
            if index == row[0]:
                self._row_open = 0
            marks.append((self._now_s, self._answering.could))
            self._take_photo(index)
        (begun_s, could_before), (ended_s, could) = marks[0], marks[-1]
        length_m = distance_m(plan[row[0]].position, plan[row[-1]].position)
        flown_m_s = (plan[row[-1]].ground_speed_m_s or self._speed_m_s) * (len(row) - 1)
        return RowAnswers(
            row=number,
            photos=len(row),
            photos_per_s=flown_m_s / length_m if length_m else 0.0,
            answers_per_s=(could - could_before) / (ended_s - begun_s) if ended_s > begun_s else 0.0,
            most_open=self._row_open,
        )

    @property
    def _now_s(self) -> float:
        return self._answering.now_s

    def _reach(self, index: int) -> None:
        """Pass the waypoint, or rest there and set off for the following one."""
        plan = self._mission.plan
        waypoint, self._target = plan[index], index
        if index and self._acts.waits_after(index - 1):
            self._demanding += self._acts.due_after(index - 1)
            self._hover(self._mission.photo_s)
            self._meet(Way(self._here, index, first_on_way(waypoint).position))
        self._fly_over(waypoint.via)
        self._get_to(waypoint.position, self._leg_end(index) or waypoint.position, waypoint.ground_speed_m_s)
        if self._motion is None:
            self._hover(waypoint.hold_s)
            if index + 1 < len(plan) and not self._acts.waits_after(index):
                following = plan[index + 1]
                first = first_on_way(following)
                end = None if following.via else self._leg_end(index + 1)
                self._set_off(end or first.position, first.ground_speed_m_s)

    def _fly_over(self, places: Sequence[Via]) -> None:
        """Rest at each of the places."""
        for via in places:
            self._get_to(via.position, via.position, via.ground_speed_m_s)
            if self._motion is not None:
                self._fly(via.position)
            self._hover(via.hold_s)

    def _get_to(self, place: Position, end: Position, ground_speed_m_s: float | None) -> None:
        """Pass the place, or rest there, and meet demands on the way; from rest it sets off for `end`."""
        if self._motion is not None and self._motion.passes_s(place) is None:
            self._brake()
        if self._motion is None:
            self._set_off(end, ground_speed_m_s)
        self._turn_back(place)
        while True:
            motion = self._motion
            assert motion is not None  # noqa: S101 - a leg is flown
            reached_s = motion.passes_s(place)
            if reached_s is None:  # it was braking when it passed the place
                self._fly(place)
                break
            if not self._demanding and self._goes_on(reached_s):
                break
            self._turn_back(place)
        if self._motion is not None and place == self._motion.end:
            self._rest(place)

    def _leg_end(self, index: int) -> Position | None:
        """The end of the waypoint's row, or the first spot on the way there where the drone rests for acts.

        None if the drone is not on that row, or the waypoint is not ahead.
        """
        plan, waypoint = self._mission.plan, self._mission.plan[index]
        if (row := row_of(waypoint)) is None:
            return None
        start, end = row
        is_on_row = index > 0 and row_of(plan[index - 1]) == row
        is_on_row |= start is not None and distance_m(self._here, start) < _THERE_M
        if not (is_on_row and passes(self._here, end, waypoint.position)):
            return None
        ahead = itertools.takewhile(lambda spot: plan[spot].row_end == end, range(index, len(plan)))
        return next((plan[spot].position for spot in ahead if self._acts.waits_after(spot)), end)

    def _take_photo(self, photo: int) -> None:
        self._open.add(photo)
        self._row_open = max(self._row_open, len(self._open))
        self._answering.take(photo, self._now_s + self._mission.photo_s)
        if self._gives_answers and len(self._open) >= self._mission.at_most:
            self._stops += 1
            self._brake()
            self._wait_below(self._mission.at_most)

    def _wait_where_best(self) -> None:
        """Wait for all answers here, or in a range where that ends sooner (backlog.py)."""
        areas = [each.area for each in self._answering.servers.values() if isinstance(each.area, Circle)]
        places = [AnswerStops([area]).beside(self._here, self._here) for area in areas]
        ends = [(self._waited_s_at(place), place) for place in places if place not in (None, self._here)]
        ended_s, place = min(ends, key=lambda end: end[0], default=(math.inf, None))
        if place is not None and ended_s < self._waited_s_at(self._here) - LEAST_GAIN_S:
            self._fly(place)
        self._wait_below(1)

    def _waited_s_at(self, place: Position | None) -> float:
        """When all answers would be there, if the drone waited at the place."""
        trial = copy.deepcopy(self, {id(self._mission): self._mission})
        if place is not None and place != self._here:
            trial._fly(place)
        trial._wait_below(1)
        return trial._now_s

    def _wait_below(self, least: int) -> None:
        """Wait at rest until fewer answers are open, and meet their demands."""
        self._meet()
        while len(self._open) >= least:
            begun_s = self._now_s
            self._goes_on(math.inf)
            self._waited_s += self._now_s - begun_s
            self._meet()

    def _goes_on(self, until_s: float) -> bool:
        """Go on to that time and return True, or False where a demand is there before."""
        while (photo := self._answering.next_answer(max(self._now_s, until_s))) is not None:
            self._open.remove(photo)
            if photo in self._mission.demanding:
                self._demanding.append(photo)
                return False
            if until_s == math.inf:
                return False
        return True

    def _turn_back(self, spot: Position) -> None:
        """Fly back for the acts that the drone does before the spot, and put the others off."""
        motion = self._motion
        assert motion is not None  # noqa: S101 - a leg is flown
        left, end = motion.place(self._now_s), motion.end
        way = Way(left, self._target, end if spot == end else left, end, motion.stop(self._now_s)[1])
        self._choose(way)
        if not self._demanding:
            return
        self._brake()
        last = self._meet(way)
        if spot != end and not (last is not None and passes(last, end, spot)):
            self._fly(left)
        self._set_off(end, motion.leg.ground_speed_m_s)

    def _choose(self, way: Way) -> None:
        """Put off the acts that cost less further on, and take those that cost no more now."""
        for photo in list(self._demanding):
            place = self._mission.plan[photo].position
            late = self._acts.choice(place, way, within_s=self._mission.act_within_s)
            if (chosen := cheapest(late)) is not None:
                self._acts.put_off(photo, place, late.gaps[chosen])
                self._demanding.remove(photo)
        self._demanding += self._acts.take(way, lambda _, late: cheapest(late) is None)

    def _meet(self, way: Way | None = None) -> Position | None:
        """Fly to the photos with a demand, in their order, and act there; return the last place.

        Acts that come meanwhile may be put off by a drone that goes on along its way.
        """
        last = None
        demanding, self._demanding = self._demanding, []
        while demanding:
            last = self._mission.plan[demanding.pop(0)].position
            if distance_m(self._here, last) >= _THERE_M:
                self._turns_back += 1
                self._fly(last)
            self._hover(self._mission.action_s)
            if way is not None:
                self._choose(way._replace(here=self._here, rest=None))
            demanding += self._demanding
            self._demanding.clear()
        return last

    def _set_off(self, end: Position, ground_speed_m_s: float | None = None) -> None:
        length_m = distance_m(self._here, end)
        leg = self._mission.pace.leg(length_m, ground_speed_m_s or self._speed_m_s)
        self._motion = Motion(self._here, end, leg, self._now_s)
        self._answering.flies(self._motion)

    def _brake(self) -> None:
        motion = self._motion
        if motion is None:
            return
        rests_s, place = motion.stop(self._now_s)
        self._finish(rests_s)
        self._rest(place)

    def _fly(self, end: Position) -> None:
        """Fly to a place, from rest to rest."""
        self._brake()
        self._set_off(end)
        assert self._motion is not None  # noqa: S101 - it was set off
        self._finish(self._now_s + self._motion.leg.duration_s)
        self._rest(end)

    def _rest(self, place: Position) -> None:
        self._here, self._motion = place, None
        self._answering.rests(place)

    def _hover(self, duration_s: float) -> None:
        self._rest(self._here)
        self._finish(self._now_s + duration_s)

    def _finish(self, at_s: float) -> None:
        """Go on to that time, and keep demands for later."""
        while not self._goes_on(at_s):
            pass
