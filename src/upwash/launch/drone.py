"""How the programs on a drone reach its vehicle, its servers and its own services."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass

from upwash.config import DroneConfig, ServerConfig, is_on_this_machine
from upwash.config.values import MDNS
from upwash.core.geo import GeoPosition, LocalFrame
from upwash.errors import CredentialsError, UsageError
from upwash.mavlink.signing import Signing
from upwash.ports import Finder
from upwash.real.instances.runtime import OwnProcesses
from upwash.real.link.link import GrpcDialer
from upwash.real.mavlink import FlightSettings, MavlinkAutopilot, connect_autopilot
from upwash.real.mavlink.signing import read_signing
from upwash.real.trust.credentials import Credentials, read_credentials
from upwash.support.loading import extra
from upwash.support.text import command

_DEFAULTS = FlightSettings()
_ASKED_WITHIN_S = 10.0  # by a command that does not fly
_FOUND_WITHIN_S = 3.0  # an answer to a multicast question takes a second at most


@dataclass(frozen=True, slots=True)
class VehicleLink:
    """How the configured vehicle is reached."""

    connection: str
    home: GeoPosition
    ground_speed_m_s: float
    signing: Signing | None
    system: int | None

    async def connect(
        self,
        settings: FlightSettings = _DEFAULTS,
        *,
        within_s: float = _ASKED_WITHIN_S,
        waiting: Callable[[str, float], None] = lambda *_: None,
    ) -> MavlinkAutopilot:
        """Connects to it; raises AutopilotError where it is not heard, or not certain. See `connect_autopilot`."""
        return await connect_autopilot(
            self.connection,
            frame=LocalFrame(self.home),
            ground_speed_m_s=self.ground_speed_m_s,
            settings=settings,
            signing=self.signing,
            system=self.system,
            heartbeat_timeout_s=within_s,
            waiting=waiting,
        )


def vehicle_link(config: DroneConfig) -> VehicleLink:
    """How the configured vehicle is reached; raises UsageError where the configuration does not say."""
    return VehicleLink(
        home=home_of(config),
        connection=connection_of(config),
        ground_speed_m_s=config.mission.ground_speed_m_s,
        signing=signing_of(config),
        system=config.autopilot.system,
    )


def home_of(config: DroneConfig) -> GeoPosition:
    """The place where east and north are 0; raises UsageError where the configuration does not say."""
    home = config.mission.home
    if home is None:
        raise UsageError(
            "mission.home is missing: a flight needs the place where east and north are 0, such as "
            "home = { latitude_deg = 39.3666, longitude_deg = 22.9507 } in [mission]"
        )
    return home.place


def connection_of(config: DroneConfig) -> str:
    """The connection to the vehicle; raises UsageError where the configuration does not say."""
    if config.autopilot.connection is None:
        raise UsageError(
            "autopilot.connection is missing: say how the vehicle is reached, or use --autopilot"
        )
    return config.autopilot.connection


def signing_of(config: DroneConfig) -> Signing | None:
    """How messages to and from the vehicle are signed, None where they are not; raises CredentialsError."""
    key = config.autopilot.signing_key
    return read_signing(key) if key else None


def require_address(server: ServerConfig) -> None:
    """Raises UsageError for a server whose address is not known."""
    if not server.address:
        raise UsageError(f"server {server.name} has no address: a flight needs to know where its daemon is")


def require_certificates(server: ServerConfig, config: DroneConfig) -> None:
    """Raises UsageError if there are no certificates, and the server is not on this machine."""
    if config.keys is None and server.address and not is_on_this_machine(server.address):
        raise UsageError(
            f"server {server.name} at {server.address} needs certificates: make them with "
            f"{command('upwash', 'keys', 'DIR', '--server', server.name, '--drone', config.name)} and name them in "
            "[keys]; only servers on this machine are called without"
        )


def server_dialer(config: DroneConfig, credentials: Credentials | None) -> GrpcDialer:
    """Dials the drone's servers."""
    return GrpcDialer(
        config.name,
        credentials,
        max_message_bytes=config.max_message_bytes,
        max_reply_bytes={service.name: service.max_reply_bytes for service in config.services},
    )


def server_finder(config: DroneConfig) -> Finder | None:
    """Finds servers by mDNS; None if all addresses are configured. Raises UsageError without the library for it."""
    if all(server.address != MDNS for server in config.servers):
        return None
    with extra("discovery"):
        from upwash.real.network.discovery import find
    return functools.partial(find, within_s=_FOUND_WITHIN_S)


def drone_credentials(config: DroneConfig, *, valid_now: bool = True) -> Credentials | None:
    """The drone's certificate and key, None without [keys]; raises CredentialsError for another drone's certificate.

    With `valid_now`, also for a certificate that is not valid by this computer's clock.
    """
    keys = config.keys
    if keys is None:
        return None
    credentials = read_credentials(keys.authority, keys.certificate, keys.key, valid_now=valid_now)
    if config.name not in credentials.names:
        raise CredentialsError(
            f"the certificate is for {', '.join(credentials.names)}, but this drone is called {config.name}: "
            f'write name = "{credentials.names[0]}" at the top of its configuration, or make another certificate'
        )
    return credentials


def onboard(drone: str, *, max_message_bytes: int) -> OwnProcesses:
    """Starts and dials the drone's own services."""
    return OwnProcesses(drone, max_message_bytes=max_message_bytes)
