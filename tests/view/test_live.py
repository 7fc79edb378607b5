"""`upwash fly --live` where there can be no live view: nothing flies, and one message says why."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from upwash.cli.main import main

pytestmark = pytest.mark.system

CONFIG = """
[mission]
home = { latitude_deg = 39.3666, longitude_deg = 22.9507 }
waypoints_m = [[0, 0]]
[autopilot]
connection = "tcp:127.0.0.1:1"
[camera]
folder = "."
[[service]]
name = "detector"
local_call_s = { light = 1.0, heavy = 3.0 }
"""


@pytest.fixture
def config(tmp_path: Path) -> Path:
    file = tmp_path / "drone.toml"
    file.write_text(CONFIG)
    (tmp_path / "1.jpg").write_bytes(b"\xff\xd8\xff")
    return file


def test_a_port_in_use_keeps_the_drone_on_the_ground(
    config: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = config.parent / "events.jsonl"
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = str(other.getsockname()[1])
        assert main(["fly", "--config", str(config), "--log", str(log), "--live", port]) == 1
    told = capsys.readouterr().err
    assert f"cannot serve on port {port}" in told
    assert "give another, or 0" in told
    assert log.read_bytes() == b""


def test_a_log_to_resume_that_is_not_there_is_not_made(
    config: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = config.parent / "nowhere.jsonl"
    assert main(["fly", "--config", str(config), "--resume", str(log), "--live", "0"]) == 1
    assert "cannot read the event log" in capsys.readouterr().err
    assert not log.exists()
