"""The metrics of a drone, counted from the events of its log."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram

from upwash.core.knowledge.servers import State
from upwash.eventlog import schema
from upwash.eventlog.schema import Event
from upwash.metrics import CALL_S

_ON_DRONE = "drone"


class DroneMetrics:
    """Follows the events of a flight and keeps its metrics up to date."""

    def __init__(self, servers: Iterable[str]) -> None:
        self.registry = registry = CollectorRegistry()
        counter, gauge = partial(Counter, registry=registry), partial(Gauge, registry=registry)
        seconds = partial(Histogram, registry=registry, buckets=CALL_S)
        by_call, by_place = ["operation", "place"], ["place"]
        self._calls = counter("upwash_calls", "Service calls that were answered", [*by_call, "outcome"])
        self._call_s = seconds("upwash_call_seconds", "What a service call took, waiting included", by_call)
        waits = "How long calls waited for a server to be ready"
        self._wait_s = seconds("upwash_wait_seconds", waits, ["outcome"])
        self._failures = counter("upwash_failures", "Attempts at a call that had no answer", by_place)
        in_state = "1 for the state that the server is in"
        self._states = gauge("upwash_server_state", in_state, ["server", "state"])
        steps = "Steps of servers through their states"
        self._steps = counter("upwash_server_steps", steps, ["server", "step"])
        self._photos = counter("upwash_photos", "Photos taken")
        self._planned = gauge("upwash_waypoints", "Waypoints of the mission")
        self._reached = gauge("upwash_waypoints_reached", "Waypoints that the mission has reached")
        self._under_way = gauge("upwash_mission_under_way", "1 while the mission is flown")
        self._waypoints: set[int] = set()  # reached
        for server in servers:
            self._be_in(server, State.AVL)

    def follow(self, event: Event) -> None:
        """Takes in one event."""
        match event:
            case schema.Call():
                self._count_call(event)
            case schema.RemoteFailed(server=server):
                self._failures.labels(server).inc()
            case schema.LocalFailed():
                self._failures.labels(_ON_DRONE).inc()
            case schema.ServerStep(server=server, after=after):
                self._steps.labels(server, event.kind).inc()
                self._be_in(server, after)
            case schema.PhotoTaken():
                self._photos.inc()
            case schema.MissionStarted(waypoints=waypoints, done=done):
                self._planned.set(waypoints)
                self._waypoints = set(done)
                self._reached.set(len(done))
                self._under_way.set(1)
            case schema.Arrived(waypoint=int(waypoint)):
                self._waypoints.add(waypoint)  # the drone may come back to it
                self._reached.set(len(self._waypoints))
            case schema.MissionCompleted() | schema.MissionEnded():
                self._under_way.set(0)

    def _count_call(self, call: schema.Call) -> None:
        operation, place = call.operation, call.server or _ON_DRONE
        self._calls.labels(operation, place, "fell_back" if call.fell_back else "answered").inc()
        self._call_s.labels(operation, place).observe(call.delay_s)
        if call.wait:
            self._wait_s.labels(call.wait.replace(" ", "_")).observe(call.waited_s)

    def _be_in(self, server: str, state: State) -> None:
        for other in State:
            self._states.labels(server, other).set(other is state)
