"""The server-side machine: images, instances, slots and leases.

A daemon acts as one or several servers; each has its own images (services it can run), instances (at most one
of each service) and slots (drones that it serves at the same time). A slot is held by a drone as a lease. The daemon
of the server that a drone comes from, a peer, may ask for one beforehand, with the instances that it will call.

Laws:
- a server gives no lease while it has as many as slots, and only drones with a lease are admitted to its instances;
- a certificate that is revoked holds no lease, and a daemon that closes gives none;
- what a drone tells the daemon renews its lease, and what the daemon sees of it; what an instance says does not;
- a peer gets a lease for a drone where the drone itself would, for a bounded time, and nothing else;
- a drone may have peers hold one slot at a time, and only while it has a lease here;
- an instance goes absent, starting, running, stopping, absent; it may fall back to absent at any time;
- an instance is known by its number, and what arrives for another number changes nothing;
- commands are to be carried out in their order.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from upwash.core.visitors import (
    InstanceStatus,
    LeaseStatus,
    Refusals,
    RefusalStatus,
    Role,
    ServerStatus,
    Visitor,
)

_ROLES = {Role.OPERATOR: "an operator", Role.SERVER: "a server"}
_ELSEWHERE = ""  # where a request is counted that is for no server here
_MOST_MISSED = 3  # drones in a row that a peer expected in vain
_MISTRUST_HOLDS = 10  # for how many times the longest hold it is refused then


@dataclass(frozen=True, slots=True)
class ServerOffer:
    """What one server offers: the services it can run, and how many drones at once."""

    images: frozenset[str]
    slots: int = 1


@dataclass(frozen=True, slots=True)
class HostSettings:
    """How long a lease lasts without a request, an instance without a call, and a slot for a peer's drone at most."""

    lease_s: float = 30.0
    idle_stop_s: float = 600.0
    hold_s: float = 60.0


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
class Held:
    """A slot is held for the drone."""


@dataclass(frozen=True, slots=True)
class StartInstance:
    """Start an instance of the service for the server."""

    server: str
    service: str
    number: int


@dataclass(frozen=True, slots=True)
class StopInstance:
    """Stop that instance; if there is a reason let the calls under way end first, and refuse every other for it."""

    server: str
    service: str
    number: int
    why: str = ""


@dataclass(frozen=True, slots=True)
class Admit:
    """From now on the server's instances answer these drones, known by `Visitor.key`, and no others."""

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
class _Lease:
    drone: Visitor
    until_s: float
    held_by: str = ""  # the peer that asked for it, until the drone comes itself


@dataclass(slots=True)
class _Missed:
    """How many drones in a row that a peer expected did not come, and when that was noticed last."""

    times: int = 0
    last_s: float = -math.inf


@dataclass(frozen=True, slots=True)
class _SentAhead:
    """A peer was asked to hold a slot for a drone until then; without that it holds one until `otherwise_s`."""

    peer: str
    until_s: float
    otherwise_s: float


@dataclass(slots=True)
class _Server:
    offer: ServerOffer
    leases: dict[str, _Lease] = field(default_factory=dict)  # by drone
    instances: dict[str, _Instance] = field(default_factory=dict)


