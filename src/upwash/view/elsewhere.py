"""The calls of a flight under other policies: on other flights of the page, or flown in a world that is given."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import msgspec

from upwash.eventlog.results import RunResult
from upwash.report.outcome import Outcome


class Elsewhere(msgspec.Struct, frozen=True, omit_defaults=True):
    """The same mission under another policy: on the flight of that `log` of the page, or else flown in its world.

    Of what was flown in its world, `calls` has the place and the delay of each call.
    """

    policy: str
    log: int | None = None
    calls: Sequence[tuple[str, float]] = ()


def elsewhere(
    outcomes: Mapping[int, Outcome], flown: Mapping[str, RunResult]
) -> Mapping[int, Sequence[Elsewhere]]:
    """By log, what other policies did, one flight of each, where all calls are the same as on the flight of that log.

    `outcomes` are those of flights that are over, by log; `flown` are flights in the world of the first log.
    """
    by_log = {log: _others(log, outcomes) for log in outcomes}
    if 0 in by_log and flown:
        own = outcomes[0].result
        by_log[0] = [
            Elsewhere(policy, calls=[(call.place, call.delay_s) for call in run.calls])
            for policy, run in flown.items()
            if policy != own.policy and run.made_the_calls_of(own)
        ]
    return {log: others for log, others in by_log.items() if others}


def _others(log: int, outcomes: Mapping[int, Outcome]) -> Sequence[Elsewhere]:
    own = outcomes[log]
    return list(
        {
            each.result.policy: Elsewhere(each.result.policy, other)
            for other, each in outcomes.items()
            if each.result.policy != own.result.policy and _same_world(each, own)
        }.values()
    )


def _same_world(one: Outcome, other: Outcome) -> bool:
    """Whether the two flew the same plan and called alike, simulated ones in the same scenario with the same seed."""
    return (
        one.world == other.world
        and one.plan.waypoints_m == other.plan.waypoints_m
        and one.result.made_the_calls_of(other.result)
    )
