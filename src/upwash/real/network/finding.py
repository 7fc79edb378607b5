"""What somebody found who looked whether a flight can begin."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that a flight needs, what it is now, and what keeps it from being used, with the remedy."""

    subject: str
    found: str
    trouble: str = ""
