"""The dead man of a vehicle on paper."""

from __future__ import annotations

from upwash.ports import DeadManAction


class ModelDeadMan:
    """Always ready, and never needed: a simulated program does not die without a word."""

    async def missing(self) -> str:
        """Nothing."""
        return ""

    async def install(self) -> str:
        """It is there."""
        return ""

    async def watch(self, *, silence_s: float, action: DeadManAction) -> None:
        """At once."""

    async def release(self) -> None:
        """At once."""
