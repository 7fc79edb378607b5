"""What a run came to, read from its events."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import msgspec


class CallResult(msgspec.Struct, frozen=True):
    """One service call, as the mission experienced it; `waypoint` is None before the first arrival."""

    waypoint: int | None
    operation: str
    place: str
    decision: str
    delay_s: float
    waited_s: float
    at_s: float


class Totals(msgspec.Struct, frozen=True):
    """Sums over all calls; `remote` counts by server, `fallbacks` remote calls that ended on the drone."""

    calls: int
    local: int
    remote: dict[str, int]
    waits: int
    waits_failed: int
    switches: int
    fallbacks: int
    service_delay_s: float


class RunResult(msgspec.Struct, frozen=True):
    """One run; `undone` are the waypoints that were not reached, `left_hovering` whether the pilot has to land."""

    policy: str
    mission_time_s: float
    completed: bool
    calls: list[CallResult]
    totals: Totals
    waypoints: int
    undone: list[int]
    left_hovering: bool

    def local_only_time_s(self) -> float | None:
        """How long the mission would have taken with every call at the mean measured local delay.

        None where an operation was never run on the drone, so that nothing measured says.
        """
        local = mean_local_delay_s(self.calls)
        if any(call.operation not in local for call in self.calls):
            return None
        return self.mission_time_s + sum(local[call.operation] - call.delay_s for call in self.calls)


def read_result(events: Iterable[Mapping[str, Any]]) -> RunResult:
    """The result of the run that left these events, the last of several, whether it was completed or not.

    All parts of a run that was broken off and taken up again count, and the time between them too.
    """
    policy, ended_s, completed = "", 0.0, False
    began_s: float | None = None  # of the first part, where a flight was taken up again
    waypoint: int | None = None
    calls: list[CallResult] = []
    selected: list[str] = []
    waypoints, reached, left_hovering = 0, set[int | None](), False
    waits: list[str] = []
    fallbacks = 0
    for event in last_run(events):
        ended_s = event["t"]
        match event["event"]:
            case "mission_started":
                policy, waypoints = event["policy"], event.get("waypoints", 0)
                began_s = event["t"] if began_s is None else began_s
                waypoint, left_hovering = None, False
            case "mission_completed":
                completed = True
            case "arrived":
                waypoint = event["waypoint"]
                reached.add(waypoint)
            case "left_hovering":
                left_hovering = True
            case "selected":
                selected.append(event["server"])
            case "call":
                calls.append(_call(event, waypoint, began_s or 0.0))
                waits += [event["wait"]] if event["wait"] else []
                fallbacks += event["fell_back"]
        if completed:
            break
    remote: dict[str, int] = {}
    for call in calls:
        if call.place != "local":
            remote[call.place] = remote.get(call.place, 0) + 1
    return RunResult(
        policy=policy,
        mission_time_s=ended_s - (began_s or 0.0),
        completed=completed,
        calls=calls,
        totals=Totals(
            calls=len(calls),
            local=len(calls) - sum(remote.values()),
            remote=dict(sorted(remote.items())),
            waits=len(waits),
            waits_failed=waits.count("failed"),
            switches=len(selected),
            fallbacks=fallbacks,
            service_delay_s=sum(call.delay_s for call in calls),
        ),
        waypoints=waypoints,
        undone=[index for index in range(waypoints) if index not in reached],
        left_hovering=left_hovering,
    )


def last_run(events: Iterable[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """The events of the last of the runs that a log holds."""
    run: list[Mapping[str, Any]] = []
    for event in events:
        if event["event"] == "log_opened":
            run = []
        run.append(event)
    return run


def _call(event: Mapping[str, Any], waypoint: int | None, began_s: float) -> CallResult:
    return CallResult(
        waypoint=waypoint,
        operation=event["operation"],
        place=event["place"],
        decision=event["decision"],
        delay_s=event["delay_s"],
        waited_s=event["waited_s"],
        at_s=event["t"] - event["delay_s"] - began_s,
    )


def mean_local_delay_s(calls: Iterable[CallResult]) -> dict[str, float]:
    """By operation, what its calls on the drone took on average, without what was waited for servers."""
    delays: dict[str, list[float]] = {}
    for call in calls:
        if call.place == "local":
            delays.setdefault(call.operation, []).append(call.delay_s - call.waited_s)
    return {operation: sum(values) / len(values) for operation, values in delays.items()}
