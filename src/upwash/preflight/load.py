"""Whether the drone's own computer keeps up with its photos: what decides whether servers pay.

Below a load of 1 the drone hides its computation while it flies, and servers save little. Above 1 its photos pile up,
and the computer in place of the way decides how long the mission takes.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence

from msgspec import Struct

from upwash.config.drone import DroneConfig
from upwash.config.places import waypoints
from upwash.config.plan_photos import photo_legs
from upwash.core.geo import Via, Waypoint, distance_m
from upwash.core.knowledge.estimates import Estimates
from upwash.core.operation import Operation
from upwash.core.planning.legs import Leg, Pace
from upwash.drone.preparation import make_estimates, mission_beliefs, two_answers
from upwash.lab.run import simulate
from upwash.lab.speed import with_speed
from upwash.rpc.service import ServiceSpec


class Load(Struct, frozen=True, kw_only=True):
    """The seconds that the drone computes for a photo, and those from one photo to the next if no answer holds it up.

    `ratio` is the first by the second. A drone that `waits` has each answer before it flies on.
    """

    local_s: float
    every_s: float
    ratio: float
    waits: bool


def load_of(config: DroneConfig, specs: Mapping[str, ServiceSpec]) -> Load | None:
    """The load of the mission, at its closest photos if they are taken in flight.

    None without a call that the drone can compute, without two photos, and on a recorded track.
    """
    estimates, plan = make_estimates(config, specs), waypoints(config.mission)
    beliefs = mission_beliefs(config, specs, estimates, plan)
    local_s = _own_answer_s(config, specs, estimates, [call.operation for call in beliefs.stop])
    if not 0 < local_s < math.inf or config.vehicle.track_csv is not None:
        return None
    if config.mission.photos is not None:
        legs = photo_legs(with_speed(config, simulate)[0].mission)
        every_s = min((leg.step_m / leg.ground_speed_m_s for leg in legs), default=0.0)
    else:
        every_s = config.camera.photo_s + _mean_way_s(plan, config.mission.ground_speed_m_s, beliefs.pace)
    if every_s <= 0:
        return None
    waits = config.mission.photos is None and config.policy.stay_or_go == "stay"
    return Load(local_s=local_s, every_s=every_s, ratio=local_s / every_s, waits=waits)


def _own_answer_s(
    config: DroneConfig,
    specs: Mapping[str, ServiceSpec],
    estimates: Estimates,
    operations: Sequence[Operation],
) -> float:
    """How long the drone computes for a photo with those calls (s); infinite if only servers answer them."""
    first = {operation: two.first for operation, two in two_answers(config, specs, estimates).items()}
    alone = [operation for operation in operations if not estimates.needs_server(operation)]
    if operations and not alone:
        return math.inf
    return sum(estimates.local_s(first.get(operation, operation)) or 0.0 for operation in alone)


def _mean_way_s(plan: Sequence[Waypoint], ground_speed_m_s: float, pace: Pace) -> float:
    """The mean time from one stop to the next, with hovers; 0 without two stops."""
    stops: list[Via | Waypoint] = []
    for waypoint in plan:
        stops += [*waypoint.via, waypoint]
    legs = [
        Leg(
            distance_m(before.position, after.position),
            after.ground_speed_m_s or ground_speed_m_s,
            pace.acceleration_m_s2,
            pace.settling_s,
        ).duration_s
        + after.hold_s
        for before, after in itertools.pairwise(stops)
    ]
    return sum(legs) / (len(plan) - 1) if len(plan) > 1 else 0.0


def told_load(load: Load, *, judged: bool) -> str:
    """The same in a sentence, with what servers could save at most if the forecast has not judged them."""
    if judged:
        saved = ""
    elif load.waits or load.ratio > 1:
        most = load.local_s / (load.every_s + load.local_s) if load.waits else 1 - 1 / load.ratio
        saved = f": a server saves at most {100 * most:.0f} % of the time from photo to photo"
    else:
        saved = ", and a server saves little in flight"
    needs = f"the drone needs {load.local_s:.3g} s for a photo"
    if load.waits:
        return f"{needs} and waits for it at each stop, {load.every_s:.2g} s of flight apart{saved}"
    takes = f"{needs} and takes one each {load.every_s:.2g} s"
    if load.ratio > 1:
        return f"{takes}, {load.ratio:.1f} times what it can compute{saved}"
    return f"{takes}, {load.ratio:.2g} of what it can compute: it keeps up alone{saved}"
