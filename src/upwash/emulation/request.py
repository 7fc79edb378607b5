"""The request of the command to the enclosed emulation, and the outcome in the run's folder."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import msgspec

from upwash.config.drone import DroneConfig, NetworkConfig, ServerConfig, ServiceConfig
from upwash.config.drone_file import Presence, fleet_of, presences, read_drone_config
from upwash.config.truth import ServerTruth, server_truth
from upwash.config.values import HomeConfig
from upwash.errors import UsageError
from upwash.launch.processes import INTERRUPTED
from upwash.support.output_files import write_file

RadioKind = Literal["table", "ns3"]
ComputerKind = Literal["namespaces", "containers"]
_SOMEWHERE = HomeConfig(latitude_deg=39.3666, longitude_deg=22.9507)  # for scenarios of the plane alone
_MOST_STATIONS = 250  # on one server's network, by their addresses


@dataclass(frozen=True, slots=True)
class EmulatedDrone:
    """One drone of an emulation; its program starts `departs_s` after the emulation."""

    config: DroneConfig
    departs_s: float = 0.0


class EmulationRequest(msgspec.Struct, frozen=True, kw_only=True):
    """The request of the command, for the enclosed program."""

    scenarios: tuple[Path, ...]
    drones: int = 1  # of each scenario
    radio: RadioKind = "table"
    computers: ComputerKind = "namespaces"
    autopilots: tuple[str, ...] = ()  # how each drone's vehicle is reached; without any, stand-ins fly
    outside: int = -1  # a handle of their network namespace
    folder: Path

    def encoded(self) -> str:
        """The request as text, which `decoded` reads."""
        return msgspec.json.encode(self, enc_hook=str).decode()

    @classmethod
    def decoded(cls, text: str) -> EmulationRequest:
        """The request from its text."""
        return msgspec.json.decode(text, type=cls, dec_hook=lambda kind, value: kind(value))

    def read(self) -> tuple[EmulatedDrone, ...]:
        """The drones; raises UsageError."""
        drones = [
            EmulatedDrone(emulated(config), presence.departs_s)
            for file in self.scenarios
            for config, presence in _fleet(file)
            for _ in range(self.drones)
        ]
        require_same_servers([drone.config for drone in drones])
        if len(drones) > _MOST_STATIONS:
            raise UsageError(f"{len(drones)} drones are more than an emulation has addresses for")
        if self.autopilots and len(self.autopilots) != len(drones):
            raise UsageError(f"{len(drones)} drone(s) need as many autopilots: found {len(self.autopilots)}")
        return tuple(_named_apart(drones))


def _fleet(file: Path) -> Iterator[tuple[DroneConfig, Presence]]:
    config = read_drone_config(file)
    for drone, presence in zip(fleet_of(config), presences(config), strict=True):
        if presence.vanishes_s is not None:
            raise UsageError(
                f"{file.name}: {drone.name} vanishes, which is simulated only: remove its vanishes_s to emulate it"
            )
        yield drone, presence


def emulated(config: DroneConfig) -> DroneConfig:
    """The scenario as emulated: without noise, energy, faults, traces of links and delays of single calls.

    Calls on the drone take at least the configured time. The same scenario can be simulated, to compare.
    """
    replace = msgspec.structs.replace
    return replace(
        config,
        mission=replace(config.mission, home=config.mission.home or _SOMEWHERE),
        network=NetworkConfig(kind="stand-in", radios=config.network.radios),
        keys=None,
        services=tuple(
            replace(
                service,
                local_pace_s=service.local_call_s,
                local_first_extra_s=0.0,
                local_joining_slowdown={},
            )
            for service in config.services
        ),
        vehicle=replace(config.vehicle, track_csv=None, wind_csv=None, battery_csv=None),
        servers=tuple(
            replace(server, truth=replace(server.truth, first_extra_s=0.0, goodput_csv=None))
            for server in config.servers
        ),
        user=type(config.user)(),
        energy=None,
        noise=type(config.noise)(),
        faults=(),
    )


def left_out(config: DroneConfig) -> list[str]:
    """The names of the scenario's keys that an emulation leaves out."""
    found = {
        "user": config.user != type(config.user)(),
        "energy": config.energy is not None,
        "noise": config.noise != type(config.noise)(),
        "fault": bool(config.faults),
        "local_first_extra_s": any(service.local_first_extra_s for service in config.services),
        "local_joining_slowdown": any(
            share for service in config.services for share in service.local_joining_slowdown.values()
        ),
        "lanes": any(server.truth.lanes is not None for server in config.servers),
        "first_extra_s": any(server.truth.first_extra_s for server in config.servers),
        "goodput_csv": any(server.truth.goodput_csv for server in config.servers),
        "vehicle.track_csv, wind_csv or battery_csv": any(
            (config.vehicle.track_csv, config.vehicle.wind_csv, config.vehicle.battery_csv)
        ),
        "the spread of service_csv": any(server.truth.service_csv for server in config.servers),
    }
    return [name for name, there in found.items() if there]


