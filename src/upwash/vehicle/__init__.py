"""A MAVLink-speaking stand-in multicopter, for machines without an autopilot."""

from upwash.vehicle.copter import VehicleSettings
from upwash.vehicle.faults import Fault, FaultKind, read_fault
from upwash.vehicle.server import VehicleServer, serve_vehicle

__all__ = ["Fault", "FaultKind", "VehicleServer", "VehicleSettings", "read_fault", "serve_vehicle"]
