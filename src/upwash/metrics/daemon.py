"""The metrics of an edge daemon: its requests and instances, counted; its servers' state, read at each scrape.

Also whether the daemon is alive and ready, for probes.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Coroutine, Iterator
from datetime import UTC, datetime
from functools import partial
from typing import Any, get_args

from prometheus_client import CollectorRegistry, Counter, Histogram
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from upwash.core.admission.clients import Client, DoorReason, DroneUsage, TeamUsage
from upwash.core.admission.instances import InstanceState
from upwash.errors import Refused
from upwash.metrics import CALL_S
from upwash.metrics.exposition import NO_QUESTIONS, Questions
from upwash.ports import AnsweredCall, InstanceSpec
from upwash.rpc.protocol import (
    AVAILABILITY,
    DENY,
    HOLD,
    LEAVE,
    PREPARE,
    START,
    STATUS,
    DaemonStatus,
)
from upwash.server.daemon import EdgeServer, Snapshot
from upwash.server.instances import Observer

_LOOK_S = 5.0  # longer than a daemon is ever busy at a stretch
_PROBE_S = 2.0  # a Kubernetes probe waits for 3 s in our manifests
_START_S = (0.1, 0.2, 0.5, 1.0, 2.0, 3.0, 5.0, 7.5, 10.0, 15.0, 20.0, 30.0, 60.0)
_REQUESTS = {
    AVAILABILITY: "availability",
    START: "start",
    LEAVE: "leave",
    DENY: "deny",
    PREPARE: "prepare",
    HOLD: "hold",
    STATUS: "status",
}

Handle = Callable[[str, bytes, Client], Coroutine[Any, Any, bytes]]


class DaemonMetrics:
    """Counts a daemon's requests, and what happens to its instances."""

    def __init__(self) -> None:
        self.registry = registry = CollectorRegistry()
        counter, seconds = partial(Counter, registry=registry), partial(Histogram, registry=registry)
        instance = ["server", "service"]
        requests = "Requests of drones, peers and operators"
        self._requests = counter("upwash_requests", requests, ["request", "outcome"])
        starts = "What the start of an instance took, of those that became ready"
        self.starts = seconds("upwash_instance_start_seconds", starts, instance, buckets=_START_S)
        calls = "What services took for calls, from their turn to their answer"
        self.calls = seconds("upwash_service_seconds", calls, [*instance, "method"], buckets=CALL_S)
        failures = "Instances that did not start, or ended by themselves"
        self.failures = counter("upwash_instance_failures", failures, instance)
        self.questions: Questions = NO_QUESTIONS  # `look_at` adds them

    def daemon(self, handle: Handle) -> Handle:
        """The daemon's handler, with each request counted."""

        async def answer(path: str, body: bytes, client: Client) -> bytes:
            request, outcome = _REQUESTS.get(path, "unknown"), "failed"
            try:
                reply = await handle(path, body, client)
                outcome = "answered"
            except Refused:
                outcome = "refused"
                raise
            finally:
                self._requests.labels(request, outcome).inc()
            return reply

        return answer

    def observer(self) -> Observer:
        """Functions that count the starts, failures and calls of instances."""

        def answered(spec: InstanceSpec, call: AnsweredCall) -> None:
            if call.outcome != "dropped":
                self.calls.labels(spec.server, spec.service, call.method).observe(call.took_s)

        return Observer(
            started=lambda spec, took_s: self.starts.labels(spec.server, spec.service).observe(took_s),
            failed=lambda spec: self.failures.labels(spec.server, spec.service).inc(),
            answered=answered,
        )

    def look_at(self, edge: EdgeServer) -> None:
        """Read the daemon's state at each scrape from now on; must be called on its event loop.

        `/live` is True while that loop does its work, and `/ready` while the daemon takes calls of drones.
        """
        loop = asyncio.get_running_loop()
        self.registry.register(_DaemonState(edge, loop))
        self.questions = {
            "/live": lambda: _asked(_is_live(), loop),
            "/ready": lambda: _asked(_is_ready(edge), loop),
        }


_Family = GaugeMetricFamily | CounterMetricFamily
_G, _C = GaugeMetricFamily, CounterMetricFamily
_DRONE, _TEAM = ["server", "drone", "team"], ["server", "team"]
_FAMILIES: tuple[tuple[type[_Family], str, str, list[str]], ...] = (
    (_G, "slots", "Drones that the server takes at once", ["server"]),
    (_G, "leases", "Drones that have a slot", ["server"]),
    (_G, "slots_held", "Slots held for a drone on its way", ["server"]),
    (_G, "waiting", "Drones that wait for a slot", ["server"]),
    (_C, "turns_ended", "Turns that ended because another drone waited", ["server"]),
    (_G, "instances", "1 for the state that the instance is in", ["server", "service", "state"]),
    (_C, "instances_replaced", "Instances that were of no use, and were stopped", ["server", "service"]),
    (_C, "instances_renewed", "Instances that took over in another version", ["server", "service"]),
    (_G, "service_paused_seconds", "Time for which a failing service is left alone", ["server", "service"]),
    (_C, "drone_slot_seconds", "Time with a slot", _DRONE),
    (_C, "drone_calls", "Answered calls", _DRONE),
    (_C, "drone_computing_seconds", "What services took for calls", _DRONE),
    (_C, "team_slot_seconds", "Time with a slot, of forgotten drones too", _TEAM),
    (_C, "team_calls", "Answered calls, of forgotten drones too", _TEAM),
    (_C, "team_computing_seconds", "What services took for calls, of forgotten drones too", _TEAM),
    (_C, "refusals", "Clients refused, with a reason", ["server"]),
    (_C, "door_refusals", "Connections refused before any request", ["reason"]),
    (_G, "certificate_expiry_timestamp_seconds", "When the certificate ends, since 1970", ["holder"]),
    (_G, "daemon_info", "1, for the program that runs", ["version", "commit", "code", "sandbox"]),
    (_G, "clock_kept", "1 if something keeps the clock in time", []),
    (_G, "revoked_certificates", "Certificates that are refused as revoked", []),
    (_G, "in_force_since_timestamp_seconds", "Since when a part is in force, since 1970", ["part", "digest"]),
    (_G, "reload_refused", "1 if the last reload left the part as it was", ["part"]),
    (_G, "reload_successful", "1 if the last reload, or the start, refused no part", []),
    (_G, "reload_timestamp_seconds", "When the last reload was ordered, since 1970", []),
)
StateSample = tuple[str, float, tuple[str, ...]]  # its family's name, and the values of the family's labels


