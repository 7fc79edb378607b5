"""What a run came to, in a few sentences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from upwash.eventlog import schema
from upwash.eventlog.ending import went_on
from upwash.eventlog.results import RunResult, Totals
from upwash.support.text import lasting

UNPLANNED = schema.Planned()  # by its identity: what the drone set out to do is not in the log


@dataclass(frozen=True, slots=True)
class Outcome:
    """The plan of a run and its result; `world` is a simulation's scenario and seed."""

    name: str
    plan: schema.Planned
    result: RunResult
    world: tuple[str, int] | None = None


def what_it_came_to(run: Outcome, runs: Sequence[Outcome]) -> str:
    """What the run came to, also against a run without offloading, where one is among the records."""
    result = run.result
    ended = "" if result.completed else " and was not completed"
    took = f"{run.name}: the mission took {lasting(result.mission_time_s)} under the policy {result.policy}{ended}."
    took += _going(result.totals)
    if not result.totals.calls:
        return f"{took} It made no calls."
    if not result.totals.remote:
        return f"{took} {_all(result.totals.calls)} on the drone."
    paced = (
        " Calls on the drone were paced to take as long as on a slower computer." if run.plan.paced else ""
    )
    return f"{took} {_saving(run)}{_against_reference(run, runs)}{paced}"


def _all(calls: int) -> str:
    return "Its one call ran" if calls == 1 else f"All {calls} calls ran"


def _going(totals: Totals) -> str:
    if not totals.went_on:
        return ""
    waited_s = totals.service_delay_s - totals.hidden_s
    return f" The drone {went_on(totals)}; it waited for answers for {lasting(waited_s)}."


def _saving(run: Outcome) -> str:
    if run.result.totals.went_on and run.result.completed:
        return "What offloading saved is not known: the drone went on before answers were there."
    local_only_s, saved_s = run.result.local_only_time_s(), run.result.saved_s()
    if local_only_s is None or saved_s is None:
        return "What offloading saved is not known: that takes a completed mission with calls on the drone."
    return (
        f"With every call on the drone, at the local delays measured in it, it would have taken "
        f"{lasting(local_only_s)}: offloading saved {lasting(saved_s)}, {100 * saved_s / local_only_s:z.0f} %."
    )


def _against_reference(run: Outcome, runs: Sequence[Outcome]) -> str:
    """The difference to a mission over the same plan that was flown without offloading, where there is one."""
    for reference in runs:
        same = reference.plan.waypoints_m == run.plan.waypoints_m and reference.result.completed
        if same and run.result.completed and reference.result.calls and not reference.result.totals.remote:
            longer_s = reference.result.mission_time_s
            less_s = longer_s - run.result.mission_time_s
            return f" It took {lasting(less_s)} less than {reference.name}, {100 * less_s / longer_s:.0f} %."
    return ""
