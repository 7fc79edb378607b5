"""What drones and daemons offer to Prometheus: true numbers, under the names of the documentation."""

from __future__ import annotations

import asyncio
import http.client
import itertools
import json
import re
import socket
from collections.abc import Callable, Collection, Iterator
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec
import pytest
from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import Metric
from prometheus_client.parser import text_string_to_metric_families
from prometheus_client.registry import Collector
from tests.events import event as made
from tests.server.test_edge_server import COLD_START_S, Runtime

from upwash.core.admission.admission import AdmissionController
from upwash.core.admission.clients import Client
from upwash.core.admission.server import ServerOffer
from upwash.core.knowledge.servers import State
from upwash.errors import InstanceError, Refused, UsageError
from upwash.eventlog import schema
from upwash.lab.run import Run, simulate
from upwash.lab.scenario import read_scenario
from upwash.metrics.daemon import DaemonMetrics
from upwash.metrics.drone import DroneMetrics
from upwash.metrics.exposition import exposed
from upwash.ports import AnsweredCall, Instance, InstanceSpec, Program
from upwash.report.palette import DARK, LIGHT
from upwash.rpc.protocol import (
    AVAILABILITY,
    START,
    AvailabilityRequest,
    CertificateStatus,
    DaemonStatus,
    PartStatus,
    ReloadStatus,
    StartRequest,
)
from upwash.server.daemon import EdgeServer
from upwash.server.instances import Image
from upwash.sim.link import ModelDialer, Switchboard

ROOT = Path(__file__).parents[2]
IMAGES = {"detector": Image(Program("somewhere:Detector"))}
EXPIRES = datetime(2030, 1, 1, tzinfo=UTC)

# --- a drone's ------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def run() -> Run:
    """A mission with servers that fail: calls of every outcome, waits, every state."""
    return simulate(read_scenario(ROOT / "scenarios/flapping-servers.toml"))


@pytest.fixture(scope="module")
def drone(run: Run) -> DroneMetrics:
    servers = {event.server for event in run.events if isinstance(event, schema.ServerStep)}
    metrics = DroneMetrics(sorted(servers))
    for event in run.events:
        metrics.follow(event)
    return metrics


def total(registry: CollectorRegistry, sample: str, **labels: str) -> float:
    """The sum of the samples of that name that have these labels."""
    found = [
        each.value
        for family in registry.collect()
        for each in family.samples
        if each.name == sample and labels.items() <= each.labels.items()
    ]
    return sum(found)


def test_calls_are_counted_by_place_and_outcome(run: Run, drone: DroneMetrics) -> None:
    totals = run.result.totals
    calls = "upwash_calls_total"
    assert total(drone.registry, calls) == totals.calls
    assert total(drone.registry, calls, place="drone") == totals.local
    for server, count in totals.remote.items():
        assert total(drone.registry, calls, place=server) == count
    assert total(drone.registry, calls, outcome="fell_back") == totals.fallbacks > 0


def test_delays_and_waits_are_those_of_the_calls(run: Run, drone: DroneMetrics) -> None:
    assert total(drone.registry, "upwash_call_seconds_sum") == pytest.approx(
        run.result.totals.service_delay_s
    )
    slow = sum(call.delay_s > 1.0 for call in run.result.calls)
    assert total(drone.registry, "upwash_call_seconds_count") - total(
        drone.registry, "upwash_call_seconds_bucket", le="1.0"
    ) == pytest.approx(slow)
    assert total(drone.registry, "upwash_wait_seconds_count") == run.result.totals.waits
    assert (
        total(drone.registry, "upwash_wait_seconds_count", outcome="failed") == run.result.totals.waits_failed
    )


def test_each_server_is_in_the_one_state_that_the_log_left_it_in(run: Run, drone: DroneMetrics) -> None:
    last: dict[str, str] = {}
    for event in run.events:
        if isinstance(event, schema.ServerStep):
            last[event.server] = event.after
    for server, state in last.items():
        states = {
            each: total(drone.registry, "upwash_server_state", server=server, state=each) for each in State
        }
        assert states == {each: float(each == state) for each in State}
    failed = sum(event.kind in {"remote_failed", "local_failed"} for event in run.events)
    assert total(drone.registry, "upwash_failures_total") == failed > 0