class Host:
    """Keeps the servers of one daemon and decides whom they serve and what runs."""

    def __init__(
        self,
        offers: Mapping[str, ServerOffer],
        settings: HostSettings | None = None,
        *,
        peers: Iterable[str] = (),
    ) -> None:
        self.settings = settings or HostSettings()
        self.peers = tuple(peers)  # the servers that other daemons of the operator act as
        self._sent_ahead: dict[str, _SentAhead] = {}  # by drone, until the slot is held no longer
        self._number = 0
        self._closing = ""  # why nobody is served any more
        self._revoked: frozenset[str] = frozenset()
        self._missed: dict[str, _Missed] = {}  # by peer
        self._refusals = Refusals()
        self._refused = dict.fromkeys([*offers, _ELSEWHERE], 0)  # how often, by server
        self._servers = {
            name: _Server(offer, instances={service: _Instance() for service in sorted(offer.images)})
            for name, offer in offers.items()
        }

    def availability(
        self, server: str, services: Iterable[str], drone: Visitor, *, now_s: float
    ) -> tuple[Available | Denied, list[Command]]:
        """Whether the drone can be served now; if so it holds a slot until its lease ends."""
        commands = self._end_leases(now_s)
        wanted = sorted(set(services))
        denied = self._deny(server, wanted, drone, now_s)
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
        self, server: str, service: str, drone: Visitor, *, now_s: float
    ) -> tuple[Running | Pending | Denied, list[Command]]:
        """Has the service running for the drone; two starts of one service make one instance."""
        commands = self._end_leases(now_s)
        denied = self._deny(server, [service], drone, now_s)
        if denied is not None:
            return denied, commands
        commands += self._renew(server, drone, now_s)
        instance = self._servers[server].instances[service]
        if instance.state is InstanceState.RUNNING:
            return Running(instance.endpoint), commands
        commands += self._begin(server, service)
        return Pending(instance.number, stopping=instance.state is InstanceState.STOPPING), commands

    def send_ahead(
        self, server: str, peer: str, drone: Visitor, *, for_s: float, now_s: float
    ) -> tuple[Denied | None, list[Command]]:
        """Whether the drone, which is served here, may have the peer hold a slot for it; one at a time may be."""
        commands = self._end_leases(now_s)
        why = self._mistrust(drone) or self._obstacle(server, (), drone) or self._unknown(peer)
        lease = self._servers[server].leases.get(drone.name) if not why else None
        ahead = self._sent_ahead.get(drone.name)
        if not why and (lease is None or lease.drone != drone):
            why = f"{drone.name} has no lease on {server}"
        elif not why and ahead is not None and ahead.peer != peer and ahead.until_s > now_s:
            why = f"{drone.name} has a slot of {ahead.peer} held for another {ahead.until_s - now_s:.0f} s"
        if why:
            return self._denied(server, drone.name, why, now_s), commands
        known_s = ahead.until_s if ahead is not None else now_s
        until_s = max(known_s, now_s + min(self.settings.hold_s, for_s))
        self._sent_ahead[drone.name] = _SentAhead(peer, until_s, otherwise_s=known_s)
        return None, commands

    def not_held(self, peer: str, drone: Visitor) -> None:
        """The peer refused what it was asked last; what it granted before still counts."""
        ahead = self._sent_ahead.get(drone.name)
        if ahead is not None and ahead.peer == peer:
            self._sent_ahead[drone.name] = _SentAhead(peer, ahead.otherwise_s, ahead.otherwise_s)

    def hold(
        self,
        server: str,
        services: Iterable[str],
        drone: Visitor,
        *,
        peer: Visitor,
        for_s: float,
        now_s: float,
    ) -> tuple[Held | Denied, list[Command]]:
        """Has the services running for a drone that a peer expects to come, and a slot, as if the drone had asked."""
        commands = self._end_leases(now_s)
        why = self._mistrust(peer) or self._unknown(peer.name)
        if not why and peer.certificate and peer.role is not Role.SERVER:
            why = f"{peer.name} is no daemon: only a server's certificate may ask for another drone"
        if why:
            return self._denied(server, peer.name, why, now_s), commands
        wanted = sorted(set(services))
        denied = self._deny(server, wanted, drone, now_s) or self._impostor(server, drone, now_s)
        if denied is not None:
            return denied, commands
        why = self._too_many(server, drone, peer.name, now_s)
        if why:
            return self._denied(server, peer.name, why, now_s), commands
        commands += self._hold(server, drone, peer.name, now_s + min(self.settings.hold_s, for_s))
        for service in wanted:
            commands += self._begin(server, service)
        return Held(), commands

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
        """The instance says that the drone, known by `Visitor.key`, called: with a lease, it uses the service."""
        if self._lease_by_key(server, drone, now_s) is not None:
            self._servers[server].instances[service].used_s = now_s

    def seen(self, server: str, drone: str, *, now_s: float) -> None:
        """The daemon saw that the drone, known by `Visitor.key`, is there: a lease that it has is renewed."""
        lease = self._lease_by_key(server, drone, now_s)
        if lease is not None:
            lease.until_s = max(lease.until_s, now_s + self.settings.lease_s)

    def leave(self, server: str, drone: Visitor) -> list[Command]:
        """The drone needs the server no more: its slot is free."""
        state = self._servers.get(server)
        lease = state.leases.get(drone.name) if state else None
        if state is None or lease is None or lease.drone != drone:
            return []
        del state.leases[drone.name]
        return [self._admission(server)]

    def offer(self, offers: Mapping[str, ServerOffer], *, replaced: frozenset[str]) -> list[Command]:
        """From now on the same servers offer this; what runs of an image that is withdrawn or replaced is stopped.

        A drone that holds one slot too many keeps it until its lease ends.
        """
        commands: list[Command] = []
        for name, offer in offers.items():
            server = self._servers[name]
            for service in sorted(server.offer.images):
                if service not in offer.images:
                    commands += self._stop(name, service, f"{name} has no image of {service} any more")
                elif service in replaced:
                    commands += self._stop(name, service, f"{name} has another image of {service} now")
            server.offer = offer
            for service in sorted(offer.images):
                server.instances.setdefault(service, _Instance())
        return commands

    def revoke(self, certificates: frozenset[str]) -> list[Command]:
        """From now on these certificates, and no others, are good for nothing; leases held by them end."""
        self._revoked = certificates
        return [
            command
            for name, server in self._servers.items()
            for command in self._end(
                name,
                [drone for drone, lease in server.leases.items() if lease.drone.certificate in certificates],
            )
        ]

    @property
    def closing(self) -> str:
        """Why nobody is served any more; empty where drones are."""
        return self._closing

    def close(self, why: str) -> list[Command]:
        """From now on nobody is served, for the first such reason; every instance ends its calls and stops."""
        self._closing = self._closing or why
        return [
            command
            for name, server in self._servers.items()
            for service in server.instances
            for command in self._stop(name, service, self._closing)
        ]

    def refused(self, server: str, visitor: str, why: str, *, now_s: float) -> None:
        """A visitor was refused, for a reason that the host may not know of."""
        self._refused[server if server in self._servers else _ELSEWHERE] += 1
        self._refusals.note(server, visitor, why, now_s=now_s)

    def show(
        self, visitor: Visitor, *, now_s: float
    ) -> tuple[list[ServerStatus], list[RefusalStatus]] | Denied:
        """What there is to see of the servers, and the last refusals, for an operator."""
        why = self._mistrust(visitor)
        if not why and visitor.certificate and visitor.role is not Role.OPERATOR:
            why = f"{visitor.name} is no operator: show a certificate of `upwash keys --operator NAME`"
        if why:
            self.refused(_ELSEWHERE, visitor.name, why, now_s=now_s)
            return Denied(why)
        return self.servers(now_s=now_s), self._refusals.status(now_s=now_s)

    def servers(self, *, now_s: float) -> list[ServerStatus]:
        """The servers as they are now."""
        return [self._status(name, server, now_s) for name, server in self._servers.items()]

    @property
    def refused_times(self) -> Mapping[str, int]:
        """How often each server has refused somebody; what asked for no server of this daemon is under ""."""
        return self._refused

    def look(self, *, now_s: float) -> list[Command]:
        """Ends the leases whose time is over, and stops the instances that nobody uses."""
        commands = self._end_leases(now_s)
        for name, server in self._servers.items():
            if not server.leases:
                commands += self._stop_idle(name, now_s)
        return commands

    def next_end_s(self, *, now_s: float) -> float:
        """Before this time nothing comes to its end by itself, but for a slot that a peer has held from now on."""
        settings = self.settings
        ends_s = [now_s + settings.lease_s, now_s + settings.idle_stop_s]
        for server in self._servers.values():
            ends_s += [lease.until_s for lease in server.leases.values()]
            ends_s += [
                instance.used_s + settings.idle_stop_s
                for instance in server.instances.values()
                if instance.state is InstanceState.RUNNING
            ]
        return min(ends_s)

    def leases(self, server: str) -> frozenset[str]:
        """The names of the drones that hold a slot of the server."""
        return frozenset(self._servers[server].leases)

    def state(self, server: str, service: str) -> InstanceState:
        """Where the instance of the service is in its life."""
        return self._servers[server].instances[service].state

    def _deny(self, name: str, services: Iterable[str], drone: Visitor, now_s: float) -> Denied | None:
        why = self._mistrust(drone) or self._obstacle(name, services, drone)
        return self._denied(name, drone.name, why, now_s) if why else None

    def _denied(self, name: str, visitor: str, why: str, now_s: float) -> Denied:
        self.refused(name, visitor, why, now_s=now_s)
        return Denied(why)

    def _mistrust(self, visitor: Visitor) -> str:
        if visitor.certificate in self._revoked:
            return f"the certificate of {visitor.name} is revoked"
        return ""

    def _unknown(self, peer: str) -> str:
        return "" if peer in self.peers else f"{peer} is no peer of this daemon"

    def _impostor(self, name: str, drone: Visitor, now_s: float) -> Denied | None:
        """A peer cannot take the lease from a drone that came itself, under another certificate."""
        lease = self._servers[name].leases.get(drone.name)
        if lease is None or lease.held_by or lease.drone == drone:
            return None
        return self._denied(
            name, drone.name, f"{drone.name} is here already, with another certificate", now_s
        )

    def _obstacle(self, name: str, services: Iterable[str], drone: Visitor) -> str:
        server = self._servers.get(name)
        if server is None:
            return f"no server {name} here; this daemon is {', '.join(self._servers)}"
        if self._closing:
            return self._closing
        if drone.role is not Role.DRONE:
            return f"{drone.name} is {_ROLES[drone.role]}, and {name} serves drones"
        missing = [service for service in services if service not in server.offer.images]
        if missing:
            return f"{name} has no image of {', '.join(missing)}"
        if drone.name not in server.leases and len(server.leases) >= server.offer.slots:
            return f"{name} has no free slot: {len(server.leases)} of {server.offer.slots} in use"
        return ""

    def _lease_by_key(self, name: str, key: str, now_s: float) -> _Lease | None:
        leases = self._servers[name].leases.values()
        return next((each for each in leases if each.drone.key == key and each.until_s > now_s), None)

    def _renew(self, name: str, drone: Visitor, now_s: float) -> list[Command]:
        leases = self._servers[name].leases
        known = leases.get(drone.name)
        if known is not None and known.held_by and known.drone == drone:
            self._missed.pop(known.held_by, None)  # it came
        leases[drone.name] = _Lease(drone, now_s + self.settings.lease_s)
        return [] if known is not None and known.drone == drone else [self._admission(name)]

    def _too_many(self, name: str, drone: Visitor, peer: str, now_s: float) -> str:
        """Why nothing more is held for that peer: its key may be stolen, and its drones invented."""
        server, missed = self._servers[name], self._missed.get(peer, _Missed())
        if missed.times >= _MOST_MISSED and now_s < missed.last_s + _MISTRUST_HOLDS * self.settings.hold_s:
            return f"the last {missed.times} drones that {peer} expected did not come"
        others = sum(lease.held_by == peer for each, lease in server.leases.items() if each != drone.name)
        most = max(1, server.offer.slots // 2)
        return f"{peer} has {others} slots held, half of all" if others >= most else ""

    def _hold(self, name: str, drone: Visitor, peer: str, until_s: float) -> list[Command]:
        """A lease until then; one that the drone has itself is not made shorter by it."""
        leases = self._servers[name].leases
        known = leases.get(drone.name)
        if known is not None and not known.held_by:
            known.until_s = max(known.until_s, until_s)
            return []
        leases[drone.name] = _Lease(drone, until_s, held_by=peer)
        return [] if known is not None and known.drone == drone else [self._admission(name)]

    def _begin(self, name: str, service: str) -> list[Command]:
        instance = self._servers[name].instances[service]
        if instance.state is not InstanceState.ABSENT:
            return []
        self._number += 1
        instance.state = InstanceState.STARTING
        instance.number = self._number
        return [StartInstance(name, service, instance.number)]

    def _end_leases(self, now_s: float) -> list[Command]:
        self._sent_ahead = {drone: each for drone, each in self._sent_ahead.items() if each.until_s > now_s}
        for server in self._servers.values():
            for lease in server.leases.values():
                if lease.held_by and lease.until_s <= now_s:
                    missed = self._missed.setdefault(lease.held_by, _Missed())
                    missed.times, missed.last_s = missed.times + 1, now_s
        return [
            command
            for name, server in self._servers.items()
            for command in self._end(
                name, [drone for drone, lease in server.leases.items() if lease.until_s <= now_s]
            )
        ]

    def _end(self, name: str, drones: list[str]) -> list[Command]:
        for drone in drones:
            del self._servers[name].leases[drone]
        return [self._admission(name)] if drones else []

    def _admission(self, name: str) -> Admit:
        leases = self._servers[name].leases
        return Admit(name, frozenset(lease.drone.key for lease in leases.values()))

    def _stop_idle(self, name: str, now_s: float) -> list[Command]:
        return [
            command
            for service, instance in self._servers[name].instances.items()
            if instance.state is InstanceState.RUNNING
            and now_s - instance.used_s >= self.settings.idle_stop_s
            for command in self._stop(name, service)
        ]

    def _stop(self, name: str, service: str, why: str = "") -> list[Command]:
        instance = self._servers[name].instances[service]
        if instance.state not in (InstanceState.STARTING, InstanceState.RUNNING):
            return []
        instance.state = InstanceState.STOPPING
        instance.endpoint = ""
        return [StopInstance(name, service, instance.number, why)]

    def _status(self, name: str, server: _Server, now_s: float) -> ServerStatus:
        return ServerStatus(
            name,
            server.offer.slots,
            [
                LeaseStatus(drone, lease.drone.certificate, lease.until_s - now_s, lease.held_by)
                for drone, lease in sorted(server.leases.items())
            ],
            [
                InstanceStatus(
                    service,
                    instance.state.value,
                    instance.endpoint,
                    now_s - instance.used_s if instance.state is InstanceState.RUNNING else 0.0,
                )
                for service, instance in sorted(server.instances.items())
                if service in server.offer.images or instance.state is not InstanceState.ABSENT
            ],
        )
