"""Promises about flights: 1, 8, the mission, 13, 14, 20, 21, the vehicle."""

from __future__ import annotations

from collections.abc import Iterator

from upwash.config.places import waypoints
from upwash.core.vehicle.control import Owner
from upwash.eventlog import schema
from upwash.lab.faults.history import ROUNDING_S, SLACK_S, Breach, History, calls_of, deadline_of
from upwash.lab.observer import Observation
from upwash.support.text import counted

_FAREWELL_S = 0.5  # a drone says goodbye to its last server


def autonomy(history: History) -> Iterator[Breach]:
    """Every waypoint in order, its calls answered; an autopilot that failed may cut that short."""
    events, run = history.run.events, history.run
    for failed in history.logged(schema.OffloadingFailed):
        yield failed, f"offloading ended for the rest of the flight: {failed.why}"
    arrivals = (event.waypoint for event in history.logged(schema.Arrived))
    arrived = list(dict.fromkeys(arrivals))  # it may come back to one
    if history.flies_rows or history.asks_servers or history.draws_objects:
        arrived = [waypoint for waypoint in arrived if waypoint is not None]  # from a detour, or off the row
    planned = [waypoint.index for waypoint in waypoints(history.config.mission)]
    if arrived != planned[: len(arrived)]:
        yield None, f"arrived at waypoints {arrived} instead of {planned}"
    if history.may_be_cut_short:
        return
    if run.failure or not run.result.completed:
        yield (events[-1] if events else None), f"the mission was not completed: {run.failure}"
    elif len(arrived) < len(planned):
        yield None, f"arrived at {len(arrived)} of {counted(len(planned), 'waypoint')}"
    if history.alone is not None and not history.asks_servers:
        made, wanted = (
            [(call.waypoint, call.asked or call.operation) for call in flown.result.calls]
            for flown in (run, history.alone)
        )
        if history.flies_rows:
            made, wanted = sorted(made, key=str), sorted(wanted, key=str)
        if made != wanted:
            yield (
                None,
                f"{counted(len(made), 'call')} had a result, the drone alone has {len(wanted)}: {made}",
            )


def no_harm(history: History) -> Iterator[Breach]:
    """The mission ends no later than that of the drone alone, plus the waits and deadlines that the rules allowed.

    Chance and heat make equal local calls differ: each counts here as long as it took alone. Missions that fly on
    before answers are not judged: their losses depend on when answers come.
    """
    yield from _hedged_too_much(history)
    if history.config.policy.stay_or_go != "stay" or history.flies_rows or history.draws_objects:
        return
    if history.within_s or history.alone is None or history.run.failure or history.alone.failure:
        return
    calls, alone = history.calls, list(calls_of(history.alone.events))
    luck_s = sum(
        ours.ended.onboard_s - theirs.ended.onboard_s
        for ours, theirs in zip(calls, alone, strict=False)
        if ours.ended.onboard_s
    )
    allowed_s = sum(call.allowed_s for call in calls)
    latest_s = history.alone.result.mission_time_s + luck_s + allowed_s + _FAREWELL_S + SLACK_S
    if (took_s := history.run.result.mission_time_s) > latest_s:
        why = f"the mission took {took_s:.3f} s; alone, with what the rules allowed, at most {latest_s:.3f} s"
        yield None, why


def _hedged_too_much(history: History) -> Iterator[Breach]:
    """A hedge starts only while wasted computing is within its share of the time of all calls."""
    hedge = history.config.policy.hedging
    calls_s = extra_s = 0.0
    for call in history.calls:
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


_DONE = {
    "return": schema.Landed,
    "land": schema.Landed,
    "hold": schema.LeftHovering,
    "disarm": schema.Disarmed,
}
_NAMED_AFTER = {  # who is named, by who has taken the vehicle before
    Owner.PILOT: ("pilot",),
    Owner.GROUND_STATION: ("ground station",),
    Owner.FAILSAFE: ("fail-safe",),
    Owner.UNKNOWN: ("pilot", "ground station", "fail-safe", "restarted autopilot"),
}
_AT_WAYPOINT_M = 5.0
_KEEP_TRYING_S = 600.0  # a safe end is given up no earlier


