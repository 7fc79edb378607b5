"""`upwash check --servers` makes the calls of a flight, over the way that they take then."""

from __future__ import annotations

import asyncio
import contextlib
import random
from collections.abc import AsyncIterator, Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from tests.programs import write_drone
from tests.system.daemons import config, daemon

from upwash.config.drone import DroneConfig
from upwash.config.drone_file import read_drone_config
from upwash.launch.survey import survey_servers
from upwash.real.network import SurveyFinding

pytestmark = pytest.mark.system

JPEG = cv2.imencode(".jpg", np.full((48, 64, 3), 90, np.uint8))[1].tobytes()


@contextlib.asynccontextmanager
async def forwarded(address: str, at: int = 0) -> AsyncIterator[str]:
    """A port of this computer that leads to the address, as a router's does."""
    host, _, port = address.rpartition(":")
    carriers: list[asyncio.Task[None]] = []

    async def carry(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            while data := await reader.read(65536):
                writer.write(data)
                await writer.drain()
        finally:
            writer.close()
            with contextlib.suppress(OSError):
                await writer.wait_closed()

    async def lead(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        inside, inwards = await asyncio.open_connection(host, int(port))
        carriers.extend(asyncio.create_task(carry(*each)) for each in ((reader, inwards), (inside, writer)))

    async with await asyncio.start_server(lead, "127.0.0.1", at) as server:
        yield f"127.0.0.1:{server.sockets[0].getsockname()[1]}"
        for carrier in carriers:
            carrier.cancel()
        await asyncio.gather(*carriers, return_exceptions=True)


def drone(folder: Path, keys: Path, program: str, address: str, **tables: Any) -> DroneConfig:
    own = {"authority": "authority.pem", "certificate": "heron.pem", "key": "heron.key"}
    service = {"name": program.rpartition(":")[2].lower(), "program": program, "local_call_s": 10.0}
    server = {
        "name": "s1",
        "range_m": 50,
        "east_m": 0,
        "north_m": 0,
        "address": address,
        "remote_call_s": 1.0,
    }
    fixed = {
        "keys": {name: f"{keys}/{file}" for name, file in own.items()},
        "service": [service],
        "server": [server],
    }
    file = write_drone(folder, **fixed | tables)
    (folder / "photos" / "1.jpg").write_bytes(JPEG)
    return read_drone_config(file)


@pytest.fixture
def programs(tmp_path: Path) -> Path:
    file = tmp_path / "finders.py"
    file.write_text(FINDERS)
    return file


FINDERS = """
import time
from upwash import service

@service
class Finder:
    def find(self, photo: bytes) -> int:
        return len(photo)

@service
class Failing:
    def find(self, photo: bytes) -> int:
        raise ValueError("no such layer")

@service
class Mute:
    def say(self, number: int) -> int:
        return number

@service
class Late:
    def __init__(self) -> None:
        time.sleep(60.0)

    def find(self, photo: bytes) -> int:
        return 0
"""


async def found(
    folder: Path,
    keys: Path,
    program: str,
    *,
    forward: bool = False,
    mapped: Mapping[int, int] | None = None,
    settings: Mapping[str, Any] | None = None,
    **tables: Any,
) -> SurveyFinding:
    classes = ("Finder", "Failing", "Mute", "Late")
    file = program.rpartition(":")[0]
    services = [{"name": cls.lower(), "program": f"{file}:{cls}"} for cls in classes]
    fixed = {
        "listen": "127.0.0.2:0",
        "service": services,
        "server": [{"name": "s1"}],
        "start_timeout_s": 60.0,
    }
    async with contextlib.AsyncExitStack() as stack:
        at = stack.enter_context(daemon(folder, config(keys, **fixed | dict(settings or {})), names="s1"))
        address = await stack.enter_async_context(forwarded(at.address)) if forward else at.address
        for outside, inside in (mapped or {}).items():
            await stack.enter_async_context(forwarded(f"127.0.0.2:{inside}", at=outside))
        (finding,) = await survey_servers(drone(folder, keys, program, address, **tables))
        return finding


async def test_a_service_is_called_with_the_cameras_photo(tmp_path: Path, keys: Path, programs: Path) -> None:
    finding = await found(tmp_path, keys, f"{programs}:Finder")
    assert finding.trouble == ""
    assert "started finder" in finding.found and "called finder.find in" in finding.found


@pytest.mark.parametrize("cls", ["Finder", "Mute"])
async def test_a_server_of_which_only_the_daemons_port_is_reached_is_not_ready(
    tmp_path: Path, keys: Path, programs: Path, cls: str
) -> None:
    finding = await found(tmp_path, keys, f"{programs}:{cls}", forward=True)
    assert "instance_ports" in finding.trouble


async def test_a_server_whose_ports_are_mapped_is_ready(tmp_path: Path, keys: Path, programs: Path) -> None:
    first = random.randrange(20_000, 29_000, 8)  # below those that the system hands out
    inside, outside = range(first, first + 4), range(first + 4, first + 8)
    settings = {"instance_ports": [inside[0], inside[-1]], "outside_ports": [outside[0], outside[-1]]}
    mapped = dict(zip(outside, inside, strict=True))
    finding = await found(
        tmp_path, keys, f"{programs}:Finder", forward=True, mapped=mapped, settings=settings
    )
    assert finding.trouble == ""


async def test_a_service_that_fails_on_the_photo_is_not_ready(
    tmp_path: Path, keys: Path, programs: Path
) -> None:
    assert "failing.find failed on 1.jpg" in (await found(tmp_path, keys, f"{programs}:Failing")).trouble


@pytest.mark.parametrize(("daemons_s", "own_s"), [(10.0, 60.0), (60.0, 0.1)])
async def test_a_start_that_takes_too_long_names_the_key(
    tmp_path: Path, keys: Path, programs: Path, daemons_s: float, own_s: float
) -> None:
    late = f"{programs}:Late"
    trouble = (
        await found(tmp_path, keys, late, settings={"start_timeout_s": daemons_s}, start_timeout_s=own_s)
    ).trouble
    whose = "daemon" if daemons_s < own_s else "drone"
    assert f"raise start_timeout_s in the {whose}'s configuration" in trouble


async def test_a_camera_without_a_photo_is_told_beside_the_servers(
    tmp_path: Path, keys: Path, programs: Path
) -> None:
    camera = {"folder": "paintings"}
    blind = drone(tmp_path, keys, f"{programs}:Finder", "127.0.0.1:1", camera=camera)
    told, server = await survey_servers(blind)
    assert "there is no folder" in told.trouble
    assert server.subject == "s1 at 127.0.0.1:1" and server.trouble
