"""Too little room for what commands write: nothing is half made, and a flight goes on and is told as flown."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.system.attacks.full_disk import ATTACKS, attack

pytestmark = [pytest.mark.system, pytest.mark.long]


@pytest.mark.parametrize("name", ATTACKS)
def test_too_little_room_breaks_nothing(name: str, tmp_path: Path) -> None:
    finding = attack(name, tmp_path)
    if finding is None:
        pytest.skip("this user may not make a disk in a namespace of its own")
    assert not finding.broken, finding
