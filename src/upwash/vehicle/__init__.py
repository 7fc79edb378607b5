"""A MAVLink-speaking stand-in multicopter, for machines without an autopilot."""

from upwash.vehicle.copter import VehicleSettings
from upwash.vehicle.server import VehicleServer, serve_vehicle

__all__ = ["VehicleServer", "VehicleSettings", "serve_vehicle"]
