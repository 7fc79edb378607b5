"""Puts the programs on models: the counterpart of launch/flight.py."""

from __future__ import annotations

import asyncio
import functools
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from msgspec.structs import replace

from upwash.config.drone import DroneConfig, VehicleConfig
from upwash.config.drone_file import Presence, fleet_of, presences
from upwash.config.flight_times import pace_in_numbers
from upwash.config.places import (
    coverage_of,
    frame_of,
    server_places,
    stands,
    track_of,
    true_areas,
    true_range_m,
    waypoints,
)
from upwash.config.traces import read_battery, read_wind
from upwash.config.truth import server_truth
from upwash.core.geo import Position, Reach
from upwash.core.knowledge.coverage import Coverage
from upwash.core.planning.demand_map import DemandMap
from upwash.core.policies.policy import Policy
from upwash.drone.flight import Flight, Ports
from upwash.drone.networks import NetworkCell, PositionNetwork
from upwash.errors import MissionFailed, UpwashError, UsageError
from upwash.eventlog import schema
from upwash.eventlog.kept import KeptEvents
from upwash.eventlog.results import RunResult, read_result
from upwash.lab.field import FieldSoftware, daemon_address, serving
from upwash.lab.observer import Observation, ObservedJournal, RangeInterval, drone_observer, observe_ranges
from upwash.lab.speed import with_speed
from upwash.missions.bundled import load_services
from upwash.missions.program import is_bundled, load_mission
from upwash.ports import Camera, Dialer, Network
from upwash.sim.autopilot import ModelAutopilot
from upwash.sim.camera import ModelCamera, ObjectCamera, RenderedCamera, UnseenCamera, eventful, mistaken
from upwash.sim.chance import Chance
from upwash.sim.energy import EnergyMeter
from upwash.sim.faults import Faults
from upwash.sim.journal import MemoryJournal
from upwash.sim.link import ModelDialer, Observe, Switchboard, lived, unobserved
from upwash.sim.loop import run_virtually
from upwash.sim.over_time import OverTime
from upwash.sim.runtime import ModelRuntime
from upwash.sim.supplies import ModelComputer
from upwash.sim.tracked import TrackedAutopilot
from upwash.sim.turns import sleeps_reported
from upwash.sim.vehicle import FlightModel, Plain
from upwash.sim.world import DroneComputer, JoinedSlowly, Joining, ModelRadio
from upwash.support.background import beside
from upwash.support.heat import Heat, Surroundings
from upwash.support.progress import work
from upwash.vehicle.ardupilot import airframe as arducopter
from upwash.vehicle.px4 import airframe as px4

_LONGEST_S = 48 * 3600.0  # of virtual time: a longer mission never ends
_LONGEST_STOP_S = 120.0  # more for each waypoint of the longest plan


@dataclass(frozen=True, slots=True)
class Run:
    """One simulated mission: its events, its result, and the times in range of each server.

    `failure` says why it was not completed; `vanished` is whether the scenario had the drone vanish. `coverage` is
    the coverage of servers without a range after the mission, and `demand_map` where answers had demands.
    """

    events: KeptEvents
    result: RunResult
    range_intervals: list[RangeInterval]
    failure: str = ""
    vanished: bool = False
    coverage: Coverage | None = None
    demand_map: DemandMap | None = None

    def log(self) -> bytes:
        """The event log, as the flying drone would have written it."""
        return b"".join(self.events.lines())


def simulate(config: DroneConfig, *, policy: Policy | None = None) -> Run:
    """Flies the scenario's mission on virtual time; the same scenario and seed give the same run.

    A `policy` takes the place of the scenario's policy.

    Raises MissionFailed for a mission program with a bug, and UsageError for what cannot be simulated; another early
    end is the run's `failure`.
    """
    if config.drones:
        raise UsageError(f"the scenario has {len(config.drones)} drones, and this is for one")
    (run,) = simulate_fleet([config], policy=policy)
    return run