def vehicle_first(history: History) -> Iterator[Breach]:
    """A mission that ends early in the air ends in the configured action, or has tried for long enough.

    A mission that ends on the ground disarms the vehicle. No rule holds once another party has the vehicle.
    """
    events = {type(event): event for event in history.run.events}  # the last of each kind
    yield from _flown_below_reserve(history)
    for over in history.own("flight_over"):
        if schema.Landed in events and over.altitude_m > 0:
            yield events[schema.Landed], f"the vehicle is {over.altitude_m:.1f} m up"
    safe_ends = list(history.logged(schema.SafeEnd))
    if not history.run.failure or schema.Armed not in events or (schema.Landed in events and not safe_ends):
        return
    last = history.run.events[-1]
    if not isinstance(last, schema.MissionEnded):
        yield last, "the mission failed, and its end is not in the log"
    if _owners(history)[-1] is not Owner.PROGRAM:
        return
    wanted = history.config.autopilot.on_failure
    begun = safe_ends[0] if safe_ends else None
    if begun is None or begun.action not in (wanted, "disarm"):
        yield begun or last, f"the mission failed in the air without {wanted}"
    elif given_up := events.get(schema.LeftToPilot):
        if given_up.t - begun.t < _KEEP_TRYING_S:
            yield given_up, f"the vehicle was given up after {given_up.t - begun.t:.0f} s"
    elif _DONE[safe_ends[-1].action] not in events:
        yield last, f"{begun.action} neither succeeded nor was given up"


_ENDS = schema.Stopping, schema.SafeEnd, schema.Returning, schema.Landing, schema.MissionEnded
_LOOKS_S = 2.5  # of the reserve's watch


def _flown_below_reserve(history: History) -> Iterator[Breach]:
    """No leg begins once the second battery is below the reserve, which the watch sees each second."""
    least_percent = history.config.mission.reserve_percent
    took_off = next((fact for fact in history.own("commanded") if fact.command == "take-off"), None)
    second = next((fault for fault in history.config.faults if fault.kind == "battery"), None)
    if least_percent is None or took_off is None or second is None:
        return
    low_s = max(took_off.t, second.from_s) + second.lasts_s * (1 - least_percent / 100)
    for event in history.run.events:
        lost = isinstance(event, schema.ControlChanged) and event.owner is not Owner.PROGRAM
        if lost or isinstance(event, _ENDS):
            return
        if isinstance(event, schema.SetOff) and low_s + _LOOKS_S < event.t < second.to_s:
            yield event, f"a leg began {event.t - low_s:.1f} s after the second battery was below the reserve"
            return


def pilot_wins(history: History) -> Iterator[Breach]:
    """From the moment that the vehicle is not the program's, no command reaches it, and it is not taken back.

    While its link is silent the program cannot know, but it sends nothing then either. A pilot who takes it and gives
    it back within one silence leaves nothing that the program could hear of: that turn does not count.
    """
    taken: Observation | None = None
    for fact in history.own("taken", "given_back_unheard", "commanded"):
        if fact.event == "taken":
            taken = taken or fact
        elif fact.event == "given_back_unheard":
            taken = None
        elif taken is not None:
            why = f"{fact.command} was commanded {fact.t - taken.t:.3f} s after a {taken.by} took over"
            yield fact, why
    owners = _owners(history)
    if Owner.PROGRAM in owners[1:]:
        yield None, f"the vehicle was the {' then the '.join(owners)}'s: it was taken back"


def arrived_truly(history: History) -> Iterator[Breach]:
    """An arrival counts only where the vehicle truly is at the place, at its altitude above the take-off.

    A jump of its position within a silence may be a way that it has flown: what comes after it is not judged.
    """
    for fact in history.own("reached", "jumped_unheard"):
        if fact.event == "jumped_unheard":
            return
        if fact.off_m > _AT_WAYPOINT_M:
            yield fact, f"the vehicle counted as arrived {fact.off_m:.1f} m from there"


def named_truly(history: History) -> Iterator[Breach]:
    """The log names as an owner only a party that has taken the vehicle before."""
    taken = list(history.own("taken", "taken_unseen"))
    for event in history.logged(schema.ControlChanged):
        if event.owner in _NAMED_AFTER:
            before = {fact.by for fact in taken if fact.t <= event.t + ROUNDING_S}
            if before.isdisjoint(_NAMED_AFTER[event.owner]):
                why = f"it is said to be the {event.owner}'s, and was taken by {sorted(before) or 'nobody'}"
                yield event, why


def _owners(history: History) -> list[Owner]:
    return [event.owner for event in history.logged(schema.ControlChanged)]
