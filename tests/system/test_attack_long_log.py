"""A log that is larger than memory is reported all the same."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.system.attacks.long_log import KINDS, report, write_log

pytestmark = [pytest.mark.system, pytest.mark.long]

MOST_MB = 90  # of which Python and what the command imports are 30


@pytest.mark.parametrize("kind", KINDS)
def test_a_report_holds_no_log(tmp_path: Path, kind: str) -> None:
    log = tmp_path / "long.jsonl"
    write_log(log, kind, 20_000_000)
    memory_mb, _ = report(log, "-o", str(tmp_path / "page.html"), "--csv", str(tmp_path / "calls.csv"))
    assert memory_mb < MOST_MB