def test_the_mission_is_followed_from_its_start_to_its_end(run: Run) -> None:
    metrics, under_way = DroneMetrics([]), set()
    for event in run.events:
        metrics.follow(event)
        under_way.add(total(metrics.registry, "upwash_mission_under_way"))
    assert under_way == {0.0, 1.0}
    assert total(metrics.registry, "upwash_mission_under_way") == 0.0
    assert total(metrics.registry, "upwash_waypoints_reached") == run.result.waypoints > 0
    assert total(metrics.registry, "upwash_photos_total") == run.result.totals.calls


def test_a_waypoint_that_the_drone_turns_back_to_is_reached_once() -> None:
    metrics = DroneMetrics(())
    metrics.follow(made("mission_started", waypoints=4, done=[0]))
    for waypoint in (0, 1, 2, 1, 2, None):
        metrics.follow(made("arrived", waypoint=waypoint))
    assert total(metrics.registry, "upwash_waypoints_reached") == 3


# --- a daemon's -----------------------------------------------------------------------------------------------


class Edge:
    """A daemon with its metrics."""

    def __init__(self, runtime: Any, expires: datetime = EXPIRES) -> None:
        self.metrics = DaemonMetrics()
        self.status = DaemonStatus(
            version="1.0",
            commit="c0ffee",
            code="ab",
            sandbox="bubblewrap",
            time=EXPIRES,
            clock_is_kept=True,
            revoked=3,
            parts={
                "revocations": PartStatus("0a", EXPIRES),
                "keys": PartStatus("0b", EXPIRES, "no such file"),
            },
            reload=ReloadStatus(EXPIRES, "SIGHUP", EXPIRES),
        )
        self.edge = EdgeServer(
            AdmissionController({"s1": ServerOffer(frozenset({"detector"}), slots=1)}),
            images=IMAGES,
            runtime=runtime,
            observer=self.metrics.observer(),
            dialer=ModelDialer("s1", Switchboard({})),
            start_timeout_s=60.0,
            drain_s=10.0,
            certificates=lambda: [CertificateStatus("s1", expires)],
            status=lambda: self.status,
        )
        self.handle = self.metrics.daemon(self.edge.handle)

    async def ask(self, drone: str, server: str = "s1") -> None:
        request = msgspec.msgpack.encode(AvailabilityRequest(server, ["detector"]))
        await self.handle(AVAILABILITY, request, Client(drone))

    async def start(self, drone: str) -> None:
        await self.handle(START, msgspec.msgpack.encode(StartRequest("s1", "detector")), Client(drone))

    def total(self, sample: str, **labels: str) -> float:
        return total(self.metrics.registry, sample, **labels)


@pytest.mark.virtual
async def test_starts_are_timed_and_what_fails_is_counted() -> None:
    runtime = Runtime()
    at = Edge(runtime)
    await at.start("heron")
    assert at.total("upwash_instance_start_seconds_sum", service="detector") == pytest.approx(COLD_START_S)
    runtime.instances[0].ended.set_result("it crashed")
    await asyncio.sleep(5.0)
    assert at.total("upwash_instance_failures_total", server="s1") == 1
    runtime.broken = "no memory"
    await at.start("heron")
    assert at.total("upwash_instance_failures_total") == 2
    assert at.total("upwash_instance_start_seconds_count") == 1
    await at.edge.close()
    assert at.total("upwash_instance_failures_total") == 2, "an end that was asked for is no failure"


@pytest.mark.virtual
async def test_a_start_that_the_daemon_breaks_off_is_no_failure() -> None:
    at = Edge(Runtime())
    starting = asyncio.create_task(at.start("heron"))
    await asyncio.sleep(COLD_START_S / 2)
    await at.edge.close()
    await starting
    assert at.total("upwash_instance_failures_total") == 0


