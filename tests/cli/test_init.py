"""What `upwash init` makes is understood by the other commands."""

from __future__ import annotations

import stat
from pathlib import Path

import pytest

from upwash.cli.main import main
from upwash.config.daemon import read_daemon_config
from upwash.config.drone_file import read_drone_config


@pytest.fixture
def made(tmp_path: Path) -> Path:
    folder = tmp_path / "patrol"
    assert main(["init", str(folder)]) == 0
    return folder


def test_drone_and_server_fit_each_other(made: Path) -> None:
    drone, server = read_drone_config(made / "drone.toml"), read_daemon_config(made / "server.toml")
    (wanted,) = drone.servers
    assert wanted.address == server.listen
    assert [wanted.name] == [identity.name for identity in server.identities]
    assert [service.name for service in drone.services] == [image.name for image in server.images]


def test_keys_stay_with_their_owner_and_out_of_a_repository(made: Path) -> None:
    for key in (made / "keys").glob("*.key"):
        assert stat.S_IMODE(key.stat().st_mode) == 0o600
    assert {path.stem for path in (made / "keys").glob("*.key")} == {"authority", "drone", "operator", "s1"}
    assert "keys/" in (made / ".gitignore").read_text().splitlines()


def test_a_folder_with_files_is_left_as_it_is(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = {file: file.read_bytes() for file in made.rglob("*") if file.is_file()}
    assert main(["init", str(made)]) == 2
    assert "is not an empty folder" in capsys.readouterr().err
    assert {file: file.read_bytes() for file in made.rglob("*") if file.is_file()} == before


def test_an_empty_folder_is_taken(tmp_path: Path) -> None:
    assert main(["init", str(tmp_path)]) == 0
    assert (tmp_path / "patrol.py").is_file()
