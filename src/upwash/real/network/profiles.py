"""Which connection profile and interface a network needs, and why they cannot be used."""

from __future__ import annotations

import shlex
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence

from upwash.errors import NetworkError
from upwash.real.network import SurveyFinding
from upwash.real.network.networkmanager import (
    Device,
    DeviceKind,
    DeviceState,
    NetworkConnection,
    NetworkState,
    Profile,
    connect_networkmanager,
)
from upwash.support.text import command

_FITS: dict[str, tuple[int, ...]] = {
    "802-3-ethernet": (DeviceKind.ETHERNET, DeviceKind.VETH),
    "802-11-wireless": (DeviceKind.WIFI,),
}
_KIND_NAMES: dict[int, str] = {
    DeviceKind.ETHERNET: "Ethernet",
    DeviceKind.VETH: "Ethernet",
    DeviceKind.WIFI: "WiFi",
}
_MAKES_ITS_OWN_DEVICE = ("vpn", "wireguard")
_ANY_RADIO = "connection.interface-name ''"


def find_profile(network: str, profiles: Iterable[Profile]) -> Profile:
    """The profile with that UUID or name; raises NetworkError if there is none, or several."""
    found = [profile for profile in profiles if network in (profile.uuid, profile.name)]
    if not found:
        raise NetworkError(
            f"no connection profile {network} is on this drone: make it with `nmcli connection add`, as "
            "docs/networks.md shows"
        )
    if len(found) > 1:
        raise NetworkError(
            f"{len(found)} connection profiles are called {network}: name the right one by its UUID, one of "
            + ", ".join(profile.uuid for profile in found)
        )
    return found[0]


def find_device(profile: Profile, interfaces: Sequence[str], devices: Iterable[Device]) -> Device | None:
    """The first of the interfaces on which the profile can be activated; None for a profile that makes its own.

    Raises NetworkError if there is none.
    """
    if profile.interface and profile.interface not in interfaces:
        raise NetworkError(
            f"{profile.name} is for {profile.interface}, which is not among network.interfaces: "
            + modified(profile.name, f"connection.interface-name {interfaces[0]}")
        )
    if profile.kind in _MAKES_ITS_OWN_DEVICE:
        return None
    by_name = {device.interface: device for device in devices}
    for interface in [profile.interface] if profile.interface else interfaces:
        device = by_name.get(interface)
        if device is not None and device.kind in _FITS.get(profile.kind, (device.kind,)):
            return device
    raise NetworkError(
        f"{profile.name} needs an interface that is not there: {profile.interface or profile.kind}"
    )


def is_left_over(
    connection: NetworkConnection,
    devices: Iterable[Device],
    interfaces: Collection[str],
    networks: Collection[str],
) -> bool:
    """Whether the connection is of one of these networks, on one of these interfaces or on its own interface."""
    if connection.uuid not in networks and connection.name not in networks:
        return False
    mine = [device.path for device in devices if device.interface in interfaces]
    return connection.kind in _MAKES_ITS_OWN_DEVICE or any(path in mine for path in connection.devices)


def interface_trouble(interface: str, networks: Collection[str], state: NetworkState) -> str:
    """Why the interface cannot be used for the networks, with the remedy; "" if it can."""
    device = next((device for device in state.devices if device.interface == interface), None)
    if device is None:
        makers = (profile for profile in state.profiles if profile.kind in _MAKES_ITS_OWN_DEVICE)
        if any(profile.interface == interface for profile in makers):
            return ""
        known = ", ".join(device.interface for device in state.devices if device.kind in _KIND_NAMES)
        return f"no such interface; NetworkManager knows {known or 'none'}"
    if device.state <= DeviceState.UNMANAGED:
        free = command("nmcli", "device", "set", interface, "managed", "yes")
        return f"NetworkManager leaves it alone: {free}"
    if device.kind == DeviceKind.WIFI and device.state == DeviceState.UNAVAILABLE:
        return "its radio is switched off, or lacks its firmware: `nmcli radio wifi on`"
    active = state.active_on(device)
    if active is None or active.uuid in networks or active.name in networks:
        return ""
    return (
        f"{active.name} is active on it: name another interface, or free it: "
        f"{modified(active.name, 'connection.autoconnect no')} and "
        + command("nmcli", "connection", "down", active.name)
    )


