"""A real flight past a daemon that lies: it costs waits, never the flight."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.system.attacks.lying_daemon import LIES, flown_past

pytestmark = [pytest.mark.system, pytest.mark.long]

MOST_BYTES = 120_000_000
MOST_ASKED = 40  # a renewal every two thirds of a second at most, and a dozen calls


AT_NIGHT = (  # tests/drone tells the drone each of these, and fifty more, on virtual time
    "an endpoint ipv4:",
    "a started endpoint of 10 MB",
    "a lease of 1e-9 s",
    "an endpoint unix-abstract:",
    "control characters in a refusal",
)


@pytest.mark.flight
@pytest.mark.parametrize(
    "name",
    [
        "150,000 endpoints",  # of which virtual time shows no memory
        *(pytest.param(name, marks=pytest.mark.nightly) for name in AT_NIGHT),
    ],
)
def test_a_lie_costs_waits_and_never_the_flight(name: str, tmp_path: Path) -> None:
    outcome = flown_past(LIES[name], tmp_path)
    assert outcome.is_well, outcome
    assert outcome.memory_bytes < MOST_BYTES
    assert outcome.asked <= MOST_ASKED
