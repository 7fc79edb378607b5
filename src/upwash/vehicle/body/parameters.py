"""Parameters of a stand-in: their values, and as messages hold them."""

from __future__ import annotations

from dataclasses import dataclass

from upwash.errors import UsageError


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter as it is told: its place in the list, its value and its MAV_PARAM_TYPE."""

    name: str
    index: int
    value: float
    type: int


def read_setting(text: str) -> tuple[str, float]:
    """The parameter and the value that are written as `NAME=VALUE`; UsageError if they are not."""
    name, _, value = text.partition("=")
    try:
        return name, float(value)
    except ValueError:
        raise UsageError(
            f'"{text}" sets no parameter; write its name and value, such as FENCE_RADIUS=60'
        ) from None
