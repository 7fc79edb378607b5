"""A mission's expected times at its waypoints and of its end, and the calls that run lighter so that it ends in time.

In seconds of the mission's time, which counts from arming to landed:

    at a waypoint   the take-off + each leg, pause and call before it, at the vehicle's pace
    over            the same at the last call's end + the way home
    forecast        the time used by now + this call + each pause, leg and call ahead + the way home,
                    all calls as they are asked for
    late            forecast - finish_by; where it is not above 0, no call is lighter
    saved           by a call in the lighter mode, in the place where the call is expected to run; never below 0
    lighter         a call that saves something, where the later calls that save more, all together, save less
                    than `late`

So the calls that save most are made lighter first, which are those on the drone; of calls that save alike, the
soonest. Where all of them save less than `late`, all are lighter. An earlier `finish_by` never makes a call heavier.
Each call is judged anew, by the measurements until then. Where calls run is foreseen by the policy itself
(call_forecast.py).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from msgspec import structs

from upwash.core.geo import Position
from upwash.core.operation import Operation
from upwash.core.planning.legs import Pace
from upwash.core.planning.mission_model import CallClock, ExpectedCall, MissionBeliefs, MissionModel
from upwash.core.policies.policy import Lightened
from upwash.core.selection.call_forecast import CallPlace
from upwash.core.selection.moment import Moment, Part
from upwash.core.selection.server_planning import ServerPlanning
from upwash.core.vehicle.way_home import UNKNOWN, EnergyFacts, descent_s
from upwash.eventlog.schema import Foreseen


def is_lighter(saves_s: float, others_save_s: Iterable[float], late_s: float) -> bool:
    """Whether a call runs in the lighter mode, by the seconds that it and the coming calls would save."""
    return saves_s > 0 and sum(each_s for each_s in others_save_s if each_s > saves_s) < late_s


class MissionTimes(Part):
    """Foresees one mission, and decides which of its calls run lighter.

    `mission` is a model of its own: it sees the whole mission, from the ground.
    """

    def __init__(
        self, moment: Moment, planning: ServerPlanning, beliefs: MissionBeliefs, mission: MissionModel
    ) -> None:
        super().__init__(moment)
        self._planning, self._beliefs, self._mission = planning, beliefs, mission
        self._begun_s: float | None = None  # the mission's time
        self._leaving_s = 0.0  # from the last waypoint over the places after it
        self._home_s = 0.0  # from there to landed

    def judge(self, operation: Operation, *, on_drone: bool = False) -> Lightened | None:
        """The lighter operation of a call that is made now; None if it runs as asked for.

        Tell the planning's model of the call first. With `on_drone` the drone computes the call.
        """
        settings, now_s = self._settings.lighter, self._now_s
        if settings is None or self._begun_s is None or operation not in settings.operations:
            return None
        lighter_of, placing = settings.operations, self._planning.placing()
        rest = self._planning.mission.rest(self._moment.here, now_s=now_s)
        calls = [self._planning.made_now(operation), *rest]
        places = list(placing.places(calls))
        if on_drone:
            places[0] = CallPlace()
        placed = list(zip(places, calls, strict=True))
        takes_s = [placing.delay_s(place, call) for place, call in placed]
        lighter_s = [placing.delay_s(place, call, lighter_of.get(call.operation)) for place, call in placed]
        home_s = self._leaving_s + self._home_s
        forecast_s = now_s - self._begun_s + _over_s(calls, takes_s) + home_s
        saves_s = [max(0.0, as_asked - less) for as_asked, less in zip(takes_s, lighter_s, strict=True)]
        if not is_lighter(saves_s[0], saves_s[1:], forecast_s - settings.finish_by_s):
            return None
        return Lightened(lighter_of[operation], operation, forecast_s, settings.finish_by_s)

    def begin(self, vehicle: EnergyFacts, found: Pace | None) -> None:
        """Note that the mission begins now; log its expected times, if a waypoint and a call are known."""
        self._begun_s = now_s = self._now_s
        if not self._beliefs.plan:
            return
        first, last = self._beliefs.plan[0], self._beliefs.plan[-1].position
        if self._beliefs.leaving:
            last = self._beliefs.leaving[-1].position
        way, pace = vehicle.way_home or UNKNOWN, self._beliefs.pace_of(found)
        self._home_s = pace.home_share * (
            way.hover_s + descent_s(last.altitude_m, way)
            if self._settings.lands
            else vehicle.time_home_s(last)
        )
        takeoff_s = pace.takeoff_s(self._settings.takeoff_m)
        self._mission.begun(found)
        self._leaving_s = self._mission.leaving_s()
        height_m = first.position.altitude_m
        if first.row_end is not None:  # of a survey, whose first leg may climb on
            height_m = self._settings.takeoff_m or height_m
        here = self._moment.here
        start = Position(here.east_m, here.north_m, height_m)
        self._mission.leg_begun(start, first.position, first.ground_speed_m_s, now_s=now_s, via=first.via)
        calls = self._mission.rest(start, now_s=now_s)
        if not calls:
            return
        reached_s, as_asked_s = self._times(calls, takeoff_s)
        foreseen = Foreseen(reached_s=reached_s, as_asked_s=as_asked_s)
        if (settings := self._settings.lighter) is not None:
            of = settings.operations
            calls = [
                structs.replace(call, operation=of.get(call.operation, call.operation)) for call in calls
            ]
            _, lightest_s = self._times(calls, takeoff_s)
            foreseen = structs.replace(foreseen, lightest_s=lightest_s, finish_by_s=settings.finish_by_s)
        self._moment.effects.append(foreseen)

    def _times(self, calls: Sequence[ExpectedCall], takeoff_s: float) -> tuple[Sequence[float], float]:
        """When each waypoint is reached, and when the mission is over."""
        stop = self._beliefs.stop
        placing = self._planning.placing()
        reached_s: list[float] = []
        clock = CallClock(takeoff_s, takeoff_s)
        for number, (call, place) in enumerate(zip(calls, placing.places(calls), strict=True)):
            clock.begin(call)
            if number % len(stop) == 0:
                reached_s.append(round(clock.reached_s - (0.0 if call.hides else stop[0].pause_s), 1))
            clock.end(placing.delay_s(place, call))
        over_s = clock.at_s
        if self._leaving_s:  # while the last answers come
            over_s = max(over_s, clock.reached_s + self._leaving_s)
        return reached_s, over_s + self._home_s


def _over_s(calls: Sequence[ExpectedCall], takes_s: Sequence[float]) -> float:
    """Seconds until the calls are over."""
    if not calls[-1].hides:
        return sum(call.gap_s for call in calls) + sum(takes_s)
    clock = CallClock()
    for call, delay_s in zip(calls, takes_s, strict=True):
        clock.begin(call)
        clock.end(delay_s)
    return clock.at_s