def simulate_drones(config: DroneConfig) -> dict[str, Run]:
    """Flies the missions of all drones of the scenario at the same time; each run by its drone's name."""
    fleet = fleet_of(config)
    runs = simulate_fleet(fleet, there=presences(config))
    return {drone.name: run for drone, run in zip(fleet, runs, strict=True)}


class Alone(NamedTuple):
    """The time of a mission by itself, and when it started each call whose answer may come later."""

    time_s: float
    started_s: tuple[float, ...]


_ALONE: deque[tuple[DroneConfig, Presence, Alone | None]] = deque(maxlen=16)


def flown_alone(config: DroneConfig, presence: Presence | None = None) -> Alone | None:
    """The scenario's mission by itself; None where it is not completed.

    The last missions are remembered, as each policy of a comparison needs the same missions.
    """
    presence = presence or Presence()
    for other, there, alone in _ALONE:
        if there == presence and other == config:
            return alone
    (run,) = simulate_fleet([config], there=[presence])
    started_s = tuple(event.t for event in run.events if isinstance(event, schema.CallStarted))
    alone = Alone(run.result.mission_time_s, started_s) if run.result.completed else None
    _ALONE.append((config, presence, alone))
    return alone


def simulate_fleet(
    fleet: Sequence[DroneConfig],
    *,
    there: Sequence[Presence] | None = None,
    computing: bool = False,
    seen: list[Observation] | None = None,
    policy: Policy | None = None,
) -> list[Run]:
    """Flies the missions of several drones at the same time, among the servers of the first one's scenario.

    `there` says when each drone is there; by default from the start to its mission's end. With `computing` the
    services really compute, in no time, instead of returning empty results; observations of drones and servers are
    added to `seen`. A policy stands in for that of each drone.
    """
    drones = [
        _Drone(config, presence, policy)
        for config, presence in zip(fleet, there or [Presence() for _ in fleet], strict=True)
    ]
    ends = [_End() for _ in drones]
    places = sum(len(waypoints(drone.config.mission)) for drone in drones)
    try:
        with sleeps_reported(), work("waypoints reached in simulation", places) as arrived:
            for drone in drones:
                drone.journal.arrived = arrived
            ends = run_virtually(_fly(drones, computing=computing, seen=seen))
    except (MissionFailed, UsageError):
        raise
    except UpwashError as error:
        ends = [_End(str(error)) for _ in drones]
    return [
        Run(drone.journal.events, read_result(drone.journal.events), drone.range_intervals, *end)
        for drone, end in zip(drones, ends, strict=True)
    ]


class _End(NamedTuple):
    """Why a mission was not completed ("" if it was), whether its drone has vanished, and what it knew then."""

    failure: str = ""
    vanished: bool = False
    coverage: Coverage | None = None
    demand_map: DemandMap | None = None


class _Drone:
    """One drone among servers at hosts of their own: what it is given, and what it leaves behind."""

    def __init__(self, config: DroneConfig, presence: Presence, policy: Policy | None) -> None:
        servers = tuple(replace(server, address=daemon_address(server.name)) for server in config.servers)
        config, self.speed_why = with_speed(config, simulate)
        self.config = replace(config, servers=servers)
        self.presence, self.policy = presence, policy
        self.chance, self.faults = Chance(config.seed), Faults(config.faults)
        self.journal = MemoryJournal()
        self.range_intervals: list[RangeInterval] = []


async def _fly(drones: Sequence[_Drone], *, computing: bool, seen: list[Observation] | None) -> list[_End]:
    for drone in drones:
        drone.journal.begin()
    first = drones[0].config
    software = FieldSoftware(load_services(first.services), computing=computing)
    async with serving(first, software, seen=seen) as switchboard:
        flights = [_fly_one(drone, software, switchboard, seen) for drone in drones]
        longest_s = _LONGEST_S + max(map(_stops_s, drones))
        try:
            async with asyncio.timeout(longest_s):
                return await asyncio.gather(*flights)
        except TimeoutError:
            raise UpwashError(
                f"the mission did not end within {longest_s / 3600:.0f} h of virtual time; "
                "a verb of the mission never returned, or it flies in circles"
            ) from None


