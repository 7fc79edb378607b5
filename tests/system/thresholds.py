"""Which decisions of a simulated mission may as well go the other way when it is flown."""

from __future__ import annotations

from upwash.core.knowledge.servers import State
from upwash.eventlog import schema
from upwash.lab.run import Run


def waits_at_their_threshold(run: Run, *, within: float) -> set[int]:
    """The waypoints where the wait that was expected is about the longest that is worth it, within a share of it."""
    found, waypoint = set(), -1
    for event in run.events:
        match event:
            case schema.Arrived(waypoint=int(index)):
                waypoint = index
            case schema.Decided(
                state=State.CHECK | State.CHECK_R,
                check_s=float(check_s),
                check_elapsed_s=float(elapsed_s),
                local_s=float(local_s),
                remote_s=float(remote_s),
            ):
                wait_s = check_s - elapsed_s
                longest_s = local_s * 0.75 - remote_s
                if abs(wait_s - longest_s) < within * longest_s:
                    found.add(waypoint)
    return found
