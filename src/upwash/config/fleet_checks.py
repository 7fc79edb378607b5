"""What cannot be of several drones in one file, and of such a file where one drone is wanted."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from upwash.config.checks import times_problems, way_problems
from upwash.config.drone import DroneConfig, FleetDroneConfig
from upwash.config.problems import Problem
from upwash.config.values import repeated
from upwash.core.operation import ON_DRONE
from upwash.errors import ConfigError

_MOST_DRONES = 1000  # that one simulation has been tried with


def fleet_problems(config: DroneConfig) -> Iterator[Problem]:
    """Everything about the drones of the file that cannot be."""
    if len(config.drones) > _MOST_DRONES:
        yield (
            "drone",
            f"{len(config.drones)} drones: one simulation has at most {_MOST_DRONES}, divide them among files",
        )
    for index, name in repeated([drone.name for drone in config.drones]):
        yield f"drone[{index}].name", f'a second drone named "{name}": give each its own name'
    for index, drone in enumerate(config.drones):
        for key, problem in _drone_problems(drone, config):
            yield f"drone[{index}]{key}", problem


def refuse_several(config: DroneConfig, file: Path, *, what: str) -> None:
    """Raises ConfigError where the file has several drones, and `what` is of one."""
    if config.drones:
        raise ConfigError(
            str(file),
            "drone",
            f"{what} is of one drone, and this file has [[drone]] tables, which are for simulations: give each drone "
            "a file of its own, with its name at the top and its waypoints in [mission]",
        )


def _drone_problems(drone: FleetDroneConfig, config: DroneConfig) -> Iterator[Problem]:
    if drone.name == ON_DRONE:
        yield ".name", f'"{ON_DRONE}" stands for the drone itself in results: rename the drone'
    if drone.name in [server.name for server in config.servers]:
        yield ".name", f'"{drone.name}" is a server too: rename one of them'
    if drone.vanishes_s is not None and drone.vanishes_s <= drone.departs_s:
        yield (
            ".vanishes_s",
            f"{drone.vanishes_s:g} is not after departs_s = {drone.departs_s:g}: let it vanish later",
        )
    yield from _way_problems(drone, config)
    for key, problem in times_problems("local_call_s", drone.local_call_s, config.services):
        yield f".{key}", problem


def _way_problems(drone: FleetDroneConfig, config: DroneConfig) -> Iterator[Problem]:
    mission = config.mission
    if drone.grid is None and drone.waypoints_m is None and drone.plan is None:
        if mission.grid is None and mission.waypoints_m is None and mission.plan is None:
            yield "", "nowhere to fly: give it a grid, waypoints_m or a plan, or [mission] one for all drones"
        else:
            yield from way_problems("", mission)
        return
    yield from way_problems("", drone)
    if drone.plan is not None and mission.home is None:
        yield ".plan", "its places count from mission.home, which all drones share: add it"
