"""Stops for calls that wait for an answer, where a server can give it.

For calls that only servers compute:

    in the last range   before a leg, if the rest of the way after it, home included, passes no range
    beside the way home in the range with the shortest detour, unless home is in a range
    at home             once the drone has landed: until they are answered, or no server there answers

For calls that the drone could compute, while it rests: the policy chooses a range, or here. By default it is the
range where their line ends sooner than here, with the way there and on (core/planning/backlog.py).

No stop lasts longer than `policy.detour_s`, or than the reserve of the battery allows.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from statistics import fmean

from upwash.core.geo import Circle, Position, Waypoint
from upwash.core.operation import Operation
from upwash.core.planning.answer_stops import AnswerStops, longer_m
from upwash.core.planning.answering import ServerBelief
from upwash.core.planning.backlog import Backlog, Stay, WaitPlace
from upwash.core.planning.legs import Pace
from upwash.core.selection.selection import Selection
from upwash.drone.server_calls import ServerCalls
from upwash.eventlog import schema
from upwash.ports import Journal

_LEAST_GAIN_S = 1.0  # a stop that may not last so long is none


class Seeking:
    """Decides about these stops, and waits; on the loop.

    `home` returns where the vehicle lands, None if it does not return; `home_s` the seconds of its way home from a
    place; `spare_s` the seconds of flight that the reserve leaves, None if unknown. `believed` returns
    the servers that may compute these operations, and `where_to_wait` the server of the range where the drone waits.
    """

    def __init__(
        self,
        calls: ServerCalls,
        journal: Journal,
        *,
        selection: Selection,
        believed: Callable[[Sequence[Operation]], Mapping[str, ServerBelief]],
        where_to_wait: Callable[[Stay], str | None],
        areas: Mapping[str, Circle],
        plan: Sequence[Waypoint],
        home: Callable[[], Position | None],
        home_s: Callable[[Position], float],
        ground_speed_m_s: float,
        pace: Pace,
        gain_switch: float,
        detour_s: float,
        spare_s: Callable[[], float | None],
    ) -> None:
        self._calls = calls
        self._journal = journal
        self._selection = selection
        self._believed = believed
        self._where_to_wait = where_to_wait
        self._estimates = selection.estimates
        self._areas = areas
        self._plan = plan
        self._home = home
        self._home_s = home_s
        self._ground_speed_m_s = ground_speed_m_s
        self._pace = pace
        self._gain_switch = gain_switch
        self._detour_s = detour_s
        self._spare_s = spare_s
        self._last_legs: dict[frozenset[str], int] = {}  # of the plan that passes a range of these servers

    async def leads_away(self, here: Position, target: Waypoint) -> bool:
        """Whether the leg to the target leaves the last range of the way, while calls wait."""
        stops = self._stops()
        return stops.contains(here) and not self._leads_through(self._hosting(), target)

    def _leads_through(self, names: Iterable[str], target: Waypoint) -> bool:
        """Whether the way from the target on passes a range of these servers."""
        if target not in self._plan:
            return True  # nothing is known of the way
        home, servers = self._home(), frozenset(names)
        stops = AnswerStops([self._areas[name] for name in names])
        places = [waypoint.position for waypoint in self._plan]
        if home is not None and stops.passed([places[-1], home]):
            return True
        if servers not in self._last_legs:
            legs = range(len(places) - 1, 0, -1)
            self._last_legs[servers] = next(
                (leg for leg in legs if stops.passed(places[leg - 1 : leg + 1])), 0
            )
        return self._plan.index(target) < self._last_legs[servers] or stops.contains(target.position)

    async def beside_way_home(
        self, here: Position, allows: Callable[[Position, Position], bool]
    ) -> Position | None:
        """The place to stop at on the way home; None if none is worth it, or a fence forbids the way."""
        home, stops = self._home(), self._stops()
        if home is None:
            return here if stops.contains(here) else None
        if stops.contains(home):
            return None
        place = stops.beside(here, home)
        if place is None or self._most_s(self._extra_s(here, place, home)) < self._needed_s():
            return None
        return place if allows(here, place) and allows(place, home.at_altitude(place.altitude_m)) else None

    async def sooner(
        self,
        operations: Sequence[Operation],
        here: Position,
        allows: Callable[[Position, Position], bool],
        *,
        following: Waypoint | None,
        back: bool,
        but: set[str],
    ) -> Position | None:
        """The place in a range where the policy has the drone wait for these calls, in line; None to wait here.

        If the drone flies `back`, it comes back here; else it flies home. `following` is its next waypoint. The drone
        does not fly to the servers in `but`, which gets one more.
        """
        home = None if back else self._home()
        home_s = self._home_s if home is not None else None
        backlog = self._backlog(operations, here if back else home, home_s, but)
        onwards, spare_s = backlog.after or here, self._spare_s()
        most_s = math.inf if spare_s is None else spare_s + backlog.onwards_s(here)

        def may(place: WaitPlace) -> bool:
            ends = onwards.at_altitude(place.position.altitude_m)
            fits = place.extra_s < self._detour_s and place.ends_s <= most_s
            return fits and allows(here, place.position) and allows(place.position, ends)

        ranges = {place.server: place for place in backlog.ranges(here) if may(place)}
        if not ranges:
            return None
        passes = following is not None and self._leads_through(list(backlog.servers), following)
        places = [backlog.wait_at(here, here=here), *ranges.values()]
        server = self._where_to_wait(Stay(len(operations), places, passes))
        if server is None:
            return None
        but.add(server)
        place, extra_s = ranges[server].position, round(ranges[server].extra_s, 1)
        self._journal.record(schema.SoughtAnswers(waiting=len(operations), position=place, extra_s=extra_s))
        return place

    def _backlog(
        self,
        operations: Sequence[Operation],
        after: Position | None,
        home_s: Callable[[Position], float] | None,
        but: set[str],
    ) -> Backlog:
        """These calls; what the drone computes of one with two answers is the first."""
        computed = [
            operation if (two := self._selection.two_answers.get(operation)) is None else two.first
            for operation in operations
        ]
        times_s = [time_s for each in computed if (time_s := self._estimates.local_s(each)) is not None]
        believed = self._believed(list(dict.fromkeys(operations))) if times_s else {}
        return Backlog(
            photos=len(operations),
            local_s=fmean(times_s) if times_s else 0.0,
            servers={n: s for n, s in believed.items() if n in self._areas and n not in but},
            gain_switch=self._gain_switch,
            ground_speed_m_s=self._ground_speed_m_s,
            pace=self._pace,
            after=after,
            home_s=home_s,
        )

    async def wait_here(self, here: Position, left_from: Position | None = None) -> None:
        """Wait at the place, which was chosen when the drone was at `left_from`."""
        home = self._home()
        extra_s = 0.0 if home is None or left_from is None else self._extra_s(left_from, here, home)
        waiting = len(self._calls.waiting)
        if not waiting or (most_s := self._most_s(extra_s)) < _LEAST_GAIN_S:
            return
        self._journal.record(schema.SoughtAnswers(waiting=waiting, position=here, extra_s=round(extra_s, 1)))
        await self._calls.answered_here(most_s)

    async def after_landing(self) -> None:
        """Wait for answers at home, and end the calls that none answers."""
        await self._calls.answered_here()
        await self._calls.end_all("the flight is over, and no server in range answers")

    def _hosting(self) -> list[str]:
        """The servers with a range that can answer a waiting call."""
        waiting = dict.fromkeys(self._calls.waiting)
        return [
            name
            for name in self._areas
            if any(self._estimates.is_hosted(name, operation) for operation in waiting)
        ]

    def _stops(self) -> AnswerStops:
        return AnswerStops([self._areas[name] for name in self._hosting()])

    def _extra_s(self, here: Position, place: Position, home: Position) -> float:
        return max(0.0, longer_m(here, place, home)) / self._ground_speed_m_s

    def _most_s(self, extra_s: float) -> float:
        """How long a stop may last that makes the way longer by that time."""
        spare_s = self._spare_s()
        return min(self._detour_s, math.inf if spare_s is None else spare_s) - extra_s

    def _needed_s(self) -> float:
        """The seconds until the oldest call is answered there, at least."""
        hosting, waiting = self._hosting(), self._calls.waiting
        times_s = [
            self._estimates.check_s(name, running=False) + remote_s
            for name in hosting
            if (remote_s := self._estimates.remote_s(name, waiting[0])) is not None
        ]
        return min(times_s, default=math.inf)
