"""Runs a drone's heavy computations on the drone or on an edge server, without the mission knowing."""

from __future__ import annotations

from typing import TYPE_CHECKING

from upwash.service import once, service

if TYPE_CHECKING:
    from upwash.drone import Drone

__all__ = ["Drone", "once", "service"]


def __getattr__(name: str) -> object:
    """`Drone` is imported when it is first asked for: a service's process never needs it."""
    if name == "Drone":
        from upwash.drone import Drone

        return Drone
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
