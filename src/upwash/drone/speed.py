"""The ground speed of a mission of rows: what limits it, what it leads to, and `mission.speed = "auto"`.

A speed that is chosen moves the ground by half a pixel at most during an exposure: the finest detail that a photo can
have keeps 90 % of its contrast then. A speed that a person chose is warned of above one pixel, which keeps 64 %. With
a blur of b pixels the contrast of the finest detail is sin(pi b / 2) / (pi b / 2).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from statistics import fmean

from msgspec.structs import replace

from upwash.config import (
    DroneConfig,
    demand_map_of,
    ending,
    photo_ground,
    photo_legs,
    server_areas,
    stands,
    waypoints,
)
from upwash.core.geo import Position, Waypoint, ground_distance_m
from upwash.core.knowledge.estimates import Estimates
from upwash.core.operation import Operation
from upwash.core.planning.answering import ServerBelief
from upwash.core.planning.ground_speed import ChosenSpeed, SpeedLimit, choose_speed
from upwash.core.planning.legs import Leg, Pace
from upwash.core.planning.row_forecast import RowForecast, RowMission, forecast_rows
from upwash.drone.preparation import home_s, make_estimates, mission_beliefs, two_answers
from upwash.rpc.service import ServiceSpec

SHARP_PX, BLURRED_PX = 0.5, 1.0
_SETS = 5  # of demands that are likely


def with_speed(config: DroneConfig, specs: Mapping[str, ServiceSpec]) -> tuple[DroneConfig, str]:
    """The configuration with a ground speed, and why it was chosen; "" for a speed that is given."""
    if config.mission.speed == "given":
        return config, ""
    chosen = chosen_speed(config, specs)
    return _at(config, chosen.ground_speed_m_s), chosen.why


def _at(config: DroneConfig, ground_speed_m_s: float) -> DroneConfig:
    mission = replace(config.mission, speed="given", ground_speed_m_s=ground_speed_m_s)
    return replace(config, mission=mission)


def chosen_speed(config: DroneConfig, specs: Mapping[str, ServiceSpec]) -> ChosenSpeed:
    """The speed with the shortest forecast, for a mission of rows."""
    return choose_speed(
        list(speed_limits(config)), lambda speed_m_s: forecast_speed(_at(config, speed_m_s), specs)
    )


def forecast_speed(config: DroneConfig, specs: Mapping[str, ServiceSpec]) -> RowForecast:
    """The forecast of a mission of rows at its ground speed: of one of those that are likely, with the mean time."""
    speed_m_s = config.mission.ground_speed_m_s
    found = [forecast_rows(mission, speed_m_s) for mission in row_missions(config, specs)]
    return replace(found[len(found) // 2], mission_s=fmean(one.mission_s for one in found))


def speed_limits(config: DroneConfig) -> Iterator[SpeedLimit]:
    """The limits of a speed that is chosen, for a mission of rows."""
    legs, camera = photo_legs(config.mission), config.camera
    pixel_m = photo_ground(config, min((leg.altitude_m for leg in legs), default=None)).pixel_m
    if pixel_m is not None and camera.exposure_s is not None:
        yield SpeedLimit("blur", SHARP_PX * pixel_m / camera.exposure_s)
    if legs and camera.photo_s > 0:
        yield SpeedLimit("the camera", min(leg.step_m for leg in legs) / camera.photo_s)
    yield SpeedLimit("mission.ground_speed_m_s", config.mission.ground_speed_m_s)


def photo_doubts(config: DroneConfig) -> Iterator[tuple[str, str]]:
    """Warnings of photos taken in flight, each a kind and a sentence; of blur only where the speed is given."""
    legs, camera = photo_legs(config.mission), config.camera
    if not legs:
        return
    fastest = max(legs, key=lambda leg: leg.ground_speed_m_s / leg.altitude_m)  # over the ground of a photo
    ground = photo_ground(config, fastest.altitude_m)
    if ground.pixel_m is not None and camera.exposure_s is not None and config.mission.speed == "given":
        moved_px = fastest.ground_speed_m_s * camera.exposure_s / ground.pixel_m
        if moved_px > BLURRED_PX:
            allowed_m_s = BLURRED_PX * ground.pixel_m / camera.exposure_s
            yield (
                "blur",
                f"the ground moves by {moved_px:.1f} pixels during an exposure of {camera.exposure_s:g} s: at "
                f"{allowed_m_s:.2g} m/s it is one pixel; fly slower, or expose for a shorter time",
            )
    widest = max(legs, key=lambda leg: leg.step_m / leg.altitude_m)
    ground, step_m = photo_ground(config, widest.altitude_m), widest.step_m
    if ground.along_m is not None and step_m > ground.along_m:
        yield (
            "gaps",
            f"a photo shows {ground.along_m:.1f} m of a row, so that one every {step_m:g} m leaves gaps of "
            f"{step_m - ground.along_m:.1f} m: take photos more often, or fly higher, unless spots are enough",
        )


def row_missions(config: DroneConfig, specs: Mapping[str, ServiceSpec]) -> list[RowMission]:
    """What is known of a mission of rows before take-off: missions that differ by their demands."""
    mission, photos = config.mission, config.mission.photos
    if photos is None:
        raise ValueError("a mission without photos has no rows")
    plan, start, estimates = waypoints(mission), stands(mission), make_estimates(config, specs)
    beliefs = mission_beliefs(config, specs, estimates, plan)
    operations = [call.operation for call in beliefs.stop]
    local_s = own_answer_s(config, specs, estimates, operations)
    alone = [operation for operation in operations if not estimates.needs_server(operation)]
    operations = alone or operations  # answers that only servers give hold the drone up no more than others
    areas = {} if config.policy.name == "local-only" else server_areas(config)
    known = RowMission(
        plan=plan,
        leaving=beliefs.leaving,
        start=start.at_altitude(mission.altitude_m),
        pace=beliefs.pace,
        takeoff_s=beliefs.pace.takeoff_s(mission.altitude_m),
        home_s=partial(home_s, config, start=start),
        returns=ending(mission) == "return",
        photo_s=config.camera.photo_s,
        local_s=local_s,
        servers={
            name: ServerBelief(
                area,
                sum(_call_s(estimates, name, operation) for operation in operations),
                estimates.check_s(name, running=False),
                estimates.check_s(name, running=True),
            )
            for name, area in areas.items()
        },
        gain_switch=config.policy.gain_switch,
        newest=photos.order == "newest",
        at_most=photos.at_most,
        action_s=mission.action_s + _second_look_s(config, plan, beliefs.pace),
        act_within_s=config.policy.acts_within_s,
    )
    return [replace(known, demanding=demanding) for demanding in _demanding(config, plan)]


def _second_look_s(config: DroneConfig, plan: Sequence[Waypoint], pace: Pace) -> float:
    """The seconds of a second look: down, the photo, and up again."""
    look, speed_m_s = config.mission.second_look, config.mission.ground_speed_m_s
    if look is None:
        return 0.0
    down_m = fmean(waypoint.position.altitude_m for waypoint in plan) - look.altitude_m
    down = Leg(down_m, speed_m_s, pace.acceleration_m_s2, pace.settling_s)
    return 2 * down.duration_s + config.camera.photo_s


def own_answer_s(
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


def _call_s(estimates: Estimates, server: str, operation: Operation) -> float:
    """A call there, or on the drone if the server does not offer it."""
    remote_s = estimates.remote_s(server, operation)
    if remote_s is None and estimates.needs_server(operation):
        return math.inf
    return (estimates.local_s(operation) or 0.0) if remote_s is None else remote_s


def _demanding(config: DroneConfig, plan: Sequence[Waypoint]) -> list[frozenset[int]]:
    """Sets of photos whose answers demand an action, all as likely: one by `[event] every`, else some.

    Each has as many as is likely by `[event]`, or by the demands that earlier flights met, evenly spread. None has a
    photo if neither is known, or if the mission only tells answers.
    """
    if config.mission.only_tells:
        return [frozenset()]
    event, known = config.event, demand_map_of(config, plan)
    if event is not None and event.every is not None:
        return [frozenset(range(event.offset, len(plan), event.every))]
    if event is not None and event.objects:
        places = [Position(each.east_m, each.north_m) for each in event.objects]
        away_m = [[ground_distance_m(each.position, place) for each in plan] for place in places]
        return [frozenset(each.index(min(each)) for each in away_m)]  # whose photo is likely to show it first
    if event is not None:
        chances = [event.chance(waypoint.position) for waypoint in plan]
    elif known is not None and any(known.places()):
        chances = [known.chance(waypoint.position, known.before) for waypoint in plan]
    else:
        return [frozenset()]
    sums = list(itertools.accumulate(chances, initial=0.0))
    phases = [(number + 0.5) / _SETS for number in range(_SETS)] if sums[-1] else [0.5]
    return [
        frozenset(
            index
            for index, (before, after) in enumerate(itertools.pairwise(sums))
            if math.floor(after + phase) > math.floor(before + phase)
        )
        for phase in phases
    ]