@pytest.mark.virtual
async def test_what_services_take_is_told_by_instances() -> None:
    runtime = Runtime()
    at = Edge(runtime)
    await at.start("heron")
    for took_s in (0.2, 3.0):
        runtime.answered[0](AnsweredCall("heron", "process_photo", 60.0, took_s))
    took_s = at.total("upwash_service_seconds_sum", server="s1", service="detector", method="process_photo")
    assert took_s == pytest.approx(3.2)
    assert at.total("upwash_service_seconds_bucket", le="0.5") == 1
    await at.edge.close()


@pytest.mark.virtual
async def test_requests_are_counted_by_their_outcome() -> None:
    at = Edge(Runtime())
    await at.ask("heron")
    with pytest.raises(Refused):
        await at.handle(AVAILABILITY, b"garbage", Client("heron"))
    with pytest.raises(Refused):
        await at.handle("/upwash.Daemon/Nonsense", b"", Client("heron"))
    requests = "upwash_requests_total"
    assert at.total(requests, request="availability", outcome="answered") == 1
    assert at.total(requests, request="availability", outcome="refused") == 1
    assert at.total(requests, request="unknown", outcome="refused") == 1
    assert at.total(requests) == 3


class Ready:
    """A runtime whose instances are there at once."""

    async def start(self, spec: InstanceSpec, *, called: Callable[[str], None], **_: Any) -> Instance:
        return _Running()


class _Running:
    endpoint = ":1"

    async def admit(self, drones: frozenset[str], finishing: frozenset[str] = frozenset()) -> None: ...
    async def drain(self, why: str) -> None: ...
    async def stop(self) -> None: ...
    async def health(self) -> None: ...

    async def exited(self) -> str:
        await asyncio.get_running_loop().create_future()
        raise InstanceError("never")


async def test_how_the_daemon_stands_is_looked_at_when_it_is_asked() -> None:
    at = Edge(Ready())
    at.metrics.look_at(at.edge)
    assert await offered(at) == {"slots": 1, "leases": 0, "absent": 1, "running": 0, "refused": 0}
    await at.start("heron")
    assert await offered(at) == {"slots": 1, "leases": 1, "absent": 0, "running": 1, "refused": 0}
    await at.ask("stork")
    await at.ask("stork", server="s7")
    assert await offered(at) == {"slots": 1, "leases": 1, "absent": 0, "running": 1, "refused": 1}
    elsewhere = await asyncio.to_thread(at.total, "upwash_refusals_total", server="")
    assert elsewhere == 1, "whatever server strangers name, there is one number for it"
    expiry = await asyncio.to_thread(at.total, "upwash_certificate_expiry_timestamp_seconds", holder="s1")
    assert expiry == EXPIRES.timestamp()
    await at.edge.close()


async def test_a_reload_that_refused_a_part_is_offered_with_the_part_and_what_is_in_force() -> None:
    at = Edge(Ready())
    at.metrics.look_at(at.edge)
    parts = [
        await asyncio.to_thread(at.total, "upwash_reload_refused", part=part)
        for part in ("revocations", "keys")
    ]
    assert parts == [0.0, 1.0]
    for sample, expected in (
        ("upwash_reload_successful", 0.0),
        ("upwash_revoked_certificates", 3.0),
        ("upwash_clock_kept", 1.0),
        ("upwash_reload_timestamp_seconds", EXPIRES.timestamp()),
    ):
        assert await asyncio.to_thread(at.total, sample) == expected, sample
    since = await asyncio.to_thread(at.total, "upwash_in_force_since_timestamp_seconds", digest="0a")
    assert since == EXPIRES.timestamp()
    await at.edge.close()


async def test_a_drone_that_waits_is_told_as_such_and_refused_once_however_often_it_asks() -> None:
    at = Edge(Ready())
    at.metrics.look_at(at.edge)
    await at.ask("heron")
    for _ in range(3):
        await at.ask("stork")
    assert await told(at, "upwash_waiting", "upwash_turns_ended_total", "upwash_refusals_total") == [
        1,
        0,
        1,
    ]
    at_once = ServerOffer(frozenset({"detector"}), slots=1, turn_s=0.0)
    at.edge.reload({"s1": at_once}, images=IMAGES)
    await at.ask("stork")
    assert await told(at, "upwash_waiting", "upwash_turns_ended_total", "upwash_leases") == [0, 1, 1]


