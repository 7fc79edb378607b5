"""A drone that sends control characters: none of them reaches a log or a terminal."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.system.attacks.escaping_drone import attacked, unprintable

pytestmark = pytest.mark.system

SHOWN = r"\x1b[2J\x1b]0;owned\x07\x9b31m\u202edetsurt\u2066\r\nWARNING all is well"


def test_no_control_character_of_a_drone_reaches_a_log_or_a_terminal(tmp_path: Path) -> None:
    logged, told = attacked(tmp_path)
    assert f"no place for heron: no server {SHOWN} here" in logged
    assert "no server" in told
    assert unprintable(logged) == unprintable(told) == 0
