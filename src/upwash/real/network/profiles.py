"""Which connection profile and which interface a network needs, and what keeps them from being used."""

from __future__ import annotations

import shlex
from collections.abc import Collection, Iterable, Iterator, Sequence

from upwash.errors import NetworkError
from upwash.real.network.networkmanager import NO_OBJECT, Connection, Device, DeviceKind, DeviceState, Profile
from upwash.support.commands import command

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


def find_profile(network: str, profiles: Iterable[Profile]) -> Profile:
    """The profile with that UUID or name; raises NetworkError where there is none, or several."""
    found = [each for each in profiles if network in (each.uuid, each.name)]
    if not found:
        raise NetworkError(
            f"no connection profile {network} is on this drone: make it with `nmcli connection add`, as "
            "docs/networks.md shows"
        )
    if len(found) > 1:
        raise NetworkError(
            f"{len(found)} connection profiles are called {network}: name the right one by its UUID, one of "
            + ", ".join(each.uuid for each in found)
        )
    return found[0]


def find_device(profile: Profile, interfaces: Sequence[str], devices: Iterable[Device]) -> Device | None:
    """The first of the interfaces that the profile can be activated on; None for one that makes its own.

    Raises NetworkError where none is there.
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


def kind_name(kind: int) -> str:
    """What an interface of that kind is called."""
    return _KIND_NAMES.get(kind, "neither Ethernet nor WiFi")


def is_left_over(
    connection: Connection,
    *,
    interfaces: Collection[str],
    networks: Collection[str],
    devices: Iterable[Device],
) -> bool:
    """Whether what is active is one of the networks, on one of the interfaces or on one of its own."""
    if connection.uuid not in networks and connection.name not in networks:
        return False
    mine = [device.path for device in devices if device.interface in interfaces]
    return connection.kind in _MAKES_ITS_OWN_DEVICE or any(path in mine for path in connection.devices)


def interface_trouble(
    interface: str,
    *,
    networks: Collection[str],
    devices: Sequence[Device],
    connections: Iterable[Connection],
    profiles: Iterable[Profile],
) -> str:
    """What keeps the interface from being used for the networks, with the remedy; empty where nothing does."""
    device = next((each for each in devices if each.interface == interface), None)
    if device is None:
        if any(each.interface == interface and each.kind in _MAKES_ITS_OWN_DEVICE for each in profiles):
            return ""
        known = ", ".join(each.interface for each in devices if each.kind in _KIND_NAMES)
        return f"no such interface; NetworkManager knows {known or 'none'}"
    if device.state <= DeviceState.UNMANAGED:
        return "NetworkManager leaves it alone: " + command(
            "nmcli", "device", "set", interface, "managed", "yes"
        )
    if device.kind == DeviceKind.WIFI and device.state == DeviceState.UNAVAILABLE:
        return "its radio is switched off, or lacks its firmware: `nmcli radio wifi on`"
    if device.connection == NO_OBJECT:
        return ""
    active = next((each for each in connections if each.path == device.connection), None)
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


def profile_troubles(profile: Profile) -> Iterator[tuple[str, str]]:
    """What in the profile would do harm in flight, each with the setting that mends it."""
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