async def test_what_drones_and_teams_used_is_offered_by_name() -> None:
    runtime = Runtime()
    at = Edge(runtime)
    at.metrics.look_at(at.edge)
    await at.start("north-1")
    for took_s in (0.5, 0.25):
        runtime.answered[0](AnsweredCall("north-1", "process_photo", 1.0, took_s))
    found = await asyncio.to_thread(generate_latest, at.metrics.registry)
    of_drone = 'drone="north-1",server="s1",team="north"'
    for line in (
        f"upwash_drone_calls_total{{{of_drone}}} 2.0",
        f"upwash_drone_computing_seconds_total{{{of_drone}}} 0.75",
        'upwash_team_calls_total{server="s1",team="north"} 2.0',
    ):
        assert line in found.decode()
    await at.edge.close()


async def told(at: Edge, *samples: str) -> list[float]:
    return await asyncio.to_thread(lambda: [at.total(sample, server="s1") for sample in samples])


async def offered(at: Edge) -> dict[str, float]:
    def look() -> dict[str, float]:
        return {
            "slots": at.total("upwash_slots", server="s1"),
            "leases": at.total("upwash_leases", server="s1"),
            "absent": at.total("upwash_instances", service="detector", state="absent"),
            "running": at.total("upwash_instances", service="detector", state="running"),
            "refused": at.total("upwash_refusals_total", server="s1"),
        }

    return await asyncio.to_thread(look)


# --- where they are offered -----------------------------------------------------------------------------------


def fetch(address: str) -> str:
    connection = http.client.HTTPConnection(address, timeout=10.0)
    connection.request("GET", "/metrics")
    return connection.getresponse().read().decode()


def test_they_are_offered_until_the_end_and_no_longer(drone: DroneMetrics) -> None:
    async def story() -> str:
        async with exposed(drone.registry, "127.0.0.1:0") as address:
            assert "upwash_calls_total{" in await asyncio.to_thread(fetch, address)
        return address

    with pytest.raises(ConnectionRefusedError):
        fetch(asyncio.run(story()))


def asked(request: bytes, hosts: Collection[str] = ()) -> bytes:
    """What is answered to these bytes, to the end of the connection."""

    def ask(address: str) -> bytes:
        host, _, port = address.rpartition(":")
        with socket.create_connection((host, int(port)), timeout=10.0) as connection:
            connection.sendall(request.replace(b"ADDRESS", address.encode()))
            with connection.makefile("rb") as answer:
                return answer.read()

    async def story() -> bytes:
        async with exposed(CollectorRegistry(), "127.0.0.1:0", hosts) as address:
            return await asyncio.to_thread(ask, address)

    return asyncio.run(story())


@pytest.mark.parametrize(
    ("request_", "status"),
    [
        (b"GET /metrics HTTP/1.1\r\nHost: ADDRESS\r\n\r\n", 200),
        (b"GET /metrics?name[]=up HTTP/1.0\r\nhost:localhost\r\n\r\n", 200),
        (b"HEAD / HTTP/1.1\r\nHost: ADDRESS\r\n\r\n", 200),
        (b"GET /metrics HTTP/1.1\r\nHost: evil.example\r\n\r\n", 421),
        (b"GET /metrics HTTP/1.1\r\nHost: ADDRESS\r\nHost: evil.example\r\n\r\n", 400),
        (b"GET /metrics HTTP/1.1\r\n\r\n", 400),
        (b"GET /else HTTP/1.1\r\nHost: ADDRESS\r\n\r\n", 404),
        (b"POST /metrics HTTP/1.1\r\nHost: ADDRESS\r\n\r\n", 405),
        (b"\x16\x03\x01\r\n\r\n", 400),
        (b"GET /metrics HTTP/1.1\r\nHost: \xff\xfe\r\n\r\n", 421),
        (b"GET /metrics HTTP/1.1\r\n" + b"A: b\r\n" * 10_000, 400),
        (b"GET /metrics HTTP/1.1\r\nHost: ADDRESS\r\n" + b"A: b\r\n" * 10_000 + b"\r\n", 400),
        (b"GET /metrics HTTP/1.0\r\n\r\n", 400),
        (b"GET /metrics HTTP/1.1\r\nHost: ADDRESS\r\nAccept: \xff\r\n\r\n", 200),
    ],
)
def test_only_who_means_this_machine_is_answered(request_: bytes, status: int) -> None:
    assert asked(request_).startswith(f"HTTP/1.1 {status} ".encode())


