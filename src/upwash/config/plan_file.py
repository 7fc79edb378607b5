"""The plan of a ground station that a configuration names."""

from __future__ import annotations

from pathlib import Path

from upwash.config.values import NamedFile
from upwash.plans import FlightPlan, read_plan


class PlanFile(NamedFile):
    """A plan and the file that it was read from."""

    def __init__(self, file: Path, plan: FlightPlan | None = None) -> None:
        super().__init__(file)
        self.plan: FlightPlan = plan or read_plan(file)
