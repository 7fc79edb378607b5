"""The world as a drone believes it before take-off: a scenario, where the twin flies the mission as a forecast.

It has no fault and no noise, and its servers are as believed. As many answers demand an act as is likely, evenly
spread over the plan.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

from msgspec.structs import replace

from upwash.config.drone import DroneConfig
from upwash.config.places import demand_map_of, waypoints
from upwash.config.world import EventAreaConfig, EventConfig, NoiseConfig, TruthConfig

_PHASES = (0.5, 1 / 6, 5 / 6)
_HERE_M = 0.01


def believed_worlds(config: DroneConfig) -> list[DroneConfig]:
    """The configuration without what only a simulation knows, and without what ends a mission early.

    There are several where chance says which answers demand an act.
    """
    world = replace(
        config,
        seed=1,
        mission=replace(config.mission, reserve_percent=None, reserve_s=None),
        vehicle=replace(config.vehicle, endurance_s=None, battery_csv=None, wind_csv=None),
        servers=tuple(replace(server, truth=TruthConfig()) for server in config.servers),
        heat=None,
        energy=None,
        noise=NoiseConfig(),
        faults=(),
        drones=(),
    )
    if config.mission.only_tells:
        return [replace(world, event=None)]
    if not any(chances := demand_chances(config)):
        return [world]
    return [replace(world, event=_spread(config, chances, phase)) for phase in _PHASES]


def demand_chances(config: DroneConfig) -> Sequence[float]:
    """The chance of a demand at each waypoint, by `[event]` or else by earlier flights; empty if neither has any."""
    plan, event = waypoints(config.mission), config.event
    if event is not None:
        drawn = event.probability is not None
        return [event.chance(waypoint.position) for waypoint in plan] if drawn else []
    known = demand_map_of(config, plan)
    if known is None or not any(known.places()):
        return []
    return [known.chance(waypoint.position, known.before) for waypoint in plan]


def _spread(config: DroneConfig, chances: Sequence[float], phase: float) -> EventConfig:
    """Demands at as many waypoints as is likely, evenly spread; the phase says where they begin."""
    sums = list(itertools.accumulate(chances, initial=phase))
    demanding = [
        waypoint.position
        for waypoint, (before, after) in zip(waypoints(config.mission), itertools.pairwise(sums), strict=True)
        if math.floor(after) > math.floor(before)
    ]
    areas = [
        EventAreaConfig(east_m=place.east_m, north_m=place.north_m, radius_m=_HERE_M, probability=1.0)
        for place in demanding
    ]
    return replace(config.event or EventConfig(probability=0.0), probability=0.0, areas=tuple(areas))
