"""Defects of second servers, which calls with a deadline get."""

from __future__ import annotations

from typing import Any

from tests.sim.planting import planted

from upwash.core.knowledge.servers import Server
from upwash.core.selection.call_placement import CallPlacement


@planted("a second server gets a call before it is ready", CallPlacement, "second")
def not_ready(
    _: Any, self: CallPlacement, operation: object, beside: str, *__: Any, **___: Any
) -> Server | None:
    return next((server for server in self._radios.selected if server.name != beside), None)
