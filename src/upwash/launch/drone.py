"""How the programs on a drone reach its vehicle, its networks, its servers and its own services."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Sequence

from upwash.config.drone import DroneConfig, ServerConfig
from upwash.config.places import true_areas
from upwash.config.truth import server_truth
from upwash.config.values import MDNS, is_on_this_machine
from upwash.core.geo import GeoPosition, LocalFrame
from upwash.drone.networks import NetworkCell, NoNetwork, PositionNetwork
from upwash.errors import CredentialsError, UsageError
from upwash.mavlink.signing import Signing
from upwash.ports import Finder, Journal, Network, Whereabouts
from upwash.real.link.link import GrpcDialer
from upwash.real.mavlink import FlightSettings, MavlinkAutopilot, connect_autopilot
from upwash.real.mavlink.signing import read_signing
from upwash.real.trust.credentials import Credentials, read_credentials
from upwash.support.loading import extra
from upwash.support.text import command

_DEFAULTS = FlightSettings()
_ASKED_WITHIN_S = 10.0  # by a command that does not fly
_FOUND_WITHIN_S = 3.0  # an answer to a multicast question takes a second at most


async def connect_vehicle(
    config: DroneConfig,
    settings: FlightSettings = _DEFAULTS,
    *,
    within_s: float = _ASKED_WITHIN_S,
    waiting: Callable[[str, float], None] = lambda *_: None,
) -> MavlinkAutopilot:
    """The configured vehicle. See `connect_autopilot`.

    Raises UsageError if home or connection is missing, AutopilotError if the vehicle is silent or unknown.
    """
    return await connect_autopilot(
        connection_of(config),
        frame=LocalFrame(home_of(config)),
        ground_speed_m_s=config.mission.ground_speed_m_s,
        settings=settings,
        signing=signing_of(config),
        system=config.autopilot.system,
        heartbeat_timeout_s=within_s,
        waiting=waiting,
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


async def opened_networks(
    config: DroneConfig, autopilot: Whereabouts, journal: Journal, stack: contextlib.AsyncExitStack
) -> list[Network]:
    """A network for each radio, until the stack is closed; raises NetworkError if a radio cannot be used."""
    radios = range(config.network.radios)
    if config.network.kind == "wired":
        return [NoNetwork() for _ in radios]
    if config.network.kind == "networkmanager":
        return [
            await _managed_network(interfaces, config, journal, stack) for interfaces in _per_radio(config)
        ]
    areas = true_areas(config)
    cells: dict[str, list[NetworkCell]] = {}
    for server in config.servers:
        truth = server_truth(server, config.services)
        cell = NetworkCell(areas[server.name], truth.join_s, leave_s=truth.leave_s)
        cells.setdefault(server.network, []).append(cell)
    return [PositionNetwork(cells, lambda: autopilot.position) for _ in radios]


async def network_on_the_ground(
    config: DroneConfig, journal: Journal, stack: contextlib.AsyncExitStack
) -> Network:
    """The network of the first radio, before a flight; nothing is joined if a position stands in for networks."""
    if config.network.kind != "networkmanager":
        return NoNetwork()
    return await _managed_network(_per_radio(config)[0], config, journal, stack)


def _per_radio(config: DroneConfig) -> list[tuple[str, ...]]:
    """The interfaces of each radio: a single radio may use all, and each of several has one of its own."""
    interfaces = config.network.interfaces
    return [interfaces] if config.network.radios == 1 else [(interface,) for interface in interfaces]


async def _managed_network(
    interfaces: Sequence[str], config: DroneConfig, journal: Journal, stack: contextlib.AsyncExitStack
) -> Network:
    with extra("network"):
        from upwash.real.network.network import ManagedNetwork
    network = ManagedNetwork(interfaces, [server.network for server in config.servers], journal)
    stack.push_async_callback(network.close)
    await network.open()
    return network