def _stops_s(drone: _Drone) -> float:
    """The longest that all stops of the plan may take."""
    plan = waypoints(drone.config.mission)
    holds_s = sum(waypoint.hold_s + sum(via.hold_s for via in waypoint.via) for waypoint in plan)
    return _LONGEST_STOP_S * len(plan) + holds_s


async def _fly_one(
    drone: _Drone, software: FieldSoftware, switchboard: Switchboard, seen: list[Observation] | None
) -> _End:
    config, presence, journal = drone.config, drone.presence, drone.journal
    if presence.departs_s:
        await asyncio.sleep(presence.departs_s)
    chance, faults = drone.chance, drone.faults
    journal.meter = _energy(config)
    observe: Observe = unobserved
    if seen is not None:
        observe = drone_observer(config.name, seen, position=lambda: autopilot.position, life=journal.life)
    charge, wind = config.vehicle.battery_csv, _wind(config)
    options: dict[str, Any] = {
        "ground_speed_m_s": config.mission.ground_speed_m_s,
        "manner": _manner(config.vehicle),
        "frame": frame_of(config.mission),
        "stretch": lambda: chance.factor("leg", config.noise.leg),
        "fault": lambda: faults.now("autopilot"),
        "incidents": faults.incidents,
        "returns": faults.settings,
        "endurance_s": config.vehicle.endurance_s,
        "energy": journal.meter,
        "charge": None if charge is None else OverTime(read_battery(charge)),
        "wind": wind,
        "observe": observe,
    }
    track = track_of(config.vehicle, config.mission)
    autopilot = (
        TrackedAutopilot(track, **options) if track else ModelAutopilot(stands(config.mission), **options)
    )
    areas = true_areas(config)
    radios = _radios(drone, areas, autopilot, switchboard, observe)
    flight = Flight(
        load_mission(config.mission.program, mode=config.mission.mode),
        config,
        services=software.classes,
        programs=software.programs,
        parts=software.parts,
        ports=_ports(drone, autopilot, radios, software, observe),
        speed_why=drone.speed_why,
        policy=drone.policy,
    )
    try:
        async with beside(observe_ranges(autopilot, areas, drone.range_intervals), name="observer of ranges"):
            await lived(flight.run(), journal.life, until_s=presence.vanishes_s)
    except MissionFailed:
        raise
    except UpwashError as error:
        return _End(str(error), coverage=flight.coverage, demand_map=flight.demand_map)
    finally:
        observe("flight_over", altitude_m=autopilot.position.altitude_m)
        await autopilot.close()
    if journal.life.is_over:
        return _End(f"the drone vanished at {presence.vanishes_s:g} s, as its vanishes_s says", True)
    return _End(coverage=flight.coverage, demand_map=flight.demand_map)


def _ports(
    drone: _Drone,
    autopilot: ModelAutopilot,
    radios: tuple[list[Network], Dialer],
    software: FieldSoftware,
    observe: Observe,
) -> Ports:
    config, journal = drone.config, drone.journal
    joining = Joining()
    computer = DroneComputer(
        config.services,
        heat=Heat(config.heat) if config.heat else None,
        joining=joining,
        noise=config.noise.call,
        chance=drone.chance,
        energy=journal.meter,
        observe=observe,
    )
    networks, dialer = radios
    onboard = Switchboard({})
    return Ports(
        autopilot=autopilot,
        networks=[
            JoinedSlowly(network, joining, radio=radio, observe=observe)
            for radio, network in enumerate(networks)
        ],
        dialer=dialer,
        onboard_dialer=ModelDialer(config.name, onboard),
        onboard_runtime=ModelRuntime(
            software.specs | software.part_specs, computer, onboard, objects=software.objects
        ),
        camera=_camera(config, drone.chance),
        notifier=journal,
        journal=ObservedJournal(
            journal,
            {waypoint.index: waypoint.position for waypoint in waypoints(config.mission)},
            lambda: autopilot.true_position,
            observe,
        ),
        computer=ModelComputer(drone.faults),
    )


