"""Results that are kept: figures with the commit they were measured at, as small files of bench/results."""

from __future__ import annotations

import os
import subprocess
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec

FOLDER = Path(__file__).parent / "results"


class Result(msgspec.Struct, frozen=True, kw_only=True):
    """What one command measured."""

    command: str
    commit: str
    day: str
    load: float  # of the machine when it was over, averaged over a quarter of an hour
    figures: Any


def leave(file: Path, *, command: str, figures: object) -> None:
    """Writes the figures down with the commit that is checked out."""
    commit = _git("rev-parse", "--short", "HEAD")
    if _git("status", "--porcelain", "--", ":/src", ":/tests"):
        commit += " and changes"
    result = Result(
        command=command,
        commit=commit,
        day=datetime.now(UTC).date().isoformat(),
        load=round(os.getloadavg()[2], 1),
        figures=msgspec.to_builtins(figures),
    )
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(msgspec.json.format(msgspec.json.encode(result)) + b"\n")


def _git(*words: str) -> str:
    return subprocess.run(
        ("git", "-C", str(FOLDER.parent), *words), capture_output=True, text=True, check=True
    ).stdout.strip()


def read(name: str) -> Result | None:
    """The kept result of that name, if there is one."""
    file = FOLDER / f"{name}.json"
    return msgspec.json.decode(file.read_bytes(), type=Result) if file.exists() else None
