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

import asyncio
import contextlib
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from statistics import fmean

from upwash.config.drone import DroneConfig
from upwash.config.places import ending, server_areas
from upwash.core.call.on_servers import patience_s
from upwash.core.call.steps import EndWaiting
from upwash.core.geo import Circle, Position, Waypoint
from upwash.core.operation import Operation
from upwash.core.planning.answer_stops import AnswerStops, longer_m
from upwash.core.planning.backlog import Backlog, Stay, WaitPlace
from upwash.core.selection.selection import Selection
from upwash.drone.legs import Legs
from upwash.drone.offloading import Offloading
from upwash.drone.reserve import ReserveWatch
from upwash.eventlog import schema

_LEAST_GAIN_S = 1.0  # a stop that may not last so long is none


@dataclass(eq=False)
class Seeking:
    """Decides about these stops, and waits; on the loop. `waiting` are the open calls that only servers compute."""

    config: DroneConfig
    selection: Selection
    offloading: Offloading
    legs: Legs
    reserve: ReserveWatch

    def __post_init__(self) -> None:
        is_offloading = self.config.policy.name != "local-only"
        areas = server_areas(self.config) if is_offloading else {}
        self._areas = {name: area for name, area in areas.items() if isinstance(area, Circle)}
        self._last_legs: dict[frozenset[str], int] = {}  # of the plan that passes a range of these servers

    async def leads_away(self, target: Waypoint) -> bool:
        """Whether the leg to the target leaves the last range of the way, while calls wait."""
        return self._stops().contains(self.legs.position) and not self._leads_through(self._hosting(), target)

    def _leads_through(self, names: Iterable[str], target: Waypoint) -> bool:
        """Whether the way from the target on passes a range of these servers."""
        if target not in self.legs.site.waypoints:
            return True  # nothing is known of the way
        home, servers = self._home, frozenset(names)
        stops = AnswerStops([self._areas[name] for name in names])
        places = [waypoint.position for waypoint in self.legs.site.waypoints]
        if home is not None and stops.passed([places[-1], home]):
            return True
        if servers not in self._last_legs:
            legs = range(len(places) - 1, 0, -1)
            self._last_legs[servers] = next(
                (leg for leg in legs if stops.passed(places[leg - 1 : leg + 1])), 0
            )
        return self.legs.site.waypoints.index(target) < self._last_legs[servers] or stops.contains(
            target.position
        )

    async def beside_way_home(self) -> Position | None:
        """The place to stop at on the way home; None if none is worth it, or a fence forbids the way."""
        here, home, stops = self.legs.position, self._home, self._stops()
        if home is None:
            return here if stops.contains(here) else None
        if stops.contains(home):
            return None
        place = stops.beside(here, home)
        if place is None or self._most_s(self._extra_s(here, place, home)) < self._needed_s():
            return None
        return place if self._allows(here, place, home) else None

    async def sooner(
        self,
        operations: Sequence[Operation],
        *,
        following: Waypoint | None,
        back: bool,
        but: set[str],
    ) -> Position | None:
        """The place in a range where the policy has the drone wait for these calls, in line; None to wait here.

        If the drone flies `back`, it comes back here; else it flies home. `following` is its next waypoint. The drone
        does not fly to the servers in `but`, which gets one more.
        """
        here, home = self.legs.position, None if back else self._home
        backlog = self._backlog(operations, here if back else home, but, flies_home=home is not None)
        onwards, spare_s = backlog.after or here, self.reserve.spare_s()
        most_s = math.inf if spare_s is None else spare_s + backlog.onwards_s(here)

        def may(place: WaitPlace) -> bool:
            fits = place.extra_s < self.config.policy.detour_s and place.ends_s <= most_s
            return fits and self._allows(here, place.position, onwards)

        ranges = {place.server: place for place in backlog.ranges(here) if may(place)}
        if not ranges:
            return None
        passes = following is not None and self._leads_through(list(backlog.servers), following)
        places = [backlog.wait_at(here, here=here), *ranges.values()]
        stay, policy = Stay(len(operations), places, passes), self.selection.policy
        if (server := self.offloading.ask(lambda: policy.where_to_wait(stay))) is None:
            return None
        but.add(server)
        place, extra_s = ranges[server].position, round(ranges[server].extra_s, 1)
        self.legs.journal.record(
            schema.SoughtAnswers(waiting=len(operations), position=place, extra_s=extra_s)
        )
        return place

    def _allows(self, here: Position, place: Position, onwards: Position) -> bool:
        allows = self.legs.allows
        return allows(here, place) and allows(place, onwards.at_altitude(place.altitude_m))

    def _backlog(
        self, operations: Sequence[Operation], after: Position | None, but: set[str], *, flies_home: bool
    ) -> Backlog:
        """These calls; what the drone computes of one with two answers is the first."""
        local_s, two_answers = self.selection.estimates.local_s, self.selection.two_answers
        computed = [two.first if (two := two_answers.get(each)) else each for each in operations]
        times_s = [time_s for each in computed if (time_s := local_s(each)) is not None]
        of_calls, offloading = list(dict.fromkeys(operations)), self.offloading
        believed = offloading.ask(lambda: offloading.planning.believed(of_calls)) if times_s else {}
        return Backlog(
            photos=len(operations),
            local_s=fmean(times_s) if times_s else 0.0,
            servers={n: s for n, s in (believed or {}).items() if n in self._areas and n not in but},
            gain_switch=self.config.policy.gain_switch,
            ground_speed_m_s=self.config.mission.ground_speed_m_s,
            pace=self.reserve.pace,
            after=after,
            home_s=self.reserve.home_s if flies_home else None,
        )

    async def wait_here(self, here: Position, left_from: Position | None = None) -> None:
        """Wait at the place, which was chosen when the drone was at `left_from`."""
        home = self._home
        extra_s = 0.0 if home is None or left_from is None else self._extra_s(left_from, here, home)
        waiting = len(self.offloading.waiting())
        if not waiting or (most_s := self._most_s(extra_s)) < _LEAST_GAIN_S:
            return
        self.legs.journal.record(
            schema.SoughtAnswers(waiting=waiting, position=here, extra_s=round(extra_s, 1))
        )
        await self._answered_here(most_s)

    async def after_landing(self) -> None:
        """Wait for answers at home, and end the calls that none answers."""
        await self._answered_here()
        self.offloading.tell(EndWaiting("the flight is over, and no server in range answers"))
        while self.offloading.waiting():
            await self.offloading.happened()

    async def _answered_here(self, at_most_s: float = math.inf) -> None:
        """Return when no call waits, or when no server in range answers the next one, and after that time at most."""
        waiting, reach_s = self.offloading.waiting, self.offloading.reach_s
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(at_most_s if at_most_s < math.inf else None):
                while calls := waiting():
                    reaches = [reach_s(operation) for operation in dict.fromkeys(calls)]
                    slowest_s = max((each_s for each_s in reaches if each_s is not None), default=None)
                    if slowest_s is None:
                        return
                    async with asyncio.timeout(patience_s(slowest_s)):
                        while len(waiting()) == len(calls):
                            await self.offloading.happened()

    async def soon_s(self, operation: Operation) -> float | None:
        """Seconds until a call made now is answered here; None if a stop is not worth it."""
        reach_s, alone_s = self.offloading.reach_s(operation), self.selection.estimates.alone_s(operation)
        if reach_s is None or alone_s is None:
            return None
        soon_s = reach_s * max(1, len(self.offloading.waiting()))
        return soon_s if soon_s <= alone_s else None

    @property
    def _home(self) -> Position | None:
        returns = ending(self.config.mission) == "return"
        energy, here = self.legs.autopilot.energy, self.legs.position
        return energy.returns_to(here).position if returns else None

    def _hosting(self) -> list[str]:
        waiting, is_hosted = dict.fromkeys(self.offloading.waiting()), self.selection.estimates.is_hosted
        return [name for name in self._areas if any(is_hosted(name, each) for each in waiting)]

    def _stops(self) -> AnswerStops:
        return AnswerStops([self._areas[name] for name in self._hosting()])

    def _extra_s(self, here: Position, place: Position, home: Position) -> float:
        return max(0.0, longer_m(here, place, home)) / self.config.mission.ground_speed_m_s

    def _most_s(self, extra_s: float) -> float:
        """How long a stop may last that makes the way longer by that time."""
        spare_s = self.reserve.spare_s()
        return min(self.config.policy.detour_s, math.inf if spare_s is None else spare_s) - extra_s

    def _needed_s(self) -> float:
        """The seconds until the oldest call is answered there, at least."""
        estimates, oldest = self.selection.estimates, next(iter(self.offloading.waiting()), None)
        times_s = [
            estimates.check_s(name, running=False) + remote_s
            for name in self._hosting()
            if oldest and (remote_s := estimates.remote_s(name, oldest)) is not None
        ]
        return min(times_s, default=math.inf)
