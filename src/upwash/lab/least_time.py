"""The least time of a mission under any policy, which shows what a policy can still gain.

The bounds know every true delay and never pay for the start of a service. For a drone that may fly on before an
answer (stay_or_go.py) no way to an act makes its way longer.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from msgspec import Struct

from upwash.core.planning.schedule import CheckTimes, ComingCall, quickest


class Bound(Struct, frozen=True):
    """The least time of a mission, or of its calls alone, in seconds.

    `free_s` has every server joined at once and for free; `with_joins_s` pays for each join, one at a time. Both are
    the same for a drone that may fly on before answers: its joins are left out.
    """

    free_s: float
    with_joins_s: float


class FleetBound(Struct, frozen=True):
    """The least mean time of several drones' missions, in seconds.

    `free_s` and `with_joins_s` are means of the drones' own bounds, as if each had all servers alone. `shared_s` has
    every server joined for free, and computing no more at a time than it can.
    """

    free_s: float
    with_joins_s: float
    shared_s: float


class SharedMission(Struct, frozen=True):
    """One mission of several at the same time: its beginning, its time with every call on the drone, and at least."""

    begun_s: float
    local_s: float
    free_s: float


def bound(calls: Sequence[ComingCall], joins_s: Mapping[str, float]) -> Bound:
    """The bounds for calls with their true delays, and servers with the true times of joining them.

    Each call runs where it is fastest. Paying for joins, there is one radio: the drone leaves one network to join
    another, on the way between two calls where it can, and each mission decides in hindsight.
    """
    free_s = sum(min([call.local_s, *(offer.call_s for offer in call.offers)]) for call in calls)
    joins = {server: CheckTimes(join_s, join_s) for server, join_s in joins_s.items()}
    return Bound(free_s, max(free_s, quickest(calls, joins).total_s))  # which rounds its sums otherwise


def shared_s(missions: Sequence[SharedMission], saved_per_s: float) -> float:
    """The least mean time of at least one mission, if all servers together save `saved_per_s` each second.

    By the end of any k missions, these have saved at most `saved_per_s` each second since the first began. So the
    k-th end is no sooner than that bound allows for the least work of any k missions, and no sooner than the k-th of
    the missions' own bounds. The earliest ends under both bounds, taken in order, have the least sum: delaying an
    end by some time advances later ends by no more than that in all.
    """
    began_s = min(mission.begun_s for mission in missions)
    alone_s = sorted(mission.begun_s + mission.local_s for mission in missions)
    at_least_s = sorted(mission.begun_s + mission.free_s for mission in missions)
    ends_s = work_s = 0.0
    for end_alone_s, least_s in zip(alone_s, at_least_s, strict=True):
        work_s += end_alone_s
        end_s = 0.0
        if not math.isinf(saved_per_s):
            end_s = (saved_per_s * began_s + work_s - ends_s) / (1 + saved_per_s)
        ends_s += max(end_s, least_s)
    return (ends_s - sum(mission.begun_s for mission in missions)) / len(missions)
