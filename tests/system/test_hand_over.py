"""A daemon whose program is changed while drones call: what they notice of it."""

from __future__ import annotations

import asyncio
import os
import signal
from pathlib import Path

import pytest
from tests.children import is_alive
from tests.system.daemons import config, daemon, eventually
from tests.system.flying import Flying
from tests.waiting import wait_for

from upwash.launch.status import ask_status
from upwash.real.trust.authority import make_keys, revoke

pytestmark = [pytest.mark.system, pytest.mark.xdist_group("hand-over")]

DRONES = [f"d{number}" for number in range(20)]
LEASE_S = 6.0


@pytest.fixture
def own_keys(tmp_path: Path) -> Path:
    folder = tmp_path / "keys"
    make_keys(folder, servers=[["s1", "s2"]], drones=DRONES, operators=["alice"])
    return folder


async def test_twenty_drones_call_on_while_the_daemon_is_changed_for_another(
    tmp_path: Path, services: Path, own_keys: Path
) -> None:
    async def calls_told() -> dict[str, int]:
        reply = await ask_status(at.address, server="s1", operator="alice", keys=own_keys)
        return {drone.drone: drone.calls for server in reply.servers for drone in server.drones}

    def of_both(told: dict[str, int], name: str, drone: Flying) -> bool:
        """Whether the new daemon counts its own calls of the drone, and calls that the old one answered."""
        _, after = dict.fromkeys(drone.answered)
        return told[name] > drone.answered.count(after)

    text = config(own_keys, lease_s=LEASE_S, server=[{"name": name, "slots": 20} for name in ("s1", "s2")])
    with daemon(tmp_path, text) as at:
        drones = [Flying(name, at.address, own_keys, f"{services}:Workbench") for name in DRONES]
        enough, here = asyncio.Event(), asyncio.Semaphore(0)
        async with asyncio.TaskGroup() as flights:
            for drone in drones:
                flights.create_task(drone.fly(enough, here.release))
            for _ in drones:
                await here.acquire()
            await eventually(calls_told, lambda told: all(map(told.get, DRONES)))
            at.process.send_signal(signal.SIGUSR2)
            async with asyncio.timeout(120.0):
                for drone in drones:
                    await drone.answered_by(2)
                await asyncio.to_thread(at.process.wait)
            enough.set()
        named = list(zip(DRONES, drones, strict=True))
        await eventually(calls_told, lambda told: all(of_both(told, *each) for each in named))
        assert at.process.wait() == 0
        for drone in drones:
            before, after = dict.fromkeys(drone.answered)
            assert drone.answered == sorted(drone.answered, key=[before, after].index)
            assert not is_alive(before)
            assert is_alive(after)


async def test_a_drone_that_is_revoked_after_a_change_is_refused_by_the_daemon_before_too(
    tmp_path: Path, services: Path, own_keys: Path
) -> None:
    with daemon(tmp_path, config(own_keys, lease_s=60.0)) as at:
        drone = Flying(DRONES[0], at.address, own_keys, f"{services}:Workbench")
        enough, here = asyncio.Event(), asyncio.Event()
        flight = asyncio.create_task(drone.fly(enough, here.set))
        await here.wait()
        at.process.send_signal(signal.SIGUSR2)
        (new,) = await asyncio.to_thread(wait_for, at.successors, seen=at.said)
        try:
            revoke(own_keys, [DRONES[0]])
            os.kill(new, signal.SIGHUP)
            await asyncio.to_thread(wait_for, lambda: at.process.poll() == 0, within_s=20.0, seen=at.said)
            assert at.said().count("1 certificates are revoked, 0 of them since before") == 2
        finally:
            flight.cancel()
            await asyncio.gather(flight, return_exceptions=True)


async def test_a_program_that_does_not_come_up_leaves_the_daemon_as_it_is(
    tmp_path: Path, services: Path, own_keys: Path
) -> None:
    with daemon(tmp_path, config(own_keys)) as at:
        drone = Flying(DRONES[0], at.address, own_keys, f"{services}:Workbench")
        enough, here = asyncio.Event(), asyncio.Event()
        async with asyncio.TaskGroup() as flights:
            flights.create_task(drone.fly(enough, here.set))
            await here.wait()
            (tmp_path / "server.toml").write_text("listen = 3")
            at.process.send_signal(signal.SIGUSR2)
            await asyncio.to_thread(at.has_said, "this daemon stays: the new daemon ended")
            count = len(drone.answered)
            async with asyncio.timeout(30.0):
                while len(drone.answered) < count + 10:
                    await drone.called()
            enough.set()
        assert len(set(drone.answered)) == 1
        assert at.process.poll() is None


def test_a_daemon_without_certificates_says_that_it_stays(tmp_path: Path) -> None:
    with daemon(tmp_path, config(None)) as at:
        at.process.send_signal(signal.SIGUSR2)
        at.has_said("no other daemon can take this one's place")
        assert at.process.poll() is None
