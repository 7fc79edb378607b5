"""upwash profile, with a service in a process of its own."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from upwash.cli.main import main

pytestmark = pytest.mark.system


@pytest.fixture
def photos(tmp_path: Path) -> Path:
    folder = tmp_path / "photos"
    folder.mkdir()
    (folder / "one.jpg").write_bytes(b"\xff\xd8" + bytes(50_000))
    return folder


def test_a_service_is_measured_here_and_the_result_is_a_configuration(
    services: Path, photos: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "service.toml"
    arguments = [f"{services}:Workbench", "--photos", str(photos), "--calls", "3"]
    assert main(["profile", *arguments, "--out", str(out)]) == 0
    (table,) = tomllib.loads(out.read_text())["service"]
    assert table["name"] == "workbench"
    assert table["program"] == f"{services}:Workbench"
    assert table["request_bytes"] == pytest.approx(50_000, rel=0.01)
    assert 0 < table["local_call_s"]["echo"] < 5
    memory_mb = int(out.read_text().partition(" MB of memory")[0].rpartition(" ")[2])
    assert 10 < memory_mb < 2000
    assert f"written: {out}" in capsys.readouterr().out


def test_a_part_before_sending_is_measured_with_its_loss(
    services: Path, photos: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["profile", f"{services}:Carrier", "--photos", str(photos), "--calls", "1"]) == 0
    (table,) = tomllib.loads(capsys.readouterr().out)["service"]
    measured = table["before_sending"]
    assert measured["request_bytes"] == pytest.approx(25_000, rel=0.01)
    assert measured["loss"] == {"echo": 1.0}
    assert 0 < measured["takes_s"] < 5


def test_times_may_be_missing_from_the_configuration_and_what_the_service_prints_is_shown(
    photos: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "talker.py").write_text(
        "from upwash import service\nfrom upwash.services import Detection\n\n\n@service\nclass Talker:\n"
        "    def __init__(self, *, name: str) -> None:\n        print(f'network of {name}')\n"
        "        print('warning: no scores')\n\n"
        "    def look(self, photo: bytes) -> list[Detection]:\n        return []\n"
    )
    config = tmp_path / "drone.toml"
    config.write_text(
        '[mission]\nwaypoints_m = [[0, 0]]\n[[service]]\nname = "talker"\nprogram = "talker.py:Talker"\n'
        'settings = { name = "mine" }\n'
    )
    assert main(["profile", "talker", "--config", str(config), "--photos", str(photos), "--calls", "1"]) == 0
    said = capsys.readouterr().out
    assert said.count("# It says: network of mine\n") == 1
    assert said.count("# It says: warning: no scores\n") == 1
    assert "# talker.look: 0 boxes in 0 of " in said and "; in [event]: probability = 0\n" in said
    assert "local_call_s = { look = " in said


CHOOSER = """
import time
from typing import Literal
from upwash import service

@service
class Chooser:
    def __init__(self, *, engine: Literal["absent", "fast", "slow"] = "slow") -> None:
        if engine == "absent":
            raise ImportError("there is no such engine here")
        self.delay_s = {"fast": 0.0, "slow": 0.1}[engine]

    def look(self, photo: bytes) -> int:
        time.sleep(self.delay_s)
        return len(photo)
"""


def test_the_fastest_value_of_a_setting_is_named_and_one_that_does_not_start_is_left_out(
    photos: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    program, out = tmp_path / "chooser.py", tmp_path / "service.toml"
    program.write_text(CHOOSER)
    arguments = [f"{program}:Chooser", "--photos", str(photos), "--calls", "1", "--each", "engine"]
    assert main(["profile", *arguments, "--out", str(out)]) == 0
    (table,) = tomllib.loads(out.read_text())["service"]
    assert table["settings"] == {"engine": "fast"}
    assert table["local_call_s"]["look"] < 0.1
    assert "# slow: look 0.1" in out.read_text()
    said = capsys.readouterr().err
    assert "left out: " in said
    assert "there is no such engine here" in " ".join(said.split())


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--server", "s1"], "--server needs --config"),
        (["--each", "speed"], "service 'workbench' has no setting 'speed'; it has none"),
        (["--photos", "/nowhere"], "there is no folder /nowhere"),
    ],
)
def test_what_is_missing_is_said(
    arguments: list[str], said: str, services: Path, photos: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["profile", f"{services}:Workbench", "--photos", str(photos), *arguments]) == 2
    assert said in capsys.readouterr().err
