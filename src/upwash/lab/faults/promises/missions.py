"""Promises about the mission as a whole: 1, that it is flown, and 8, that servers do no harm."""

from __future__ import annotations

from collections.abc import Iterator

from upwash.config import waypoints
from upwash.eventlog import schema
from upwash.lab.faults.promises.history import (
    ROUNDING_S,
    SLACK_S,
    Breach,
    History,
    calls_of,
    deadline_of,
    may_be_cut_short,
)

_FAREWELL_S = 0.5  # a drone says goodbye to its last server


def autonomy(history: History) -> Iterator[Breach]:
    """Every waypoint in order, its calls answered; an autopilot that failed may cut that short."""
    events, run = history.run.events, history.run
    for event in events:
        if isinstance(event, schema.OffloadingFailed):
            yield event, f"offloading ended for the rest of the flight: {event.why}"
    arrivals = (event.waypoint for event in events if isinstance(event, schema.Arrived))
    arrived = list(dict.fromkeys(arrivals))  # it may come back to one
    planned = [waypoint.index for waypoint in waypoints(history.config.mission)]
    if arrived != planned[: len(arrived)]:
        yield None, f"arrived at waypoints {arrived} instead of {planned}"
    if may_be_cut_short(history):
        return
    if run.failure or not run.result.completed:
        yield (events[-1] if events else None), f"the mission was not completed: {run.failure}"
    elif len(arrived) < len(planned):
        yield None, f"arrived at {len(arrived)} of {len(planned)} waypoints"
    if history.alone is not None:
        made, wanted = (
            [(call.waypoint, call.operation) for call in each.result.calls] for each in (run, history.alone)
        )
        if made != wanted:
            yield None, f"{len(made)} calls had a result, the drone alone has {len(wanted)}: {made}"


def no_harm(history: History) -> Iterator[Breach]:
    """No later than the drone alone, but for the waits and deadlines that the rules allowed.

    Chance and heat make two local calls differ that would be alike: each counts here as long as it took alone. What a
    drone loses that flies on before it has its answer depends on when that comes.
    """
    yield from _hedged_too_much(history)
    if history.config.policy.stay_or_go != "stay":
        return
    if history.alone is None or history.run.failure or history.alone.failure:
        return
    calls, alone = list(calls_of(history.run.events)), list(calls_of(history.alone.events))
    luck_s = sum(
        ours.ended.onboard_s - theirs.ended.onboard_s
        for ours, theirs in zip(calls, alone, strict=False)
        if ours.ended.onboard_s
    )
    allowed_s = sum(call.allowed_s for call in calls)
    latest_s = history.alone.result.mission_time_s + luck_s + allowed_s + _FAREWELL_S + SLACK_S
    if (took_s := history.run.result.mission_time_s) > latest_s:
        yield (
            None,
            f"the mission took {took_s:.3f} s; alone, with what the rules allowed, at most {latest_s:.3f} s",
        )


def _hedged_too_much(history: History) -> Iterator[Breach]:
    """A hedge starts only while what was computed for nothing is within the share of what all calls would take."""
    hedge = history.config.policy.hedging
    calls_s = extra_s = 0.0
    for call in calls_of(history.run.events):
        if not call.decisions:  # it runs once, and on the drone
            continue
        decided = call.sent or call.decisions[-1]
        calls_s += decided.local_s or 0.0
        if call.hedged is None:
            continue
        if hedge is None or extra_s > hedge.budget * calls_s + ROUNDING_S:
            yield call.hedged, f"{extra_s:.3f} s were computed for nothing, of {calls_s:.3f} s in all calls"
        if decided.server is None or call.ended.server != decided.server:
            continue
        if call.ended.t - decided.t <= deadline_of(decided) - ROUNDING_S:
            extra_s += decided.local_s or 0.0