def modified(profile: str, settings: str) -> str:
    """The command that changes these settings of a connection profile, such as "ipv4.never-default yes"."""
    return command("nmcli", "connection", "modify", profile, *shlex.split(settings))


def _profile_troubles(profile: Profile) -> Iterator[tuple[str, str]]:
    """The settings of the profile that would do harm in flight, each with the correct setting."""
    sections = profile.settings
    if sections["connection"].get("autoconnect", True):
        yield "joins itself whenever it can", "connection.autoconnect no"
    for section in ("ipv4", "ipv6"):
        values = sections.get(section, {})
        is_used = values.get("method", "auto") not in ("disabled", "ignore", "link-local", "shared")
        if is_used and not values.get("never-default", False):
            yield f"may take over the way to the Internet ({section})", f"{section}.never-default yes"
    for section, flags in (
        ("802-11-wireless-security", "psk-flags"),
        ("802-11-wireless-security", "wep-key-flags"),
        ("802-1x", "password-flags"),
    ):
        if sections.get(section, {}).get(flags, 0):
            yield "its secret is not stored for the whole system", f"{section}.{flags} 0"


# --- before take-off ----------------------------------------------------------------------------------------


async def survey_networks(
    interfaces: Sequence[str], servers: Mapping[str, str], *, radios: int = 1
) -> list[SurveyFinding]:
    """The state of the manager, of each interface, and of each server's network; nothing is joined.

    `servers` has the network of each server. Raises NetworkError without a manager.
    """
    manager = await connect_networkmanager(lambda _: None)
    try:
        version, may_join = await manager.version(), await manager.may_join()
        state = await manager.state()
    finally:
        await manager.close()
    forbidden = "this user may not join networks: docs/networks.md has the polkit rule that lets it"
    findings = [SurveyFinding("NetworkManager", version, "" if may_join else forbidden)]
    for interface in interfaces:
        trouble = interface_trouble(interface, list(servers.values()), state)
        findings.append(SurveyFinding(interface, _found_of(interface, state), trouble))
    for server, network in servers.items():
        found, trouble = _usable(network, interfaces, state, radios)
        findings.append(SurveyFinding(server, found, trouble))
    return findings


def _found_of(interface: str, state: NetworkState) -> str:
    device = next((device for device in state.devices if device.interface == interface), None)
    if device is None:
        return "not there"
    active = state.active_on(device)
    kind = _KIND_NAMES.get(device.kind, "neither Ethernet nor WiFi")
    carrier = "" if device.has_carrier else ", no carrier now"
    return f"{kind}, {f'{active.name} is active' if active else 'idle'}{carrier}"


def _usable(network: str, interfaces: Sequence[str], state: NetworkState, radios: int) -> tuple[str, str]:
    """A network's profile and interface in words, and its trouble; "" without trouble."""
    found = f"{network}: no profile"
    try:
        profile = find_profile(network, state.profiles)
        found = f"{profile.name}, {profile.kind}"
        device = find_device(profile, interfaces, state.devices)
    except NetworkError as error:
        return found, str(error)
    found += f", on {device.interface}" if device else ", makes its own interface"
    troubles = list(_profile_troubles(profile))
    if radios > 1 and profile.interface:
        why = f"is for {profile.interface} alone, and either radio may have to join it"
        troubles.append((why, _ANY_RADIO))
    if not troubles:
        return found, ""
    remedy = modified(profile.name, " ".join(setting for _, setting in troubles))
    return found, f"{', '.join(trouble for trouble, _ in troubles)}: {remedy}"
