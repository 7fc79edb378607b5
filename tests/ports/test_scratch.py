"""Folders for sockets, of which a killed program leaves some."""

from __future__ import annotations

import socket
from pathlib import Path

from upwash.real.host.scratch import socket_folder


def left(folder: Path, name: str) -> Path:
    made = folder / name
    made.mkdir()
    with socket.socket(socket.AF_UNIX) as bound:
        bound.bind(f"{made}/daemon.sock")
    return made


def test_what_a_killed_program_left_goes_and_what_another_uses_or_owns_stays(tmp_path: Path) -> None:
    of_killed = left(tmp_path, "uw-killed")
    with_file = left(tmp_path, "uw-file")
    (with_file / "notes").touch()
    elsewhere = left(tmp_path, "other")
    with socket_folder(tmp_path) as used:
        assert not of_killed.exists()
        assert with_file.exists()
        assert elsewhere.exists()
        with socket_folder(tmp_path) as own:
            assert own != used
            assert used.exists()
    assert not used.exists()
