"""The ground speed of rows: the quickest of those that are flown in simulation, for `mission.speed = "auto"`.

    limits     the highest speeds by the photos and by the vehicle
    tried      the highest; then in equal ratios down, until the rows alone take as long; then halves around the best
    chosen     the lowest speed whose mission is at most 0.2 % longer than the shortest

Each mission is flown in the world that the drone believes in. Where a drone has to stop for answers, a slightly lower
speed may be a stop less; it has fewer open answers, and is as quick. The number of missions is bounded by their
photos, so that a small computer has chosen before long.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from statistics import fmean
from typing import Protocol

from msgspec import Struct
from msgspec.structs import replace

from upwash.config.drone import DroneConfig
from upwash.config.places import waypoints
from upwash.core.geo import distance_m, row_of
from upwash.drone.speed import SpeedLimit, speed_limits
from upwash.errors import UpwashError
from upwash.eventlog.results import RunResult
from upwash.eventlog.schema import Event
from upwash.lab.believed import believed_worlds
from upwash.lab.flown_rows import RowForecast, flown_rows
from upwash.support.progress import work
from upwash.support.text import lasting

_STEP_M_S = 0.1
_RATIO = 0.75  # of two speeds that are tried at first, or more where many are left
_HALVINGS = 2
_CLOSE = 1.05  # two speeds with no further one between them
_AS_QUICK = 1.002
_PHOTOS, _LEAST, _MOST = 1000, 4, 12  # photos of all missions that are flown; speeds that are tried


class Flown(Protocol):
    """A simulated mission, as the forecast reads it."""

    @property
    def events(self) -> Iterable[Event]:
        """Its log."""

    @property
    def result(self) -> RunResult:
        """Its result."""

    @property
    def failure(self) -> str:
        """Why it was not completed; "" if it was."""


Simulate = Callable[[DroneConfig], Flown]


class ChosenSpeed(Struct, frozen=True):
    """A ground speed and why it was chosen, with its forecast; None where no mission could be flown."""

    ground_speed_m_s: float
    why: str
    forecast: RowForecast | None = None


_FLOWN: deque[tuple[DroneConfig, RowForecast]] = deque(maxlen=64)


def with_speed(config: DroneConfig, simulate: Simulate) -> tuple[DroneConfig, str]:
    """The configuration with a ground speed, and why it was chosen; "" for a speed that is given."""
    if config.mission.speed == "given":
        return config, ""
    chosen = chosen_speed(config, simulate)
    return _at(config, chosen.ground_speed_m_s), chosen.why


def _at(config: DroneConfig, ground_speed_m_s: float) -> DroneConfig:
    mission = replace(config.mission, speed="given", ground_speed_m_s=ground_speed_m_s)
    return replace(config, mission=mission)


def chosen_speed(config: DroneConfig, simulate: Simulate, *, most: int = _MOST) -> ChosenSpeed:
    """The speed with the shortest mission of at most `most`; the highest allowed one where none can be flown."""
    worlds = believed_worlds(config)
    limits, plan = list(speed_limits(config)), waypoints(config.mission)
    rows_m = sum(
        distance_m(before.position, after.position)
        for before, after in itertools.pairwise(plan)
        if row_of(before) == row_of(after) is not None
    )
    most = max(_LEAST, min(most, _PHOTOS // len(plan)))
    try:
        with work("ground speeds tried in simulation", most) as done:

            def forecast(speed_m_s: float) -> RowForecast:
                found = _forecast([_at(worlds[0], speed_m_s)], simulate)
                done()
                return found

            return choose_speed(limits, forecast, rows_m=rows_m, most=most)
    except Exception as error:  # noqa: BLE001 - of a mission's own program too: a choice never ends a flight
        top_m_s = _rounded(min(limit.ground_speed_m_s for limit in limits))
        why = f"{top_m_s:g} m/s, as allowed: {_told(limits)}; no forecast, as {str(error) or type(error).__name__}"
        return ChosenSpeed(top_m_s, why)


def forecast_speed(config: DroneConfig, simulate: Simulate) -> RowForecast:
    """The forecast of a mission of rows at its ground speed; raises UpwashError where it is not completed."""
    return _forecast(believed_worlds(config), simulate)


def _forecast(worlds: Sequence[DroneConfig], simulate: Simulate) -> RowForecast:
    found = [_flown(world, simulate) for world in worlds]
    mean_s = fmean(one.mission_s for one in found)
    nearest = min(found, key=lambda one: abs(one.mission_s - mean_s))
    return replace(nearest, mission_s=mean_s, worlds=len(found))


def _flown(world: DroneConfig, simulate: Simulate) -> RowForecast:
    """The forecast in one world.

    The last ones are remembered: cases of a check and seeds of a campaign differ in what no drone knows.
    """
    for other, forecast in _FLOWN:
        if other == world:
            return forecast
    run = simulate(world)
    if run.failure or not run.result.completed:
        raise UpwashError(f"the mission is not completed in simulation: {run.failure}")
    mission = world.mission
    forecast = flown_rows(run.result, run.events, waypoints(mission), mission.ground_speed_m_s)
    _FLOWN.append((world, forecast))
    return forecast


def choose_speed(
    limits: Sequence[SpeedLimit], forecast: Callable[[float], RowForecast], *, rows_m: float, most: int
) -> ChosenSpeed:
    """The speed with the shortest forecast of `most`, as far as the limits allow; there is at least one limit."""
    top_m_s = _rounded(min(limit.ground_speed_m_s for limit in limits))
    found = {top_m_s: forecast(top_m_s)}

    def try_speed(speed_m_s: float) -> bool:
        """Try the speed if it is a new one; whether it was tried."""
        if (speed_m_s := _rounded(speed_m_s)) in found or len(found) >= most:
            return False
        found[speed_m_s] = forecast(speed_m_s)
        return True

    def least_m_s() -> float:
        """The least speed worth a try: below it the rows alone take longer than the shortest mission until now.

        Rows may have no length.
        """
        return max(min(top_m_s, _STEP_M_S), rows_m / min(one.mission_s for one in found.values()))

    if found[top_m_s].is_held_up:
        low_m_s = least_m_s()
        steps = math.log(low_m_s / top_m_s) / math.log(_RATIO)
        ratio = (low_m_s / top_m_s) ** (1 / max(1.0, min(math.floor(steps), most // 2)))
        speed_m_s = top_m_s * ratio
        while speed_m_s >= least_m_s() and not _gets_longer(found) and try_speed(speed_m_s):
            speed_m_s *= ratio
        for _ in range(_HALVINGS):
            for speed_m_s in _between(found, _lowest_quick(found), least_m_s()):
                try_speed(speed_m_s)
    best_m_s = _lowest_quick(found)
    return ChosenSpeed(best_m_s, _why(best_m_s, limits, found), found[best_m_s])


def _gets_longer(found: dict[float, RowForecast]) -> bool:
    """Whether the last two missions, each slower than the one before, took longer than that."""
    times_s = [one.mission_s for one in found.values()][-3:]
    return len(times_s) == 3 and times_s[0] < times_s[1] < times_s[2]


def _lowest_quick(found: dict[float, RowForecast]) -> float:
    """The lowest speed that is about as quick as the quickest."""
    shortest_s = min(one.mission_s for one in found.values())
    return min(speed_m_s for speed_m_s, one in found.items() if one.mission_s <= _AS_QUICK * shortest_s)


def _between(found: Iterable[float], best_m_s: float, least_m_s: float) -> list[float]:
    """The speeds half way from the best to those beside it, unless these are close."""
    speeds_m_s = sorted({least_m_s, *found})
    place = speeds_m_s.index(best_m_s)
    beside = itertools.pairwise(speeds_m_s[max(0, place - 1) : place + 2])
    return [math.sqrt(low * high) for low, high in beside if high > _CLOSE * low]


def _rounded(speed_m_s: float) -> float:
    """The speed rounded down to 0.1 m/s, or to two digits if it is slower than 1 m/s."""
    step = _STEP_M_S if speed_m_s >= 1 else 10.0 ** (math.floor(math.log10(speed_m_s)) - 1)
    return round(math.floor(speed_m_s / step + 1e-6) * step, 9)


def _why(speed_m_s: float, limits: Sequence[SpeedLimit], found: dict[float, RowForecast]) -> str:
    why = f"{speed_m_s:g} m/s, {lasting(found[speed_m_s].mission_s)} by forecast: {_told(limits)}"
    top_m_s = max(found)
    return (
        why if speed_m_s == top_m_s else f"{why}; {top_m_s:g} m/s takes {lasting(found[top_m_s].mission_s)}"
    )


def _told(limits: Sequence[SpeedLimit]) -> str:
    first, *others = limits
    told = [f"{first.by} allows {first.ground_speed_m_s:.3g}"]
    return ", ".join([*told, *(f"{limit.by} {limit.ground_speed_m_s:.3g}" for limit in others)])
