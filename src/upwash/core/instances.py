"""The server-side machine: images, instances, slots and leases.

A daemon acts as one or several servers; each has its own images (services it can run), instances (at most one
of each service) and slots (drones that it serves at the same time). A slot is held by a drone as a lease.

Laws:
- a server never has more leases than slots, and only drones with a lease are admitted to its instances;
- an instance goes absent, starting, running, stopping, absent; it may fall back to absent at any time;
- an instance is known by its number, and what arrives for another number changes nothing;
- commands are to be carried out in their order.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum


@dataclass(frozen=True, slots=True)
class ServerOffer:
    """What one server offers: the services it can run, and how many drones at once."""

    images: frozenset[str]
    slots: int = 1


@dataclass(frozen=True, slots=True)
class HostSettings:
    """How long a lease lasts without a request, and an instance without a call."""

    lease_s: float = 30.0
    idle_stop_s: float = 600.0


class InstanceState(StrEnum):
    """Where an instance is in its life."""

    ABSENT = "absent"
    STARTING = "starting"
    RUNNING = "running"
    STOPPING = "stopping"


@dataclass(frozen=True, slots=True)
class Available:
    """The server can serve the drone; `endpoints` are of those wanted services that run already."""

    endpoints: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Denied:
    """The server cannot serve the drone, and why."""

    why: str


@dataclass(frozen=True, slots=True)
class Running:
    """The service can be called at the endpoint."""

    endpoint: str


@dataclass(frozen=True, slots=True)
class Pending:
    """The instance of that number is starting, or still stopping; ask again when it is ready or gone."""

    number: int
    stopping: bool


@dataclass(frozen=True, slots=True)
class StartInstance:
    """Start an instance of the service for the server."""

    server: str
    service: str
    number: int


@dataclass(frozen=True, slots=True)
class StopInstance:
    """Stop that instance."""

    server: str
    service: str
    number: int


@dataclass(frozen=True, slots=True)
class Admit:
    """From now on the server's instances answer these drones and no others."""

    server: str
    drones: frozenset[str]


Command = StartInstance | StopInstance | Admit


@dataclass(slots=True)
class _Instance:
    state: InstanceState = InstanceState.ABSENT
    number: int = 0
    endpoint: str = ""
    used_s: float = 0.0  # when it became ready or was last called


@dataclass(slots=True)
class _Server:
    offer: ServerOffer
    leases: dict[str, float] = field(default_factory=dict)  # drone → when the lease ends
    instances: dict[str, _Instance] = field(default_factory=dict)


