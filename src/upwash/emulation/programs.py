"""The emulated programs: an edge daemon, a vehicle and a flight, each a process in its namespace."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from pathlib import Path

import msgspec

from upwash.config import CameraConfig, DroneConfig, ServerConfig, told_in_numbers
from upwash.emulation.computers import Computers
from upwash.emulation.field import Field, drone_namespace, server_namespace
from upwash.emulation.files import daemon_config, write_daemon_file, write_drone_file
from upwash.launch.flight_program import FlightProgram
from upwash.launch.processes import ready_program
from upwash.real.trust.authority import keys_in

_PARK_SEED = 1  # of the photos of a drone that has no camera


@contextlib.contextmanager
def ready_daemon(server: ServerConfig, field: Field, computers: Computers, folder: Path) -> Iterator[None]:
    """Runs the server's daemon until the end of the block."""
    file = daemon_file(server, field, computers, folder)
    through = computers.inside(server_namespace(server.name))
    with ready_program(server.name, folder, "serve", "--config", str(file), through=through):
        yield


def daemon_file(server: ServerConfig, field: Field, computers: Computers, folder: Path) -> Path:
    """Writes what the server's daemon is told, once its computer can run the services, and returns the file."""
    daemon = daemon_config(
        server,
        field.drones[0],
        listen=field.daemon_address(server),
        peers=field.peers(server),
        keys=keys_in(folder / "keys", server.name),
    )
    runtime = computers.equip(server_namespace(server.name), daemon, subnet=field.subnet(server))
    file = folder / f"{server.name}.toml"
    write_daemon_file(file, msgspec.structs.replace(daemon, runtime=runtime))
    return file


def drone_file(drone: DroneConfig, field: Field, folder: Path, *, vehicle: str) -> Path:
    """Writes what the drone is told, and returns the file; `vehicle` is how its vehicle is reached."""
    file = folder / f"{drone.name}.toml"
    replace = msgspec.structs.replace
    servers = tuple(replace(server, address=field.daemon_address(server)) for server in drone.servers)
    write_drone_file(
        file,
        replace(
            drone,
            autopilot=replace(drone.autopilot, connection=vehicle, signing_key=None),
            camera=_camera(drone.camera),
            keys=keys_in(folder / "keys", drone.name),
            servers=servers,
            vehicle=told_in_numbers(drone.vehicle),
        ),
    )
    return file


class Flight:
    """One drone's `upwash fly`, from its configuration to its exit code."""

    def __init__(
        self,
        drone: DroneConfig,
        field: Field,
        computers: Computers,
        folder: Path,
        *,
        vehicle: str,
        departs_s: float = 0.0,
    ) -> None:
        self.drone = drone.name
        self._departs_s = departs_s
        self._prefix = f"{drone.name}: " if len(field.drones) > 1 else ""
        self._program = FlightProgram(
            drone_file(drone, field, folder, vehicle=vehicle),
            folder / f"{drone.name}.jsonl",
            say=self._pass_on,
            through=computers.inside(drone_namespace(drone.name)),
        )

    async def fly(self) -> int:
        """Flies once it is time, passes on what the program prints, and returns its exit code."""
        return await self._program.run(after_s=self._departs_s)

    def _pass_on(self, line: str) -> None:
        sys.stdout.write(f"{self._prefix}{line}\n")
        sys.stdout.flush()

    def stop(self) -> None:
        """Has it end its mission and land, as a Ctrl-C would."""
        self._program.stop()


def _camera(config: CameraConfig) -> CameraConfig:
    """The drone's own, or one whose photos are rendered."""
    if (config.folder, config.device, config.park_seed) == (None, None, None):
        return msgspec.structs.replace(config, park_seed=_PARK_SEED)
    return config
