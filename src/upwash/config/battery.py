"""How long a mission may take, by its battery's endurance and its reserve, or by when it is to be over."""

from __future__ import annotations

from upwash.config.drone import DroneConfig

_STEPS_PERCENT = 2.0  # of what a vehicle reports: the watch over the reserve adds one, and one is left


def reserve_percent(config: DroneConfig) -> float | None:
    """What has to be left of the battery at touchdown; None where nothing has to, or nothing tells how much it is."""
    mission, endurance_s = config.mission, config.vehicle.endurance_s
    reserves = [mission.reserve_percent]
    if mission.reserve_s is not None and endurance_s is not None:
        reserves.append(100 * mission.reserve_s / endurance_s)
    return max((each for each in reserves if each is not None), default=None)


def usable_s(config: DroneConfig) -> float | None:
    """How long the battery lasts above the mission's reserve; None where the configuration does not say."""
    if config.vehicle.endurance_s is None:
        return None
    return config.vehicle.endurance_s * (1 - (reserve_percent(config) or 0.0) / 100)


def finish_by_s(config: DroneConfig) -> float | None:
    """By when the mission is to be over, in seconds from arming: as configured, or else before the reserve ends it.

    None where nothing may run lighter, or nothing says how long the battery lasts.
    """
    mission = config.mission
    if mission.finish_by_s is not None or not mission.lighter:
        return mission.finish_by_s
    lasts_s, endurance_s = usable_s(config), config.vehicle.endurance_s
    if lasts_s is None or endurance_s is None or reserve_percent(config) is None:
        return None
    return lasts_s - _STEPS_PERCENT / 100 * endurance_s
