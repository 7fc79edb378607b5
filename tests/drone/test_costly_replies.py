"""A server's reply that costs far more than its bytes is no answer: the drone computes the call, and flies on."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any
from unittest.mock import patch

import msgspec
import pytest
from tests.events import written
from tests.waiting import million_steps_s

from upwash.config.drone_file import drone_config
from upwash.drone.server_session import ServerSession
from upwash.lab.run import simulate_fleet

PROGRAM = """
import numpy as np
from numpy.typing import NDArray
from upwash import Drone, service

@service
class Costly:
    def array(self) -> NDArray[np.float32]:
        return np.zeros(4, np.float32)
    def lists(self) -> list[list[int]]:
        return [[1]]
    def text(self) -> str:
        return "own"
    def keys(self) -> dict[int, int]:
        return {1: 1}

def survey(drone: Drone) -> None:
    costly = drone.service(Costly)
    drone.autopilot.arm()
    drone.autopilot.takeoff(drone.altitude_m)
    for waypoint in drone.plan:
        drone.autopilot.goto(waypoint)
        drone.user.notify(str(getattr(costly, "METHOD")()), at=waypoint)
    drone.end_flight()
"""
MOST_MILLIONS = 550  # of steps, for the whole flight; one of these replies used to take up to hours
REPLIES: dict[str, tuple[str, Any]] = {
    "array": ("[0. 0. 0. 0.]", {"dtype": "<f4", "shape": [2**63 - 1] * 400_000, "data": bytes(4)}),
    "lists": ("[[1]]", [[]] * 4_000_000),
    "text": ("own", "\x01" * 4_000_000),
    "keys": ("{1: 1}", dict.fromkeys(range(100_000))),
}


@pytest.mark.parametrize("method", REPLIES)
def test_the_mission_gets_the_drones_own_answer_in_time(tmp_path: Path, method: str) -> None:
    own, value = REPLIES[method]
    reply = msgspec.msgpack.encode({"value": value})

    async def lie(*_: object, **__: object) -> bytes:
        return reply

    file = tmp_path / "costly.py"
    file.write_text(PROGRAM.replace("METHOD", method))
    document = {
        "mission": {"program": f"{file}:survey", "waypoints_m": [[0.0, 0.0], [20.0, 0.0]]},
        "policy": {"blacklist_s": 1.0},
        "service": [{"name": "costly", "program": f"{file}:Costly", "local_call_s": {"": 10.0}}],
        "server": [
            {"name": "s1", "east_m": 0.0, "north_m": 0.0, "range_m": 1000.0, "remote_call_s": {"costly": 0.5}}
        ],
    }
    began_s = time.process_time()
    with patch.object(ServerSession, "call", lie):
        (run,) = simulate_fleet([drone_config(document, tmp_path / "scenario.toml")], computing=True)
    assert time.process_time() - began_s < MOST_MILLIONS * million_steps_s()
    assert run.failure == ""
    events = written(run.events)
    assert [event["message"] for event in events if event["event"] == "notified"] == [own] * 2
    failed = [event["why"] for event in events if event["event"] == "remote_failed"]
    assert failed
    assert all("more than" in why and len(why) < 1000 for why in failed)