class _DaemonState(Collector):
    """Reads a daemon's state on its own event loop, from the thread that answers Prometheus."""

    def __init__(self, edge: EdgeServer, loop: asyncio.AbstractEventLoop) -> None:
        self._edge = edge
        self._loop = loop

    def collect(self) -> Iterator[Metric]:
        """The metrics of the daemon's state now."""
        standing = asyncio.run_coroutine_threadsafe(_read(self._edge), self._loop).result(_LOOK_S)
        families = {
            name: kind(f"upwash_{name}", what, labels=labels) for kind, name, what, labels in _FAMILIES
        }
        for name, number, values in _samples(standing):
            families[name].add_metric(values, float(number))
        yield from families.values()


async def _read(edge: EdgeServer) -> Snapshot:
    return edge.standing()


def _asked(question: Coroutine[Any, Any, bool], loop: asyncio.AbstractEventLoop) -> bool:
    """The answer of the daemon's event loop; False if the loop is busy for too long."""
    with contextlib.suppress(TimeoutError):
        return asyncio.run_coroutine_threadsafe(question, loop).result(_PROBE_S)
    return False


async def _is_live() -> bool:
    return True


async def _is_ready(edge: EdgeServer) -> bool:
    """Whether drones are admitted, every service runs or can be started, and the certificates are valid."""
    standing, now = edge.standing(), datetime.now(UTC)
    failing = (
        instance.paused_s > 0 and instance.state != InstanceState.RUNNING
        for server in standing.servers
        for instance in server.instances
    )
    ended = (certificate.expires <= now for certificate in standing.certificates)
    return not (edge.is_closing or any(failing) or any(ended))


def _samples(standing: Snapshot) -> Iterator[StateSample]:
    for server in standing.servers:
        at = (server.name,)
        held = sum(bool(lease.held_by) for lease in server.leases)
        yield "slots", server.slots, at
        yield "leases", len(server.leases) - held, at
        yield "slots_held", held, at
        yield "waiting", sum(drone.waits_s is not None for drone in server.accounts), at
        yield "turns_ended", server.turns_ended, at
        for instance in server.instances:
            service = (server.name, instance.service)
            yield "instances_replaced", instance.replaced, service
            yield "instances_renewed", instance.renewed, service
            yield "service_paused_seconds", instance.paused_s, service
            for state in InstanceState:
                yield "instances", instance.state == state, (*service, state)
        for drone in server.drones:
            yield from _used("drone", drone, (server.name, drone.drone, drone.team))
        for team in server.teams:
            yield from _used("team", team, (server.name, team.team))
    for name, times in standing.refused.items():
        yield "refusals", times, (name,)
    at_door = {status.reason: status.times for status in standing.at_door}
    for reason in get_args(DoorReason):
        yield "door_refusals", at_door.get(reason, 0), (reason,)
    for known in standing.certificates:
        yield "certificate_expiry_timestamp_seconds", known.expires.timestamp(), (known.holder,)
    if standing.daemon is not None:
        yield from _in_force(standing.daemon)


def _in_force(daemon: DaemonStatus) -> Iterator[StateSample]:
    yield "daemon_info", 1, (daemon.version, daemon.commit, daemon.code, daemon.sandbox)
    if daemon.clock_is_kept is not None:
        yield "clock_kept", daemon.clock_is_kept, ()
    yield "revoked_certificates", daemon.revoked, ()
    for part, status in daemon.parts.items():
        yield "in_force_since_timestamp_seconds", status.since.timestamp(), (part, status.digest)
        yield "reload_refused", bool(status.refused), (part,)
    yield "reload_successful", not any(status.refused for status in daemon.parts.values()), ()
    if daemon.reload is not None:
        yield "reload_timestamp_seconds", daemon.reload.asked.timestamp(), ()


def _used(whose: str, user: DroneUsage | TeamUsage, values: tuple[str, ...]) -> Iterator[StateSample]:
    yield f"{whose}_slot_seconds", user.slot_s, values
    yield f"{whose}_calls", user.calls, values
    yield f"{whose}_computing_seconds", user.computed_s, values
