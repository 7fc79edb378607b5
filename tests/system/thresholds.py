"""Which decisions of a simulated mission may as well go the other way when it is flown."""

from __future__ import annotations

from upwash.lab.run import Run


def waits_at_their_threshold(run: Run, *, within: float) -> set[int]:
    """The waypoints where the wait that was expected is about the longest that is worth it, within a share of it."""
    found, waypoint = set(), -1
    for event in run.events:
        match event:
            case {"event": "arrived", "waypoint": waypoint}:
                pass
            case {"event": "decided", "state": "CHECK" | "CHECK-R"}:
                wait_s = event["check_s"] - event["check_elapsed_s"]
                longest_s = event["local_s"] * 0.75 - event["remote_s"]
                if abs(wait_s - longest_s) < within * longest_s:
                    found.add(waypoint)
    return found
