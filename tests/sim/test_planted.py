"""The promises' checks bite: each planted defect is found, in the world where it was found first."""

from __future__ import annotations

import pytest
from tests.sim.planted import DEFECTS, MOST_SEEDS, Defect, first_broken

from upwash.lab.chaos import judge


@pytest.mark.parametrize("defect", DEFECTS, ids=lambda defect: defect.plant.__name__)
def test_a_planted_defect_breaks_a_promise(defect: Defect) -> None:
    seed = defect.found_by_seed
    assert seed <= MOST_SEEDS
    assert first_broken(defect, range(seed, seed + 1)), f"{defect.what}: find its seed with tests.sim.planted"


@pytest.mark.parametrize("seed", sorted({defect.found_by_seed for defect in DEFECTS}))
def test_without_the_defect_no_promise_is_broken(seed: int) -> None:
    assert judge(seed, replay=True).broken == []
