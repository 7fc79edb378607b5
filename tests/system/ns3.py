"""The ns-3 programs, for the tests that need them."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def require_ns3() -> None:
    """Builds the programs; skips the test where ns-3 is not installed."""
    if not Path("/usr/include/ns3/core-module.h").exists() or not shutil.which("g++"):
        pytest.skip("needs g++ and libns3-dev")
    built = subprocess.run(["make", "native"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
