"""What counted calls say of the share of all calls: exact one-sided bounds (Clopper and Pearson, 1934)."""

from __future__ import annotations

import math
from bisect import bisect_right
from functools import lru_cache

_NEGLIGIBLE = 1e-15
_HALVINGS = 40


@lru_cache(maxsize=1024)
def least_share(hits: int, count: int, miss: float) -> float:
    """The share is at least this with the probability 1 - `miss`, where `hits` of `count` calls were hits."""
    low, high = 0.0, hits / max(1, count)
    for _ in range(_HALVINGS):
        share = (low + high) / 2
        low, high = (share, high) if _at_most(count - hits, count, share) <= miss else (low, share)
    return low


@lru_cache(maxsize=1024)
def hits_for(share: float, count: int, miss: float) -> int:
    """The fewest hits of `count` calls whose `least_share` is that share; more than `count` if all are too few."""
    if share <= 0:
        return 0
    return count + 1 - bisect_right(range(count + 1), miss, key=lambda misses: _at_most(misses, count, share))


def calls_for(share: float, miss: float) -> int:
    """The fewest calls that show the share if all of them are hits; the share is above 0 and below 1."""
    return math.ceil(math.log(miss) / math.log(share))


def _at_most(misses: int, count: int, share: float) -> float:
    """The probability that `count` calls, each a hit with probability `share`, have that many misses or fewer.

    It is 1 where it is more than a half.
    """
    if misses >= count * (1 - share):  # the mean, which is no more than one from the median
        return 1.0
    ways = math.lgamma(count + 1) - math.lgamma(misses + 1) - math.lgamma(count - misses + 1)
    term = math.exp(ways + misses * math.log1p(-share) + (count - misses) * math.log(share))
    total = 0.0
    for number in range(misses, -1, -1):  # smaller and smaller
        total += term
        if term < _NEGLIGIBLE * total:
            break
        term *= number * share / ((count - number + 1) * (1 - share))
    return total
