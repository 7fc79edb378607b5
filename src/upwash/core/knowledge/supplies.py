"""What the program has left of its computer, and which of it is scarce.

A supply is scarce below its least amount, and ample again above twice that.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Literal, NamedTuple, TypeAlias

from msgspec import Struct

Supply: TypeAlias = Literal["files", "threads", "memory", "disk"]
LEAST: Mapping[Supply, float] = {"files": 48, "threads": 24, "memory": 64e6, "disk": 32e6}
FOR_LINKS: tuple[Supply, ...] = ("files", "threads", "memory")  # which a new link needs


class Supplies(Struct, frozen=True):
    """Open files and threads that the program may still have, and the free bytes of memory and of the log's disk."""

    files: float = math.inf
    threads: float = math.inf
    memory: float = math.inf
    disk: float = math.inf


class SupplyChange(NamedTuple):
    """A supply that is scarce from now on, or no more, and what is left of it."""

    supply: Supply
    left: float
    scarce: bool


class Scarcity:
    """Which supplies are scarce, by what was left at each look."""

    def __init__(self) -> None:
        self.scarce: Mapping[Supply, float] = {}  # and what was left

    def look(self, supplies: Supplies) -> Iterator[SupplyChange]:
        """Take in what is left; yields the changes."""
        before = self.scarce
        left: dict[Supply, float] = {supply: getattr(supplies, supply) for supply in LEAST}
        self.scarce = {
            supply: amount
            for supply, amount in left.items()
            if amount < LEAST[supply] * (2 if supply in before else 1)
        }
        for supply, amount in left.items():
            if (supply in before) != (supply in self.scarce):
                yield SupplyChange(supply, amount, supply in self.scarce)
