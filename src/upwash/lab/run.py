"""Puts the programs on models: the counterpart of launch.py."""

from __future__ import annotations

import asyncio
import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import msgspec

from upwash.bundled import load_mission, load_services
from upwash.config import CameraConfig, DroneConfig, VehicleConfig, server_area, server_truth, waypoints
from upwash.core.geo import Position
from upwash.drone import Flight, World
from upwash.errors import MissionFailed, UpwashError, UsageError
from upwash.lab.field import Software, daemon_address, serving
from upwash.lab.stays import Stay, observe
from upwash.lab.witness import DroneWitness
from upwash.ports import Camera, Dialer, Network
from upwash.results import RunResult, read_result
from upwash.service import spec_of
from upwash.sim.autopilot import ModelAutopilot, Plain
from upwash.sim.camera import ModelCamera, RenderedCamera
from upwash.sim.chance import Chance
from upwash.sim.faults import Faults
from upwash.sim.heat import Heat
from upwash.sim.journal import MemoryJournal
from upwash.sim.link import ModelDialer, Switchboard
from upwash.sim.loop import run_virtually
from upwash.sim.network import Cell, ModelNetwork
from upwash.sim.runtime import Computer, ModelRuntime
from upwash.sim.sleeping import sleeps_reported
from upwash.sim.vehicle import Manner
from upwash.sim.world import DroneComputer, Radio, Wire
from upwash.vehicle import arducopter
from upwash.vehicle.px4 import airframe as px4

_LONGEST_S = 48 * 3600.0  # of virtual time: a mission that takes longer never ends


@dataclass(frozen=True, slots=True)
class Run:
    """One simulated mission: its events, what they came to, and what was in range when.

    `failure` says why it was not completed.
    """

    events: list[dict[str, Any]]
    result: RunResult
    stays: list[Stay]
    failure: str = ""

    def log(self) -> bytes:
        """The event log, as the flying drone would have written it."""
        return b"".join(msgspec.json.encode(event) + b"\n" for event in self.events)


def simulate(config: DroneConfig) -> Run:
    """Flies the scenario's mission on virtual time; the same scenario and seed give the same run.

    Raises MissionFailed for a mission program with a bug, and UsageError for what cannot be simulated; whatever else
    ends a mission early is the run's `failure`.
    """
    (run,) = simulate_fleet([config])
    return run


def simulate_fleet(
    fleet: Sequence[DroneConfig], *, computing: bool = False, witness: MemoryJournal | None = None
) -> list[Run]:
    """Flies the missions of several drones at the same time, among the servers of the first one's scenario.

    With `computing` the services really compute, in no time, instead of returning empty results; the witness
    notes what it sees of drones and servers.
    """
    fleet = [_at_hosts_of_their_own(config) for config in fleet]
    journals = [MemoryJournal() for _ in fleet]
    stays: list[list[Stay]] = [[] for _ in fleet]
    failures = [""] * len(fleet)
    try:
        with sleeps_reported():
            failures = run_virtually(_fly(fleet, journals, stays, computing=computing, witness=witness))
    except (MissionFailed, UsageError):
        raise
    except UpwashError as error:
        failures = [str(error)] * len(fleet)
    return [
        Run(journal.events, read_result(journal.events), its_stays, failure)
        for journal, its_stays, failure in zip(journals, stays, failures, strict=True)
    ]


def _at_hosts_of_their_own(config: DroneConfig) -> DroneConfig:
    """The same with servers that are reached by their names, wherever they really are."""
    servers = tuple(
        msgspec.structs.replace(server, address=daemon_address(server.name)) for server in config.servers
    )
    return msgspec.structs.replace(config, servers=servers)


async def _fly(
    fleet: Sequence[DroneConfig],
    journals: Sequence[MemoryJournal],
    stays: Sequence[list[Stay]],
    *,
    computing: bool,
    witness: MemoryJournal | None,
) -> list[str]:
    """Returns why each mission was not completed, "" for those that were."""
    for journal in (*journals, *([witness] if witness else [])):
        journal.begin()
    services = load_services(fleet[0].services)
    classes = {name: service.cls for name, service in services.items()}
    software = Software(
        specs={name: spec_of(cls) for name, cls in classes.items()},
        programs={name: service.program for name, service in services.items()},
        objects={name: service.made() for name, service in services.items()} if computing else {},
    )
    async with serving(fleet[0], software, witness=witness) as switchboard:
        flights = [
            _fly_one(
                config,
                journal,
                its_stays,
                classes=classes,
                software=software,
                switchboard=switchboard,
                seen_by=witness,
            )
            for config, journal, its_stays in zip(fleet, journals, stays, strict=True)
        ]
        try:
            async with asyncio.timeout(_LONGEST_S):
                return await asyncio.gather(*flights)
        except TimeoutError:
            raise UpwashError(
                f"the mission did not end within {_LONGEST_S / 3600:.0f} h of virtual time; "
                "a verb of the mission never returned, or it flies in circles"
            ) from None


