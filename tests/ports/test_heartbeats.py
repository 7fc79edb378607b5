"""Heartbeats to a vehicle, which go on after a defect."""

from __future__ import annotations

import asyncio
import socket

import pytest

from upwash.eventlog.schema import LinkTrouble
from upwash.ports import VehicleNews
from upwash.real.mavlink import Patience
from upwash.real.mavlink.arducopter import ARDUCOPTER
from upwash.real.mavlink.vehicle import MavlinkVehicle


def test_heartbeats_go_on_after_a_defect_which_is_told(caplog: pytest.LogCaptureFixture) -> None:
    async def use() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle:
            vehicle.bind(("127.0.0.1", 0))
            vehicle.setblocking(False)
            heard = MavlinkVehicle(f"udpout:127.0.0.1:{vehicle.getsockname()[1]}", Patience(), [ARDUCOPTER])
            failed, news = asyncio.Event(), list[VehicleNews]()

            def fail_once() -> int:
                if not failed.is_set():
                    failed.set()
                    raise LookupError("a defect")
                return 0

            heard.heartbeat_word = fail_once
            heard.listen(news.append)
            try:
                async with asyncio.timeout(10.0):
                    assert await asyncio.get_running_loop().sock_recv(vehicle, 300)
                assert failed.is_set()
                (trouble,) = news
                assert isinstance(trouble, LinkTrouble) and "LookupError: a defect" in trouble.why
            finally:
                await heard.close()

    asyncio.run(use())
    assert "the vehicle's link failed: LookupError: a defect" in caplog.text
