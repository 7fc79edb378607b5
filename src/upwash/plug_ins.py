"""What plug-ins are written with: docs/plug-ins.md.

Public are the names in `__all__`, as those of `upwash`.
"""

from __future__ import annotations

from upwash.cli.arguments import fills, option, reads, repeated, writes
from upwash.core.admission.limits import Limits
from upwash.core.camera.lens import Lens
from upwash.ports import (
    Camera,
    Engine,
    Export,
    Handed,
    InstanceSpec,
    LoggedRun,
    OtherClock,
    Photo,
    Program,
    ServiceProcess,
)
from upwash.support.heat import Surroundings

__all__ = [
    "Camera",
    "Engine",
    "Export",
    "Handed",
    "InstanceSpec",
    "Lens",
    "Limits",
    "LoggedRun",
    "OtherClock",
    "Photo",
    "Program",
    "ServiceProcess",
    "Surroundings",
    "fills",
    "option",
    "reads",
    "repeated",
    "writes",
]
