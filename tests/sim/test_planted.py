"""The promises' checks bite: each planted defect is found."""

from __future__ import annotations

import pytest
from tests.sim.planted import MOST_SEEDS, first_broken
from tests.sim.planting import DEFECTS, Defect

pytestmark = pytest.mark.long


@pytest.mark.parametrize("defect", DEFECTS, ids=lambda defect: defect.what)
def test_a_planted_defect_breaks_a_promise(defect: Defect) -> None:
    assert first_broken(defect), f"{defect.what}: not found in {MOST_SEEDS} worlds"