def test_a_prometheus_by_another_name_learns_how_the_name_is_added(caplog: pytest.LogCaptureFixture) -> None:
    refused = asked(b"GET /metrics HTTP/1.1\r\nHost: host.docker.internal:9100\r\n\r\n").decode()
    for said in (refused, caplog.text):
        assert re.search(r'Host is "host\.docker\.internal:9100".*`metrics_hosts`.*: add the name', said)


def test_head_has_the_length_and_no_body_and_the_connection_closes() -> None:
    head, _, body = asked(b"HEAD /metrics HTTP/1.1\r\nHost: ADDRESS\r\n\r\n").lower().partition(b"\r\n\r\n")
    assert (b"content-length: 0" in head, body) == (True, b"")  # nothing is registered
    assert b"connection: close" in head
    assert b"x-content-type-options: nosniff" in head


def test_only_the_first_of_many_refusals_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    async def story() -> list[int]:
        async with exposed(CollectorRegistry(), "127.0.0.1:0") as address:
            return [await asyncio.to_thread(status, address, "/", Host="evil.example") for _ in range(3)]

    assert asyncio.run(story()) == [421, 421, 421]
    assert caplog.text.count("refused a request") == 1


class Raising(Collector):
    """Fails when it is asked the first time."""

    times = 0

    def collect(self) -> Iterator[Metric]:
        self.times += 1
        if self.times == 1:
            raise ValueError("no state")
        yield from ()


def test_a_collector_that_raises_is_logged_and_the_next_scrape_is_answered(
    caplog: pytest.LogCaptureFixture,
) -> None:
    registry = CollectorRegistry()
    registry.register(Raising())

    async def story() -> list[int]:
        async with exposed(registry, "127.0.0.1:0") as address:
            return [await asyncio.to_thread(status, address, "/metrics") for _ in range(2)]

    assert asyncio.run(story()) == [500, 200]
    assert caplog.text.count("ValueError: no state") == 1


def test_a_prometheus_that_reads_openmetrics_gets_it() -> None:
    accept = b"Accept: application/openmetrics-text;version=1.0.0\r\n"
    assert asked(b"GET / HTTP/1.1\r\nHost: ADDRESS\r\n" + accept + b"\r\n").endswith(b"# EOF\n")


def test_a_prometheus_by_a_name_that_was_added_is_answered() -> None:
    request = b"GET /metrics HTTP/1.1\r\nHost: host.docker.internal:9100\r\n\r\n"
    assert asked(request, hosts=["host.docker.internal"]).startswith(b"HTTP/1.1 200 ")


def status(address: str, path: str, **headers: str) -> int:
    connection = http.client.HTTPConnection(address, timeout=10.0)
    connection.request("GET", path, headers=headers)
    return connection.getresponse().status


class Broken:
    """A runtime in which nothing starts."""

    async def start(self, spec: InstanceSpec, **_: Any) -> Instance:
        raise InstanceError("no memory")


