"""The promises' checks bite: each planted defect is found."""

from __future__ import annotations

import pytest
from tests.sim.planted import MOST_SEEDS, first_broken
from tests.sim.planting import DEFECTS, FOUND_BY_SEED, Defect

pytestmark = pytest.mark.long


@pytest.mark.parametrize("defect", DEFECTS, ids=lambda defect: defect.what)
def test_a_planted_defect_breaks_a_promise(defect: Defect) -> None:
    since = FOUND_BY_SEED.get(defect.what, 1)
    assert first_broken(defect, since=since), f"{defect.what}: not found from seed {since} to {MOST_SEEDS}"


def test_each_seed_is_of_a_defect() -> None:
    assert {defect.what for defect in DEFECTS} > FOUND_BY_SEED.keys()
