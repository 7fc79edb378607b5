"""`make pictures`: the pages in every size, as a browser draws them."""

from __future__ import annotations

import struct
import sys
from pathlib import Path

import pytest
from tests.programs import ROOT, ended
from tests.system.browser import NEEDED

pytestmark = NEEDED


@pytest.mark.parametrize(
    ("name", "size"),
    [
        ("alarm-phone-dark", (390, 844)),
        ("fleet-zoomed-light", (1400, 900)),
        pytest.param("many-report-1400-light", None, marks=pytest.mark.nightly),
        pytest.param("taken-over-1400-light", (1400, 900), marks=pytest.mark.nightly),
    ],
)
def test_a_picture_is_taken_of_each_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, size: tuple[int, int] | None
) -> None:
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    taken = ended([sys.executable, ROOT / "site" / "screenshots.py", tmp_path, "--only", name])
    assert taken.returncode == 0, taken.stdout + taken.stderr
    picture = (tmp_path / f"{name}.png").read_bytes()
    width, height = struct.unpack(">II", picture[16:24])
    if size is None:
        assert width == 1400
        assert height > 900, "a report is shown whole"
    else:
        assert (width, height) == size
    assert len(picture) > 10_000, "there is something on it"
