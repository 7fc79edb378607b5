"""Read a drone's configuration or a scenario."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import msgspec

from upwash.config.checks import order_problems, plan_problems, problems
from upwash.config.drone import DroneConfig
from upwash.config.fleet import fleet_of
from upwash.config.places import as_planned
from upwash.config.reading import Document, Problem, convert, read_document, refuse_first
from upwash.config.shorthand import written_out
from upwash.errors import ConfigError

_MOST_PAIRS = 20_000  # of a service and a server
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
        mission = as_planned(mission, mission.plan, named=document["mission"])
        config = msgspec.structs.replace(config, mission=mission)
    refuse_first(file, problems(config))
    for drone in fleet_of(config):
        plan = drone.mission.plan
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
            f"{what} is of one drone, and this file has [[drone]] tables, which are for simulations: give each drone "
            "a file of its own, with its name at the top and its waypoints in [mission]",
        )
