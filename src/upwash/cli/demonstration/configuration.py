"""The configurations of the demonstration's drones: what the file beside this one says, and what follows from it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.resources import as_file, files
from pathlib import Path

import msgspec

from upwash.config import DroneConfig, MissionConfig, read_drone_config, told_in_numbers, waypoints
from upwash.core.geo import Position
from upwash.real.trust.authority import keys_in

_LANE_M = 5.0
_FIELD_M = (
    10.0  # between the outermost lanes: beyond that the servers cover fewer waypoints of some than of others
)


def read_demonstration(*, policy: str | None = None, stay_or_go: str | None = None) -> DroneConfig:
    """The demonstration's configuration, as it is simulated; a flight fills in what only exists while it runs.

    `policy` and `stay_or_go` are others than the configured ones.
    """
    with as_file(files("upwash.cli.demonstration") / "drone.toml") as file:
        config = read_drone_config(file)
    others = {"name": policy, "stay_or_go": stay_or_go}
    changes = {key: value for key, value in others.items() if value is not None}
    return msgspec.structs.replace(config, policy=msgspec.structs.replace(config.policy, **changes))


def fleet_of(config: DroneConfig, drones: int) -> list[DroneConfig]:
    """So many drones instead of one, each with a name of its own and on a lane of its own.

    The lanes lie one within the other, so that no way crosses another; the first drone flies the outermost one.
    """
    spacing_m = min(_LANE_M, _FIELD_M / max(1, drones - 1))
    wider_m = [spacing_m * (drones - 1 - 2 * number) / 2 for number in range(drones)]
    return [
        msgspec.structs.replace(
            config,
            name=f"{config.name}-{number + 1}",
            mission=_on_lane(config.mission, wider_m=wider, longer_m=wider - wider_m[-1]),
        )
        for number, wider in enumerate(wider_m)
    ]


def _on_lane(mission: MissionConfig, *, wider_m: float, longer_m: float) -> MissionConfig:
    """The mission with its outermost waypoints so much further out, to north and south, and to east and west."""
    places = mission.waypoints_m or ()
    easts_m, norths_m = zip(*places, strict=True)
    return msgspec.structs.replace(
        mission,
        waypoints_m=tuple(
            (_further_out(east_m, easts_m, longer_m), _further_out(north_m, norths_m, wider_m))
            for east_m, north_m in places
        ),
    )


def _further_out(place_m: float, all_m: Sequence[float], by_m: float) -> float:
    """The place further from the middle by so much where it is one of the outermost of them all."""
    if place_m == min(all_m):
        return place_m - by_m
    return place_m + by_m if place_m == max(all_m) else place_m


def start_of(config: DroneConfig) -> Position:
    """Where the drone stands at first: beneath its first waypoint, where no other drone stands."""
    first = waypoints(config.mission)[0].position
    return Position(first.east_m, first.north_m)


def filled_in(config: DroneConfig, folder: Path, *, vehicle: str, servers: Mapping[str, str]) -> DroneConfig:
    """The configuration with what exists while it runs: the vehicle, the servers' addresses and the drone's keys."""
    replace = msgspec.structs.replace
    return replace(
        config,
        autopilot=replace(config.autopilot, connection=vehicle),
        keys=keys_in(folder / "keys", config.name),
        vehicle=told_in_numbers(config.vehicle),
        servers=tuple(replace(server, address=servers[server.name]) for server in config.servers),
    )
