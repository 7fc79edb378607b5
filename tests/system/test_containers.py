"""Containers of a real engine: what a service in one can do, what is left of it, and whom it can harm."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from ipaddress import IPv4Network
from pathlib import Path
from typing import Any

import pytest
from tests.doors import led
from tests.engines import OwnEngine
from tests.system.container_site import DISK_BYTES, MAX_MESSAGE_BYTES, MEMORY_BYTES, PROCESSES, Site
from tests.system.daemons import Guest
from tests.waiting import wait_for

from upwash.errors import InstanceError, LinkError, Refused, ServiceError
from upwash.missions.bundled import load_service_alone
from upwash.packaging.image import Recipe, package
from upwash.ports import InstanceSpec, Program
from upwash.real.control_credentials import SERVICE_PORT
from upwash.real.credentials import Credentials, fingerprint
from upwash.real.door import Lead
from upwash.real.link import GrpcDialer
from upwash.real.lxd.container import ContainerSettings
from upwash.real.lxd.engine import Engine, EngineAddress
from upwash.real.lxd.instance import ContainerInstance
from upwash.real.lxd.runtime import ContainerRuntime

pytestmark = [pytest.mark.root, pytest.mark.system, pytest.mark.xdist_group("lxd")]


OpenSite = Callable[..., Any]


@pytest.fixture(scope="session")
def vandal_image(services: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return package(
        Recipe(load_service_alone(f"{services}:Vandal")),
        tmp_path_factory.mktemp("images"),
        report=lambda _: None,
    )


@pytest.fixture
def open_site(
    lxd: OwnEngine,
    services: Path,
    credentials: Callable[[str], Credentials],
    workbench_image: Path,
    vandal_image: Path,
) -> OpenSite:
    @asynccontextmanager
    async def site(*, freezes: bool = False) -> AsyncIterator[Site]:
        async with led(credentials("s1")) as lead, site_behind(lead, freezes=freezes) as there:
            yield there

    @asynccontextmanager
    async def site_behind(lead: Lead, *, freezes: bool) -> AsyncIterator[Site]:
        engine = Engine([EngineAddress(f"unix:{lxd.socket}")], project="default")
        runtime = ContainerRuntime(
            engine,
            ContainerSettings(
                IPv4Network("10.147.71.0/24"),
                memory_bytes=MEMORY_BYTES,
                processes=PROCESSES,
                disk_bytes=DISK_BYTES,
            ),
            freezes=freezes,
            lead=lead,
            max_message_bytes=MAX_MESSAGE_BYTES,
        )
        await engine.connect()
        try:
            await engine.import_image(workbench_image)
            await engine.import_image(vandal_image)
            await runtime.prepare(["s1", "s2"], [("s1", "workbench"), ("s1", "vandal"), ("s2", "workbench")])
            heron = credentials("heron")
            dialer = GrpcDialer("heron", heron, max_message_bytes=MAX_MESSAGE_BYTES)
            yield Site(runtime, dialer, services, frozenset({fingerprint(heron.certificate)}))
        finally:
            await runtime.close()

    return site


def at(open_site: OpenSite, use: Callable[[Site], Awaitable[None]], **settings: bool) -> None:
    async def run() -> None:
        async with open_site(**settings) as site:
            await use(site)

    asyncio.run(run())


# --- what a service can do ----------------------------------------------------------------------------------


def test_a_service_has_no_rights_and_reaches_nobody(open_site: OpenSite) -> None:
    async def use(site: Site) -> None:
        vandal, neighbour = await site.start("s1", "vandal"), await site.start("s2", "workbench")
        user, capabilities = await site.call(vandal, "s1", "identity")
        assert (user, capabilities) == (1000, 0)
        assert isinstance(neighbour, ContainerInstance)
        host = neighbour.container.address
        assert await site.call(vandal, "s1", "reach", host, SERVICE_PORT) != "connected"
        assert await site.call(vandal, "s1", "reach", "169.254.0.1", 22) == "TimeoutError"
        assert await site.call(neighbour, "s2", "echo", b"photo") == b"photo"
        for instance in (vandal, neighbour):
            await instance.stop()

    at(open_site, use)


@pytest.mark.parametrize("harm", ["eat_memory", "fork_without_end", "fill_disk"])
def test_an_instance_out_of_control_harms_neither_its_neighbours_nor_the_daemon(
    open_site: OpenSite, harm: str
) -> None:
    async def use(site: Site) -> None:
        vandal, neighbour = await site.start("s1", "vandal"), await site.start("s1", "workbench")
        free_before = os.statvfs("/tmp").f_bavail * os.statvfs("/tmp").f_frsize
        rampage = asyncio.create_task(site.call(vandal, "s1", harm, timeout_s=25.0))
        while not rampage.done():
            assert await site.call(neighbour, "s1", "echo", b"photo") == b"photo"
            await asyncio.sleep(0.1)
        match harm, rampage.exception() or rampage.result():
            case "fork_without_end", int(children):
                assert 0 < children < PROCESSES
            case "fill_disk", int(written_bytes):
                assert written_bytes <= 2 * DISK_BYTES
            case _, LinkError() | ServiceError() | MemoryError():
                pass  # it was killed, or it got no more
            case _, outcome:
                pytest.fail(f"{harm} came to {outcome!r}")
        free_after = os.statvfs("/tmp").f_bavail * os.statvfs("/tmp").f_frsize
        assert free_before - free_after < 2**30, "others write here too, but not that much"
        await vandal.stop()
        again = await site.start("s1", "vandal")
        assert (await site.call(again, "s1", "identity"))[0] == 1000
        for instance in (again, neighbour):
            await instance.stop()

    at(open_site, use)


# --- how it ends --------------------------------------------------------------------------------------------


def test_a_service_that_crashes_ends_its_container_with_its_last_words(
    open_site: OpenSite, lxd: OwnEngine
) -> None:
    async def use(site: Site) -> None:
        instance = await site.start("s1", "workbench")
        await site.call(instance, "s1", "say", "the lens is broken")
        with pytest.raises(LinkError):
            await site.call(instance, "s1", "crash")
        async with asyncio.timeout(10.0):
            assert await instance.exited() == "ended with code 3: the lens is broken"
        await instance.stop()
        assert lxd.running() == []

    at(open_site, use)


def test_a_frozen_instance_thaws_as_it_was_and_forgets_whom_it_admitted(
    open_site: OpenSite, lxd: OwnEngine
) -> None:
    async def use(site: Site) -> None:
        first = await site.start("s1", "workbench")
        process = await site.call(first, "s1", "process_id")
        await first.stop()
        assert len(lxd.running()) == 1, "it is frozen"
        second = await site.runtime.start(site.spec("s1", "workbench"), called=lambda _: None)
        with pytest.raises(Refused, match="heron has no lease"):
            await site.call(second, "s1", "process_id")
        await second.admit(site.heron)
        assert await site.call(second, "s1", "process_id") == process
        await second.stop()

    at(open_site, use, freezes=True)
    assert lxd.running() == []


def test_a_paced_start_takes_its_time_and_a_thaw_does_not(open_site: OpenSite) -> None:
    async def use(site: Site) -> None:
        slow = InstanceSpec("s1", "workbench", Program(""), start_pace_s=5.0)
        for at_least_s, at_most_s in ((5.0, 60.0), (0.0, 4.0)):
            began_s = time.monotonic()
            instance = await site.runtime.start(slow, called=lambda _: None)
            assert at_least_s <= time.monotonic() - began_s < at_most_s
            await instance.stop()

    at(open_site, use, freezes=True)


def test_what_a_killed_daemon_left_ends_by_itself_or_at_the_next_start(
    open_site: OpenSite, lxd: OwnEngine, tmp_path: Path, keys: Path, services: Path
) -> None:
    async def use(site: Site) -> None:
        async def visit(server: str, *, leave: bool) -> None:
            guest = Guest(site.dialer, server, address, f"{services}:Workbench")
            endpoint = (await guest.start()).endpoint
            assert await guest.call(endpoint, "echo", b"photo") == b"photo"
            if leave:
                await guest.leave()
            await guest.close()

        with (tmp_path / "stderr").open("w") as stderr:
            process = await asyncio.create_subprocess_exec(
                *serving(tmp_path, lxd, keys), stdout=subprocess.PIPE, stderr=stderr
            )
        try:
            assert process.stdout is not None
            address = (await process.stdout.readline()).decode().split()[-1]
            await visit("s2", leave=True)
            await asyncio.to_thread(
                wait_for, lambda: "FROZEN" in lxd.command("list", "-f", "csv", "-c", "s"), within_s=10.0
            )
            await visit("s1", leave=False)
        finally:
            process.kill()
            await process.wait()
        # The one that runs reads the end of its line; the frozen one cannot.
        await asyncio.to_thread(wait_for, lambda: len(lxd.running()) == 1, within_s=10.0)

    at(open_site, use)
    made = lxd.command("list", "-f", "csv", "-c", "n")

    async def again(site: Site) -> None:
        assert lxd.running() == []
        assert lxd.command("list", "-f", "csv", "-c", "n") == made, "what was made is used again"
        instance = await site.start("s2", "workbench")
        assert await site.call(instance, "s2", "echo", b"photo") == b"photo"
        await instance.stop()

    at(open_site, again)


def serving(folder: Path, lxd: OwnEngine, keys: Path) -> list[str]:
    """The command of a daemon that keeps idle containers frozen, and finds them idle soon."""
    config = folder / "server.toml"
    config.write_text(
        f"""
        listen = "127.0.0.1:0"
        lease_s = 2.0
        idle_stop_s = 0.5
        keys = {{ authority = "{keys}/authority.pem", certificate = "{keys}/s1.pem", key = "{keys}/s1.key" }}
        service = [{{ name = "workbench" }}, {{ name = "vandal" }}]
        server = [{{ name = "s1" }}, {{ name = "s2", images = ["workbench"] }}]
        [runtime]
        kind = "lxd"
        idle = "freeze"
        memory_bytes = {MEMORY_BYTES}
        network.subnet = "10.147.71.0/24"
        engine.addresses = ["unix:{lxd.socket}"]
        """
    )
    return [sys.executable, "-m", "upwash", "serve", "--config", str(config)]


def test_a_container_that_is_killed_from_outside_is_noticed_and_started_again(
    open_site: OpenSite, lxd: OwnEngine
) -> None:
    async def use(site: Site) -> None:
        instance = await site.start("s1", "workbench")
        (name,) = lxd.running()
        os.kill(lxd.process_1(name), signal.SIGKILL)
        async with asyncio.timeout(10.0):
            assert await instance.exited() == "the container is gone, or cannot be reached"
        await instance.stop()
        again = await site.start("s1", "workbench")
        assert await site.call(again, "s1", "echo", b"photo") == b"photo"
        await again.stop()

    at(open_site, use)


def test_an_image_of_another_release_is_refused(open_site: OpenSite, monkeypatch: pytest.MonkeyPatch) -> None:
    async def use(site: Site) -> None:
        monkeypatch.setattr("upwash.real.service_image.version", lambda _: "9.9")
        with pytest.raises(InstanceError, match=r"made with upwash .*, and this is 9\.9: make it again"):
            await site.start("s1", "workbench")

    at(open_site, use)


def test_a_start_without_an_image_names_the_remedy(open_site: OpenSite) -> None:
    async def use(site: Site) -> None:
        with pytest.raises(
            InstanceError, match="no image of unpackaged: make one with `upwash package unpackaged`"
        ):
            await site.runtime.start(site.spec("s1", "unpackaged"), called=lambda _: None)

    at(open_site, use)
