"""How fast the vehicle gets on, as far as a file says."""

from __future__ import annotations

from msgspec import structs

from upwash.config.drone import VehicleConfig
from upwash.core.planning.legs import PACES, Pace

_USUAL_M_S2, _USUAL_TAKEOFF_S = 1.0, 10.0  # of a simulated vehicle of which nothing is said


def told_pace(vehicle: VehicleConfig) -> Pace | None:
    """That of the profile or of the numbers; None where the file has neither."""
    if vehicle.profile is not None:
        return PACES[vehicle.profile]
    if vehicle.acceleration_m_s2 is None and vehicle.takeoff_s is None:
        return None
    return pace_in_numbers(vehicle)


def told_in_numbers(vehicle: VehicleConfig) -> VehicleConfig:
    """The same vehicle, whose file says what a simulation assumes: for a flight with a stand-in that flies so."""
    if vehicle.profile is not None:
        return vehicle
    pace = pace_in_numbers(vehicle)
    return structs.replace(vehicle, acceleration_m_s2=pace.acceleration_m_s2, takeoff_s=pace.lifting_s)


def pace_in_numbers(vehicle: VehicleConfig) -> Pace:
    """That of a simulated vehicle without a profile."""
    takeoff_s = _USUAL_TAKEOFF_S if vehicle.takeoff_s is None else vehicle.takeoff_s
    return Pace(vehicle.acceleration_m_s2 or _USUAL_M_S2, lifting_s=takeoff_s)
