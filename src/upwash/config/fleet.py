"""Several drones of one simulated world: a configuration for each, and when it is there."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping

import msgspec
from msgspec import Struct

from upwash.config.drone import DroneConfig, FleetDroneConfig, MissionConfig, PolicyConfig, ServiceConfig
from upwash.config.places import as_planned
from upwash.core.planning.order import SWEEPS

_SEED_BYTES = 6  # of a seed that is derived: it fits every integer


class Presence(Struct, frozen=True):
    """From when on a drone is there, and when its computer is gone without a word; seconds of the simulation."""

    departs_s: float = 0.0
    vanishes_s: float | None = None


def fleet_of(config: DroneConfig) -> tuple[DroneConfig, ...]:
    """A configuration of its own for each drone of the file: that one alone where it has no `[[drone]]`.

    The first one has the file's seed, and each other one a seed that follows from it and from the drone's name.
    """
    if not config.drones:
        return (config,)
    return tuple(_one(config, drone, number) for number, drone in enumerate(config.drones))


def presences(config: DroneConfig) -> tuple[Presence, ...]:
    """When each drone of `fleet_of` is there."""
    return tuple(Presence(drone.departs_s, drone.vanishes_s) for drone in config.drones) or (Presence(),)


def _one(config: DroneConfig, drone: FleetDroneConfig, number: int) -> DroneConfig:
    return msgspec.structs.replace(
        config,
        name=drone.name,
        seed=config.seed if number == 0 else _seed(config.seed, drone.name),
        mission=_mission(_ordered(config.mission, number), drone),
        policy=_policy(config.policy, drone),
        services=tuple(_service(service, drone.local_call_s) for service in config.services),
        drones=(),
    )


def _seed(seed: int, name: str) -> int:
    """Differs from drone to drone, and does not hang on how many others there are."""
    digest = hashlib.sha256(f"{seed}/{name}".encode()).digest()
    return int.from_bytes(digest[:_SEED_BYTES])


def _ordered(mission: MissionConfig, number: int) -> MissionConfig:
    """With the drone's own sweep where the file has them by index."""
    return msgspec.structs.replace(mission, order=number % SWEEPS) if mission.order == "by-index" else mission


def _mission(mission: MissionConfig, drone: FleetDroneConfig) -> MissionConfig:
    """The file's, over the drone's own waypoints where it has any; its own plan says how high and how fast."""
    if drone.grid is None and drone.waypoints_m is None and drone.plan is None:
        return mission
    mission = msgspec.structs.replace(
        mission, grid=drone.grid, waypoints_m=drone.waypoints_m, plan=drone.plan
    )
    return mission if drone.plan is None else as_planned(mission, drone.plan, named=("home",))


def _policy(policy: PolicyConfig, drone: FleetDroneConfig) -> PolicyConfig:
    return policy if drone.policy is None else msgspec.structs.replace(policy, name=drone.policy)


def _service(service: ServiceConfig, local_call_s: Mapping[str, Mapping[str, float]]) -> ServiceConfig:
    own_s = local_call_s.get(service.name)
    if not own_s:
        return service
    return msgspec.structs.replace(service, local_call_s={**service.local_call_s, **own_s})
