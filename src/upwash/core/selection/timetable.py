"""When a mission that is about to take off is expected at each waypoint, and over.

In seconds of the mission's time, which counts from arming to landed:

    at a waypoint   the take-off + each leg, pause and call before it, at the vehicle's pace
    over            the same at the last call's end + the way home

Where the calls run is foreseen by the policy itself, with nothing failing (core/selection/placing.py).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from msgspec import structs

from upwash.core.geo import Circle, Position
from upwash.core.knowledge.area_index import AreaIndex
from upwash.core.planning.mission_model import ExpectedCall, MissionBeliefs, MissionModel
from upwash.core.planning.pace import Pace
from upwash.core.selection.commands import Foreseen
from upwash.core.selection.lighter import LighterSettings
from upwash.core.selection.server_choice import Planning
from upwash.core.vehicle.energy import UNKNOWN, EnergyFacts, descent_s, time_home_s

_HOME = Position(0.0, 0.0)


class Timetable:
    """Foresees one mission, which takes off to `takeoff_m`, and `lands` at its last waypoint or else returns home.

    `home_s` is the time from its last call to landed, once it has begun.
    """

    def __init__(
        self,
        planning: Planning,
        beliefs: MissionBeliefs,
        areas: Mapping[str, Circle],
        index: AreaIndex,
        *,
        takeoff_m: float,
        lands: bool,
        lighter: LighterSettings | None = None,
    ) -> None:
        self.home_s = 0.0
        self._planning = planning
        self._beliefs = beliefs
        # Of its own: it sees the whole mission, from the ground.
        self._mission = MissionModel(beliefs, areas, index)
        self._takeoff_m = takeoff_m
        self._lands = lands
        self._lighter = lighter

    def begin(
        self, vehicle: EnergyFacts, found: Pace | None, *, now_s: float, position: Position
    ) -> Foreseen | None:
        """What is expected of the mission, which begins now; None where no waypoint or no call is known."""
        if not self._beliefs.plan:
            return None
        first, last = self._beliefs.plan[0], self._beliefs.plan[-1].position
        way, pace = vehicle.way_home or UNKNOWN, self._beliefs.pace_of(found)
        self.home_s = pace.home_share * (
            way.hover_s + descent_s(last.altitude_m, way)
            if self._lands
            else time_home_s(last, vehicle.home or _HOME, way)
        )
        takeoff_s = pace.takeoff_s(self._takeoff_m)
        self._mission.begun(found)
        start = Position(position.east_m, position.north_m, first.position.altitude_m)
        self._mission.leg_begun(start, first.position, first.ground_speed_m_s, now_s=now_s)
        calls = self._mission.rest(start, now_s=now_s)
        if not calls:
            return None
        reached_s, as_asked_s = self._times(calls, now_s, takeoff_s)
        if self._lighter is None:
            return Foreseen(reached_s, as_asked_s)
        of = self._lighter.operations
        lighter = [structs.replace(call, operation=of.get(call.operation, call.operation)) for call in calls]
        _, lightest_s = self._times(lighter, now_s, takeoff_s)
        return Foreseen(reached_s, as_asked_s, lightest_s, self._lighter.finish_by_s)

    def _times(
        self, calls: Sequence[ExpectedCall], now_s: float, takeoff_s: float
    ) -> tuple[Sequence[float], float]:
        """When the drone is at each waypoint, and landed."""
        stop = self._beliefs.stop
        placing = self._planning.placing(now_s)
        reached_s: list[float] = []
        at_s = takeoff_s
        for number, (call, place) in enumerate(zip(calls, placing.places(calls), strict=True)):
            at_s += call.gap_s
            if number % len(stop) == 0:
                reached_s.append(at_s - stop[0].pause_s)
            at_s += placing.delay_s(place, call)
        return reached_s, at_s + self.home_s
