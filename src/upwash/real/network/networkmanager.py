"""NetworkManager over D-Bus: calls that are bounded in time, and its signals. Nothing is decided here."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, TypeVar

from dbus_fast import BusType, DBusFastError, Message, MessageFlag, MessageType, Variant
from dbus_fast.aio import MessageBus
from dbus_fast.unpack import unpack_variants

from upwash.errors import NetworkError
from upwash.support.background import start
from upwash.support.text import printable

T = TypeVar("T")
NO_OBJECT = "/"

_NAME = "org.freedesktop.NetworkManager"
_ROOT = "/org/freedesktop/NetworkManager"
_DEVICE = f"{_NAME}.Device"
_WIRELESS = f"{_DEVICE}.Wireless"
_ACTIVE = f"{_NAME}.Connection.Active"
_PROPERTIES = "org.freedesktop.DBus.Properties"
_BUS = "org.freedesktop.DBus"
_SIGNALS = (
    f"type='signal',sender='{_NAME}',interface='{_DEVICE}',member='StateChanged'",
    f"type='signal',sender='{_NAME}',interface='{_ACTIVE}',member='StateChanged'",
    f"type='signal',sender='{_NAME}',interface='{_PROPERTIES}',member='PropertiesChanged',arg0='{_DEVICE}'",
    f"type='signal',sender='{_BUS}',interface='{_BUS}',member='NameOwnerChanged',arg0='{_NAME}'",
)

_ANSWER_S = 3.0  # the manager answers within milliseconds, or hangs
_LOWER_UP = 0x2  # of a device's InterfaceFlags: the carrier
_ABSENT = (f"{_BUS}.Error.ServiceUnknown", f"{_BUS}.Error.NameHasNoOwner")
_GONE = (
    f"{_NAME}.ConnectionNotActive",
    *(f"{_BUS}.Error.{name}" for name in ("UnknownObject", "UnknownMethod", "UnknownInterface")),
)
_FORBIDDEN = (f"{_NAME}.PermissionDenied", f"{_BUS}.Error.AccessDenied")


class DeviceKind(IntEnum):
    """The kinds of interfaces that matter here; NetworkManager has many more."""

    ETHERNET = 1
    WIFI = 2
    VETH = 20  # a cable between two namespaces


class DeviceState(IntEnum):
    """The states of an interface, as NetworkManager numbers them."""

    UNMANAGED = 10
    UNAVAILABLE = 20
    PREPARE = 40
    CONFIG = 50
    NEED_AUTH = 60
    IP_CONFIG = 70
    ACTIVATED = 100


class ConnectionState(IntEnum):
    """The states of an active connection that matter here."""

    ACTIVATED = 2
    DEACTIVATED = 4


@dataclass(frozen=True, slots=True)
class Profile:
    """A stored connection profile of a network."""

    path: str
    uuid: str
    name: str
    kind: str  # such as 802-11-wireless
    interface: str  # which alone it is for; "" for any
    settings: Mapping[str, Mapping[str, Any]]  # by section, without the secrets


@dataclass(frozen=True, slots=True)
class Device:
    """An interface as the manager sees it."""

    path: str
    interface: str
    kind: int
    state: int
    has_carrier: bool
    connection: str  # the path of the connection that is active on it, or NO_OBJECT


@dataclass(frozen=True, slots=True)
class NetworkConnection:
    """A profile that is active or being activated."""

    path: str
    uuid: str
    name: str
    kind: str
    devices: tuple[str, ...]
    addresses: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class NetworkState:
    """All interfaces, active connections, and profiles that this user may see."""

    devices: Sequence[Device]
    connections: Sequence[NetworkConnection]
    profiles: Sequence[Profile]

    def active_on(self, device: Device) -> NetworkConnection | None:
        """The connection that is active on the device."""
        return next((active for active in self.connections if active.path == device.connection), None)


@dataclass(frozen=True, slots=True)
class Signal:
    """The new state of the device or active connection at that path, with the manager's reason or 0.

    Signals of a carrier have no state. Without a path the manager, or the bus, is gone: after a restart all paths
    differ.
    """

    path: str = ""
    state: int | None = None
    before: int = 0  # the former state of a device
    reason: int = 0
    has_carrier: bool = False


class ObjectGoneError(NetworkError):
    """Raised when an object does not exist any more."""


class ForbiddenError(NetworkError):
    """Raised when this user has no permission."""


class NetworkManager:
    """NetworkManager on the system's bus; each method raises NetworkError on a failure, or after 3 s."""

    def __init__(self, bus: MessageBus, on_signal: Callable[[Signal], None]) -> None:
        self._bus = bus
        self._on_signal = on_signal
        bus.add_message_handler(self._receive)
        self._end = start(self._await_end(), name="the watch of the bus", failed=self._lose)

    @property
    def is_connected(self) -> bool:
        """Whether the bus can still be used."""
        return self._bus.connected

    async def close(self) -> None:
        """Disconnects from the bus."""
        self._bus.disconnect()
        await asyncio.wait([self._end])

    async def version(self) -> str:
        """The manager's version."""
        return str((await self._properties(_ROOT, _NAME))["Version"])

    async def may_join(self) -> bool:
        """Whether this process may activate and deactivate profiles without a password."""
        (permissions,) = await self._call(_ROOT, _NAME, "GetPermissions")
        return bool(permissions.get(f"{_NAME}.network-control") == "yes")

    async def state(self) -> NetworkState:
        """The devices, connections and profiles."""
        return NetworkState(await self.devices(), await self.connections(), await self.profiles())

    async def profiles(self) -> list[Profile]:
        """The stored profiles that this user may see."""
        (paths,) = await self._call(f"{_ROOT}/Settings", f"{_NAME}.Settings", "ListConnections")
        # Another user's own is forbidden.
        return await _existing(paths, self._profile, missing=(ObjectGoneError, ForbiddenError))

    async def _profile(self, path: str) -> Profile:
        (settings,) = await self._call(path, f"{_NAME}.Settings.Connection", "GetSettings")
        about = settings["connection"]
        name, interface = printable(about["id"]), about.get("interface-name", "")
        return Profile(path, about["uuid"], name, about["type"], interface, settings)

    async def devices(self) -> list[Device]:
        """The interfaces of this computer."""
        return await _existing((await self._properties(_ROOT, _NAME))["AllDevices"], self._device)

    async def _device(self, path: str) -> Device:
        about = await self._properties(path, _DEVICE)
        has_carrier = bool(about.get("InterfaceFlags", _LOWER_UP) & _LOWER_UP)
        kind, state, active = about["DeviceType"], about["State"], about["ActiveConnection"]
        return Device(path, about["Interface"], kind, state, has_carrier, active)

    async def connections(self) -> list[NetworkConnection]:
        """The active connections."""
        return await _existing((await self._properties(_ROOT, _NAME))["ActiveConnections"], self.connection)

    async def connection(self, path: str) -> NetworkConnection:
        """The active connection at a path; raises ObjectGoneError if it is no longer active."""
        about = await self._properties(path, _ACTIVE)
        addresses: list[str] = []
        for version in ("4", "6"):
            if (config := about.get(f"Ip{version}Config", NO_OBJECT)) != NO_OBJECT:
                data = (await self._properties(config, f"{_NAME}.IP{version}Config"))["AddressData"]
                addresses += [entry["address"] for entry in data if not entry["address"].startswith("fe80:")]
        uuid, kind, devices = about["Uuid"], about["Type"], tuple(about["Devices"])
        return NetworkConnection(path, uuid, printable(about["Id"]), kind, devices, tuple(addresses))

    async def activate(self, profile: Profile, device: Device | None) -> str:
        """Begins to activate a profile on the device, None if it makes its own; returns the connection's path."""
        place = device.path if device else NO_OBJECT
        (path,) = await self._call(_ROOT, _NAME, "ActivateConnection", "ooo", profile.path, place, NO_OBJECT)
        return str(path)

    async def deactivate(self, connection: str) -> None:
        """Begins to end a connection; raises ObjectGoneError if it has ended already."""
        await self._call(_ROOT, _NAME, "DeactivateConnection", "o", connection)

    async def scan(self, device: Device) -> None:
        """Asks a WiFi device to scan for networks; it refuses scans in quick succession."""
        await self._call(device.path, _WIRELESS, "RequestScan", "a{sv}", {})

    # --- the bus --------------------------------------------------------------------------------------------

    async def listen(self) -> None:
        """Subscribes to the manager's signals on the bus."""
        for rule in _SIGNALS:
            await self._call("/org/freedesktop/DBus", _BUS, "AddMatch", "s", rule)

    async def _properties(self, path: str, interface: str) -> dict[str, Any]:
        (properties,) = await self._call(path, _PROPERTIES, "GetAll", "s", interface)
        return dict(properties)

    async def _call(
        self, path: str, interface: str, member: str, signature: str = "", *arguments: object
    ) -> list[Any]:
        message = Message(
            destination=_BUS if interface == _BUS else _NAME,
            path=path,
            interface=interface,
            member=member,
            signature=signature,
            body=list(arguments),
            flags=MessageFlag.NO_AUTOSTART,
        )
        try:
            async with asyncio.timeout(_ANSWER_S):
                reply = await self._bus.call(message)
        except TimeoutError:
            raise NetworkError(
                f"NetworkManager did not answer {member} within {_ANSWER_S:.0f} s: it hangs; "
                "`systemctl restart NetworkManager` may help"
            ) from None
        except (OSError, EOFError, DBusFastError) as error:
            raise NetworkError(f"the system bus broke off: {error}") from error
        if reply is None:
            raise NetworkError("the system bus was left")
        if reply.message_type is MessageType.ERROR:
            raise _refusal(reply.error_name or "", str(reply.body[0]) if reply.body else "")
        return list(unpack_variants(reply.body))

    def _receive(self, message: Message) -> None:
        path = message.path or ""
        match message.interface, message.member, message.body:
            case name, "StateChanged", [int(state), int(before), int(reason)] if name == _DEVICE:
                self._on_signal(Signal(path, state, before, reason))
            case name, "StateChanged", [int(state), int(reason)] if name == _ACTIVE:
                self._on_signal(Signal(path, state, reason=reason))
            case _, "PropertiesChanged", [_, {"InterfaceFlags": Variant(value=int(flags))}, _]:
                self._on_signal(Signal(path, has_carrier=bool(flags & _LOWER_UP)))
            case _, "NameOwnerChanged", [str(name), str(before), _] if name == _NAME and before:
                self._on_signal(Signal())

    def _lose(self, _: Exception) -> None:
        self._bus.disconnect()  # so that the next call connects again
        self._on_signal(Signal())

    async def _await_end(self) -> None:
        try:
            await self._bus.wait_for_disconnect()  # type: ignore[no-untyped-call]
        except (OSError, EOFError, DBusFastError):
            self._on_signal(Signal())


