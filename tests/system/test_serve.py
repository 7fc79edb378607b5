"""The edge daemon as a process: what drones get from it, and what is left of it."""

from __future__ import annotations

import asyncio
import http.client
import json
import os
import re
import signal
import socket
from collections.abc import Awaitable, Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from tests.children import children, is_alive
from tests.played import played
from tests.programs import upwash
from tests.system.daemons import (
    SERVERS,
    SERVICES,
    Daemon,
    Guest,
    config,
    daemon,
    guests,
    shown,
    started,
)
from tests.waiting import wait_for

from upwash.errors import LinkError, Refused, Unreachable, UsageError
from upwash.launch.status import ask_status
from upwash.real.instances.sandbox import find_sandbox
from upwash.real.trust.authority import drop_former_authorities, make_keys, renew_authority, revoke
from upwash.real.trust.credentials import Credentials
from upwash.rpc.protocol import AVAILABILITY, LEAVE, START

pytestmark = pytest.mark.system

Visited = Callable[..., None]
SHUTTING_DOWN = "this edge server is shutting down"
SLOW = """
import os, time
from pathlib import Path
from upwash import service

Path({loading!r}).write_text(str(os.getpid()))
while not Path({loaded!r}).exists():
    time.sleep(0.05)

@service
class Tool:
    def add(self, a: int) -> int:
        return a
"""
TWO_SLOTS = [{"name": "s1", "slots": 2}, {"name": "s2", "slots": 1}]


@pytest.fixture
def visited(tmp_path: Path, services: Path, keys: Path) -> Visited:
    """Plays a scene of a daemon and its guests, each a drone at a server, such as "heron@s1"."""

    def play(
        scene: Callable[..., Awaitable[None]], *who: str, certified: Path | None = keys, **settings: Any
    ) -> None:
        async def live(at: Daemon) -> None:
            drones = [name.partition("@") for name in who]
            known = [
                (name, shown(certified, name) if certified else None, server) for name, _, server in drones
            ]
            async with guests(at, services, *known) as present:
                await scene(at, *present)

        with daemon(tmp_path, config(certified, **settings)) as at:
            asyncio.run(live(at))

    return play


@pytest.fixture
def own_keys(tmp_path: Path) -> Path:
    """Keys that a test may revoke."""
    folder = tmp_path / "keys"
    make_keys(folder, servers=[["s1", "s2"]], drones=["heron", "stork"], operators=["alice"])
    return folder


@pytest.fixture
def own_visited(visited: Visited, own_keys: Path) -> Visited:
    return partial(visited, certified=own_keys)


@pytest.fixture
def socket_visited(visited: Visited, tmp_path: Path) -> Visited:
    return partial(visited, certified=None, listen=f"unix:{tmp_path}/socket")


async def served(guest: Guest, endpoint: str = "") -> str:
    """The endpoint that served the guest, started where none was named."""
    if not endpoint:
        reply = await guest.start()
        endpoint = reply.endpoint
        assert endpoint, reply.reason
    assert await guest.call(endpoint, "echo", b"photo") == b"photo"
    return endpoint


# --- what drones get ----------------------------------------------------------------------------------------


@played("visited", "heron@s1")
async def test_a_drone_asks_has_a_service_started_calls_it_and_leaves(_: Daemon, heron: Guest) -> None:
    before = await heron.availability("workbench")
    assert (before.available, before.endpoints, before.lease_s) == (True, {}, 30.0)
    endpoint = await served(heron)
    assert endpoint.startswith(":")
    assert (await heron.availability("workbench")).endpoints == {"workbench": endpoint}
    await heron.leave()
    with pytest.raises(Refused, match="heron has no lease"):
        await heron.call(endpoint, "echo", b"photo")
    assert (await heron.availability("workbench")).endpoints == {"workbench": endpoint}
    await served(heron, endpoint)


