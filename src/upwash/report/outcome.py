"""What a run came to, in a few sentences."""

from __future__ import annotations

from collections.abc import Sequence

from upwash.eventlog.narration import counted
from upwash.eventlog.results import Totals
from upwash.report.record import Record


def what_it_came_to(record: Record, records: Sequence[Record]) -> str:
    """What the run came to, also against a run without offloading, where one is among the records."""
    result = record.result
    ended = "" if result.completed else " and was not completed"
    took = f"{record.name}: the mission took {result.mission_time_s:.1f} s under the policy {result.policy}{ended}."
    took += _going(result.totals)
    if not result.totals.remote:
        return f"{took} All {result.totals.calls} calls ran on the drone."
    paced = (
        " Calls on the drone were paced to take as long as on a slower computer." if record.plan.paced else ""
    )
    return f"{took} {_saving(record)}{_against_reference(record, records)}{paced}"


def _going(totals: Totals) -> str:
    if not totals.went_on:
        return ""
    return (
        f" The drone went on before {counted(totals.went_on, 'answer')} and turned back for {totals.turned_back}: "
        f"during {totals.hidden_s:.1f} s of the calls it did something else."
    )


def _saving(record: Record) -> str:
    if record.answers and record.result.completed:
        return "What offloading saved is not known: the drone went on before answers were there."
    local_only_s, saved_s = record.result.local_only_time_s(), record.saved_s
    if local_only_s is None or saved_s is None:
        return "What offloading saved is not known: that takes a completed mission with calls on the drone."
    return (
        f"With every call on the drone, at the local delays measured in it, it would have taken "
        f"{local_only_s:.1f} s: offloading saved {saved_s:z.1f} s, {100 * saved_s / local_only_s:z.0f} %."
    )


def _against_reference(record: Record, records: Sequence[Record]) -> str:
    """The difference to a mission over the same plan that was flown without offloading, where there is one."""
    for reference in records:
        same = reference.plan.waypoints_m == record.plan.waypoints_m and reference.result.completed
        if same and record.result.completed and reference.result.calls and not reference.result.totals.remote:
            longer_s = reference.result.mission_time_s
            less_s = longer_s - record.result.mission_time_s
            return f" It took {less_s:.1f} s less than {reference.name}, {100 * less_s / longer_s:.0f} %."
    return ""
