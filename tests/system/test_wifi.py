"""The flights over a real WiFi stack, where the machine for them is at hand: `python -m tests.system.wifi FOLDER`."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from tests.system.wifi.flights import CASES
from tests.system.wifi.machine import flights, is_built, why_not

MACHINE = "UPWASH_WIFI_MACHINE"
TIMEOUT_S = 3600.0

pytestmark = [pytest.mark.system, pytest.mark.root, pytest.mark.timeout(TIMEOUT_S)]


def test_each_flight_goes_as_expected(tmp_path: Path) -> None:
    folder = Path(os.environ.get(MACHINE, ""))
    if not os.environ.get(MACHINE) or not is_built(folder):
        pytest.skip(f"{MACHINE} names no folder with the machine that `python -m tests.system.wifi` builds")
    if trouble := why_not():
        pytest.skip(trouble)
    found = flights(folder, [], tmp_path, timeout_s=TIMEOUT_S)
    assert {flight.case: flight.wrong for flight in found} == {case.name: "" for case in CASES}
