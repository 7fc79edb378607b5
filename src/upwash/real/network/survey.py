"""What NetworkManager has ready for a flight, seen without joining anything."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from upwash.errors import NetworkError
from upwash.real.network.finding import Finding
from upwash.real.network.networkmanager import Connection, Device, Profile, connect_networkmanager
from upwash.real.network.profiles import (
    find_device,
    find_profile,
    interface_trouble,
    kind_name,
    modified,
    profile_troubles,
)

_ANY_RADIO = "connection.interface-name ''"


async def survey_networks(
    interfaces: Sequence[str], servers: Mapping[str, str], *, radios: int = 1
) -> list[Finding]:
    """The manager, each interface, and the network of each server; raises NetworkError without a manager."""
    manager = await connect_networkmanager(lambda _: None)
    try:
        version, may_join = await manager.version(), await manager.may_join()
        devices, connections = await manager.devices(), await manager.connections()
        profiles = await manager.profiles()
    finally:
        await manager.close()
    forbidden = "this user may not join networks: docs/networks.md has the polkit rule that lets it"
    findings = [Finding("NetworkManager", version, "" if may_join else forbidden)]
    networks = list(servers.values())
    for interface in interfaces:
        trouble = interface_trouble(
            interface, networks=networks, devices=devices, connections=connections, profiles=profiles
        )
        findings.append(Finding(interface, _interface_found(interface, devices, connections), trouble))
    for server, network in servers.items():
        findings.append(_network_finding(server, network, interfaces, profiles, devices, radios=radios))
    return findings


def _interface_found(interface: str, devices: Sequence[Device], connections: Sequence[Connection]) -> str:
    device = next((each for each in devices if each.interface == interface), None)
    if device is None:
        return "not there"
    active = next((each.name for each in connections if each.path == device.connection), "")
    carrier = "" if device.has_carrier else ", no carrier now"
    return f"{kind_name(device.kind)}, {f'{active} is active' if active else 'idle'}{carrier}"


def _network_finding(
    server: str,
    network: str,
    interfaces: Sequence[str],
    profiles: Sequence[Profile],
    devices: Sequence[Device],
    *,
    radios: int,
) -> Finding:
    try:
        profile = find_profile(network, profiles)
    except NetworkError as error:
        return Finding(server, f"{network}: no profile", str(error))
    try:
        device = find_device(profile, interfaces, devices)
    except NetworkError as error:
        return Finding(server, f"{profile.name}, {profile.kind}", str(error))
    place = f"on {device.interface}" if device else "makes its own interface"
    found = f"{profile.name}, {profile.kind}, {place}"
    troubles = list(profile_troubles(profile))
    if radios > 1 and profile.interface:
        troubles.append(
            (f"is for {profile.interface} alone, and either radio may have to join it", _ANY_RADIO)
        )
    if not troubles:
        return Finding(server, found)
    settings = " ".join(setting for _, setting in troubles)
    return Finding(
        server,
        found,
        f"{', '.join(trouble for trouble, _ in troubles)}: {modified(profile.name, settings)}",
    )