@played("visited", "heron@s1", "heron@s2", "stork@s1", "stork@s2")
async def test_a_slot_serves_one_drone_until_it_leaves_and_each_server_has_its_own(
    at: Daemon, heron1: Guest, heron2: Guest, stork1: Guest, stork2: Guest
) -> None:
    first, second = await heron1.start(), await stork2.start()
    process_ids = {
        await heron1.call(first.endpoint, "process_id"),
        await stork2.call(second.endpoint, "process_id"),
    }
    assert process_ids == set(at.instances())
    assert len(process_ids) == 2
    for guest in (stork1, heron2):
        refused = await guest.availability("workbench")
        assert (refused.available, refused.endpoints) == (False, {})
        assert "has no free slot: 1 of 1 in use" in refused.reason
        assert "has no free slot" in (await guest.start()).reason
    with pytest.raises(Refused):
        await stork1.call(first.endpoint, "echo", b"photo")
    await heron1.leave()
    assert (await stork1.availability("workbench")).endpoints == {"workbench": first.endpoint}
    await served(stork1, first.endpoint)
    with pytest.raises(Refused):
        await heron1.call(first.endpoint, "echo", b"photo")


@played("socket_visited", "heron@s1")
async def test_a_daemon_on_a_unix_socket_needs_no_certificates(_: Daemon, heron: Guest) -> None:
    assert (await served(heron)).startswith("unix:")


# --- whom it does not serve ---------------------------------------------------------------------------------


@pytest.fixture
def strangers(keys: Path) -> list[Credentials | None]:
    """Of another authority; the same, who believes ours; without a certificate."""
    theirs = shown(keys / "other", "heron")
    return [theirs, Credentials(shown(keys, "heron").authority, theirs.certificate, theirs.key), None]


@played("visited", "heron@s1")
async def test_a_drone_of_another_authority_gets_no_answer(
    at: Daemon, heron: Guest, *, services: Path, strangers: list[Credentials | None]
) -> None:
    endpoint = (await heron.start()).endpoint
    async with guests(at, services, *(("heron", each, "s1") for each in strangers)) as others:
        for stranger in others:
            with pytest.raises(Unreachable):
                await stranger.availability("workbench")
            with pytest.raises(Unreachable):
                await stranger.call(endpoint, "echo", b"photo")


@played("visited", "heron@s1")
async def test_garbage_does_not_harm_it(at: Daemon, heron: Guest) -> None:
    hello = b"\x16\x03\x01\xff\xff" + b"x" * 500
    for garbage in (b"", b"\x00" * 10_000, b"GET / HTTP/1.1\r\n\r\n", hello):
        with socket.create_connection(("127.0.0.1", at.port)) as connection:
            connection.sendall(garbage)
    for path in (AVAILABILITY, START, LEAVE, "/upwash.Daemon/Nonsense"):
        for body in (b"", b"\xff" * 100, b"\x81\xa6server\xa2\xff\xfe", b"\x91" * 50_000):
            with pytest.raises(Refused) as refusal:
                await heron.daemon.request(path, body, timeout_s=5.0)
            assert "log says why" not in str(refusal.value)
    assert (await heron.availability("workbench")).available


# --- how it ends --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
@played("visited", "heron@s1", drain_s=0.3)
async def test_a_signal_ends_it_with_a_call_under_way_and_leaves_nothing(
    at: Daemon, heron: Guest, *, number: signal.Signals
) -> None:
    endpoint = (await heron.start()).endpoint
    child = await heron.call(endpoint, "spawn")
    calling = asyncio.create_task(heron.call(endpoint, "pause", 60.0))
    await asyncio.sleep(0.2)
    instances = at.instances()
    assert await asyncio.to_thread(at.end, number) == 0
    assert not any(map(is_alive, [*instances, child]))
    with pytest.raises(LinkError):
        await calling


@played("visited", "heron@s1", "stork@s1", server=TWO_SLOTS)
async def test_a_call_under_way_ends_before_the_daemon_does_and_new_ones_are_refused_with_the_reason(
    at: Daemon, heron: Guest, stork: Guest
) -> None:
    endpoint = (await heron.start()).endpoint
    assert (await stork.availability("workbench")).available
    for guest in (heron, stork):
        await served(guest, endpoint)
    running = asyncio.create_task(heron.call(endpoint, "pause", 4.0))
    await asyncio.sleep(0.3)
    queued = asyncio.create_task(stork.call(endpoint, "echo", b"photo"))
    await asyncio.sleep(0.3)
    at.process.send_signal(signal.SIGTERM)
    with pytest.raises(Refused, match=SHUTTING_DOWN):
        await queued
    with pytest.raises(Refused, match=SHUTTING_DOWN):
        await stork.call(endpoint, "echo", b"photo")
    assert (await stork.availability("workbench")).reason == SHUTTING_DOWN
    assert not running.done(), "a drone should fall back at once"
    await running
    assert await asyncio.to_thread(at.process.wait, 10.0) == 0


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_counts_while_services_are_loaded_for_the_start(
    tmp_path: Path, number: signal.Signals
) -> None:
    loading, loaded = tmp_path / "loading", tmp_path / "loaded"
    (tmp_path / "slow.py").write_text(SLOW.format(loading=str(loading), loaded=str(loaded)))
    slow = {"name": "tool", "program": f"{tmp_path}/slow.py:Tool"}
    with started(tmp_path, config(None, service=[slow])) as process:
        try:
            loader = int(wait_for(lambda: loading.exists() and loading.read_text(), process=process))
            process.send_signal(number)
            if number == signal.SIGHUP:
                loaded.touch()
                at = Daemon(process, "s1, s2", tmp_path)
                at.has_said("SIGHUP orders a reload")
                at.process.send_signal(signal.SIGTERM)
            assert process.wait(timeout=20.0) == 0
            assert not is_alive(loader)
        finally:
            process.kill()
            loaded.touch()


