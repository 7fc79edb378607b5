"""Which calls run in a lighter mode, so that a mission is over by a given time.

The laws, in seconds of the mission's time, which counts from arming to landed:

    forecast   the time used so far + this call + each pause, leg and call to come + the way home,
               all calls as they are asked for
    late       forecast - finish_by; where it is not above 0, no call is lighter
    saved      of a call: what it takes as asked for, less what it takes in the lighter mode, in the place where it
               is expected to run; never below 0
    lighter    a call that saves something, where the calls to come that save more, all together, save less than
               `late`

So those go first that save most, which are the calls on the drone; of those that save alike, the soonest: what has
been saved is saved, whatever comes. Where all of them save less than `late`, all are lighter. An earlier time never
makes a call heavier. Each call is judged anew, by what was measured so far.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from upwash.core.geo import Position
from upwash.core.operation import Operation
from upwash.core.policies.policy import Lightened
from upwash.core.selection.placing import Place
from upwash.core.selection.server_choice import Planning


@dataclass(frozen=True, slots=True)
class LighterSettings:
    """By when the mission is to be over, and the lighter operation of each that has one."""

    finish_by_s: float
    operations: Mapping[Operation, Operation]


def is_lighter(saves_s: float, others_save_s: Iterable[float], late_s: float) -> bool:
    """Whether a call runs in the lighter mode, by what it and the calls to come would save so."""
    return saves_s > 0 and sum(each_s for each_s in others_save_s if each_s > saves_s) < late_s


class Lighter:
    """Judges the calls of one mission."""

    def __init__(self, settings: LighterSettings, planning: Planning) -> None:
        self._settings = settings
        self._planning = planning
        self._begun_s: float | None = None
        self._home_s = 0.0  # from the last waypoint to landed

    def begin(self, *, now_s: float, home_s: float) -> None:
        """The mission's time begins; it takes `home_s` from the last waypoint to landed."""
        self._begun_s, self._home_s = now_s, home_s

    def judge(
        self, operation: Operation, *, now_s: float, position: Position, on_drone: bool = False
    ) -> Lightened | None:
        """The lighter operation that a call runs as which is made now; None where it runs as it is asked for.

        The mission's model knows of the call. With `on_drone` it runs there, wherever others would.
        """
        lighter = self._settings.operations.get(operation)
        if lighter is None or self._begun_s is None:
            return None
        calls = [
            self._planning.made_now(operation, now_s),
            *self._planning.mission.rest(position, now_s=now_s),
        ]
        placing = self._planning.placing(now_s)
        places = list(placing.places(calls))
        if on_drone:
            places[0] = Place()
        takes_s = [placing.delay_s(place, call) for place, call in zip(places, calls, strict=True)]
        lighter_s = [
            placing.delay_s(place, call, self._lighter_of(call.operation))
            for place, call in zip(places, calls, strict=True)
        ]
        forecast_s = now_s - self._begun_s + sum(call.gap_s for call in calls) + sum(takes_s) + self._home_s
        saves_s = [max(0.0, as_asked - less) for as_asked, less in zip(takes_s, lighter_s, strict=True)]
        if not is_lighter(saves_s[0], saves_s[1:], forecast_s - self._settings.finish_by_s):
            return None
        return Lightened(lighter, operation, forecast_s, self._settings.finish_by_s)

    def _lighter_of(self, operation: Operation) -> Operation:
        return self._settings.operations.get(operation, operation)
