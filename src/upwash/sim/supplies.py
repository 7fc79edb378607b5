"""What a simulated drone's computer has left: enough, except in faults of its world."""

from __future__ import annotations

from collections.abc import Mapping

from upwash.core.knowledge.supplies import Supplies
from upwash.sim.faults import COMPUTER, Faults

_SCARCE: Mapping[str, Supplies] = {
    "files": Supplies(files=0),
    "threads": Supplies(threads=0),
    "memory": Supplies(memory=1e6),
    "disk": Supplies(disk=1e6),
}


class ModelComputer:
    """A Computer of a world with these faults."""

    def __init__(self, faults: Faults) -> None:
        self._faults = faults

    def left(self) -> Supplies:
        """What the present fault leaves."""
        fault = self._faults.now(COMPUTER)
        return Supplies() if fault is None else _SCARCE[fault.kind]

    async def may_have_changed(self) -> None:
        """Return at the next change of a fault."""
        await self._faults.change(COMPUTER)
