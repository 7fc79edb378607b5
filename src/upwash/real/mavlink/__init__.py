"""Vehicles over MAVLink: ArduCopter and PX4."""

from upwash.real.mavlink.autopilot import MavlinkAutopilot
from upwash.real.mavlink.connect import connect_autopilot
from upwash.real.mavlink.link import MavlinkLink
from upwash.real.mavlink.settings import FlightSettings, Patience

__all__ = ["FlightSettings", "MavlinkAutopilot", "MavlinkLink", "Patience", "connect_autopilot"]
