"""A daemon whose services run in containers takes their lanes from the images; no container runs here."""

from __future__ import annotations

import asyncio
import os
import signal
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path

import pytest

from upwash.core.admission.slots import MeasuredSlots
from upwash.launch import containers
from upwash.launch.daemon import serve
from upwash.launch.status import ask_status
from upwash.ports import Program
from upwash.real.host.service_manager import ServiceManager
from upwash.real.instances.containers import HeldImage, ServiceImage
from upwash.real.instances.lxd.engine import EngineInstance
from upwash.real.trust.authority import make_keys

LANES = 3
CONFIG = """
listen = "127.0.0.1:0"
[runtime]
kind = "lxd"
[keys]
authority = "authority.pem"
certificate = "s1.pem"
key = "s1.key"
[[service]]
name = "detector"
[[server]]
name = "s1"
"""


class Engine:
    """Has an image of the detector, and makes containers that nobody starts."""

    kind = "lxd"

    async def connect(self) -> None: ...
    async def close(self) -> None: ...

    async def images(self) -> list[HeldImage]:
        program = Program("package:Detector")
        image = ServiceImage("detector", program, "host", "3.11", version("upwash"), "", concurrency=LANES)
        return [HeldImage("f00", image.properties(), "2026")]

    async def instances(self) -> list[EngineInstance]:
        return []

    async def members(self) -> list[str]:
        return ["none"]

    async def create(self, definition: Mapping[str, object], *, member: str, wait_s: float) -> None: ...


class Told(ServiceManager):
    """Knows when the daemon is ready, and is so again."""

    def __init__(self) -> None:
        super().__init__("")
        self.is_ready = asyncio.Event()

    def ready(self) -> None:
        self.is_ready.set()


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    make_keys(tmp_path, servers=[["s1"]], operators=["alice"])
    monkeypatch.setattr(containers, "Engine", lambda _: Engine())
    (tmp_path / "server.toml").write_text(CONFIG)
    return tmp_path / "server.toml"


def test_until_it_is_measured_a_server_has_slots_by_the_lanes_of_its_images(
    file: Path, tmp_path: Path
) -> None:
    async def slots(address: str) -> int:
        (server,) = (await ask_status(address, server="s1", operator="alice", keys=tmp_path)).servers
        return server.slots

    async def story() -> list[int]:
        manager, found = Told(), list[int]()
        address = asyncio.get_running_loop().create_future()
        daemon = asyncio.create_task(
            serve(file, ready=lambda _, known: address.set_result(known), manager=manager)
        )
        try:
            found.append(await slots(await address))
            await manager.is_ready.wait()
            manager.is_ready.clear()
            os.kill(os.getpid(), signal.SIGHUP)
            await manager.is_ready.wait()
            found.append(await slots(await address))
        finally:
            daemon.cancel()
            await asyncio.gather(daemon, return_exceptions=True)
        return found

    expected = MeasuredSlots({"detector": LANES}).count
    assert expected > MeasuredSlots({"detector": 1}).count
    assert asyncio.run(asyncio.wait_for(story(), 30.0)) == [expected, expected]
