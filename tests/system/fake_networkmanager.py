"""A NetworkManager that does as its script says, on a bus of its own: for what only WiFi and trouble can do."""

from __future__ import annotations

import asyncio
import contextlib
import shutil
import subprocess
from collections.abc import AsyncIterator, Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from dbus_fast import BusType, Message, MessageType, Variant
from dbus_fast.aio import MessageBus

NAME = "org.freedesktop.NetworkManager"
ROOT = "/org/freedesktop/NetworkManager"
DEVICE, ACTIVE = f"{NAME}.Device", f"{NAME}.Connection.Active"
WIFI, ETHERNET = 2, 1
LOWER_UP = 0x2

_BUS_CONFIG = """
<busconfig><type>system</type><listen>unix:path={socket}</listen><auth>EXTERNAL</auth>
<policy context="default"><allow user="*"/><allow own="*"/>
<allow send_destination="*"/><allow receive_sender="*"/></policy>
</busconfig>
"""


@contextlib.contextmanager
def bus_daemon(folder: Path) -> Iterator[str]:
    """The address of a bus that ends with the block."""
    program = shutil.which("dbus-daemon")
    if program is None:
        pytest.skip("dbus-daemon is not installed: tests/system/install-packages installs it")
    (folder / "bus.conf").write_text(_BUS_CONFIG.format(socket=folder / "bus"))
    command = [program, "--nofork", "--nopidfile", "--print-address=1", f"--config-file={folder}/bus.conf"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as daemon:
        assert daemon.stdout is not None
        try:
            yield daemon.stdout.readline().strip()
        finally:
            daemon.terminate()


@dataclass
class FakeDevice:
    interface: str
    kind: int = WIFI
    state: int = 30
    flags: int = 0x1 | LOWER_UP
    connection: str = "/"


@dataclass
class FakeProfile:
    name: str
    uuid: str
    kind: str = "802-11-wireless"
    settings: dict[str, dict[str, Variant]] = field(default_factory=dict)
    fails: int = 0  # with this reason of the device, instead of being activated
    fails_itself: int = 0  # with this reason of the connection
    is_stuck: bool = False  # at waiting for an address
    lacks_address: bool = False


EVERYTHING = frozenset(
    {"GetAll", "ListConnections", "GetSettings", "ActivateConnection", "DeactivateConnection", "RequestScan"}
)


@dataclass
class FakeManager:
    """NetworkManager, as far as its script goes."""

    devices: dict[str, FakeDevice]
    profiles: dict[str, FakeProfile]
    ignored: frozenset[str] = frozenset()  # the calls that get no answer
    may_join: str = "yes"
    refusal: tuple[str, str] | None = None  # of any activation: an error's name and text
    calls: list[str] = field(default_factory=list)
    connections: dict[str, tuple[str, str, int]] = field(default_factory=dict)  # profile, device, state
    _number: int = 0
    _bus: MessageBus | None = None

    async def start(self) -> None:
        self._bus = await MessageBus(bus_type=BusType.SYSTEM).connect()
        self._bus.add_message_handler(self._answer)
        await self._bus.request_name(NAME)

    async def stop(self) -> None:
        assert self._bus is not None
        self._bus.disconnect()
        await self._bus.wait_for_disconnect()  # type: ignore[no-untyped-call]

    async def restart(self) -> None:
        """What was active is still so, under another path."""
        await self.stop()
        self._number += 100
        self.connections = {f"{path}{self._number}": about for path, about in self.connections.items()}
        for path, (_, device, _) in self.connections.items():
            if device != "/":
                self.devices[device].connection = path
        await self.start()

    async def until(self, condition: Callable[[], bool]) -> None:
        """Lets everyone go on until it is so."""
        while not condition():  # noqa: ASYNC110 - the script has no events
            await asyncio.sleep(0.001)

    @property
    def active(self) -> list[str]:
        """The names of the profiles that are active, or on the way to it."""
        return [self.profiles[profile].name for profile, *_ in self.connections.values()]

    def activate(self, profile: int, device: int) -> None:
        """Has a profile be active, as if someone else had activated it."""
        connection = f"{ROOT}/ActiveConnection/someone{profile}"
        place = f"{ROOT}/Devices/{device}"
        self.connections[connection] = (f"{ROOT}/Settings/{profile}", place, 2)
        self.devices[place].connection, self.devices[place].state = connection, 100

    def set_carrier(self, device: str, *, is_up: bool) -> None:
        flags = 0x1 | LOWER_UP if is_up else 0x1
        self.devices[device].flags = flags
        changed = [DEVICE, {"InterfaceFlags": Variant("u", flags)}, []]
        self._signal(device, "org.freedesktop.DBus.Properties", "PropertiesChanged", "sa{sv}as", changed)

    def take_off_the_air(self, name: str) -> None:
        """The network is gone: for whoever is there, and for whoever comes."""
        for key, device, _ in self.connections.values():
            if self.profiles[key].name == name:
                self.set_carrier(device, is_up=False)
        for profile in self.profiles.values():
            profile.fails = 53 if profile.name == name else profile.fails

    def end(self, connection: str, *, device_reason: int, connection_reason: int = 3) -> None:
        """Has a connection end, and its device say why."""
        _, device, _ = self.connections.pop(connection)
        if device != "/":
            self._move(device, 120 if device_reason else 30, device_reason)
            self.devices[device].connection = "/"
            self._move(device, 30, 0)
        self._signal(connection, ACTIVE, "StateChanged", "uu", [4, connection_reason])

    # --- the bus --------------------------------------------------------------------------------------------

    def _answer(self, message: Message) -> Message | bool | None:
        if message.message_type is not MessageType.METHOD_CALL or message.destination == self._own_name():
            return None
        self.calls.append(f"{message.member}")
        if message.member in self.ignored:
            return True
        match message.member, message.body:
            case "GetAll", [interface]:
                return self._properties(message, str(interface))
            case "ListConnections", _:
                return Message.new_method_return(message, "ao", [list(self.profiles)])
            case "GetSettings", _:
                return Message.new_method_return(message, "a{sa{sv}}", [self._settings(str(message.path))])
            case "GetPermissions", _:
                rights = {f"{NAME}.network-control": self.may_join}
                return Message.new_method_return(message, "a{ss}", [rights])
            case "ActivateConnection", [profile, device, _]:
                return self._activate(message, str(profile), str(device))
            case "DeactivateConnection", [connection]:
                if connection not in self.connections:
                    return Message.new_error(message, f"{NAME}.ConnectionNotActive", "not active")
                asyncio.get_running_loop().call_soon(self._deactivate, str(connection))
                return Message.new_method_return(message)
            case "RequestScan", _:
                return Message.new_method_return(message)
        return Message.new_error(message, "org.freedesktop.DBus.Error.UnknownMethod", str(message.member))

    def _own_name(self) -> str | None:
        return self._bus.unique_name if self._bus else None

    def _properties(self, message: Message, interface: str) -> Message:
        path = str(message.path)
        about: dict[str, Variant]
        if interface == NAME:
            about = {
                "Version": Variant("s", "1.99"),
                "AllDevices": Variant("ao", list(self.devices)),
                "ActiveConnections": Variant("ao", list(self.connections)),
            }
        elif interface == DEVICE and path in self.devices:
            device = self.devices[path]
            about = {
                "Interface": Variant("s", device.interface),
                "DeviceType": Variant("u", device.kind),
                "State": Variant("u", device.state),
                "InterfaceFlags": Variant("u", device.flags),
                "ActiveConnection": Variant("o", device.connection),
            }
        elif interface == ACTIVE and path in self.connections:
            key, place, state = self.connections[path]
            profile = self.profiles[key]
            about = {
                "Uuid": Variant("s", profile.uuid),
                "Id": Variant("s", profile.name),
                "Type": Variant("s", profile.kind),
                "State": Variant("u", state),
                "Devices": Variant("ao", [place] if place != "/" else []),
                "Ip4Config": Variant("o", f"{ROOT}/IP4Config/{key.rpartition('/')[2]}"),
                "Ip6Config": Variant("o", "/"),
            }
        elif interface == f"{NAME}.IP4Config":
            profile = self.profiles[f"{ROOT}/Settings/{path.rpartition('/')[2]}"]
            data = [] if profile.lacks_address else [{"address": Variant("s", "10.1.1.2")}]
            about = {"AddressData": Variant("aa{sv}", data)}
        else:
            return Message.new_error(message, "org.freedesktop.DBus.Error.UnknownObject", path)
        return Message.new_method_return(message, "a{sv}", [about])

    def _settings(self, path: str) -> dict[str, dict[str, Variant]]:
        profile = self.profiles[path]
        about = {
            "id": Variant("s", profile.name),
            "uuid": Variant("s", profile.uuid),
            "type": Variant("s", profile.kind),
        }
        return {**profile.settings, "connection": {**about, **profile.settings.get("connection", {})}}

    def _activate(self, message: Message, profile: str, device: str) -> Message:
        if self.refusal is not None:
            return Message.new_error(message, *self.refusal)
        for path in [path for path, (_, place, _) in self.connections.items() if place == device != "/"]:
            self.end(path, device_reason=60)
        self._number += 1
        connection = f"{ROOT}/ActiveConnection/{self._number}"
        self.connections[connection] = (profile, device, 1)
        if device != "/":
            self.devices[device].connection = connection
        asyncio.get_running_loop().call_soon(self._go_on, connection)
        return Message.new_method_return(message, "o", [connection])

    def _go_on(self, connection: str) -> None:
        if connection not in self.connections:
            return
        key, device, _ = self.connections[connection]
        profile = self.profiles[key]
        if device != "/":
            for state in (40, 50, 70):
                self._move(device, state, 0)
        if profile.is_stuck:
            return
        if profile.fails or profile.fails_itself:
            self.end(connection, device_reason=profile.fails, connection_reason=profile.fails_itself or 3)
            return
        self.connections[connection] = (key, device, 2)
        if device != "/":
            self._move(device, 100, 0)
        self._signal(connection, ACTIVE, "StateChanged", "uu", [2, 1])

    def _deactivate(self, connection: str) -> None:
        if connection in self.connections:
            self.end(connection, device_reason=39, connection_reason=2)

    def _move(self, device: str, state: int, reason: int) -> None:
        before, self.devices[device].state = self.devices[device].state, state
        self._signal(device, DEVICE, "StateChanged", "uuu", [state, before, reason])

    def _signal(self, path: str, interface: str, member: str, signature: str, body: list[Any]) -> None:
        assert self._bus is not None
        self._bus.send(Message.new_signal(path, interface, member, signature, body))


@contextlib.asynccontextmanager
async def running(*devices: FakeDevice, profiles: tuple[FakeProfile, ...]) -> AsyncIterator[FakeManager]:
    """A manager with these devices and profiles, on the bus that DBUS_SYSTEM_BUS_ADDRESS names."""
    manager = FakeManager(
        {f"{ROOT}/Devices/{number}": device for number, device in enumerate(devices, start=1)},
        {f"{ROOT}/Settings/{number}": profile for number, profile in enumerate(profiles, start=1)},
    )
    await manager.start()
    try:
        yield manager
    finally:
        await manager.stop()
