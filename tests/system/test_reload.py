"""A service whose code changes on the disk while drones call: a reload takes it, or says why not; no call fails."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest
from tests.system.daemons import config, daemon
from tests.system.flying import Flying

from upwash.real.trust.authority import make_keys

pytestmark = [pytest.mark.system, pytest.mark.xdist_group("hand-over")]

SERVICE = """
from pathlib import Path
from factor import FACTOR
from upwash import service

@service
class Scale:
    def __init__(self, model: Path) -> None:
        self.read = int(model.read_text())

    def weigh(self) -> int:
        return self.read * FACTOR
"""
MORE = """
    def tare(self) -> int:
        return 0
"""


async def test_a_service_changes_in_place_and_no_call_fails(tmp_path: Path) -> None:
    make_keys(tmp_path / "keys", servers=[["s1"]], drones=["d1"])

    def write(**files: str) -> None:
        for name, text in files.items():
            (tmp_path / name.replace("_", ".")).write_text(text)

    async def reload(awaited: str) -> None:
        await asyncio.to_thread(at.reload, text, awaited)

    write(scale_py=SERVICE, factor_py="FACTOR = 1", model_bin="10")
    program = f"{tmp_path}/scale.py:Scale"
    scale = {"name": "scale", "program": program, "settings": {"model": f"{tmp_path}/model.bin"}}
    text = config(tmp_path / "keys", lease_s=3.0, service=[scale], server=[{"name": "s1"}])
    with daemon(tmp_path, text, names="s1") as at:
        drone = Flying("d1", at.address, tmp_path / "keys", program, "weigh")
        enough, here = asyncio.Event(), asyncio.Event()
        async with asyncio.timeout(100.0), asyncio.TaskGroup() as flights:
            flights.create_task(drone.fly(enough, here.set))
            await here.wait()
            await drone.hears(10)
            await reload(r"services that changed: none")
            write(model_bin="20")
            await reload(r"services that changed: scale")
            await drone.hears(20)
            await asyncio.to_thread(at.has_said, "another version of scale now")
            write(factor_py="FACTOR =")
            await reload(r"scale stays in its former version: .*invalid syntax")
            write(factor_py="FACTOR = 3", scale_py=SERVICE + MORE, model_bin="no number")
            await reload(r"scale@s1 serves on in its former version: remove the cause")
            await drone.hears(20)
            write(model_bin="40")
            await reload(r"services that changed: scale")
            await drone.hears(120)
            enough.set()
        assert list(dict.fromkeys(drone.answered)) == [10, 20, 120]
