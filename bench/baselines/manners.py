"""The ways to fly one mission: waiting, going on before answers, or on the move; alone, or with servers."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Literal, NamedTuple

from bench.baselines.clients import replicated, stoppable
from bench.gains.kept import Missions
from msgspec.structs import replace

from upwash.config.drone import DroneConfig, PhotosConfig
from upwash.config.world import EventConfig
from upwash.errors import UpwashError
from upwash.lab.bounds import bound_of
from upwash.lab.run import Run, simulate
from upwash.lab.scenario import with_policy

Manner = Literal["waits", "goes", "learns", "moves", "moves, learns"]
MANNERS: Mapping[Manner, Literal["stay", "go", "learn"]] = {
    "waits": "stay",
    "goes": "go",
    "learns": "learn",
    "moves": "stay",
    "moves, learns": "learn",
}
ALONE, SERVED, LEAST = "alone", "served", "minimum"
RACING = "bench.baselines.clients:Racing"
CLIENTS = {
    "opportunistic": "opportunistic",
    "thesis": "location-aware",
    "races": RACING,
    "races, stops": RACING,
}
REPLICATED, COPIES = "replicates", "copies"


class Part(NamedTuple):
    """What one process flies in one go: a world with one seed, in these ways."""

    group: str
    world: str
    config: DroneConfig
    manners: Sequence[Manner] = ()
    clients: bool = False


def stopping(config: DroneConfig) -> DroneConfig:
    """The world of one drone that stops and waits at each waypoint, and is not ended by a battery."""
    mission = replace(config.mission, photos=None, reserve_percent=None, reserve_s=None)
    energy = config.energy and replace(config.energy, battery_wh=None)
    policy = replace(config.policy, stay_or_go="stay", demand_map=None)
    vehicle = replace(config.vehicle, endurance_s=None)
    return replace(config, mission=mission, energy=energy, policy=policy, vehicle=vehicle, drones=())


def demanding(config: DroneConfig, share: float, *, action_s: float = 5.0) -> DroneConfig:
    """The world, where that share of the answers demands an action."""
    event = EventConfig(probability=share) if share else None
    return replace(config, event=event, mission=replace(config.mission, action_s=action_s))


def flown(config: DroneConfig, manner: Manner) -> DroneConfig | None:
    """The same world, flown in that manner; None where a plan has no rows to move along.

    On the move the drone is no faster than its camera takes photos.
    """
    policy = replace(config.policy, stay_or_go=MANNERS[manner])
    if not manner.startswith("moves"):
        return replace(config, policy=policy)
    grid, mission = config.mission.grid, config.mission
    if grid is None:
        return None
    fastest_m_s = (
        0.999 * grid.spacing_m / config.camera.photo_s if config.camera.photo_s else mission.ground_speed_m_s
    )
    mission = replace(
        mission,
        photos=PhotosConfig(every_m=grid.spacing_m),
        ground_speed_m_s=min(mission.ground_speed_m_s, fastest_m_s),
    )
    return replace(config, policy=policy, mission=mission)


def fly(part: Part) -> Missions:
    """Flies them. A variant is "alone, waits" or a client's name; "minimum, goes" is the bound of that manner."""
    times_s: dict[str, float] = {}
    for manner in part.manners:
        config = flown(part.config, manner)
        if config is None:
            continue
        times_s[f"{ALONE}, {manner}"] = _completed(
            part, with_policy(config, "local-only")
        ).result.mission_time_s
        served = with_policy(config, "look-ahead")
        run = _completed(part, served)
        times_s[f"{SERVED}, {manner}"] = run.result.mission_time_s
        if (bound := bound_of(run, served)) is not None:
            times_s[f"{LEAST}, {manner}"] = bound.free_s
    if part.clients:
        times_s |= dict(_clients(part))
    least_s = min((time_s for name, time_s in times_s.items() if name.startswith(LEAST)), default=math.nan)
    return Missions(part.group, part.world, part.config.seed, least_s, times_s)


def _clients(part: Part) -> Iterator[tuple[str, float]]:
    """The other clients' missions, all waiting at each waypoint."""
    served = with_policy(part.config, "look-ahead")
    run = _completed(part, served)
    yield f"{SERVED}, waits", run.result.mission_time_s
    for name, policy in CLIENTS.items():
        with stoppable(name == "races, stops"):
            yield name, _completed(part, with_policy(part.config, policy)).result.mission_time_s
    yield REPLICATED, (found := replicated(run, served)).mission_s
    yield COPIES, found.copies


def _completed(part: Part, config: DroneConfig) -> Run:
    run = simulate(config)
    if not run.result.completed or run.failure or run.result.offloading_failed:
        raise UpwashError(
            f"{part.world}, {config.policy.label}, seed {config.seed}: {run.failure or run.result.offloading_failed}"
        )
    return run