async def _fly_one(
    config: DroneConfig,
    journal: MemoryJournal,
    stays: list[Stay],
    *,
    classes: Mapping[str, type],
    software: Software,
    switchboard: Switchboard,
    seen_by: MemoryJournal | None,
) -> str:
    """Returns why the mission was not completed, or ""."""
    chance, faults = Chance(config.seed), Faults(config.faults)
    witness: DroneWitness | None = None

    def saw(event: str, **facts: object) -> None:
        if witness:
            witness.record(event, **facts)

    autopilot = _autopilot(
        config,
        chance,
        faults,
        commanded=lambda command: saw("commanded", command=command),
        taken=lambda by: saw("taken", by=by),
        given_back_unheard=lambda: saw("given_back_unheard"),
    )
    witness = DroneWitness(config.name, seen_by, lambda: autopilot.position) if seen_by else None
    networks, dialer = _radios(config, autopilot, switchboard, faults)
    heat = Heat(config.heat.ambient_c, config.heat.load_w) if config.heat else None
    computer: Computer = DroneComputer(config.services, heat=heat, noise=config.noise.call, chance=chance)
    onboard = Switchboard({})
    flight = Flight(
        load_mission(config.mission.program, mode=config.mission.mode),
        config,
        services=classes,
        programs=software.programs,
        world=World(
            autopilot=autopilot,
            networks=witness.networks(networks) if witness else networks,
            dialer=witness.dialer(dialer) if witness else dialer,
            onboard_dialer=ModelDialer(config.name, onboard, Wire()),
            onboard_runtime=ModelRuntime(
                software.specs,
                witness.computer(computer) if witness else computer,
                onboard,
                objects=software.objects,
            ),
            camera=_camera(config.camera),
            notifier=journal,
            journal=journal,
        ),
    )
    areas = {server.name: server_area(server, config.mission.home) for server in config.servers}
    observer = asyncio.create_task(observe(autopilot, areas, stays), name="observer of ranges")
    try:
        await flight.run()
    except MissionFailed:
        raise
    except UpwashError as error:
        return str(error)
    finally:
        observer.cancel()
        saw("flight_over", altitude_m=autopilot.position.altitude_m)
        await autopilot.close()
    return ""


def _radios(
    config: DroneConfig, autopilot: ModelAutopilot, switchboard: Switchboard, faults: Faults
) -> tuple[list[Network], Dialer]:
    """The networks in the drone's reach, for each of its radios, and the way to whoever is there."""
    areas = {server.name: server_area(server, config.mission.home) for server in config.servers}
    truths = {server.name: server_truth(server, config.services) for server in config.servers}
    radio = Radio(
        areas,
        truths,
        config.services,
        faults=faults,
        position=lambda: autopilot.position,
    )
    cells: dict[str, list[Cell]] = {}
    for server in config.servers:
        cells.setdefault(server.network, []).append(
            Cell(
                areas[server.name],
                truths[server.name].join_s,
                is_up=functools.partial(radio.is_up, server.name),
                goes_down=functools.partial(radio.goes_down, server.name),
            )
        )
    networks: list[Network] = [
        ModelNetwork(cells, lambda: autopilot.position) for _ in range(config.network.radios)
    ]
    return networks, ModelDialer(config.name, switchboard, radio)


def _camera(config: CameraConfig) -> Camera:
    """Rendered photos where they are asked for; a folder's or a device's are not there in simulation."""
    if config.park_seed is None:
        return ModelCamera(photo_s=config.photo_s)
    return RenderedCamera(config.park_seed, photo_s=config.photo_s, in_thread=False)


def _manner(vehicle: VehicleConfig) -> Manner:
    match vehicle.profile:
        case "arducopter":
            return arducopter
        case "px4":
            return px4
    return Plain(
        acceleration_m_s2=vehicle.acceleration_m_s2,
        takeoff_s=vehicle.takeoff_s,
        return_and_land_s=vehicle.return_and_land_s,
    )


def _autopilot(
    config: DroneConfig,
    chance: Chance,
    faults: Faults,
    *,
    commanded: Callable[[str], None],
    taken: Callable[[str], None],
    given_back_unheard: Callable[[], None],
) -> ModelAutopilot:
    vehicle = config.vehicle
    return ModelAutopilot(
        Position(0.0, 0.0) if config.mission.plan else waypoints(config.mission)[0].position,
        ground_speed_m_s=config.mission.ground_speed_m_s,
        manner=_manner(vehicle),
        stretch=lambda: chance.factor("leg", config.noise.leg),
        fault=lambda: faults.now("autopilot"),
        takeovers=faults.takeovers,
        endurance_s=vehicle.endurance_s,
        commanded=commanded,
        taken=taken,
        given_back_unheard=given_back_unheard,
    )
