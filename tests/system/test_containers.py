"""What holds for services in containers of every engine: whom they harm, how they end, and what is left of them."""

from __future__ import annotations

import asyncio
import os
import re
import signal
from pathlib import Path

import pytest
from tests.programs import running
from tests.system.container_site import DISK_BYTES, PROCESSES, Host
from tests.system.daemons import Guest
from tests.waiting import wait_for

from upwash.errors import LinkError, Refused, ServiceError

pytestmark = [pytest.mark.root, pytest.mark.system]


@pytest.fixture(
    params=[
        pytest.param("docker_host", id="docker", marks=pytest.mark.xdist_group("podman")),
        pytest.param("lxd_host", id="lxd", marks=pytest.mark.xdist_group("lxd")),
    ]
)
def host(request: pytest.FixtureRequest) -> Host:
    found = request.getfixturevalue(request.param)
    assert isinstance(found, Host)
    return found


@pytest.mark.parametrize("harm", ["eat_memory", "fork_without_end", "fill_disk"])
async def test_an_instance_out_of_control_harms_neither_its_neighbours_nor_the_daemon(
    host: Host, harm: str
) -> None:
    async with host.open_site() as site:
        vandal, neighbour = await site.start("s1", "vandal"), await site.start("s1", "workbench")
        free_before = os.statvfs("/tmp").f_bavail * os.statvfs("/tmp").f_frsize
        rampage = asyncio.create_task(site.call(vandal, "s1", harm, timeout_s=25.0))
        while not rampage.done():
            assert await site.call(neighbour, "s1", "echo", b"photo") == b"photo"
            await asyncio.sleep(0.1)
        match harm, rampage.exception() or rampage.result():
            case "fork_without_end", children:
                assert isinstance(children, int), children
                assert 0 < children < PROCESSES
            case "fill_disk", int(written_bytes):
                assert written_bytes <= host.writable * DISK_BYTES
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


async def test_a_service_that_crashes_ends_its_container_with_its_last_words(host: Host) -> None:
    async with host.open_site() as site:
        instance = await site.start("s1", "workbench")
        await site.call(instance, "s1", "say", "the lens is broken")
        with pytest.raises(LinkError):
            await site.call(instance, "s1", "crash")
        async with asyncio.timeout(10.0):
            assert await instance.exited() == "ended with code 3: the lens is broken"
        await instance.stop()
        assert host.left() == []


async def test_a_container_that_is_killed_from_outside_is_noticed_and_started_again(host: Host) -> None:
    async with host.open_site() as site:
        instance = await site.start("s1", "workbench")
        (container,) = host.engine.running()
        os.kill(host.engine.process_1(container), signal.SIGKILL)
        async with asyncio.timeout(10.0):
            assert re.fullmatch(host.seen_of_a_kill, await instance.exited(), re.DOTALL)
        await instance.stop()
        again = await site.start("s1", "workbench")
        assert await site.call(again, "s1", "echo", b"photo") == b"photo"
        await again.stop()
        assert host.left() == []


async def test_a_frozen_instance_thaws_as_it_was_and_forgets_whom_it_admitted(host: Host) -> None:
    async with host.open_site(freezes=True) as site:
        first = await site.start("s1", "workbench")
        process = await site.call(first, "s1", "process_id")
        await first.stop()
        assert len(host.engine.frozen()) == 1
        second = await site.runtime.start(site.spec("s1", "workbench"), called=lambda _: None)
        with pytest.raises(Refused, match="heron has no lease"):
            await site.call(second, "s1", "process_id")
        await second.admit(site.heron)
        assert await site.call(second, "s1", "process_id") == process
        await second.stop()
    assert host.left() == []


async def test_what_a_killed_daemon_left_ends_by_itself_or_at_the_next_start(
    host: Host, tmp_path: Path, keys: Path, services: Path
) -> None:
    config = host.configured(tmp_path, keys, "freeze")
    async with host.open_site() as site:
        with running("serve", "--config", config, stderr=None) as daemon:
            assert daemon.stdout is not None
            address = daemon.stdout.readline().split()[-1]
            for server in ("s2", "s1"):
                guest = Guest(site.dialer, server, address, f"{services}:Workbench")
                endpoint = (await guest.start()).endpoint
                assert await guest.call(endpoint, "echo", b"photo") == b"photo"
                if server == "s2":
                    await guest.leave()
                    wait_for(lambda: len(host.engine.frozen()) == 1, within_s=10.0)
                await guest.close()
            assert len(host.engine.running()) == 2
        # The one that runs reads the end of its line; the frozen one cannot.
        wait_for(lambda: len(host.engine.running()) == 1, within_s=10.0)
    made = host.engine.there()
    async with host.open_site() as site:
        assert host.left() == []
        assert host.engine.there() == (made if host.keeps else [])
        instance = await site.start("s2", "workbench")
        assert await site.call(instance, "s2", "echo", b"photo") == b"photo"
        await instance.stop()
