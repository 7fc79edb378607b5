"""One emulation, from inside its enclosure: sets the field up, flies, and measures how late it was."""

from __future__ import annotations

import asyncio
import contextlib
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from upwash.config.drone import DroneConfig
from upwash.core.geo import LocalFrame, Position
from upwash.emulation.field import Field, drone_namespace
from upwash.emulation.namespaces import add_route, join_by_cable
from upwash.emulation.programs import Computers, flight_program, ready_daemon
from upwash.emulation.radios import EmulatedRadio, GhostRadio, ShapedRadio
from upwash.emulation.request import ComputerKind, EmulationOutcome, EmulationRequest, RadioKind
from upwash.emulation.vehicles import relayed, tracked
from upwash.launch.processes import FlightProgram, ready_vehicle
from upwash.real.trust.authority import make_keys


async def emulate(request: EmulationRequest, stop: asyncio.Event) -> EmulationOutcome:
    """Flies every drone of the request at once; when `stop` is set, they end their missions and land."""
    drones = request.read()
    field = Field([drone.config for drone in drones])
    with contextlib.ExitStack() as stack:
        computers = _make_computers(request.computers, request.folder)
        radio = stack.enter_context(_field_set_up(field, computers, request))
        programs: dict[str, FlightProgram] = {}
        positions: dict[str, Callable[[], Position]] = {}
        for number, deployed in enumerate(drones):
            drone = deployed.config
            vehicle, positions[drone.name] = stack.enter_context(_vehicle(drone, number, computers, request))
            programs[drone.name] = flight_program(drone, field, computers, request.folder, vehicle=vehicle)
        mover = Mover(radio, positions)
        departs_s = {drone.config.name: drone.departs_s for drone in drones}
        exit_codes = await _fly(programs, departs_s, mover, stop)
        return EmulationOutcome(
            radio=request.radio,
            radio_lag_s=radio.lag_s,
            position_lag_s=mover.lag_s,
            exit_codes=exit_codes,
        )


def _make_computers(kind: ComputerKind, folder: Path) -> Computers:
    if kind == "namespaces":
        return Computers()
    from upwash.emulation.containers import ContainerComputers

    _say("starting a container engine")
    return ContainerComputers(folder)


@contextlib.contextmanager
def _field_set_up(field: Field, computers: Computers, request: EmulationRequest) -> Iterator[EmulatedRadio]:
    folder = request.folder
    _say(f"setting up {len(field.drones)} drone(s) and {len(field.servers)} server(s)")
    for namespace in field.namespaces():
        computers.make(namespace)
    for one, other in field.wires():
        join_by_cable(one, other)
    make_keys(
        folder / "keys",
        servers=[[server.name] for server in field.servers],
        drones=[drone.name for drone in field.drones],
    )
    with contextlib.ExitStack() as stack:
        radio = stack.enter_context(contextlib.closing(make_radio(request.radio, field)))
        for link in field.links():
            add_route(link.drone_end, field.subnet(link.server), via=link.server_end.address)
        for server in field.servers:
            _say(f"starting {server.name}")
            stack.enter_context(ready_daemon(server, field, computers, folder))
        yield radio


def make_radio(kind: RadioKind, field: Field) -> EmulatedRadio:
    """The radio of that kind, between existing namespaces."""
    return GhostRadio(list(field.links())) if kind == "ns3" else ShapedRadio(field.links())


@contextlib.contextmanager
def _vehicle(
    drone: DroneConfig, number: int, computers: Computers, request: EmulationRequest
) -> Iterator[tuple[str, Callable[[], Position]]]:
    """The connection to the drone's vehicle, and its position, until the end of the block."""
    namespace, home = drone_namespace(drone.name), drone.mission.home
    assert home is not None  # noqa: S101 - EmulationRequest.read gives it one
    frame = LocalFrame(home.place)
    if request.autopilots:
        reached = relayed(request.autopilots[number], namespace=namespace, outside=request.outside)
    else:
        reached = ready_vehicle(
            f"{drone.name}-vehicle", request.folder, drone, through=computers.inside(namespace)
        )
    with reached as connection, tracked(connection, namespace=namespace, frame=frame) as position:
        yield connection, position


async def _fly(
    programs: Mapping[str, FlightProgram], departs_s: Mapping[str, float], mover: Mover, stop: asyncio.Event
) -> dict[str, int]:
    async def stop_all() -> None:
        await stop.wait()
        for program in programs.values():
            program.stop()

    async with asyncio.TaskGroup() as group:
        others = [group.create_task(mover.run()), group.create_task(stop_all())]
        flying = {
            drone: group.create_task(program.run(after_s=departs_s[drone]))
            for drone, program in programs.items()
        }
        exit_codes = {drone: await flight for drone, flight in flying.items()}
        for other in others:
            other.cancel()
    return exit_codes


def _say(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


_PERIOD_S = 0.1


class Mover:
    """Passes the drones' positions to the radio, ten times a second."""

    def __init__(self, radio: EmulatedRadio, positions: Mapping[str, Callable[[], Position]]) -> None:
        self.lag_s = 0.0
        self._radio = radio
        self._positions = positions

    async def run(self) -> None:
        """Passes positions until cancelled; raises UpwashError if the radio has failed."""
        loop = asyncio.get_running_loop()
        due_s = loop.time()
        while True:
            for drone, position in self._positions.items():
                self._radio.move(drone, position())
            self.lag_s = max(self.lag_s, loop.time() - due_s)
            due_s = max(due_s + _PERIOD_S, loop.time())
            await asyncio.sleep(due_s - loop.time())