class Host:
    """Keeps the servers of one daemon and decides whom they serve and what runs."""

    def __init__(self, offers: Mapping[str, ServerOffer], settings: HostSettings | None = None) -> None:
        self.settings = settings or HostSettings()
        self._number = 0
        self._servers = {
            name: _Server(offer, instances={service: _Instance() for service in sorted(offer.images)})
            for name, offer in offers.items()
        }

    def availability(
        self, server: str, services: Iterable[str], drone: str, *, now_s: float
    ) -> tuple[Available | Denied, list[Command]]:
        """Whether the drone can be served now; if so it holds a slot until its lease ends."""
        commands = self._end_leases(now_s)
        wanted = sorted(set(services))
        denied = self._deny(server, wanted, drone)
        if denied is not None:
            return denied, commands
        commands += self._renew(server, drone, now_s)
        instances = self._servers[server].instances
        endpoints = {
            service: instances[service].endpoint
            for service in wanted
            if instances[service].state is InstanceState.RUNNING
        }
        return Available(endpoints), commands

    def start(
        self, server: str, service: str, drone: str, *, now_s: float
    ) -> tuple[Running | Pending | Denied, list[Command]]:
        """Has the service running for the drone; two starts of one service make one instance."""
        commands = self._end_leases(now_s)
        denied = self._deny(server, [service], drone)
        if denied is not None:
            return denied, commands
        commands += self._renew(server, drone, now_s)
        instance = self._servers[server].instances[service]
        if instance.state is InstanceState.RUNNING:
            return Running(instance.endpoint), commands
        if instance.state is InstanceState.ABSENT:
            self._number += 1
            instance.state = InstanceState.STARTING
            instance.number = self._number
            commands.append(StartInstance(server, service, instance.number))
        return Pending(instance.number, stopping=instance.state is InstanceState.STOPPING), commands

    def ready(self, server: str, service: str, number: int, endpoint: str, *, now_s: float) -> list[Command]:
        """The instance of that number can be called at the endpoint."""
        instance = self._servers[server].instances[service]
        if instance.number != number or instance.state is not InstanceState.STARTING:
            return []
        instance.state = InstanceState.RUNNING
        instance.endpoint = endpoint
        instance.used_s = now_s
        return [self._admission(server)]

    def gone(self, server: str, service: str, number: int) -> None:
        """The instance of that number ended: it did not start, it crashed, or it was stopped."""
        instance = self._servers[server].instances[service]
        if instance.number == number:
            instance.state = InstanceState.ABSENT
            instance.endpoint = ""

    def called(self, server: str, service: str, drone: str, *, now_s: float) -> None:
        """The drone called the service: its lease is renewed."""
        state = self._servers[server]
        state.instances[service].used_s = now_s
        if state.leases.get(drone, now_s) > now_s:
            state.leases[drone] = now_s + self.settings.lease_s

    def leave(self, server: str, drone: str) -> list[Command]:
        """The drone needs the server no more: its slot is free."""
        state = self._servers.get(server)
        if state is None or state.leases.pop(drone, None) is None:
            return []
        return [self._admission(server)]

    def look(self, *, now_s: float) -> list[Command]:
        """Ends the leases whose time is over, and stops the instances that nobody uses."""
        commands = self._end_leases(now_s)
        for name, server in self._servers.items():
            if not server.leases:
                commands += self._stop_idle(name, now_s)
        return commands

    def next_end_s(self, *, now_s: float) -> float:
        """Before this time nothing that is held now, or will be from now on, comes to its end by itself."""
        settings = self.settings
        ends_s = [now_s + settings.lease_s, now_s + settings.idle_stop_s]
        for server in self._servers.values():
            ends_s += server.leases.values()
            ends_s += [
                instance.used_s + settings.idle_stop_s
                for instance in server.instances.values()
                if instance.state is InstanceState.RUNNING
            ]
        return min(ends_s)

    def leases(self, server: str) -> frozenset[str]:
        """The drones that hold a slot of the server."""
        return frozenset(self._servers[server].leases)

    def state(self, server: str, service: str) -> InstanceState:
        """Where the instance of the service is in its life."""
        return self._servers[server].instances[service].state

    def _deny(self, name: str, services: Iterable[str], drone: str) -> Denied | None:
        server = self._servers.get(name)
        if server is None:
            return Denied(f"no server {name} here; this daemon is {', '.join(self._servers)}")
        missing = [service for service in services if service not in server.offer.images]
        if missing:
            return Denied(f"{name} has no image of {', '.join(missing)}")
        if drone not in server.leases and len(server.leases) >= server.offer.slots:
            return Denied(f"{name} has no free slot: {len(server.leases)} of {server.offer.slots} in use")
        return None

    def _renew(self, name: str, drone: str, now_s: float) -> list[Command]:
        leases = self._servers[name].leases
        new = drone not in leases
        leases[drone] = now_s + self.settings.lease_s
        return [self._admission(name)] if new else []

    def _end_leases(self, now_s: float) -> list[Command]:
        commands: list[Command] = []
        for name, server in self._servers.items():
            over = [drone for drone, until_s in server.leases.items() if until_s <= now_s]
            for drone in over:
                del server.leases[drone]
            if over:
                commands.append(self._admission(name))
        return commands

    def _admission(self, name: str) -> Admit:
        return Admit(name, self.leases(name))

    def _stop_idle(self, name: str, now_s: float) -> list[Command]:
        commands: list[Command] = []
        for service, instance in self._servers[name].instances.items():
            idle_s = now_s - instance.used_s
            if instance.state is InstanceState.RUNNING and idle_s >= self.settings.idle_stop_s:
                instance.state = InstanceState.STOPPING
                instance.endpoint = ""
                commands.append(StopInstance(name, service, instance.number))
        return commands
