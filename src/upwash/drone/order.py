"""In which order a drone flies its waypoints: decided before take-off, from its configuration alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from upwash.config import DroneConfig, ending, geofence, server_areas, stands, sweeps_of, waypoints
from upwash.core.geo import Position
from upwash.core.planning.order import Forecaster, Order, best_order
from upwash.core.planning.pace import PACES
from upwash.core.vehicle.energy import ARDUCOPTER, PX4, time_home_s
from upwash.core.vehicle.geofence import breached_by_way
from upwash.drone.preparation import make_estimates, mission_beliefs
from upwash.rpc.service import ServiceSpec

_HOME = Position(0.0, 0.0)
_WAYS_HOME = {"arducopter": ARDUCOPTER, "px4": PX4}


def order_of(config: DroneConfig, specs: Mapping[str, ServiceSpec]) -> Order:
    """The order that `mission.order` asks for, of a configuration that was read from a file."""
    mission = config.mission
    match mission.order:
        case int(number):
            sweep = sweeps_of(mission)[number]
            return Order(sweep.waypoints, str(sweep), number)
        case "best-sweep":
            return _best(config, specs)
    return Order(waypoints(mission))


def _best(config: DroneConfig, specs: Mapping[str, ServiceSpec]) -> Order:
    """The best one that the plan's geofence allows."""
    mission, estimates = config.mission, make_estimates(config, specs)
    given, fences = waypoints(mission), geofence(mission)
    beliefs = mission_beliefs(config, specs, estimates, given)
    if not beliefs.stop:
        return Order(given, "as given: nothing is known of any call that could be forecast")
    start = stands(mission)
    forecaster = Forecaster(
        beliefs,
        estimates,
        {} if config.policy.name == "local-only" else server_areas(config),
        gain_wait=config.policy.gain_wait,
        stands=start,
        home_s=lambda place: _home_s(config, place, start),
    )
    sweeps = sweeps_of(mission)
    allowed = [
        sweep
        for sweep in sweeps
        if breached_by_way(fences, [_HOME, *(each.position for each in sweep.waypoints)]) is None
    ]
    best = best_order(given, allowed, forecaster.mission_s)
    if len(allowed) < len(sweeps):
        forbidden = f"the geofence forbids {len(sweeps) - len(allowed)} of {len(sweeps)} sweeps"
        return replace(best, why=f"{best.why}; {forbidden}")
    return best


def _home_s(config: DroneConfig, place: Position, start: Position) -> float:
    """To the ground, as the simulated vehicle flies it: without a profile in the same time from everywhere."""
    profile = config.vehicle.profile
    if profile is None or ending(config.mission) == "land":
        return config.vehicle.return_and_land_s
    return PACES[profile].home_share * time_home_s(place, start, _WAYS_HOME[profile])
