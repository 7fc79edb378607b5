"""The ground speed of a mission of rows: the speed with the shortest forecast that photos and vehicle allow.

    limits     the highest speeds by the photos and by the vehicle
    tried      speeds from the lowest limit down, each 15 % below the one before; then those around the best
    chosen     the lowest speed whose forecast is at most 0.2 % longer than the shortest

The forecast is not steady: where the drone has to stop for answers, 0.1 m/s more may be a stop more or less. A
slightly lower speed has fewer open answers, and is as quick.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache

from msgspec import Struct

from upwash.core.planning.row_forecast import RowForecast

_STEP_M_S = 0.1
_RATIO = 0.85
_LEAST_SHARE = 0.05  # of the highest speed
_MOST_BETWEEN = 16  # speeds that are tried around the best
_AS_QUICK = 1.002


class SpeedLimit(Struct, frozen=True):
    """The highest speed by one rule, and what sets it, such as "the camera"."""

    by: str
    ground_speed_m_s: float


class ChosenSpeed(Struct, frozen=True):
    """A ground speed with its forecast, and why it was chosen."""

    ground_speed_m_s: float
    why: str
    forecast: RowForecast


def choose_speed(limits: Sequence[SpeedLimit], forecast: Callable[[float], RowForecast]) -> ChosenSpeed:
    """The speed with the shortest forecast, as far as the limits allow; there is at least one limit."""
    forecast = cache(forecast)
    top_m_s = _rounded(min(limit.ground_speed_m_s for limit in limits))
    count = math.floor(math.log(_LEAST_SHARE, _RATIO)) + 1
    tried = list(dict.fromkeys(_rounded(top_m_s * _RATIO**number) for number in range(count)))
    place = tried.index(_lowest_quick(tried, forecast))
    low_m_s, high_m_s = tried[min(place + 1, len(tried) - 1)], tried[max(place - 1, 0)]
    between = min(max(1, round((high_m_s - low_m_s) / _STEP_M_S)), _MOST_BETWEEN)
    around = [_rounded(low_m_s + (high_m_s - low_m_s) * number / between) for number in range(between + 1)]
    best_m_s = _lowest_quick([*tried, *around], forecast)
    return ChosenSpeed(best_m_s, _why(best_m_s, limits, forecast(best_m_s)), forecast(best_m_s))


def _lowest_quick(speeds_m_s: Sequence[float], forecast: Callable[[float], RowForecast]) -> float:
    """The lowest of these speeds that is about as quick as the quickest."""
    shortest_s = min(forecast(speed_m_s).mission_s for speed_m_s in speeds_m_s)
    return min(speed for speed in speeds_m_s if forecast(speed).mission_s <= _AS_QUICK * shortest_s)


def _rounded(speed_m_s: float) -> float:
    """The speed rounded down to 0.1 m/s, or to two digits if it is slower than 1 m/s."""
    step = _STEP_M_S if speed_m_s >= 1 else 10.0 ** (math.floor(math.log10(speed_m_s)) - 1)
    return round(math.floor(speed_m_s / step + 1e-6) * step, 9)


def _why(speed_m_s: float, limits: Sequence[SpeedLimit], forecast: RowForecast) -> str:
    allowed = [f"{limit.by} {limit.ground_speed_m_s:.3g}" for limit in limits]
    allowed[0] = f"{limits[0].by} allows {limits[0].ground_speed_m_s:.3g}"
    if (keeps_up_m_s := forecast.keeps_up_m_s) < math.inf:
        allowed.append(f"answers keep up to {keeps_up_m_s:.2g}")
    return f"{speed_m_s:g} m/s, {forecast.mission_s / 60:.1f} min by forecast: {', '.join(allowed)}"
