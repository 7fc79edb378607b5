"""What a run came to, read from its events."""

from __future__ import annotations

from collections import Counter
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
    """One run; `undone` are the waypoints that were not reached, `left_hovering` whether the pilot has to land.

    The mission's time is counted from arming; `arming_s` is how long it had waited for that.
    """

    policy: str
    mission_time_s: float
    completed: bool
    calls: list[CallResult]
    totals: Totals
    waypoints: int
    undone: list[int]
    left_hovering: bool
    arming_s: float = 0.0

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

    All parts of a run that was broken off and taken up again count, and the time between them too. No event is kept.
    """
    tally = Tally()
    for event in events:
        if event["event"] == "log_opened":
            tally = Tally()
        if not tally.completed:
            tally.take(event)
    return tally.result()


class Tally:
    """What one run came to, gathered event by event, of which none is kept."""

    def __init__(self) -> None:
        self.completed = False
        self._policy, self._ended_s = "", 0.0
        self._began = Beginning()
        self._waypoint: int | None = None
        self._calls: list[CallResult] = []
        self._waypoints, self._reached, self._left_hovering = 0, set[int | None](), False
        self._waits: list[str] = []
        self._switches = self._fallbacks = 0

    def take(self, event: Mapping[str, Any]) -> None:
        """Takes in the next event."""
        self._ended_s = event["t"]
        self._began.take(event)
        match event["event"]:
            case "mission_started":
                self._policy, self._waypoints = event["policy"], event.get("waypoints", 0)
                self._waypoint, self._left_hovering = None, False
            case "mission_completed":
                self.completed = True
            case "arrived":
                self._waypoint = event["waypoint"]
                self._reached.add(self._waypoint)
            case "left_hovering":
                self._left_hovering = True
            case "selected":
                self._switches += 1
            case "call":
                self._calls.append(_call(event, self._waypoint, self._began.at_s or 0.0))
                self._waits += [event["wait"]] if event["wait"] else []
                self._fallbacks += event["fell_back"]

    def result(self) -> RunResult:
        """What it came to."""
        remote = Counter(call.place for call in self._calls if call.place != "local")
        return RunResult(
            policy=self._policy,
            mission_time_s=self._ended_s - (self._began.at_s or 0.0),
            completed=self.completed,
            calls=self._calls,
            totals=Totals(
                calls=len(self._calls),
                local=len(self._calls) - remote.total(),
                remote=dict(sorted(remote.items())),
                waits=len(self._waits),
                waits_failed=self._waits.count("failed"),
                switches=self._switches,
                fallbacks=self._fallbacks,
                service_delay_s=sum(call.delay_s for call in self._calls),
            ),
            waypoints=self._waypoints,
            undone=[index for index in range(self._waypoints) if index not in self._reached],
            left_hovering=self._left_hovering,
            arming_s=self._began.arming_s,
        )


class Beginning:
    """When the mission's time begins, gathered event by event: as it is armed for its first leg.

    `at_s` is None before the mission has started; where it took photos or called services before it was armed, or was
    taken up again in the air, it began as it started.
    """

    def __init__(self) -> None:
        self.at_s: float | None = None
        self.arming_s = 0.0
        self._settled = False

    def take(self, event: Mapping[str, Any]) -> None:
        """Takes in the next event."""
        match event["event"]:
            case "mission_started" if self.at_s is None:
                self.at_s = event["t"]
            case "armed" if self.at_s is not None and not self._settled:
                self.arming_s = event["t"] - self.at_s
                self.at_s, self._settled = event["t"], True
            case "photo" | "call" | "leg" | "log_resumed" if self.at_s is not None:
                self._settled = True


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
