"""How fast the vehicle gets on, and how long a mission may take, as far as a configuration says."""

from __future__ import annotations

from msgspec import structs

from upwash.config.drone import DroneConfig, VehicleConfig
from upwash.core.planning.legs import PACES, Pace

_USUAL_M_S2, _USUAL_TAKEOFF_S = 1.0, 10.0  # of a simulated vehicle without numbers
_STEPS_PERCENT = 2.0  # of the reported battery level: the reserve's watch adds one step, and one is left


def told_pace(vehicle: VehicleConfig) -> Pace | None:
    """The pace of the profile or of the numbers; None where the file has neither."""
    if vehicle.profile is not None:
        return PACES[vehicle.profile]
    if vehicle.acceleration_m_s2 is None and vehicle.takeoff_s is None:
        return None
    return pace_in_numbers(vehicle)


def told_in_numbers(vehicle: VehicleConfig) -> VehicleConfig:
    """The vehicle with the numbers that a simulation assumes, for a flight with a stand-in."""
    if vehicle.profile is not None:
        return vehicle
    pace = pace_in_numbers(vehicle)
    return structs.replace(vehicle, acceleration_m_s2=pace.acceleration_m_s2, takeoff_s=pace.lifting_s)


def pace_in_numbers(vehicle: VehicleConfig) -> Pace:
    """The pace of a simulated vehicle without a profile."""
    takeoff_s = _USUAL_TAKEOFF_S if vehicle.takeoff_s is None else vehicle.takeoff_s
    return Pace(vehicle.acceleration_m_s2 or _USUAL_M_S2, lifting_s=takeoff_s)


def reserve_percent(config: DroneConfig) -> float | None:
    """The least battery level at touchdown, in percent; None without a reserve, or if its level is unknown."""
    mission, endurance_s = config.mission, config.vehicle.endurance_s
    reserves = [mission.reserve_percent]
    if mission.reserve_s is not None and endurance_s is not None:
        reserves.append(100 * mission.reserve_s / endurance_s)
    return max((percent for percent in reserves if percent is not None), default=None)


def usable_s(config: DroneConfig) -> float | None:
    """How long the battery lasts above the mission's reserve, in seconds; None if not configured."""
    if config.vehicle.endurance_s is None:
        return None
    return config.vehicle.endurance_s * (1 - (reserve_percent(config) or 0.0) / 100)


def finish_by_s(config: DroneConfig) -> float | None:
    """When the mission must be over, in seconds from arming: as configured, or before the reserve ends it.

    None where no call may run lighter, or the battery's endurance is unknown.
    """
    mission = config.mission
    if mission.finish_by_s is not None or not mission.lighter:
        return mission.finish_by_s
    lasts_s, endurance_s = usable_s(config), config.vehicle.endurance_s
    if lasts_s is None or endurance_s is None or reserve_percent(config) is None:
        return None
    return lasts_s - _STEPS_PERCENT / 100 * endurance_s
