"""Runs a drone's heavy computations on the drone or on an edge server, without the mission knowing.

Public are the names in `__all__` here, in `upwash.services`, `upwash.policies`, `upwash.plug_ins` and
`upwash.environment`, which docs/api.md has. All else may change.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from upwash.errors import (
    AutopilotError,
    AutopilotLost,
    AutopilotOverruled,
    AutopilotRefused,
    AutopilotTimeout,
    CameraError,
    ConfigError,
    DeclarationError,
    InstanceError,
    MissionFailed,
    MissionStopped,
    ModelError,
    OutcomeUnknown,
    ServiceError,
    Unanswered,
    UpwashError,
    UsageError,
)

__all__ = [
    "Attitude",
    "AutopilotError",
    "AutopilotLost",
    "AutopilotOverruled",
    "AutopilotRefused",
    "AutopilotTimeout",
    "Bound",
    "CallResult",
    "CameraError",
    "ComparedPolicy",
    "ConfigError",
    "DeclarationError",
    "Demand",
    "Drone",
    "EarthPosition",
    "EnergyTotals",
    "Event",
    "Events",
    "FleetBound",
    "FleetSimulation",
    "FoundObject",
    "GeoPosition",
    "GpsFix",
    "InstanceError",
    "MissionFailed",
    "MissionStopped",
    "ModelError",
    "OutcomeUnknown",
    "Payload",
    "Pending",
    "PhotoPose",
    "Photographer",
    "Place",
    "Position",
    "RunResult",
    "SecondLook",
    "ServiceError",
    "Simulation",
    "Telemetry",
    "Totals",
    "Unanswered",
    "Unplaced",
    "UpwashError",
    "UsageError",
    "User",
    "Vehicle",
    "Velocity",
    "Via",
    "Waypoint",
    "compare",
    "draw_world",
    "once",
    "read_log",
    "read_result",
    "service",
    "simulate",
    "simulate_fleet",
]

if TYPE_CHECKING:
    from upwash.config.drone import SecondLook
    from upwash.core.camera.georeference import Place, Unplaced
    from upwash.core.geo import EarthPosition, GeoPosition, Position, Velocity, Via, Waypoint
    from upwash.core.vehicle.telemetry import Attitude, GpsFix, Telemetry
    from upwash.drone.api import Drone, User
    from upwash.drone.objects import FoundObject
    from upwash.drone.payload import Payload
    from upwash.drone.pending import Demand, Pending
    from upwash.drone.photographer import Photographer, PhotoPose
    from upwash.drone.vehicle import Vehicle
    from upwash.eventlog.log import Events
    from upwash.eventlog.log import read as read_log
    from upwash.eventlog.results import CallResult, EnergyTotals, RunResult, Totals, read_result
    from upwash.eventlog.schema import Event
    from upwash.lab.campaigns.comparison import ComparedPolicy, compare
    from upwash.lab.least_time import Bound, FleetBound
    from upwash.lab.simulation import FleetSimulation, Simulation, simulate, simulate_fleet
    from upwash.lab.worlds import draw_world
    from upwash.rpc.service import once, service
else:
    _NAMES = {
        "upwash.config.drone": ("SecondLook",),
        "upwash.core.geo": ("EarthPosition", "GeoPosition", "Position", "Velocity", "Via", "Waypoint"),
        "upwash.lab.least_time": ("Bound", "FleetBound"),
        "upwash.core.vehicle.telemetry": ("Attitude", "GpsFix", "Telemetry"),
        "upwash.drone.api": ("Drone", "User"),
        "upwash.drone.vehicle": ("Vehicle",),
        "upwash.drone.objects": ("FoundObject",),
        "upwash.drone.payload": ("Payload",),
        "upwash.drone.photographer": ("Photographer", "PhotoPose"),
        "upwash.core.camera.georeference": ("Place", "Unplaced"),
        "upwash.drone.pending": ("Demand", "Pending"),
        "upwash.eventlog.log": ("Events", "read_log"),
        "upwash.eventlog.results": ("CallResult", "EnergyTotals", "RunResult", "Totals", "read_result"),
        "upwash.eventlog.schema": ("Event",),
        "upwash.lab.campaigns.comparison": ("ComparedPolicy", "compare"),
        "upwash.lab.worlds": ("draw_world",),
        "upwash.lab.simulation": ("FleetSimulation", "Simulation", "simulate", "simulate_fleet"),
        "upwash.rpc.service": ("once", "service"),
    }

    def __getattr__(name: str) -> object:
        """Import a name on its first use: no process needs them all."""
        for module, names in _NAMES.items():
            if name in names:
                return getattr(import_module(module), "read" if name == "read_log" else name)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

    def __dir__() -> list[str]:
        """For completion in a notebook."""
        return sorted({*globals(), *__all__})
