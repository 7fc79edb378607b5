"""Read a drone's configuration or a scenario, which may be of several drones."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path

from msgspec import Struct
from msgspec.structs import replace

from upwash.config.checks import order_problems, plan_problems, problems
from upwash.config.drone import DroneConfig, FleetDroneConfig, MissionConfig
from upwash.config.places import as_planned
from upwash.config.plan_photos import photo_plan_problems
from upwash.config.problems import Problem
from upwash.config.reading import Document, convert, read_document, refuse_first
from upwash.config.shorthand import written_out
from upwash.core.planning.order import SWEEPS
from upwash.errors import ConfigError

_MOST_PAIRS = 5_000  # of a service and a server
FASTEST_M_S = 10.0  # of chosen speeds, where the file names no limit: of an ArduCopter as delivered
_SEED_BYTES = 6  # of a derived seed: it fits every integer
_OF_A_DAEMON = {"listen", "runtime", "lease_s", "allow_without_certificates"}


def read_drone_config(path: Path) -> DroneConfig:
    """The configuration in the file; raises ConfigError."""
    return drone_config(read_document(path), path)


def drone_config(document: Document, file: Path) -> DroneConfig:
    """The configuration in the document of that file; raises ConfigError."""
    if "mission" not in document and (of_a_daemon := sorted(_OF_A_DAEMON & document.keys())):
        raise ConfigError(
            str(file), of_a_daemon[0], "this is a daemon's configuration: name the drone's file"
        )
    refuse_first(file, _size_problems(document))
    tables = written_out(document, file.absolute().parent)
    config = convert(tables, DroneConfig, file=file, as_written=document)
    mission = config.mission
    if mission.plan is not None:
        photo_s = config.camera.photo_s
        mission = as_planned(mission, mission.plan, named=document["mission"], photo_s=photo_s)
        config = replace(config, mission=mission)
    if mission.speed == "auto" and "ground_speed_m_s" not in document["mission"]:
        config = replace(config, mission=replace(mission, ground_speed_m_s=FASTEST_M_S))
    refuse_first(file, problems(config))
    for drone in fleet_of(config):
        plan = drone.mission.plan
        refuse_first(file, photo_plan_problems(drone))
        if plan is not None:
            refuse_first(plan.file, plan_problems(drone.mission, plan.plan))
        refuse_first(file, order_problems(drone))
    return config


def _size_problems(document: Document) -> Iterator[Problem]:
    """Too many kinds of calls: each service at each server is checked and planned."""
    tables = [document.get(name) for name in ("service", "server")]
    services, servers = (len(found) if isinstance(found, list) else 0 for found in tables)
    if services * servers > _MOST_PAIRS:
        yield (
            "server",
            f"{servers} servers of {services} services are {services * servers:,} pairs: at most {_MOST_PAIRS:,}",
        )


def refuse_several(config: DroneConfig, file: Path, *, what: str) -> None:
    """Raise ConfigError where the file has several drones; `what` needs one."""
    if config.drones:
        raise ConfigError(
            str(file),
            "drone",
            f"{what} is of one drone, and this file has [[drone]] tables, which are for simulations; give each drone "
            "a file of its own, with its name at the top and its waypoints in [mission]",
        )


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
    own = f"{config.seed}/{drone.name}".encode()  # independent of the other drones
    digest = hashlib.sha256(own).digest()
    return replace(
        config,
        name=drone.name,
        seed=config.seed if number == 0 else int.from_bytes(digest[:_SEED_BYTES]),
        mission=_mission(config, drone, number),
        policy=config.policy.under(drone.policy or config.policy.name),
        services=tuple(
            replace(
                service, local_call_s={**service.local_call_s, **drone.local_call_s.get(service.name, {})}
            )
            for service in config.services
        ),
        drones=(),
    )


def _mission(config: DroneConfig, drone: FleetDroneConfig, number: int) -> MissionConfig:
    mission = config.mission
    if mission.order == "by-index":
        mission = replace(mission, order=number % SWEEPS)
    if drone.grid is None and drone.waypoints_m is None and drone.plan is None:
        return mission
    mission = replace(mission, grid=drone.grid, waypoints_m=drone.waypoints_m, plan=drone.plan)
    photo_s = config.camera.photo_s
    return (
        mission if drone.plan is None else as_planned(mission, drone.plan, named=("home",), photo_s=photo_s)
    )