@played("visited", "heron@s1", drain_s=60.0)
async def test_a_second_signal_ends_it_at_once(at: Daemon, heron: Guest) -> None:
    endpoint = (await heron.start()).endpoint
    calling = asyncio.create_task(heron.call(endpoint, "pause", 60.0))
    await asyncio.sleep(0.2)
    at.process.send_signal(signal.SIGTERM)
    await asyncio.sleep(0.7)
    assert await asyncio.to_thread(at.end) == 130
    with pytest.raises(LinkError):
        await calling


@played("visited", "heron@s1")
async def test_a_signal_ends_it_while_a_service_starts(at: Daemon, heron: Guest, *, tmp_path: Path) -> None:
    starting = asyncio.create_task(heron.start("slowtostart"))
    await asyncio.to_thread(wait_for, (tmp_path / "process_id").exists)
    instances = at.instances()
    assert await asyncio.to_thread(at.end) == 0
    assert not any(map(is_alive, instances))
    await asyncio.gather(starting, return_exceptions=True)


# --- what its operator does ---------------------------------------------------------------------------------

READ_AGAIN = "the configuration was read again"


@played("own_visited", "stork@s1")
async def test_an_authority_is_changed_without_a_restart_and_without_a_call_that_fails(
    at: Daemon, stork: Guest, *, services: Path, own_keys: Path
) -> None:
    text = config(own_keys)
    endpoint = (await stork.start()).endpoint
    renew_authority(own_keys)
    at.reload(text, READ_AGAIN)
    await served(stork, endpoint)
    made_anew(own_keys, "s1", servers=[["s1", "s2"]])
    made_anew(own_keys, "heron", drones=["heron"])
    at.reload(text, READ_AGAIN)
    await served(stork, endpoint)  # on a connection of before
    await stork.leave()
    of_the_former = shown(own_keys, "stork")  # which believes both by now
    async with guests(at, services, ("stork", of_the_former, "s1")) as (again,):
        assert (await again.availability()).available
        await again.leave()
        drop_former_authorities(own_keys)
        at.reload(text, READ_AGAIN)
        for _ in range(2):
            with pytest.raises(Unreachable):
                await again.availability()
    async with guests(at, services, ("heron", shown(own_keys, "heron"), "s1")) as (heron,):
        await served(heron)


def made_anew(keys: Path, name: str, **wanted: Any) -> None:
    """Another key and certificate in the place of those of that name."""
    for ending in ("pem", "key"):
        (keys / f"{name}.{ending}").unlink()
    make_keys(keys, **wanted)


def test_a_daemon_that_reads_no_list_of_revoked_certificates_says_so(tmp_path: Path, own_keys: Path) -> None:
    (own_keys / "revoked.txt").unlink()
    with daemon(tmp_path, config(own_keys)) as at:
        at.has_said(f"revoked.txt of `upwash keys DIR --revoke NAME` beside {own_keys}/authority.pem")


