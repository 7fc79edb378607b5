"""Servers' networks, joined by NetworkManager: each is a connection profile that is on the drone before take-off."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Collection

from upwash.errors import NetworkError, UsageError
from upwash.eventlog import schema
from upwash.ports import Journal
from upwash.real.network.networkmanager import (
    ConnectionState,
    Device,
    DeviceKind,
    DeviceState,
    NetworkManager,
    ObjectGoneError,
    Signal,
    connect_networkmanager,
)
from upwash.real.network.profiles import find_device, find_profile, interface_trouble, is_left_over
from upwash.support.background import end, never, only_logged, start

_LEAVE_S = 15.0  # scripts of NetworkManager's dispatcher run first; the mission computes on meanwhile
_ADDRESS_AGAIN_S = 0.02  # a connection may count as activated a moment before its address is there
_SCAN_AGAIN_S = 10.0  # a network of the last scan is joined within half a second, others in four

_DEVICE_REASONS = {
    5: "no address: nothing answered by DHCP",
    6: "its address expired, and nothing renewed it",
    7: "its secret is missing or wrong: `nmcli connection modify` sets it",
    8: "the access point broke off",
    9: "its security settings do not fit the radio",
    10: "the radio could not agree with the access point",
    11: "the access point did not answer",
    15: "no address: DHCP did not start",
    16: "no address: DHCP failed",
    17: "no address: DHCP failed",
    36: "the interface was taken out",
    37: "the computer goes to sleep",
    38: "its profile was deleted",
    39: "someone disconnected it",
    40: "no carrier",
    53: "it is not in the air here, or, as some radios put it, its secret is wrong",
    60: "another network was activated on the interface",
    64: "its address is someone else's, too",
}
_NO_SECRETS = 7  # NetworkManager suspects the secret whenever an access point goes during the handshake
_NO_ADDRESS = (5, 15, 16, 17)
_CONNECTION_REASONS = {
    2: "someone disconnected it",
    4: "the VPN's service stopped",
    5: "the VPN gave no usable address",
    6: "the VPN's server did not answer",
    7: "the VPN's service did not start in time",
    8: "the VPN's service did not start",
    9: "its secret is missing: `nmcli connection modify` sets it",
    10: "its secret is wrong: `nmcli connection modify` sets it",
    11: "its profile was deleted",
    12: "the connection that it needs is not there",
    13: "its interface could not be made",
    14: "the interface was taken out",
}
_STAGES: dict[int, str] = {
    DeviceState.PREPARE: "it was being prepared",
    DeviceState.CONFIG: "it was being looked for",
    DeviceState.NEED_AUTH: "its secret was not accepted yet",
    DeviceState.IP_CONFIG: "it had no address yet",
    DeviceState.ACTIVATED: "it had no address yet",
}


class ManagedNetwork:
    """A radio whose networks NetworkManager joins, on the interfaces given and on no other."""

    def __init__(self, interfaces: Collection[str], networks: Collection[str], journal: Journal) -> None:
        self._interfaces = tuple(interfaces)
        self._networks = frozenset(networks)
        self._journal = journal
        self._manager: NetworkManager | None = None
        self._activation: _Activation | None = None
        self._is_untidy = True  # connections may be active that no leave() knows
        self._joined: set[str] = set()  # networks that were joined: their secrets are right
        self._scanning: asyncio.Task[None] | None = None

    async def open(self) -> None:
        """Leaves networks that an earlier flight left joined; raises UsageError if an interface cannot be used."""
        manager = await self._connected()
        state = await manager.state()
        for interface in self._interfaces:
            if trouble := interface_trouble(interface, self._networks, state):
                raise UsageError(f"network.interfaces: {interface}: {trouble}")
        await self._tidy(manager)
        self._scanning = start(self._keep_scanning(), name="scans for networks", failed=only_logged)

    async def join(self, network: str, *, timeout_s: float) -> None:
        """Activates the profile of that name or UUID, and waits for its address; raises NetworkError."""
        if self._activation is not None:
            raise NetworkError(f"cannot join {network} while {self._activation.network} is joined")
        self._activation = activation = _Activation(network, had_secret=network in self._joined)
        try:
            async with asyncio.timeout(timeout_s):
                await self._activate(activation)
            self._joined.add(network)
        except TimeoutError:
            why = f"{network} was not joined within {timeout_s:.1f} s: {activation.stage}"
            await self.leave()
            raise NetworkError(why) from None
        except BaseException:
            await self.leave()  # else it would go on joining
            raise

    async def lost(self) -> str:
        """Waits until the carrier is gone or the connection has ended, and returns why."""
        activation = self._activation
        if activation is None:
            await never()
        await activation.ended.wait()
        return activation.why

    async def leave(self) -> None:
        """Deactivates the joined or joining network; a failure is logged, and repaired by the next join."""
        activation = self._activation
        if activation is None:
            return
        try:
            async with asyncio.timeout(_LEAVE_S):
                await self._deactivate(activation)
        except (NetworkError, TimeoutError) as error:
            why = str(error) or f"it is still active after {_LEAVE_S:.0f} s"
            self._journal.record(schema.LeaveFailed(network=activation.network, why=why))
        finally:
            self._activation = None

    async def close(self) -> None:
        """Leaves the network, and stops using the interfaces."""
        await end(self._scanning)
        await self.leave()
        if self._manager is not None:
            if self._is_untidy:
                with contextlib.suppress(NetworkError):
                    await self._tidy(await self._connected())
            await self._manager.close()

    async def _activate(self, activation: _Activation) -> None:
        manager = await self._connected()
        if self._is_untidy:
            await self._tidy(manager)
        profile = find_profile(activation.network, await manager.profiles())
        device = find_device(profile, self._interfaces, await manager.devices())
        activation.follow(device)
        self._is_untidy = True  # it may be joined from now on, even if no answer comes
        activation.is_called(await manager.activate(profile, device))
        self._is_untidy = False
        await activation.settled.wait()
        if activation.why:
            raise NetworkError(f"{activation.network} cannot be joined: {activation.why}")
        while not (await manager.connection(activation.connection)).addresses:  # noqa: ASYNC110 - no signal
            await asyncio.sleep(_ADDRESS_AGAIN_S)

    async def _deactivate(self, activation: _Activation) -> None:
        if self._is_untidy:
            await self._tidy(await self._connected())
        elif self._manager is not None and activation.connection and not activation.down.is_set():
            self._is_untidy = True
            with contextlib.suppress(ObjectGoneError):
                await self._manager.deactivate(activation.connection)
                await activation.down.wait()
            self._is_untidy = False

    async def _tidy(self, manager: NetworkManager) -> None:
        devices = await manager.devices()
        for connection in await manager.connections():
            if is_left_over(connection, devices, self._interfaces, self._networks):
                with contextlib.suppress(ObjectGoneError):
                    await manager.deactivate(connection.path)
                self._journal.record(schema.LeftOver(network=connection.name))
        self._is_untidy = False

    async def _keep_scanning(self) -> None:
        while True:
            if self._activation is None and self._manager is not None:
                with contextlib.suppress(NetworkError):
                    for device in await self._manager.devices():
                        is_mine = device.interface in self._interfaces and device.kind == DeviceKind.WIFI
                        if is_mine and self._activation is None:  # still: a scan would hold a join up
                            await self._manager.scan(device)
            await asyncio.sleep(_SCAN_AGAIN_S)

    async def _connected(self) -> NetworkManager:
        if self._manager is None or not self._manager.is_connected:
            if self._manager is not None:
                await self._manager.close()
            self._manager = await connect_networkmanager(self._on_signal)
        return self._manager

    def _on_signal(self, signal: Signal) -> None:
        if not signal.path:
            self._is_untidy = True  # once it is back, what was active may be so again, under another path
        if self._activation is not None:
            self._activation.take_in(signal)


class _Activation:
    def __init__(self, network: str, *, had_secret: bool) -> None:
        self.network = network
        self._had_secret = had_secret  # the profile's secret was right before
        self.connection = ""  # its path, once the manager has named it
        self.settled = asyncio.Event()  # joined, or cannot be
        self.ended = asyncio.Event()  # cannot be used, or no longer: `why` says it
        self.down = asyncio.Event()  # the manager has deactivated it
        self.why = ""
        self._early: list[Signal] = []  # from before it had a path: of it, or of another
        self._device = ""  # its path
        self._has_carrier = True
        self._state = 0  # of the device
        self._reason = 0

    @property
    def stage(self) -> str:
        """The present step of the activation, for a message."""
        return _STAGES.get(self._state, "NetworkManager had not begun")

    def follow(self, device: Device | None) -> None:
        """Take in the device's signals, too."""
        if device is not None:
            self._device = device.path
            self._has_carrier = device.has_carrier

    def is_called(self, connection: str) -> None:
        """Take in the connection's signals, also those from before its path was known."""
        self.connection = connection
        for signal in self._early:
            self.take_in(signal)

    def take_in(self, signal: Signal) -> None:
        """Take in one signal, which may concern another network."""
        match signal:
            case Signal(""):
                self._end("NetworkManager has stopped")
            case Signal(self._device, None):
                self._has_carrier = signal.has_carrier
                if self.settled.is_set() and not signal.has_carrier:
                    self._end("its carrier is gone")
            case Signal(self._device, int(state), before, reason):
                self._state = state
                if reason and before >= DeviceState.PREPARE:  # earlier ones are about what was before
                    self._reason = reason
            case _ if not self.connection:
                self._early.append(signal)
            case Signal(self.connection, ConnectionState.ACTIVATED):
                self.settled.set()
            case Signal(self.connection, ConnectionState.DEACTIVATED):
                self._end(self._explanation(signal.reason))
                self.down.set()

    def _end(self, why: str) -> None:
        self.why = self.why or why
        self.settled.set()
        self.ended.set()

    def _explanation(self, reason: int) -> str:
        if not self._has_carrier and self._reason in (0, *_NO_ADDRESS):
            return "no carrier"
        if self._reason == _NO_SECRETS and self._had_secret:
            return "the access point did not answer; its secret was right before"
        if self._reason in _DEVICE_REASONS:
            return _DEVICE_REASONS[self._reason]
        known = _CONNECTION_REASONS.get(reason)
        return known or f"NetworkManager gave the reasons {self._reason} (device) and {reason} (connection)"
