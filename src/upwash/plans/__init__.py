"""Plans made with a ground station, as values: QGroundControl's `.plan` and `QGC WPL 110` text."""

from __future__ import annotations

from upwash.plans.plan import Ending, Plan, PlannedCircle, PlannedPolygon, PlannedWaypoint
from upwash.plans.reading import read_plan

__all__ = ["Ending", "Plan", "PlannedCircle", "PlannedPolygon", "PlannedWaypoint", "read_plan"]