@pytest.mark.parametrize("named", [True, False])
def test_a_revoked_drone_is_refused_by_the_daemon_and_by_what_runs_until_it_shows_another_certificate(
    own_visited: Visited, services: Path, own_keys: Path, *, named: bool
) -> None:
    keys = {"revoked": f"{own_keys}/revoked.txt"} if named else {}

    async def scene(at: Daemon, thief: Guest) -> None:
        endpoint = await served(thief)
        revoke(own_keys, ["heron"])
        at.reload(config(own_keys, keys=keys), "1 certificates are revoked")
        for _ in range(2):  # the first on connections that were there
            with pytest.raises(Unreachable):
                await thief.call(endpoint, "echo", b"photo")
            with pytest.raises(Unreachable):
                await thief.availability()
        made_anew(own_keys, "heron", drones=["heron"])
        async with guests(at, services, ("heron", shown(own_keys, "heron"), "s1")) as (heron,):
            assert (await heron.start()).endpoint == endpoint
            await served(heron, endpoint)
            with pytest.raises(Unreachable, match="it hung up;"):
                await thief.call(endpoint, "echo", b"photo")

    own_visited(scene, "heron@s1", keys=keys)


@played("visited", "heron@s1", "stork@s1")
async def test_images_and_slots_follow_the_configuration_and_a_bad_one_changes_nothing(
    at: Daemon, heron: Guest, stork: Guest, *, keys: Path
) -> None:
    endpoint = (await heron.start()).endpoint
    text = config(keys)
    for bad, why in (
        ("listen = ", "not valid TOML"),
        (text.replace("Workbench", "NoSuchClass"), "there is no NoSuchClass"),
        (text.replace('name = "s2"', 'name = "s3"'), "restart it"),
        (config(keys, lease_s=3.0), "lease_s cannot change"),
    ):
        at.reload(bad, "the old configuration stays: ")
        assert why in at.said().splitlines()[-1]
    await served(heron, endpoint)
    assert not (await stork.availability()).available
    other = {"name": "s1", "slots": 2, "images": ["unstartable"]}
    at.reload(config(keys, server=[other, SERVERS[1]]), "was read again")
    assert (await stork.availability()).available
    assert "s1 has no image of workbench" in (await stork.start()).reason
    with pytest.raises(LinkError):
        await heron.call(endpoint, "echo", b"photo")
    wait_for(lambda: at.instances() == [])


@played("own_visited", "heron@s1", "stork@s1")
async def test_its_status_shows_an_operator_leases_instances_refusals_and_certificates(
    at: Daemon, heron: Guest, stork: Guest, *, own_keys: Path
) -> None:
    await heron.start()
    await stork.availability()
    status = ("status", at.address, "--server", "s1", "--keys", own_keys, "--operator")
    seen = await asyncio.to_thread(upwash, *status, "alice")
    assert (seen.returncode, seen.stderr) == (0, "")
    for expected in (
        r"s1: 1 of 1 slot in use, 1 drone waits\n  1 slot, as configured; a turn lasts 30 s\n",
        r"heron: has a slot for \d+ s, counts as having had \d+ s; lease ends in \d+ s, certificate \w{16}",
        r"stork: waits for \d+ s, counts as having had \d+ s",
        r"workbench +running +:\d+",
        r"unstartable +starts on demand",
        r"1 +s1 +stork +s1 has no free slot: 1 of 1 in use",
        r"certificate of s1: valid until 20\d\d-\d\d-\d\d, 7\d\d days",
    ):
        assert re.search(expected, seen.stdout), seen.stdout
    refused = await asyncio.to_thread(upwash, *status, "heron")
    assert (refused.returncode, refused.stdout) == (1, "")
    assert "heron is no operator" in refused.stderr


@played("visited", "heron@s1", metrics="127.0.0.1:0")
async def test_prometheus_finds_what_drones_hold_and_what_runs(at: Daemon, heron: Guest) -> None:
    await served(heron)
    (address,) = re.findall(r"metrics at http://(\S+)/metrics", at.said())

    def told_now() -> list[str]:
        connection = http.client.HTTPConnection(address, timeout=10.0)
        connection.request("GET", "/metrics")
        return connection.getresponse().read().decode().splitlines()

    # The instance tells the daemon of a call after the drone has its reply.
    counted = 'upwash_service_seconds_count{method="echo",server="s1",service="workbench"} 1.0'
    wait_for(lambda: counted in told_now(), within_s=10.0)
    told = told_now()
    assert 'upwash_leases{server="s1"} 1.0' in told
    assert 'upwash_leases{server="s2"} 0.0' in told
    assert 'upwash_instances{server="s1",service="workbench",state="running"} 1.0' in told
    assert 'upwash_requests_total{outcome="answered",request="start"} 1.0' in told