def _wind(config: DroneConfig) -> OverTime | None:
    file = config.vehicle.wind_csv
    return None if file is None else OverTime(read_wind(file))


def _energy(config: DroneConfig) -> EnergyMeter | None:
    if config.energy is None:
        return None
    load_w = (config.heat or Surroundings()).load_w
    if config.energy.computer_load_w is not None:
        load_w = config.energy.computer_load_w
    return EnergyMeter(config.energy, load_w=load_w, radios=config.network.radios, wind=_wind(config))


def _radios(
    drone: _Drone,
    areas: Mapping[str, Reach],
    autopilot: ModelAutopilot,
    switchboard: Switchboard,
    observe: Observe,
) -> tuple[list[Network], Dialer]:
    """The networks in the drone's reach, for each of its radios, and what opens links to their servers."""
    config, journal = drone.config, drone.journal
    truths = {server.name: server_truth(server, config.services) for server in config.servers}
    known = coverage_of(config)
    limited = {server.name for server in config.servers if true_range_m(server) is not None}

    def is_reached(server: str, position: Position) -> bool:
        """Whether a server without a range answers there, by what earlier flights measured."""
        place = known.at(server, position) if known is not None and server not in limited else None
        return place is None or place.reached

    radio = ModelRadio(
        areas,
        server_places(config),
        truths,
        config.services,
        faults=drone.faults,
        position=lambda: autopilot.true_position,
        energy=journal.meter,
        reached=is_reached,
    )
    cells: dict[str, list[NetworkCell]] = {}
    for server in config.servers:
        cells.setdefault(server.network, []).append(
            NetworkCell(
                areas[server.name],
                truths[server.name].join_s,
                is_up=functools.partial(radio.is_up, server.name),
                goes_down=functools.partial(radio.goes_down, server.name),
                leave_s=truths[server.name].leave_s,
                stretch=functools.partial(drone.chance.factor, f"join/{server.name}", config.noise.join),
            )
        )
    networks: list[Network] = [
        PositionNetwork(cells, lambda: autopilot.true_position) for _ in range(config.network.radios)
    ]
    return networks, ModelDialer(config.name, switchboard, radio, life=journal.life, observe=observe)


def renders_photos(config: DroneConfig) -> bool:
    """Whether a simulation renders the photos, because the mission may look at them."""
    return config.camera.park_seed is not None and not is_bundled(config.mission.program)


def _camera(config: DroneConfig, chance: Chance) -> Camera:
    """The camera of a simulation, which has no folders or devices."""
    camera = config.camera
    if camera.park_seed is not None:
        kind = functools.partial(RenderedCamera, in_thread=False) if renders_photos(config) else UnseenCamera
        return kind(camera.park_seed, photo_s=camera.photo_s)
    in_flight = config.mission.photos is not None
    if config.event is not None and config.event.objects:
        errors = chance.stream("errors of photos")
        return ObjectCamera(config.event.objects, camera, in_flight=in_flight, chance=errors)
    places = waypoints(config.mission)
    events = eventful(config.event, places, chance)
    return ModelCamera(
        photo_s=camera.photo_s,
        events=[waypoint.position for waypoint in events],
        mistaken=mistaken(config.event, places, events, chance),
        in_flight=in_flight,
    )


def _manner(vehicle: VehicleConfig) -> FlightModel:
    match vehicle.profile:
        case "arducopter":
            return arducopter
        case "px4":
            return px4
    pace = pace_in_numbers(vehicle)
    return Plain(
        acceleration_m_s2=pace.acceleration_m_s2,
        takeoff_s=pace.lifting_s,
        return_and_land_s=vehicle.return_and_land_s,
    )
