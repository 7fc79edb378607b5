"""The namespaces and addresses of the emulated field, and the links between them."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from upwash.config.drone import DroneConfig, ServerConfig
from upwash.config.places import server_position
from upwash.core.geo import Position
from upwash.emulation.namespaces import LinkEnd

_DAEMON_PORT = 7070


@dataclass(frozen=True, slots=True)
class EmulatedLink:
    """The network that joins one drone and one server."""

    drone: str
    server: ServerConfig
    server_at: Position
    drone_end: LinkEnd
    server_end: LinkEnd


@dataclass(frozen=True, slots=True)
class Field:
    """The drones, and the servers that all drones know."""

    drones: Sequence[DroneConfig]

    @property
    def servers(self) -> Sequence[ServerConfig]:
        """The servers, by the drones' scenarios."""
        return self.drones[0].servers

    def links(self) -> Iterator[EmulatedLink]:
        """A link for every drone and every server."""
        for number, drone in enumerate(self.drones):
            for index, server in enumerate(self.servers):
                yield EmulatedLink(
                    drone=drone.name,
                    server=server,
                    server_at=server_position(server, drone.mission.home),
                    drone_end=LinkEnd(
                        drone_namespace(drone.name), f"to{index}", f"10.83.{index}.{number + 2}"
                    ),
                    server_end=LinkEnd(server_namespace(server.name), f"to{number}", self._address(index)),
                )

    def wires(self) -> Iterator[tuple[LinkEnd, LinkEnd]]:
        """A wire for every two servers that are peers, between the addresses that their daemons listen at."""
        for (index, server), (other_index, other) in itertools.combinations(enumerate(self.servers), 2):
            if other.name in server.truth.peers or server.name in other.truth.peers:
                yield (
                    LinkEnd(server_namespace(server.name), f"wire{other_index}", self._address(index)),
                    LinkEnd(server_namespace(other.name), f"wire{index}", self._address(other_index)),
                )

    def peers(self, server: ServerConfig) -> dict[str, str]:
        """The server's peers, each with its daemon's address."""
        return {
            other.name: self.daemon_address(other)
            for other in self.servers
            if other.name in server.truth.peers
        }

    def daemon_address(self, server: ServerConfig) -> str:
        """The address of the server's daemon, on the server's own network."""
        return f"{self._address(self.servers.index(server))}:{_DAEMON_PORT}"

    def subnet(self, server: ServerConfig) -> str:
        """The subnet of the server's services, behind its computer."""
        return f"10.84.{self.servers.index(server)}.0/24"

    def _address(self, index: int) -> str:
        return f"10.83.{index}.1"

    def namespaces(self) -> list[str]:
        """The namespace of each drone and of each server."""
        return [
            *(drone_namespace(drone.name) for drone in self.drones),
            *(server_namespace(server.name) for server in self.servers),
        ]


def drone_namespace(name: str) -> str:
    """The namespace of the drone of that name."""
    return f"drone-{name}"


def server_namespace(name: str) -> str:
    """The namespace of the server of that name."""
    return f"server-{name}"