def test_a_service_manager_is_told_when_it_is_ready_reloads_and_stops(
    tmp_path: Path, keys: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(f"{tmp_path}/notify")
        manager.settimeout(10.0)
        monkeypatch.setenv("NOTIFY_SOCKET", f"{tmp_path}/notify")
        monkeypatch.setenv("WATCHDOG_USEC", "600000000")  # one sign of life in this test
        with daemon(tmp_path, config(keys)) as at:
            assert manager.recv(1000) == b"READY=1"
            assert manager.recv(1000) == b"WATCHDOG=1"
            at.process.send_signal(signal.SIGHUP)
            assert re.fullmatch(rb"RELOADING=1\nMONOTONIC_USEC=\d+", manager.recv(1000))
            assert manager.recv(1000) == b"READY=1"
            assert at.end() == 0
            assert manager.recv(1000).startswith(b"STOPPING=1\n")


@pytest.fixture(params=["", "DEBUG"], ids=["as installed", "with what gRPC says"])
def verbosity(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """How much gRPC says of itself to the programs that a test starts."""
    if request.param:
        monkeypatch.setenv("GRPC_VERBOSITY", request.param)
    return str(request.param)


async def test_its_log_can_be_json_lines_and_tells_of_a_refused_certificate(
    verbosity: str, tmp_path: Path, services: Path, keys: Path, strangers: list[Credentials | None]
) -> None:
    with daemon(tmp_path, config(keys), "--log-format", "json") as at:
        async with guests(at, services, ("heron", strangers[1], "s1")) as (stranger,):
            with pytest.raises(Unreachable):
                await stranger.availability("workbench")
        at.has_said("CERTIFICATE_VERIFY_FAILED")
        at.end()
        lines = [json.loads(line) for line in at.said().splitlines()]
    assert all({"time", "level", "logger", "message"} <= line.keys() for line in lines)
    assert any("CERTIFICATE_VERIFY_FAILED" in line["message"] for line in lines)
    assert any(line["logger"] == "upwash.foreign" for line in lines) == bool(verbosity)


# --- in a sandbox -------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def _sandbox() -> None:
    try:
        find_sandbox(readable=())
    except UsageError as error:
        pytest.skip(str(error))


def descendants(process_id: int) -> list[int]:
    """The processes that the process started, and those that they started, and so on."""
    return [each for child in children(process_id) for each in (child, *descendants(child))]


@pytest.mark.sandbox
@pytest.mark.usefixtures("_sandbox")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
@played("visited", "heron@s1", runtime={"sandbox": "required"})
async def test_a_drone_calls_into_a_sandbox_which_ends_with_the_daemon(
    at: Daemon, heron: Guest, *, number: signal.Signals
) -> None:
    endpoint = await served(heron)
    assert await heron.call(endpoint, "process_id") < 10, "it has a numbering of processes of its own"
    await heron.call(endpoint, "spawn")
    inside = descendants(at.process.pid)
    assert len(inside) >= 3
    at.end(number)
    wait_for(lambda: not any(map(is_alive, inside)))


EATERS = """
import os
from upwash.rpc.service import service


class Eater:
    def eat(self, size_bytes: int) -> str:
        try:
            return str(len(bytes(size_bytes)))
        except MemoryError:
            return "no memory"

    def processors(self) -> int:
        return len(os.sched_getaffinity(0))

    def take_all_processors(self) -> str:
        try:
            os.sched_setaffinity(0, range(os.cpu_count()))
        except OSError as error:
            return type(error).__name__
        return "taken"

    def sees(self, path: str) -> bool:
        return os.path.exists(path)


@service
class Modest(Eater):
    pass


@service
class Greedy(Eater):
    pass
"""


@pytest.mark.sandbox
@pytest.mark.usefixtures("_sandbox")
async def test_limits_and_devices_of_one_service_hold_and_are_not_anothers(
    tmp_path: Path, own_keys: Path
) -> None:
    program = tmp_path / "eaters.py"
    program.write_text(EATERS)
    device = next(name for name in ("/dev/fuse", "/dev/kmsg", "/dev/net/tun") if Path(name).exists())
    modest = {"name": "modest", "program": f"{program}:Modest", "memory_bytes": 2**28, "cpus": 1}
    modest["devices"] = [device]
    greedy = {"name": "greedy", "program": f"{program}:Greedy"}
    text = config(own_keys, runtime={"sandbox": "required"}, service=[*SERVICES, modest, greedy])
    said = []
    with daemon(tmp_path, text) as at:
        for name in ("Modest", "Greedy"):
            known = ("heron", shown(own_keys, "heron"), "s1")
            async with guests(at, f"{program}:{name}", known) as (heron,):
                endpoint = (await heron.start(name.lower())).endpoint
                eaten = await heron.call(endpoint, "eat", 2**29)
                sees = await heron.call(endpoint, "sees", device)
                said.append([eaten, await heron.call(endpoint, "processors"), sees])
                if name == "Modest":
                    assert await heron.call(endpoint, "take_all_processors") == "PermissionError"
        reply = await ask_status(at.address, server="s1", operator="alice", keys=own_keys)
    assert said == [["no memory", 1, True], [str(2**29), len(os.sched_getaffinity(0)), False]]
    assert (reply.limits["modest"].memory_bytes, reply.limits["modest"].cpus) == (2**28, 1)
    assert (reply.limits["greedy"].memory_bytes, reply.limits["greedy"].cpus) == (2**31, None)


def test_a_limit_that_would_not_hold_ends_the_start_with_its_name(tmp_path: Path, keys: Path) -> None:
    limited = SERVICES[0] | {"memory_bytes": 2**28}
    said = refused(tmp_path, config(keys, service=[limited, *SERVICES[1:]]))
    assert 'memory_bytes of service "workbench" would have no effect' in said
    assert 'runtime.sandbox is "off"' in said


@pytest.mark.skipif(os.geteuid() != 0, reason="of root alone")
@pytest.mark.parametrize("sandbox", ["auto", "required"])
def test_root_makes_no_sandbox_unless_it_is_told_to(tmp_path: Path, keys: Path, sandbox: str) -> None:
    said = refused(tmp_path, config(keys, runtime={"sandbox": sandbox, "sandbox_as_root": False}))
    assert "run it as a user of its own (docs/servers.md), or say runtime.sandbox_as_root = true" in said


async def test_without_bubblewrap_it_serves_and_says_so_unless_a_sandbox_is_required(
    tmp_path: Path, services: Path, keys: Path
) -> None:
    with daemon(tmp_path, config(keys, runtime={"sandbox": "auto"}), path=str(tmp_path)) as at:
        async with guests(at, services, ("heron", shown(keys, "heron"), "s1")) as (heron,):
            await served(heron)
        said = at.said()
        assert "services run without a sandbox: bubblewrap is not installed: `apt install bubblewrap`" in said
    required = config(keys, runtime={"sandbox": "required"})
    assert "apt install bubblewrap" in refused(tmp_path, required, path=str(tmp_path))


# --- when it cannot start -----------------------------------------------------------------------------------


def refused(folder: Path, text: str, **settings: str) -> str:
    """What a daemon that does not start says; it must be one line, with exit code 2."""
    with started(folder, text, **settings) as process:
        assert process.wait(timeout=30.0) == 2
        assert process.stdout is not None
        assert process.stdout.read() == ""
    said = (folder / "stderr").read_text()
    assert said.startswith("upwash: ")
    assert said.count("\n") == 1
    return said


def test_the_port_of_another_daemon_is_not_shared(tmp_path: Path, keys: Path) -> None:
    (tmp_path / "first").mkdir()
    with daemon(tmp_path / "first", config(keys)) as at:
        assert "cannot listen on" in refused(tmp_path, config(keys, listen=at.address))


def test_certificates_are_left_out_on_purpose_only(tmp_path: Path) -> None:
    text = config(None).replace("allow_without_certificates = true", "")
    assert "server.toml: keys: missing" in refused(tmp_path, text)


def test_a_certificate_for_another_server_is_refused(tmp_path: Path, keys: Path) -> None:
    said = refused(tmp_path, config(keys, server=[*SERVERS, {"name": "s3"}]))
    assert "the certificate is for s1, s2, but this daemon acts as s3" in said


def test_a_drones_certificate_is_refused(tmp_path: Path, keys: Path) -> None:
    text = config(keys, server=[{"name": "heron"}]).replace(f"{keys}/s1.", f"{keys}/heron.")
    assert "heron.pem: not a certificate for a daemon" in refused(tmp_path, text)


def test_a_service_of_another_name_is_told_its_own(tmp_path: Path) -> None:
    text = config(None, service=[{"name": "workbench", "program": "services_for_tests:Unstartable"}])
    assert "which is declared as 'unstartable'" in refused(tmp_path, text)
