"""Puts the programs on models: the counterpart of launch.py."""

from __future__ import annotations

import asyncio
import contextlib
import functools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import msgspec

from upwash.bundled import load_configured_services, load_mission, service_program
from upwash.config import DroneConfig, ServerConfig, ServerTruth, server_area, server_truth, waypoints
from upwash.core.geo import Position
from upwash.core.instances import Host, ServerOffer
from upwash.drone import Flight, World
from upwash.errors import UpwashError
from upwash.results import RunResult, read_result
from upwash.server import EdgeServer
from upwash.service import ServiceSpec, spec_of
from upwash.sim.autopilot import ModelAutopilot, Plain
from upwash.sim.camera import ModelCamera
from upwash.sim.chance import Chance
from upwash.sim.faults import Faults, FaultyServer
from upwash.sim.heat import Heat
from upwash.sim.journal import MemoryJournal
from upwash.sim.link import ModelDialer, Switchboard
from upwash.sim.loop import run_virtually
from upwash.sim.network import Cell, ModelNetwork
from upwash.sim.radio import read_goodput
from upwash.sim.runtime import ModelRuntime
from upwash.sim.sleeping import sleeps_reported
from upwash.sim.world import DroneComputer, Radio, ServerComputer, Wire
from upwash.vehicle import arducopter

_LONGEST_S = 48 * 3600.0  # of virtual time: a mission that takes longer never ends


@dataclass(frozen=True, slots=True)
class Run:
    """One simulated mission: its events, and what they came to. `failure` says why it was not completed."""

    events: list[dict[str, Any]]
    result: RunResult
    failure: str = ""

    def log(self) -> bytes:
        """The event log, as the flying drone would have written it."""
        return b"".join(msgspec.json.encode(event) + b"\n" for event in self.events)


def simulate(config: DroneConfig) -> Run:
    """Flies the scenario's mission on virtual time; the same scenario and seed give the same run."""
    journal = MemoryJournal()
    failure = ""
    try:
        with sleeps_reported():
            run_virtually(_fly(config, journal))
    except UpwashError as error:
        failure = str(error)
    return Run(journal.events, read_result(journal.events), failure)


async def _fly(config: DroneConfig, journal: MemoryJournal) -> None:
    journal.begin()
    mission = load_mission(config.mission.program, mode=config.mission.mode)
    classes = load_configured_services(config)
    specs = {name: spec_of(cls) for name, cls in classes.items()}
    programs = {name: service_program(config, name) for name in classes}
    chance, faults, switchboard = Chance(config.seed), Faults(config.faults), Switchboard({})
    autopilot = _autopilot(config, chance, faults)
    areas = {server.name: server_area(server, config.mission.home) for server in config.servers}
    truths = {server.name: server_truth(server, config.services) for server in config.servers}
    radio = Radio(
        areas,
        {name: read_goodput(truth.radio) for name, truth in truths.items()},
        config.services,
        faults=faults,
        position=lambda: autopilot.position,
    )
    cells: dict[str, list[Cell]] = {}
    for server in config.servers:
        cells.setdefault(server.network, []).append(
            Cell(areas[server.name], truths[server.name].join_s, functools.partial(radio.is_up, server.name))
        )
    heat = Heat(config.heat.ambient_c, config.heat.load_w) if config.heat else None
    drone_computer = DroneComputer(config.services, heat=heat, noise=config.noise.call, chance=chance)
    onboard = Switchboard({})
    flight = Flight(
        mission,
        config,
        services=classes,
        programs=programs,
        world=World(
            autopilot=autopilot,
            network=ModelNetwork(cells, lambda: autopilot.position),
            dialer=ModelDialer(config.name, switchboard, radio),
            onboard_dialer=ModelDialer(config.name, onboard, Wire()),
            onboard_runtime=ModelRuntime(specs, drone_computer, onboard),
            camera=ModelCamera(photo_s=config.camera.photo_s),
            notifier=journal,
            journal=journal,
        ),
    )
    async with contextlib.AsyncExitStack() as stack:
        for server in config.servers:
            outside = FaultyServer(server.name, switchboard, faults=faults, slots=truths[server.name].slots)
            computer = ServerComputer(
                server.name, truths[server.name], faults=faults, noise=config.noise.call, chance=chance
            )
            edge = _edge_server(
                server, truths[server.name], computer, outside, specs=specs, programs=programs
            )
            stack.push_async_callback(edge.close)
            watch = asyncio.create_task(edge.run(), name=f"daemon of {server.name}")
            stack.callback(watch.cancel)
        try:
            async with asyncio.timeout(_LONGEST_S):
                await flight.run()
        except TimeoutError:
            raise UpwashError(
                f"the mission did not end within {_LONGEST_S / 3600:.0f} h of virtual time; "
                "a verb of the mission never returned, or it flies in circles"
            ) from None


def _autopilot(config: DroneConfig, chance: Chance, faults: Faults) -> ModelAutopilot:
    vehicle = config.vehicle
    return ModelAutopilot(
        Position(0.0, 0.0) if config.mission.plan else waypoints(config.mission)[0].position,
        ground_speed_m_s=config.mission.ground_speed_m_s,
        manner=arducopter
        if vehicle.profile == "arducopter"
        else Plain(
            acceleration_m_s2=vehicle.acceleration_m_s2,
            takeoff_s=vehicle.takeoff_s,
            return_and_land_s=vehicle.return_and_land_s,
        ),
        stretch=lambda: chance.factor("leg", config.noise.leg),
        fault=lambda: faults.now("autopilot"),
        endurance_s=vehicle.endurance_s,
    )


def _edge_server(
    server: ServerConfig,
    truth: ServerTruth,
    computer: ServerComputer,
    outside: FaultyServer,
    *,
    specs: Mapping[str, ServiceSpec],
    programs: Mapping[str, str],
) -> EdgeServer:
    runtime = ModelRuntime(specs, computer, outside)
    edge = EdgeServer(
        Host({server.name: ServerOffer(frozenset(truth.images), truth.slots)}),
        programs=programs,
        runtime=runtime,
        start_timeout_s=60.0,
    )
    outside.plug_daemon(server.address or server.name, edge.handle, crash=runtime.crash)
    return edge
