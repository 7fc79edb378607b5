"""The emulated programs, the computers that they run on, and their configuration files."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec
import tomli_w

from upwash.config.daemon import DaemonConfig, DaemonKeysConfig, IdentityConfig, ImageConfig, PeerConfig
from upwash.config.drone import CameraConfig, DroneConfig, PlanFile, ServerConfig
from upwash.config.flight_times import told_in_numbers
from upwash.config.kept_maps import CoverageFile, DemandFile
from upwash.config.runtime import RuntimeConfig
from upwash.config.truth import server_truth
from upwash.config.values import KeysConfig
from upwash.emulation.field import Field, drone_namespace, server_namespace
from upwash.emulation.namespaces import inside, make_namespace
from upwash.emulation.request import server_paces
from upwash.launch.processes import FlightProgram, ready_program
from upwash.real.trust.authority import keys_in
from upwash.support.output_files import write_file

_PARK_SEED = 1  # of the photos of a drone that has no camera


@contextlib.contextmanager
def ready_daemon(server: ServerConfig, field: Field, computers: Computers, folder: Path) -> Iterator[None]:
    """Runs the server's daemon until the end of the block."""
    file = daemon_file(server, field, computers, folder)
    through = computers.inside(server_namespace(server.name))
    with ready_program(server.name, folder, "serve", "--config", str(file), through=through):
        yield


def daemon_file(server: ServerConfig, field: Field, computers: Computers, folder: Path) -> Path:
    """Prepares the server's computer, writes its daemon's configuration, and returns the file."""
    daemon = daemon_config(
        server,
        field.drones[0],
        listen=field.daemon_address(server),
        peers=field.peers(server),
        keys=keys_in(folder / "keys", server.name),
    )
    runtime = computers.equip(server_namespace(server.name), daemon, subnet=field.subnet(server))
    file = folder / f"{server.name}.toml"
    write_config(file, msgspec.structs.replace(daemon, runtime=runtime))
    return file


def drone_file(drone: DroneConfig, field: Field, folder: Path, *, vehicle: str) -> Path:
    """Writes the drone's configuration, and returns the file; `vehicle` is the connection to its vehicle."""
    file = folder / f"{drone.name}.toml"
    replace = msgspec.structs.replace
    servers = tuple(replace(server, address=field.daemon_address(server)) for server in drone.servers)
    write_config(
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


def flight_program(
    drone: DroneConfig, field: Field, computers: Computers, folder: Path, *, vehicle: str
) -> FlightProgram:
    """The drone's `upwash fly`; its output is printed."""
    prefix = f"{drone.name}: " if len(field.drones) > 1 else ""

    def pass_on(line: str) -> None:
        sys.stdout.write(f"{prefix}{line}\n")
        sys.stdout.flush()

    return FlightProgram(
        drone_file(drone, field, folder, vehicle=vehicle),
        folder / f"{drone.name}.jsonl",
        say=pass_on,
        through=computers.inside(drone_namespace(drone.name)),
    )


def _camera(config: CameraConfig) -> CameraConfig:
    if (config.folder, config.device, config.park_seed, config.plug_in) == (None, None, None, None):
        return msgspec.structs.replace(config, park_seed=_PARK_SEED)
    return config


def write_config(file: Path, config: DroneConfig | DaemonConfig) -> None:
    """Writes the configuration as a file; reading it gives the same configuration."""
    tables = _without_nothing(msgspec.to_builtins(config, enc_hook=_as_text))
    write_file(file, tomli_w.dumps(tables).encode())


def daemon_config(
    server: ServerConfig, config: DroneConfig, *, listen: str, peers: Mapping[str, str], keys: KeysConfig
) -> DaemonConfig:
    """The configuration of the daemon that acts as one of the drone's servers."""
    truth = server_truth(server, config.services)
    paces = server_paces(server, config)
    return DaemonConfig(
        listen=listen,
        keys=DaemonKeysConfig(authority=keys.authority, certificate=keys.certificate, key=keys.key),
        images=tuple(
            ImageConfig(
                name=service.name,
                program=service.program,
                pace_s=paces[service.name],
                start_pace_s=truth.start_s,
            )
            for service in config.services
            if service.name in paces
        ),
        identities=(
            IdentityConfig(name=server.name, slots=truth.slots, turn_s=truth.turn_s, images=tuple(paces)),
        ),
        peers=tuple(PeerConfig(name=name, address=address) for name, address in peers.items()),
    )


def _as_text(value: object) -> str:
    if isinstance(value, CoverageFile | DemandFile | PlanFile):
        return str(value.file.absolute())
    if isinstance(value, Path):
        return str(value)
    raise NotImplementedError(f"no text for {value!r}")


def _without_nothing(value: Any) -> Any:
    """The value without None, which TOML does not have."""
    if isinstance(value, dict):
        return {key: _without_nothing(item) for key, item in value.items() if item is not None}
    return [_without_nothing(item) for item in value] if isinstance(value, list | tuple) else value


class Computers:
    """Computers that are network namespaces and nothing more: they share this machine's files and processes."""

    def make(self, name: str) -> None:
        """Makes a namespace."""
        make_namespace(name)

    def inside(self, name: str) -> tuple[str, ...]:
        """The words that run a command in the namespace."""
        return inside(name)

    def equip(self, name: str, daemon: DaemonConfig, *, subnet: str) -> RuntimeConfig:
        """Prepare the computer for the daemon's services; return their runtime: here, processes of the daemon.

        Services with addresses of their own get them from the subnet.
        """
        return RuntimeConfig(sandbox_as_root=True)  # who else may make networks
