"""A drone that sends control characters: none of them reaches a log or a terminal."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.system.attacks.escaping_drone import speak, told, unprintable
from tests.system.daemons import config, daemon

from upwash.real.trust.authority import make_keys

pytestmark = pytest.mark.system

SHOWN = r"\x1b[2J\x1b]0;owned\x07\x9b31m\u202edetsurt\u2066\r\nWARNING all is well"


def test_no_control_character_of_a_drone_reaches_a_log_or_a_terminal(tmp_path: Path) -> None:
    make_keys(tmp_path / "keys", servers=[["s1", "s2"]], drones=["heron"], operators=["operator"])
    with daemon(tmp_path, config(tmp_path / "keys")) as at:
        speak(at, tmp_path / "keys")
        shown = told(at, tmp_path / "keys")
    logged = (tmp_path / "stderr").read_bytes().decode()
    assert f"no place for heron: no server {SHOWN} here" in logged
    assert unprintable(logged) == 0
    assert "no server" in shown
    assert unprintable(shown) == 0
