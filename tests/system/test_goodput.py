"""Tables of goodput as ns-3 computes them, beside those that come with upwash."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.programs import printed
from tests.system.ns3 import require_ns3

from upwash.sim.radio import read_goodput

pytestmark = [pytest.mark.nightly, pytest.mark.root, pytest.mark.system, pytest.mark.timeout(280)]


@pytest.mark.parametrize(("radio", "ends_at_m"), [("disc12", 105), ("disc54", 115)])
def test_the_tables_that_come_with_upwash_can_be_computed_again(
    radio: str, ends_at_m: int, tmp_path: Path
) -> None:
    require_ns3()
    file = tmp_path / "radio.csv"
    printed("upwash", "goodput", radio, "--seeds", "2", "--out", file)
    ours, shipped = read_goodput(str(file)), read_goodput(radio)
    assert ours is not None and shipped is not None
    for distance_m in range(0, 101, 5):
        assert ours.at(distance_m) == pytest.approx(shipped.at(distance_m), rel=0.08), f"at {distance_m} m"
    assert ours.at(ends_at_m) == shipped.at(ends_at_m) == 0
