"""The system's own programs that an emulation is made with."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Mapping

from upwash.errors import UpwashError, UsageError


def require_tools(packages: Mapping[str, str]) -> None:
    """UsageError where one of the programs is missing, with the Debian packages that have those that are."""
    missing = [program for program in packages if shutil.which(program) is None]
    if missing:
        named = ", ".join(dict.fromkeys(packages[program] for program in missing))
        raise UsageError(f"{', '.join(missing)} not found: install Debian's {named}")


def command(*words: str) -> str:
    """Runs a command and returns what it prints; UpwashError with what it said where it failed."""
    done = subprocess.run(  # noqa: S603
        words, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        raise UpwashError(f"{' '.join(words)}: {done.stderr.strip() or f'ended with {done.returncode}'}")
    return done.stdout
