"""Means with 95 % confidence intervals, for few observations as for many."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache


@dataclass(frozen=True, slots=True)
class Mean:
    """A mean of `count` observations; the true one lies within `margin` of it with a probability of 95 %.

    The margin is infinite for a single observation.
    """

    count: int
    value: float
    margin: float


def mean_of(observations: Sequence[float]) -> Mean:
    """The mean of at least one observation, which are taken to be normally distributed."""
    count = len(observations)
    value = statistics.fmean(observations)
    if count == 1:
        return Mean(count, value, math.inf)
    standard_error = statistics.stdev(observations) / math.sqrt(count)
    return Mean(count, value, student_quantile(count - 1) * standard_error)


def mean_or_none(observations: Sequence[float]) -> Mean | None:
    """Their mean; None without any observation."""
    return mean_of(observations) if observations else None


def mean_saving(before: Mapping[int, float], after: Mapping[int, float]) -> Mean | None:
    """The mean of `before` less `after` over the keys of both; None where no key is in both."""
    return mean_or_none([before[key] - value for key, value in after.items() if key in before])


@cache
def student_quantile(freedom: int) -> float:
    """The t within which 95 % of a Student distribution of that many degrees of freedom lie, on either side of 0."""
    low, high = 0.0, math.pi / 2
    while (middle := (low + high) / 2) not in (low, high):
        low, high = (middle, high) if _probability(middle, freedom) < 0.95 else (low, middle)
    return math.sqrt(freedom) * math.tan(low)


def _probability(angle: float, freedom: int) -> float:
    """Of |t| <= sqrt(freedom) tan(angle): Abramowitz and Stegun, 26.7.3 and 26.7.4."""
    cosine = math.cos(angle)
    odd = freedom % 2
    term, total = (cosine if odd else 1.0), 0.0
    for power in range(1 + odd, freedom, 2):
        total += term
        term *= cosine**2 * power / (power + 1)
    total *= math.sin(angle)
    return 2 / math.pi * (angle + total) if odd else total
