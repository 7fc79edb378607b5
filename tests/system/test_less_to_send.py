"""A real flight past a real server: requests are made smaller before they are sent, in a process of the drone's."""

from __future__ import annotations

from pathlib import Path

import pytest
import tomli_w
from tests.events import read
from tests.programs import COUNTER, COUNTING, running, stand_in, write_drone

from upwash.cli.main import main

pytestmark = [pytest.mark.system, pytest.mark.flight]

PROGRAM = COUNTING.replace(
    "@service",
    """import os

@service
class Halve:
    def count(self, photo: bytes) -> bytes:
        if photo.endswith(b"crash"):
            os._exit(3)
        return photo[: len(photo) // 2]

@service(before_sending=Halve)""",
).replace("(drone.altitude_m)", "(drone.altitude_m)\n    drone.autopilot.hover(6.0)")


def test_requests_are_made_smaller_and_a_crash_of_the_part_costs_no_answer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    part = {"takes_s": 0.5, "request_bytes": 200_000, "loss": 0.5}
    write_drone(
        tmp_path,
        PROGRAM,
        mission={"altitude_m": 2.0, "waypoints_m": [[0, 0], [0, 1]]},
        service=[{**COUNTER, "request_bytes": 400_000, "local_call_s": 9.0, "before_sending": part}],
        server=[
            {
                "name": "s1",
                "east_m": 0.0,
                "north_m": 0.0,
                "range_m": 100.0,
                "address": f"unix:{tmp_path}/s1.sock",
                "bandwidth_bit_s": 1e6,
                "remote_call_s": 3.5,
            }
        ],
        policy={"most_loss": 0.6},
    )
    for name, end in ("1.jpg", b"whole"), ("2.jpg", b"crash"):
        (tmp_path / "photos" / name).write_bytes(b"\xff\xd8" + bytes(399_993) + end)
    daemon = {
        "listen": f"unix:{tmp_path}/s1.sock",
        "allow_without_certificates": True,
        "runtime": {"sandbox": "off"},
        "service": [COUNTER],
        "server": [{"name": "s1"}],
    }
    (tmp_path / "server.toml").write_text(tomli_w.dumps(daemon))
    with running("serve", "--config", "server.toml") as serving, stand_in(tmp_path) as connection:
        assert serving.stdout is not None
        assert any(" ready at " in line for line in serving.stdout)
        assert main(["fly", "--config", "drone.toml", "--autopilot", connection]) == 0
    (log,) = Path("runs").glob("*/events.jsonl")
    events = read(log)
    calls = [event for event in events if event["event"] == "call"]
    assert [call["place"] for call in calls] == ["s1", "s1"]
    assert ["sent_bytes" in call for call in calls] == [True, False]
    answers = [event["message"] for event in events if event["event"] == "notified"]
    assert answers == [200_000, 400_000]
    (failed,) = [event for event in events if event["event"] == "sent_whole"]
    assert failed["operation"] == "counter.count"
