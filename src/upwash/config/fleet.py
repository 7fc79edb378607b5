"""Several drones of one simulated world: a configuration for each, and when it is there."""

from __future__ import annotations

import hashlib

from msgspec import Struct
from msgspec.structs import replace

from upwash.config.drone import DroneConfig, FleetDroneConfig, MissionConfig
from upwash.config.places import as_planned
from upwash.core.planning.order import SWEEPS

_SEED_BYTES = 6  # of a seed that is derived: it fits every integer


class Presence(Struct, frozen=True):
    """When a drone appears, and when its computer vanishes without a word; seconds of the simulation."""

    departs_s: float = 0.0
    vanishes_s: float | None = None


def fleet_of(config: DroneConfig) -> tuple[DroneConfig, ...]:
    """A configuration for each `[[drone]]` of the file; without any, the file's own alone.

    The first drone has the file's seed. Each other drone has a seed derived from it and from the drone's name.
    """
    if not config.drones:
        return (config,)
    return tuple(_one(config, drone, number) for number, drone in enumerate(config.drones))


def presences(config: DroneConfig) -> tuple[Presence, ...]:
    """When each drone of `fleet_of` is there."""
    return tuple(Presence(drone.departs_s, drone.vanishes_s) for drone in config.drones) or (Presence(),)


def _one(config: DroneConfig, drone: FleetDroneConfig, number: int) -> DroneConfig:
    digest = hashlib.sha256(
        f"{config.seed}/{drone.name}".encode()
    ).digest()  # independent of the other drones
    return replace(
        config,
        name=drone.name,
        seed=config.seed if number == 0 else int.from_bytes(digest[:_SEED_BYTES]),
        mission=_mission(config.mission, drone, number),
        policy=replace(config.policy, name=drone.policy or config.policy.name),
        services=tuple(
            replace(
                service, local_call_s={**service.local_call_s, **drone.local_call_s.get(service.name, {})}
            )
            for service in config.services
        ),
        drones=(),
    )


def _mission(mission: MissionConfig, drone: FleetDroneConfig, number: int) -> MissionConfig:
    """The file's mission with the drone's waypoints and sweep; its own plan says how high and how fast."""
    if mission.order == "by-index":
        mission = replace(mission, order=number % SWEEPS)
    if drone.grid is None and drone.waypoints_m is None and drone.plan is None:
        return mission
    mission = replace(mission, grid=drone.grid, waypoints_m=drone.waypoints_m, plan=drone.plan)
    return mission if drone.plan is None else as_planned(mission, drone.plan, named=("home",))
