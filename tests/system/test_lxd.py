"""Containers of a real LXD: what differs from those of other engines (test_containers.py)."""

from __future__ import annotations

import time

import pytest
from tests.system.container_site import Host

from upwash.errors import InstanceError
from upwash.ports import InstanceSpec, Program
from upwash.real.instances.control_credentials import SERVICE_PORT
from upwash.real.instances.lxd.instance import LxdInstance

pytestmark = [pytest.mark.root, pytest.mark.system, pytest.mark.xdist_group("lxd")]


async def test_a_service_has_no_rights_and_reaches_nobody(lxd_host: Host) -> None:
    async with lxd_host.open_site() as site:
        vandal, neighbour = await site.start("s1", "vandal"), await site.start("s2", "workbench")
        assert await site.call(vandal, "s1", "identity") == [1000, 0]
        assert isinstance(neighbour, LxdInstance)
        host = neighbour.container.address
        assert await site.call(vandal, "s1", "reach", host, SERVICE_PORT) != "connected"
        assert await site.call(vandal, "s1", "reach", "169.254.0.1", 22) == "TimeoutError"
        assert await site.call(neighbour, "s2", "echo", b"photo") == b"photo"
        for instance in (vandal, neighbour):
            await instance.stop()


async def test_a_paced_start_takes_its_time_and_a_thaw_does_not(lxd_host: Host) -> None:
    async with lxd_host.open_site(freezes=True) as site:
        slow = InstanceSpec("s1", "workbench", Program(""), start_pace_s=5.0)
        for at_least_s, at_most_s in ((5.0, 60.0), (0.0, 4.0)):
            began_s = time.monotonic()
            instance = await site.runtime.start(slow, called=lambda _: None)
            assert at_least_s <= time.monotonic() - began_s < at_most_s
            await instance.stop()


async def test_an_image_of_another_release_is_refused(
    lxd_host: Host, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with lxd_host.open_site() as site:
        monkeypatch.setattr("upwash.real.instances.containers.version", lambda _: "9.9")
        with pytest.raises(InstanceError, match=r"made with upwash .*, and this is 9\.9: make it again"):
            await site.start("s1", "workbench")


async def test_a_start_without_an_image_names_the_remedy(lxd_host: Host) -> None:
    async with lxd_host.open_site() as site:
        with pytest.raises(
            InstanceError,
            match="no image of unpackaged: make and import one with `upwash package unpackaged --config",
        ):
            await site.runtime.start(site.spec("s1", "unpackaged"), called=lambda _: None)
