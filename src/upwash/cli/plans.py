"""The notices of a mission's plans, before the mission is flown or simulated."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from upwash.config import DroneConfig


def tell_of_plans(config: DroneConfig) -> None:
    """Prints to standard error what of the plans is flown otherwise than they say, or not at all."""
    from upwash.config import plan_notices

    for notice in plan_notices(config):
        sys.stderr.write(f"upwash: notice: {notice}\n")
