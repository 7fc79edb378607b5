"""What a service manager hears of a program, and of the program's successor."""

from __future__ import annotations

import asyncio
import socket
from pathlib import Path

import pytest

from upwash.real.host.service_manager import ServiceManager
from upwash.support.background import beside


async def test_the_watchdog_hears_the_main_process_alone(tmp_path: Path) -> None:
    environment = {"NOTIFY_SOCKET": f"{tmp_path}/notify", "WATCHDOG_USEC": "20000", "HOME": "/"}
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as heard:
        heard.bind(environment["NOTIFY_SOCKET"])
        heard.settimeout(10.0)
        manager = ServiceManager.taken_from(environment)
        assert environment == {"HOME": "/"}, "services do not report to it"
        async with beside(manager.heartbeat(), name="the watchdog"):
            for _ in range(2):
                assert await asyncio.to_thread(heard.recv, 100) == b"WATCHDOG=1"
            successor = manager.environment
            manager.main_is(7)
            manager.stopping("its last lease ends")
            heard.settimeout(0.1)  # five times the watchdog's
            said = []
            with pytest.raises(TimeoutError):
                while True:
                    said.append(await asyncio.to_thread(heard.recv, 100))
    assert said[-1] == b"MAINPID=7" and b"STOPPING" not in b"".join(said)
    assert successor == {"NOTIFY_SOCKET": f"{tmp_path}/notify", "WATCHDOG_USEC": "20000"}


@pytest.mark.virtual
async def test_without_a_service_manager_nothing_is_sent() -> None:
    manager = ServiceManager.taken_from({"WATCHDOG_USEC": "20000"})
    async with beside(manager.heartbeat(), name="the watchdog"):
        await asyncio.sleep(60.0)
    assert manager.environment == {}