def require_same_servers(configs: Sequence[DroneConfig]) -> None:
    """UsageError where the scenarios do not agree about the servers and their services."""
    for config in configs[1:]:
        if (config.servers, _at_servers(config)) != (configs[0].servers, _at_servers(configs[0])):
            raise UsageError(
                "scenarios that are emulated together need the same [[server]] and [[service]] tables"
            )


def _at_servers(config: DroneConfig) -> list[ServiceConfig]:
    """The services without their delays on the drone."""
    return [msgspec.structs.replace(service, local_call_s={}, local_pace_s={}) for service in config.services]


def _named_apart(drones: Sequence[EmulatedDrone]) -> list[EmulatedDrone]:
    if len({drone.config.name for drone in drones}) == len(drones):
        return list(drones)
    return [
        replace(drone, config=msgspec.structs.replace(drone.config, name=f"{drone.config.name}-{number}"))
        for number, drone in enumerate(drones, start=1)
    ]


def server_paces(server: ServerConfig, config: DroneConfig) -> dict[str, dict[str, float]]:
    """The least times of calls on the server, by service and profile key, so that calls take the scenario's time.

    An end-to-end time includes the transfer, which the link takes for itself.
    """
    truth = server_truth(server, config.services)
    return {
        service.name: _call_paces_s(server, truth, service)
        for service in config.services
        if service.name in truth.images
    }


def _call_paces_s(server: ServerConfig, truth: ServerTruth, service: ServiceConfig) -> dict[str, float]:
    transfer_s = 0.0
    if truth.radio == "fixed" and server.bandwidth_bit_s is not None:
        transfer_s = 8 * service.request_bytes / server.bandwidth_bit_s
    end_to_end_s = truth.remote_call_s.get(service.name, {})
    return {
        **truth.processing_s.get(service.name, {}),
        **{key: max(0.0, call_s - transfer_s) for key, call_s in end_to_end_s.items()},
    }


RADIO_LAG_LIMIT_S = 0.02  # more, and the radio's times mean nothing
POSITION_LAG_LIMIT_S = 0.5  # more, and a drone is metres away from where its radio believes it to be
_FILE = "emulation.json"


class EmulationOutcome(msgspec.Struct, frozen=True, kw_only=True):
    """How far an emulation was ever behind the clock, and each flight's exit code; the rest is in the event logs."""

    radio: RadioKind
    radio_lag_s: float
    position_lag_s: float
    exit_codes: Mapping[str, int]

    @property
    def valid(self) -> bool:
        """Whether nothing was so late that what was measured means nothing."""
        return self.radio_lag_s <= RADIO_LAG_LIMIT_S and self.position_lag_s <= POSITION_LAG_LIMIT_S

    @property
    def completed(self) -> bool:
        """Whether every flight ended as it should."""
        return not any(self.exit_codes.values())

    @property
    def interrupted(self) -> bool:
        """Whether a flight was ended by a Ctrl-C."""
        return INTERRUPTED in self.exit_codes.values()

    def write(self, folder: Path) -> None:
        """Leaves it in the folder."""
        record = msgspec.structs.asdict(self) | {"valid": self.valid}
        write_file(folder / _FILE, msgspec.json.format(msgspec.json.encode(record)) + b"\n")


def read_outcome(folder: Path) -> EmulationOutcome | None:
    """The outcome in the run's folder; None if the emulation did not end."""
    file = folder / _FILE
    return msgspec.json.decode(file.read_bytes(), type=EmulationOutcome) if file.exists() else None