async def test_a_daemon_is_ready_while_it_takes_calls_and_live_while_its_loop_works(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    at = Edge(Broken())
    at.metrics.look_at(at.edge)
    async with exposed(at.metrics.registry, "127.0.0.1:0", questions=at.metrics.questions) as address:

        async def ask(path: str) -> int:
            return await asyncio.to_thread(status, address, path)

        assert (await ask("/live"), await ask("/ready?verbose")) == (200, 200)
        await at.start("heron")
        assert (await ask("/live"), await ask("/ready")) == (200, 503), "the service is paused, as it fails"
        monkeypatch.setattr("upwash.metrics.daemon._PROBE_S", 0.05)
        with ThreadPoolExecutor(1) as elsewhere:
            assert elsewhere.submit(status, address, "/live").result() == 503, (
                "the loop waits for this very answer"
            )


@pytest.mark.parametrize(
    ("expires", "is_closing"), [(EXPIRES, True), (datetime(2020, 1, 1, tzinfo=UTC), False)]
)
async def test_a_daemon_that_ends_or_whose_certificate_has_ended_is_not_ready(
    expires: datetime, is_closing: bool
) -> None:
    at = Edge(Ready(), expires)
    at.metrics.look_at(at.edge)
    if is_closing:
        await at.edge.drain("it ends")
    assert not await asyncio.to_thread(at.metrics.questions["/ready"])
    assert await asyncio.to_thread(at.metrics.questions["/live"])


async def test_an_address_in_use_is_named() -> None:
    async with exposed(CollectorRegistry(), "127.0.0.1:0") as address:
        with pytest.raises(UsageError, match=f"cannot be offered at {address}: .*choose another address"):
            async with exposed(CollectorRegistry(), address):
                pass


@pytest.mark.parametrize(("listen", "warned"), [("0.0.0.0:0", True), ("127.0.0.1:0", False)])
def test_it_warns_where_strangers_may_look(
    listen: str, warned: bool, caplog: pytest.LogCaptureFixture
) -> None:
    async def story() -> None:
        async with exposed(CollectorRegistry(), listen):
            pass

    asyncio.run(story())
    assert ("whoever reaches 0.0.0.0:0 can read the metrics" in caplog.text) is warned


# --- their names ----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def families(drone: DroneMetrics) -> dict[str, tuple[str, frozenset[str]]]:
    """The kind and the labels of each metric, as Prometheus reads them."""

    async def daemon() -> str:
        at = Edge(Runtime())
        at.metrics.look_at(at.edge)
        at.metrics.starts.labels("s1", "detector").observe(1.0)
        at.metrics.failures.labels("s1", "detector").inc()
        at.metrics.calls.labels("s1", "detector", "process_photo").observe(1.0)
        await at.ask("heron")
        return (await asyncio.to_thread(generate_latest, at.metrics.registry)).decode()

    text = generate_latest(drone.registry).decode() + asyncio.run(daemon())
    found = {}
    for family in text_string_to_metric_families(text):
        labels = {label for sample in family.samples for label in sample.labels} - {"le"}
        if not family.name.endswith("_created"):
            name = f"{family.name}_total" if family.type == "counter" else family.name
            found[name] = (family.type, frozenset(labels))
    return found


def test_the_documentation_names_what_is_offered_and_nothing_else(
    families: dict[str, tuple[str, frozenset[str]]],
) -> None:
    page = (ROOT / "docs/metrics.md").read_text()
    rows = re.findall(r"^\| `(upwash_\w+)` \| (\w+) \|([^|]*)\|", page, flags=re.MULTILINE)
    documented = {name: (kind, frozenset(re.findall(r"`(\w+)`", labels))) for name, kind, labels in rows}
    assert documented == families


def queries(dashboard: Any) -> Iterator[str]:
    match dashboard:
        case {"expr": str(query)}:
            yield query
        case {"query": {"query": str(query)}}:
            yield query
        case dict():
            yield from itertools.chain.from_iterable(map(queries, dashboard.values()))
        case list():
            yield from itertools.chain.from_iterable(map(queries, dashboard))


@pytest.fixture(scope="module")
def samples(families: dict[str, tuple[str, frozenset[str]]]) -> dict[str, frozenset[str]]:
    """The labels of each name that a query can ask for."""
    return {
        name if kind != "histogram" else f"{name}_{part}": labels
        for name, (kind, labels) in families.items()
        for part in (("bucket", "sum", "count") if kind == "histogram" else ("",))
    }


def asked_by(query: str, samples: dict[str, frozenset[str]]) -> tuple[set[str], frozenset[str]]:
    """The names that a query asks for and the labels that these have; asserts that they are offered."""
    names = set(re.findall(r"\bupwash_\w+", query))
    assert names, query
    assert names <= set(samples), query
    known = frozenset({"le", "instance", "job"}).union(*(samples[name] for name in names))
    for group in re.findall(r"by \(([^)]*)\)", query):
        assert set(re.split(r",\s*", group)) <= known, query
    for label in re.findall(r"[{,]\s*(\w+)=", query):
        assert label in known | {"__name__"}, query
    assert query.count("(") == query.count(")"), query
    return names, known


def family(name: str) -> str:
    return re.sub(r"_(bucket|sum|count)$", "", name)


DASHBOARD = json.loads((ROOT / "deploy/grafana-dashboard.json").read_text())


def test_the_dashboard_asks_for_nothing_that_is_not_offered(samples: dict[str, frozenset[str]]) -> None:
    used = {family(name) for query in queries(DASHBOARD) for name in asked_by(query, samples)[0]}
    assert {family(name) for name in samples} - used == {
        "upwash_photos_total",
        "upwash_server_steps_total",
    }, "the others are worth a panel"


def test_a_panel_counts_or_tells_seconds_and_never_both() -> None:
    for panel in DASHBOARD["panels"]:
        of_time = [bool(re.search(r"seconds_(sum|bucket)|timestamp", query)) for query in queries(panel)]
        told_in_seconds = panel.get("fieldConfig", {}).get("defaults", {}).get("unit") == "s"
        assert all(each == told_in_seconds for each in of_time), panel["title"]


@pytest.mark.parametrize(
    ("metric", "states"),
    [
        ("upwash_server_state", [str(state) for state in State]),
        ("upwash_instances", ["absent", "starting", "running", "stopping"]),
    ],
)
def test_each_state_is_a_number_with_a_name_and_a_colour_of_its_own(metric: str, states: list[str]) -> None:
    (panel,) = (
        each
        for each in DASHBOARD["panels"]
        if each["type"] == "state-timeline" and metric in each["targets"][0]["expr"]
    )
    expression = panel["targets"][0]["expr"]
    numbered = re.findall(rf'(\d) \* {metric}{{state="([\w-]+)"', expression)
    assert {int(number): state for number, state in numbered} == dict(enumerate(states))
    (mapping,) = panel["fieldConfig"]["defaults"]["mappings"]
    named = {int(number): told["text"] for number, told in mapping["options"].items()}
    assert named == dict(enumerate(states))
    colours = [told["color"] for told in mapping["options"].values()]
    assert len(set(colours)) == len(states)
    of_states = {
        getattr(theme, name) for theme in (LIGHT, DARK) for name in ("ready", "check", "listed", "idle")
    }
    assert set(colours) <= of_states
    assert panel["options"]["showValue"] == "auto", "the colour alone says nothing"


def test_panels_lie_beside_each_other_and_not_one_on_another() -> None:
    taken: set[tuple[int, int]] = set()
    for panel in DASHBOARD["panels"]:
        at = panel["gridPos"]
        cells = set(itertools.product(range(at["x"], at["x"] + at["w"]), range(at["y"], at["y"] + at["h"])))
        assert not cells & taken, panel["title"]
        taken |= cells
    assert max(x for x, _ in taken) < 24


def test_each_alert_is_of_what_is_offered_and_says_what_to_do(samples: dict[str, frozenset[str]]) -> None:
    yaml = pytest.importorskip("yaml", reason="nothing here reads YAML")
    groups = yaml.safe_load((ROOT / "deploy/prometheus-alerts.yml").read_text())["groups"]
    rules = [rule for group in groups for rule in group["rules"]]
    assert len({rule["alert"] for rule in rules}) == len(rules) == 11
    for rule in rules:
        _, known = asked_by(rule["expr"], samples)
        assert rule["labels"]["severity"] in {"warning", "critical"}
        assert set(rule["annotations"]) == {"summary", "description"}
        told = " ".join(rule["annotations"].values())
        kept = re.findall(r"by \(([^)]*)\)", rule["expr"])
        labels = set(re.split(r",\s*", kept[0])) if kept else known
        assert set(re.findall(r"\$labels\.(\w+)", told)) <= labels, rule["alert"]
        assert rule["alert"] in (ROOT / "docs/metrics.md").read_text()
