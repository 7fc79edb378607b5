"""A service whose code changes on the disk while drones call: a reload takes it, or says why not; no call fails."""

from __future__ import annotations

import asyncio
import os
import re
import signal
from pathlib import Path

import pytest
from tests.system.daemons import Daemon, daemon
from tests.system.flying import Flying
from tests.waiting import wait_for

from upwash.real.trust.authority import make_keys

pytestmark = [pytest.mark.system, pytest.mark.xdist_group("hand-over")]

SETTINGS = """
listen = "127.0.0.1:0"
lease_s = 3
runtime.sandbox = "off"
[keys]
authority = "{folder}/keys/authority.pem"
certificate = "{folder}/keys/s1.pem"
key = "{folder}/keys/s1.key"
[[service]]
name = "scale"
program = "{folder}/scale.py:Scale"
settings = {{ model = "{folder}/model.bin" }}
[[server]]
name = "s1"
"""
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


class Operator:
    """Whoever changes files beside the daemon and has them read."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.write("scale.py", SERVICE)
        self.write("factor.py", "FACTOR = 1")
        self.write("model.bin", "10")
        self.daemon: Daemon | None = None

    def write(self, name: str, text: str) -> None:
        (self.folder / name).write_text(text)

    def said(self) -> str:
        return (self.folder / "stderr").read_text()

    async def reload(self, awaited: str) -> None:
        """Has the files read; returns when the log has said that."""
        known = len(self.said())
        assert self.daemon is not None
        os.kill(self.daemon.process.pid, signal.SIGHUP)
        await asyncio.to_thread(
            wait_for,
            lambda: re.search(awaited, self.said()[known:]),
            within_s=30.0,
            seen=self.said,
        )


def test_a_service_changes_in_place_and_no_call_fails(tmp_path: Path) -> None:
    make_keys(tmp_path / "keys", servers=[["s1"]], drones=["d1"])
    operator = Operator(tmp_path)

    async def visit(at: Daemon) -> None:
        operator.daemon = at
        drone = Flying("d1", at.address, tmp_path / "keys", f"{tmp_path}/scale.py:Scale", "weigh")
        enough, here = asyncio.Event(), asyncio.Event()
        async with asyncio.timeout(100.0), asyncio.TaskGroup() as flights:
            flights.create_task(drone.fly(enough, here.set))
            await here.wait()
            await drone.hears(10)
            await operator.reload(r"services that changed: none")
            operator.write("model.bin", "20")
            await operator.reload(r"services that changed: scale")
            await drone.hears(20)
            await asyncio.to_thread(wait_for, lambda: "another version of scale now" in operator.said())
            operator.write("factor.py", "FACTOR =")
            await operator.reload(r"scale stays in its former version: .*invalid syntax")
            operator.write("factor.py", "FACTOR = 3")
            operator.write("scale.py", SERVICE + MORE)
            operator.write("model.bin", "no number")
            await operator.reload(r"scale@s1 serves on in its former version: remove the cause")
            await drone.hears(20)
            operator.write("model.bin", "40")
            await operator.reload(r"services that changed: scale")
            await drone.hears(120)
            enough.set()
        assert list(dict.fromkeys(drone.answered)) == [10, 20, 120]

    with daemon(tmp_path, SETTINGS.format(folder=tmp_path), names="s1") as at:
        asyncio.run(visit(at))
