"""What MAVLink calls its numbers."""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega as mavlink


def name_of(enum: str, number: int | None) -> str:
    """MAVLink's name for the number in that enumeration."""
    entry = mavlink.enums[enum].get(number)
    return entry.name if entry else f"number {number}"
