"""In which order to fly a mission's waypoints: as they are given, or in the sweep that the forecast finds quickest.

The forecast is of the whole mission: every leg, every call where the quickest schedule has it, and the way home.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from upwash.core.geo import Circle, Position, Waypoint
from upwash.core.knowledge.estimates import Estimates
from upwash.core.knowledge.servers import Server
from upwash.core.planning.forecast import make_forecast
from upwash.core.planning.mission_model import MissionBeliefs, MissionModel
from upwash.core.planning.schedule import quickest
from upwash.core.planning.sweeps import Sweep

LEAST_SAVED = 0.02  # of the given order's time: what is less is within what a forecast can be wrong by


@dataclass(frozen=True, slots=True)
class Order:
    """The waypoints in the order in which they are flown, each with its index of the plan.

    `why` says so in words, "" where nothing but the given order was asked for; `sweep` is the number of the sweep
    that it is, None for the given order.
    """

    waypoints: tuple[Waypoint, ...]
    why: str = ""
    sweep: int | None = None


@dataclass(frozen=True, slots=True)
class Forecaster:
    """Foretells how long a mission takes over waypoints in some order, from above where the vehicle stands.

    `home_s` is how long it takes from a waypoint to the ground at the mission's end.
    """

    beliefs: MissionBeliefs
    estimates: Estimates
    areas: Mapping[str, Circle]
    gain_wait: float
    stands: Position
    home_s: Callable[[Position], float]

    def mission_s(self, waypoints: Sequence[Waypoint]) -> float:
        """From the first leg to the ground."""
        first, last = waypoints[0].position, waypoints[-1].position
        model = MissionModel(replace(self.beliefs, plan=waypoints), self.areas)
        start = self.stands.at_altitude(first.altitude_m)
        model.leg_begun(start, first, waypoints[0].ground_speed_m_s, now_s=0.0)
        calls = len(waypoints) * len(self.beliefs.stop)
        forecast = make_forecast(
            model.coming(start, now_s=0.0, count=calls),
            {name: Server(name, area) for name, area in self.areas.items()},
            self.estimates,
            (),
            now_s=0.0,
            banned_s={},
            idle_s=0.0,
        )
        schedule = quickest(forecast.calls, forecast.checks, gain_wait=self.gain_wait)
        return sum(call.gap_s for call in forecast.calls) + schedule.total_s + self.home_s(last)


def best_order(
    given: Sequence[Waypoint], candidates: Sequence[Sweep], mission_s: Callable[[Sequence[Waypoint]], float]
) -> Order:
    """The quickest of the sweeps where it saves LEAST_SAVED of the given order's time, else the given order."""
    given_s = mission_s(given)
    times_s = [(mission_s(sweep.waypoints), sweep) for sweep in candidates]
    best_s, best = min(times_s, key=lambda pair: pair[0], default=(given_s, None))
    saved = 1 - best_s / given_s
    if best is None or saved <= 0:
        return Order(tuple(given), "as given: by forecast no sweep is quicker")
    gain = f"{100 * saved:.1f} % by forecast ({best_s / 60:.1f} instead of {given_s / 60:.1f} min)"
    if saved < LEAST_SAVED:
        least = f"less than {100 * LEAST_SAVED:g} %"
        return Order(tuple(given), f"as given: the best, {best}, saves {gain}, {least}")
    return Order(best.waypoints, f"{best}: saves {gain}", best.number)
