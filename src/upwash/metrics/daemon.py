"""The metrics of an edge daemon: what it is asked and what starts, counted; how its servers stand, looked at."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Iterator
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, get_args

from prometheus_client import CollectorRegistry, Counter, Histogram
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from upwash.core.admission.clients import Client, DoorReason
from upwash.core.admission.instances import InstanceState
from upwash.errors import InstanceError, Refused
from upwash.metrics.buckets import CALL_S, START_S
from upwash.ports import Answered, AnsweredCall, Instance, InstanceSpec, Runtime, ignored
from upwash.rpc.protocol import AVAILABILITY, DENY, HOLD, LEAVE, PREPARE, START, STATUS
from upwash.server.daemon import EdgeServer, Snapshot

_LOOK_S = 5.0  # longer than a daemon is ever busy at a stretch
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
    """Stands between a daemon and what asks it and what it asks, and lets everything through as it is."""

    def __init__(self) -> None:
        self.registry = registry = CollectorRegistry()
        self._requests = Counter(
            "upwash_requests",
            "Requests of drones, peers and operators",
            ["request", "outcome"],
            registry=registry,
        )
        self.starts = Histogram(
            "upwash_instance_start_seconds",
            "What the start of an instance took, of those that became ready",
            ["server", "service"],
            buckets=START_S,
            registry=registry,
        )
        self.calls = Histogram(
            "upwash_service_seconds",
            "What services took for calls, from their turn to their answer",
            ["server", "service", "method"],
            buckets=CALL_S,
            registry=registry,
        )
        self.failures = Counter(
            "upwash_instance_failures",
            "Instances that did not start, or ended by themselves",
            ["server", "service"],
            registry=registry,
        )

    def daemon(self, handle: Handle) -> Handle:
        """Counts the requests that reach the daemon."""

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

    def runtime(self, runtime: Runtime) -> Runtime:
        """Counts how instances start and end."""
        return _Runtime(runtime, self)

    def look_at(self, edge: EdgeServer) -> None:
        """From now on tells how the daemon stands whenever it is asked; to be called on its event loop."""
        self.registry.register(_Standing(edge, asyncio.get_running_loop()))


@dataclass(frozen=True, slots=True)
class _Runtime:
    runtime: Runtime
    metrics: DaemonMetrics

    async def start(
        self, spec: InstanceSpec, *, called: Callable[[str], None], answered: Answered = ignored
    ) -> Instance:
        def heard(call: AnsweredCall) -> None:
            if call.outcome != "dropped":
                self.metrics.calls.labels(spec.server, spec.service, call.method).observe(call.took_s)
            answered(call)

        began_s = asyncio.get_running_loop().time()
        try:
            instance = await self.runtime.start(spec, called=called, answered=heard)
        except (InstanceError, asyncio.CancelledError):
            self.metrics.failures.labels(spec.server, spec.service).inc()
            raise
        took_s = asyncio.get_running_loop().time() - began_s
        self.metrics.starts.labels(spec.server, spec.service).observe(took_s)
        return _Instance(instance, spec, self.metrics)


@dataclass(frozen=True, slots=True)
class _Instance:
    instance: Instance
    spec: InstanceSpec
    metrics: DaemonMetrics

    @property
    def endpoint(self) -> str:
        return self.instance.endpoint

    async def admit(self, drones: frozenset[str], finishing: frozenset[str] = frozenset()) -> None:
        await self.instance.admit(drones, finishing)

    async def drain(self, why: str) -> None:
        await self.instance.drain(why)

    async def health(self) -> None:
        await self.instance.health()

    async def exited(self) -> str:
        how = await self.instance.exited()
        self.metrics.failures.labels(self.spec.server, self.spec.service).inc()
        return how

    async def stop(self) -> None:
        await self.instance.stop()


class _Standing(Collector):
    """Looks at a daemon on its own event loop, when a thread that answers Prometheus asks."""

    def __init__(self, edge: EdgeServer, loop: asyncio.AbstractEventLoop) -> None:
        self._edge = edge
        self._loop = loop

    def collect(self) -> Iterator[Metric]:
        """How the daemon stands now."""
        standing = asyncio.run_coroutine_threadsafe(_look(self._edge), self._loop).result(_LOOK_S)
        slots = GaugeMetricFamily("upwash_slots", "Drones that the server takes at once", labels=["server"])
        leases = GaugeMetricFamily("upwash_leases", "Drones that have a slot", labels=["server"])
        held = GaugeMetricFamily("upwash_slots_held", "Slots held for a drone on its way", labels=["server"])
        waiting = GaugeMetricFamily("upwash_waiting", "Drones that wait for a slot", labels=["server"])
        turns = CounterMetricFamily(
            "upwash_turns_ended", "Turns that ended for the sake of a drone that waited", labels=["server"]
        )
        instances = GaugeMetricFamily(
            "upwash_instances",
            "1 for the state that the instance is in",
            labels=["server", "service", "state"],
        )
        replaced = CounterMetricFamily(
            "upwash_instances_replaced",
            "Instances that were of no use, and were stopped",
            labels=["server", "service"],
        )
        renewed = CounterMetricFamily(
            "upwash_instances_renewed",
            "Instances that took over in another version of the service",
            labels=["server", "service"],
        )
        paused = GaugeMetricFamily(
            "upwash_service_paused_seconds",
            "How much longer a service that keeps failing is left alone",
            labels=["server", "service"],
        )
        for server in standing.servers:
            slots.add_metric([server.name], server.slots)
            coming = sum(bool(lease.held_by) for lease in server.leases)
            leases.add_metric([server.name], len(server.leases) - coming)
            held.add_metric([server.name], coming)
            waiting.add_metric([server.name], sum(each.waits_s is not None for each in server.accounts))
            turns.add_metric([server.name], server.turns_ended)
            for instance in server.instances:
                replaced.add_metric([server.name, instance.service], instance.replaced)
                renewed.add_metric([server.name, instance.service], instance.renewed)
                paused.add_metric([server.name, instance.service], instance.paused_s)
                for state in InstanceState:
                    labels = [server.name, instance.service, state]
                    instances.add_metric(labels, float(instance.state == state))
        yield from (slots, leases, held, waiting, turns, instances, replaced, renewed, paused)
        yield from _usage(standing)
        yield from (_refusals(standing), _refusals_at_door(standing), _expiries(standing))


async def _look(edge: EdgeServer) -> Snapshot:
    return edge.standing()


def _usage(standing: Snapshot) -> Iterator[Metric]:
    """What drones and teams used; the numbers of teams count forgotten drones too."""
    for whose, labels in (("drone", ["server", "drone", "team"]), ("team", ["server", "team"])):
        used = [
            (each, [server.name, *(getattr(each, label) for label in labels[1:])])
            for server in standing.servers
            for each in (server.drones if whose == "drone" else server.teams)
        ]
        for name, what, number in (
            ("slot_seconds", "Time with a slot", attrgetter("slot_s")),
            ("calls", "Answered calls", attrgetter("calls")),
            ("computing_seconds", "What services took for calls", attrgetter("computed_s")),
        ):
            family = CounterMetricFamily(f"upwash_{whose}_{name}", what, labels=labels)
            for each, values in used:
                family.add_metric(values, number(each))
            yield family


def _refusals(standing: Snapshot) -> Metric:
    refusals = CounterMetricFamily("upwash_refusals", "Clients refused, with a reason", labels=["server"])
    for server, times in standing.refused.items():
        refusals.add_metric([server], times)
    return refusals


def _refusals_at_door(standing: Snapshot) -> Metric:
    refusals = CounterMetricFamily(
        "upwash_door_refusals", "Connections refused before any request", labels=["reason"]
    )
    known = {each.reason: each.times for each in standing.at_door}
    for reason in get_args(DoorReason):
        refusals.add_metric([reason], known.get(reason, 0))
    return refusals


def _expiries(standing: Snapshot) -> Metric:
    expiries = GaugeMetricFamily(
        "upwash_certificate_expiry_timestamp_seconds",
        "When the certificate ends, since 1970",
        labels=["holder"],
    )
    for certificate in standing.certificates:
        expiries.add_metric([certificate.holder], certificate.expires.timestamp())
    return expiries
