"""Programs of the repository that are no part of the package, run as their user runs them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]


def printed(module: str, *arguments: str | Path) -> str:
    """What `python -m MODULE ARGUMENTS` prints in the repository; it must end with 0."""
    command = [sys.executable, "-m", module, *map(str, arguments)]
    wide = os.environ | {"COLUMNS": "200"}  # no table's cell is folded
    done = subprocess.run(command, cwd=ROOT, env=wide, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout
