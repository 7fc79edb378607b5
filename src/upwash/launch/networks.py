"""Puts a drone's radios on the networks that its configuration names."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence

from upwash.config import DroneConfig, server_truth, true_areas
from upwash.drone.networks import NetworkCell, NoNetwork, PositionNetwork
from upwash.ports import Autopilot, Journal, Network
from upwash.support.loading import extra


async def opened_networks(
    config: DroneConfig, autopilot: Autopilot, journal: Journal, stack: contextlib.AsyncExitStack
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
    return [interfaces] if config.network.radios == 1 else [(each,) for each in interfaces]


async def _managed_network(
    interfaces: Sequence[str], config: DroneConfig, journal: Journal, stack: contextlib.AsyncExitStack
) -> Network:
    with extra("network"):
        from upwash.real.network.network import ManagedNetwork
    network = ManagedNetwork(interfaces, [server.network for server in config.servers], journal)
    stack.push_async_callback(network.close)
    await network.open()
    return network