async def connect_networkmanager(on_signal: Callable[[Signal], None]) -> NetworkManager:
    """The manager on the system's bus; `on_signal` gets each signal. Raises NetworkError without a bus."""
    try:
        async with asyncio.timeout(_ANSWER_S):
            bus = await MessageBus(bus_type=BusType.SYSTEM).connect()
    except (OSError, EOFError, TimeoutError, DBusFastError) as error:
        raise NetworkError(
            f"the system bus cannot be reached ({str(error) or 'no answer'}): is D-Bus installed and running?"
        ) from error
    manager = NetworkManager(bus, on_signal)
    try:
        await manager.listen()
    except BaseException:
        await manager.close()
        raise
    return manager


async def _existing(
    paths: Iterable[str],
    read: Callable[[str], Awaitable[T]],
    *,
    missing: tuple[type[NetworkError], ...] = (ObjectGoneError,),
) -> list[T]:
    found = []
    for path in paths:
        with contextlib.suppress(*missing):
            found.append(await read(path))
    return found


def _refusal(name: str, text: str) -> NetworkError:
    if name in _ABSENT:
        return NetworkError(
            "NetworkManager is not on the system bus: install it, and start it with "
            "`systemctl enable --now NetworkManager`"
        )
    if name in _GONE:
        return ObjectGoneError(text)
    if name in _FORBIDDEN:
        return ForbiddenError(
            f"NetworkManager does not let this user join networks ({text}): "
            "docs/networks.md has the polkit rule that does"
        )
    return NetworkError(f"NetworkManager refused: {printable(text or name)}")
