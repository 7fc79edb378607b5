"""Runs a drone's heavy computations on the drone or on an edge server, without the mission knowing.

Public are the names in `__all__` here and in `upwash.services`, which docs/api.md describes. All else may change.
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
    UpwashError,
    UsageError,
)
from upwash.rpc.service import once, service

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
    "FleetBound",
    "FleetSimulation",
    "GpsFix",
    "InstanceError",
    "MissionFailed",
    "MissionStopped",
    "ModelError",
    "OutcomeUnknown",
    "Payload",
    "Pending",
    "Photographer",
    "Position",
    "RunResult",
    "ServiceError",
    "Simulation",
    "Telemetry",
    "Totals",
    "UpwashError",
    "UsageError",
    "User",
    "Vehicle",
    "Velocity",
    "Waypoint",
    "compare",
    "once",
    "read_log",
    "read_result",
    "service",
    "simulate",
    "simulate_fleet",
]

if TYPE_CHECKING:
    from upwash.core.geo import EarthPosition, Position, Velocity, Waypoint
    from upwash.core.planning.bound import Bound, FleetBound
    from upwash.core.vehicle.telemetry import Attitude, GpsFix, Telemetry
    from upwash.drone.api import Drone, User, Vehicle
    from upwash.drone.payload import Payload, Photographer
    from upwash.drone.pending import Demand, Pending
    from upwash.eventlog.log import read as read_log
    from upwash.eventlog.results import CallResult, EnergyTotals, RunResult, Totals, read_result
    from upwash.eventlog.schema import Event
    from upwash.lab.campaigns.comparison import ComparedPolicy, compare
    from upwash.lab.simulation import FleetSimulation, Simulation, simulate, simulate_fleet
else:
    _MODULES = {
        "Attitude": "upwash.core.vehicle.telemetry",
        "Bound": "upwash.core.planning.bound",
        "CallResult": "upwash.eventlog.results",
        "ComparedPolicy": "upwash.lab.campaigns.comparison",
        "Demand": "upwash.drone.pending",
        "Drone": "upwash.drone.api",
        "EnergyTotals": "upwash.eventlog.results",
        "EarthPosition": "upwash.core.geo",
        "Event": "upwash.eventlog.schema",
        "FleetBound": "upwash.core.planning.bound",
        "FleetSimulation": "upwash.lab.simulation",
        "GpsFix": "upwash.core.vehicle.telemetry",
        "Payload": "upwash.drone.payload",
        "Pending": "upwash.drone.pending",
        "Photographer": "upwash.drone.payload",
        "Position": "upwash.core.geo",
        "RunResult": "upwash.eventlog.results",
        "Simulation": "upwash.lab.simulation",
        "Telemetry": "upwash.core.vehicle.telemetry",
        "Totals": "upwash.eventlog.results",
        "User": "upwash.drone.api",
        "Vehicle": "upwash.drone.api",
        "Velocity": "upwash.core.geo",
        "Waypoint": "upwash.core.geo",
        "compare": "upwash.lab.campaigns.comparison",
        "read_log": "upwash.eventlog.log:read",
        "read_result": "upwash.eventlog.results",
        "simulate": "upwash.lab.simulation",
        "simulate_fleet": "upwash.lab.simulation",
    }

    def __getattr__(name: str) -> object:
        """Imports what a service's process never needs when it is first asked for."""
        if name not in _MODULES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        module, _, called = _MODULES[name].partition(":")
        return getattr(import_module(module), called or name)

    def __dir__() -> list[str]:
        """For completion in a notebook."""
        return sorted({*globals(), *__all__})
