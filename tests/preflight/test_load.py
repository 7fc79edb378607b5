"""What `upwash check` says of the drone's own computer beside its photos, against figures computed by hand."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from upwash.cli.main import main

ROWS = """
[mission]
waypoints_m = [[0, 0], [90, 0], [90, 25], [0, 25]]
ground_speed_m_s = 6.0
photos = { every_m = 9.0 }

[vehicle]
acceleration_m_s2 = 1.0
takeoff_s = 10.0

[camera]
photo_s = 0.5

[[service]]
name = "detector"
local_call_s = { light = 8.0, heavy = 8.0 }
"""
SERVER = """
[[server]]
name = "s1"
east_m = 45.0
north_m = 0.0
range_m = 120.0
check_s = 5.0
remote_call_s = { light = 1.0, heavy = 1.0 }
"""
STOPS = (
    ROWS.replace("photos = { every_m = 9.0 }\n", "").replace("[90, 25]", "[90, 90]").replace("0, 25", "0, 90")
)
EACH_DEMANDS = "[event]\nevery = 1\n"


def checked(file: Path, capsys: pytest.CaptureFixture[str], text: str) -> tuple[dict[str, Any], str]:
    """The object of --json, and what a person reads."""
    file.write_text(text)
    main(["check", str(file), "--json", "--workers", "1"])
    found = json.loads(capsys.readouterr().out)
    main(["check", str(file), "--workers", "1"])
    return found, " ".join(capsys.readouterr().out.split())


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "drone.toml"


def test_rows_that_outrun_the_drone_are_told_with_what_servers_save(
    file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found, told = checked(file, capsys, ROWS + SERVER)
    assert found["load"] == {"local_s": 8.0, "every_s": 1.5, "ratio": pytest.approx(16 / 3), "waits": False}
    alone_s, served_s = (found["worth"][side]["mission_time_s"] for side in ("alone", "served"))
    saved = 100 * (1 - served_s / alone_s)
    assert saved > 50
    assert f" saved, {saved:.0f} %, " in told
    assert "the drone needs 8 s for a photo and takes one each 1.5 s, 5.3 times what it can compute" in told


def test_a_drone_that_keeps_up_needs_no_server(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    quick = ROWS.replace("8.0", "0.6")
    found, told = checked(file, capsys, quick + SERVER)
    assert found["load"]["ratio"] == pytest.approx(0.4)
    assert "takes one each 1.5 s, 0.4 of what it can compute: it keeps up alone" in told
    assert "it keeps up alone, and a server saves little in flight" in checked(file, capsys, quick)[1]


def test_a_file_without_servers_says_what_one_could_save(
    file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found, told = checked(file, capsys, ROWS)
    assert "worth" not in found
    assert (
        "5.3 times what it can compute: a server saves at most 81 % of the time from photo to photo" in told
    )


def test_a_drone_that_waits_at_each_stop_pays_for_each_answer(
    file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # a leg of 90 m at 6 m/s with 1 m/s²: 90 / 6 + 6 s; the photo 0.5 s
    found, told = checked(file, capsys, STOPS)
    assert found["load"] == {"local_s": 8.0, "every_s": 21.5, "ratio": pytest.approx(8 / 21.5), "waits": True}
    assert (
        "needs 8 s for a photo and waits for it at each stop, 22 s of flight apart: a server saves at most 27 %"
        in told
    )
    found, told = checked(file, capsys, STOPS + SERVER + EACH_DEMANDS)
    assert found["load"]["waits"], "each answer is acted on at once"
    assert "at each stop, 22 s of flight apart" in told


def test_a_drone_that_flies_on_hides_its_computation(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found, told = checked(file, capsys, STOPS + SERVER)
    assert found["worth"]["served"]["case"] == 'policy.stay_or_go = "learn"'
    assert not found["load"]["waits"]
    assert "takes one each 22 s, 0.37 of what it can compute: it keeps up alone" in told


def test_the_load_is_that_of_the_speed_which_servers_allow(
    file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    chosen = ROWS.replace("ground_speed_m_s = 6.0", 'speed = "auto"')
    found, _ = checked(file, capsys, chosen + SERVER)
    assert found["load"]["every_s"] == pytest.approx(9 / found["speed"]["ground_speed_m_s"])
    assert found["load"]["ratio"] > 3
    assert "load" not in checked(file, capsys, chosen)[0], "alone, it chooses a speed that it keeps up with"
