"""The server-side machine: whom the servers of a daemon serve, and what runs there.

A daemon acts as one or several servers; each has its own images (services it can run), instances (at most one
of each service) and slots (drones that it serves at the same time). A slot is held by a drone as a lease. The daemon
of the server that a drone comes from, a peer, may ask for one beforehand, with the instances that it will call.
server.py has what one server decides; here is whom it listens to.

Laws:
- a server gives no lease while it has as many as slots, and only drones with a lease are admitted to its instances;
- where more drones ask than there are slots they take turns (turns.py), and no turn ends a call that is under way;
- a certificate that is revoked holds no lease, and a daemon that closes gives none;
- what a drone tells the daemon renews its lease, and what the daemon sees of it; what an instance says does not;
- a peer gets a lease for a drone only if the drone itself would get one, and for a bounded time;
- a drone may have peers hold one slot at a time, and only while it has a lease here;
- an instance goes absent, starting, running, stopping, absent; it may fall back to absent at any time;
- an instance is known by its number, and what arrives for another number changes nothing;
- an instance of another version takes over when it is ready; the former one serves for the length of one lease
  more, as drones ask for addresses within that time;
- commands must be carried out in their order.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping, Sequence

from msgspec import Struct

from upwash.core.admission.clients import (
    Client,
    DroneUsage,
    Refusals,
    RefusalStatus,
    Role,
    ServerStatus,
    TeamUsage,
)
from upwash.core.admission.instances import InstanceState
from upwash.core.admission.leases import Admit, Lease
from upwash.core.admission.peers import Peers
from upwash.core.admission.server import Command, Denied, HostedServer, ServerOffer
from upwash.core.admission.usage import LeaseEnded

_ROLES = {Role.OPERATOR: "an operator", Role.SERVER: "a server"}
_ELSEWHERE = ""  # where a request is counted that is for no server here


class AdmissionSettings(Struct, frozen=True):
    """How long a lease lasts without a request, an instance without a call, and a slot for a peer's drone at most."""

    lease_s: float = 30.0
    idle_stop_s: float = 600.0
    hold_s: float = 60.0


class Available(Struct, frozen=True):
    """The server can serve the drone; `endpoints` of its running services. `waiting` other drones queue."""

    endpoints: Mapping[str, str]
    waiting: int = 0


class ServiceRunning(Struct, frozen=True):
    """The service can be called at the endpoint."""

    endpoint: str


class StartPending(Struct, frozen=True):
    """The instance of that number starts or still stops; ask again when it is ready or gone."""

    number: int
    stopping: bool


class AdmissionController:
    """Keeps the servers of one daemon and decides whom they serve and what runs."""

    def __init__(
        self,
        offers: Mapping[str, ServerOffer],
        settings: AdmissionSettings | None = None,
        *,
        peers: Iterable[str] = (),
    ) -> None:
        self.settings = settings = settings or AdmissionSettings()
        self.peers = tuple(peers)  # the servers that other daemons of the operator act as
        self.closing = ""  # why drones are refused; empty while they are served
        self.refused_times = dict.fromkeys([*offers, _ELSEWHERE], 0)  # by server; "": of no server here
        self._peers = Peers(self.peers, hold_s=settings.hold_s)
        self._numbers = iter(range(1, sys.maxsize))  # of instances; Python 3.14 copies no itertools.count
        self._revoked: frozenset[str] = frozenset()
        self._refusals = Refusals()
        self._servers = {
            name: HostedServer(name, offer, self._numbers, lease_s=settings.lease_s)
            for name, offer in offers.items()
        }

    def at(self, server: str) -> HostedServer:
        """The server of that name, to tell it of its instances; KeyError where there is none."""
        return self._servers[server]

    # --- what drones ask ------------------------------------------------------------------------------------

    def availability(
        self, server: str, services: Iterable[str], drone: Client, *, now_s: float
    ) -> tuple[Available | Denied, list[Command]]:
        """Whether the server can serve the drone now; if so, the drone holds a slot until its lease ends."""
        wanted = sorted(set(services))
        denied, commands = self._lease(server, wanted, drone, now_s)
        if denied is not None:
            return denied, commands
        at = self._servers[server]
        return Available(at.endpoints(wanted), len(at.turns.waiting(now_s=now_s))), commands

    def start(
        self, server: str, service: str, drone: Client, *, now_s: float
    ) -> tuple[ServiceRunning | StartPending | Denied, list[Command]]:
        """Start the service for the drone; two starts of one service make one instance."""
        denied, commands = self._lease(server, [service], drone, now_s)
        if denied is not None:
            return denied, commands
        place, starts = self._servers[server].begin(service)
        if place.is_running:
            return ServiceRunning(place.endpoint), commands
        return StartPending(place.number, place.state is InstanceState.STOPPING), [*commands, *starts]

    def deny(self, server: str, services: Iterable[str], drone: Client, *, now_s: float) -> list[Command]:
        """Note that these services raised in calls of the drone, but not on the drone; stop useless instances."""
        at = self._servers.get(server)
        return [] if at is None else at.deny(services, drone, now_s=now_s)

    def leave(self, server: str, drone: Client, *, now_s: float) -> list[Command]:
        """Free the drone's slot, or its place in the queue; return the commands that follow."""
        if (at := self._servers.get(server)) is None:
            return []
        at.turns.gave_up(drone.name)
        return [*at.leases.end(lambda lease: lease.drone == drone, now_s=now_s)]

    # --- requests of peers and of an earlier daemon -----------------------------------------------------------

    def send_ahead(
        self, server: str, peer: str, drone: Client, *, for_s: float, now_s: float
    ) -> tuple[Denied | None, list[Command]]:
        """Decide whether a drone served here may have a slot held at the peer; None allows it.

        A drone may have one slot held at a time.
        """
        commands = self._end_leases(now_s)
        why = (
            self._mistrust(drone)
            or self._obstacle(server, (), drone)
            or self._peers.unknown(peer)
            or ("" if self._servers[server].leases.is_of(drone) else f"{drone.name} has no lease on {server}")
            or self._peers.elsewhere(drone.name, peer, now_s=now_s)
        )
        if why:
            return self._denied(server, drone.name, why, now_s), commands
        self._peers.ask(drone.name, peer, for_s=for_s, now_s=now_s)
        return None, commands

    def not_held(self, peer: str, drone: Client) -> None:
        """The peer refused the latest hold; earlier holds still count."""
        self._peers.refused(drone.name, peer)

    def hold(
        self,
        server: str,
        services: Iterable[str],
        drone: Client,
        *,
        peer: Client,
        for_s: float,
        now_s: float,
    ) -> tuple[Denied | None, list[Command]]:
        """Hold a slot and start the services for a drone that a peer announces, as if the drone had asked."""
        commands = self._end_leases(now_s)
        why = self._mistrust(peer) or self._peers.unknown(peer.name)
        if not why and peer.certificate and peer.role is not Role.SERVER:
            why = f"{peer.name} is no daemon: only a server's certificate may ask for another drone"
        if why:
            return self._denied(server, peer.name, why, now_s), commands
        wanted = sorted(set(services))
        if (denied := self._deny(server, wanted, drone, now_s)) is not None:
            return denied, commands
        at = self._servers[server]
        if (lease := at.leases.of(drone.name)) is not None and not lease.held_by and lease.drone != drone:
            why = f"{drone.name} is here already, with another certificate"
            return self._denied(server, drone.name, why, now_s), commands
        if why := self._peers.mistrust(peer.name, now_s=now_s) or at.no_hold(drone, peer.name, now_s=now_s):
            return self._denied(server, peer.name, why, now_s), commands
        until_s = now_s + min(self.settings.hold_s, for_s)
        commands += at.leases.hold(drone, until_s, peer=peer.name, now_s=now_s)
        for service in wanted:
            commands += at.begin(service)[1]
        return None, commands

    def take_up(
        self, server: str, drones: Iterable[Client], services: Iterable[str], *, now_s: float
    ) -> list[Command]:
        """Serve the drones of the daemon that this daemon replaces; start the services that ran there."""
        if (at := self._servers.get(server)) is None:
            return []
        trusted = [drone for drone in drones if not self._mistrust(drone)]
        commands: list[Command] = [command for drone in trusted for command in self._renew(at, drone, now_s)]
        for service in sorted(at.offer.images & frozenset(services)):
            commands += at.begin(service)[1]
        return commands

    def take_up_usage(
        self, server: str, drones: Sequence[DroneUsage], teams: Sequence[TeamUsage], *, now_s: float
    ) -> None:
        """Continue the usage counts of the former daemon; call it after `take_up`."""
        if server in self._servers:
            self._servers[server].usage.take_up(drones, teams, now_s=now_s)

    # --- what the operator changes --------------------------------------------------------------------------

    def offer(
        self, offers: Mapping[str, ServerOffer], *, outdated: frozenset[tuple[str, str]]
    ) -> list[Command]:
        """Replace the offers of these servers; return the commands that stop withdrawn services.

        `outdated` has the pairs of server and service whose image changed: each gets a new instance, and the old one
        serves until the new one is ready. With fewer slots than before, each drone keeps its slot until its lease
        ends.
        """
        changes = [self._servers[name].change(offer, outdated=outdated) for name, offer in offers.items()]
        return [command for change in changes for command in change]

    def revoke(self, certificates: frozenset[str], *, now_s: float) -> list[Command]:
        """Refuse exactly these certificates from now on; end their leases."""
        self._revoked = certificates
        ended = [server.leases.revoke(certificates, now_s=now_s) for server in self._servers.values()]
        return [command for commands in ended for command in commands]

    def close(self, why: str) -> list[Command]:
        """Serve no drone from now on, for the first reason given; every instance ends its calls and stops."""
        self.closing = self.closing or why
        return [stop for server in self._servers.values() for stop in server.close(self.closing)]

    def end_leases(self, *, now_s: float) -> list[Command]:
        """End every lease, as the daemon ends."""
        return self._end(lambda _: True, now_s)

    # --- what ends by itself --------------------------------------------------------------------------------

    def look(self, *, now_s: float) -> list[Command]:
        """End leases whose time is over; stop unused instances."""
        commands = self._end_leases(now_s)
        for server in self._servers.values():
            commands += server.stop_unused(self.settings.idle_stop_s, now_s=now_s)
        return commands

    @property
    def is_idle(self) -> bool:
        """Whether no drone has a slot and nothing runs, so that nothing ends until a request arrives."""
        return all(server.is_idle for server in self._servers.values())

    def next_end_s(self, *, now_s: float) -> float:
        """The earliest time of an end by itself (leases, turns, holds), except new holds for peers."""
        idle_s = self.settings.idle_stop_s
        ends_s = (end_s for server in self._servers.values() for end_s in server.ends_s(idle_s))
        return min(now_s + self.settings.lease_s, now_s + idle_s, *ends_s)

    # --- the status page ------------------------------------------------------------------------------------

    def refused(self, server: str, client: str, why: str, *, now_s: float) -> None:
        """Count a refused client, for a reason that the controller need not know."""
        self.refused_times[server if server in self._servers else _ELSEWHERE] += 1
        self._refusals.note(server, client, why, now_s=now_s)

    def show(
        self, client: Client, *, now_s: float
    ) -> tuple[list[ServerStatus], list[RefusalStatus]] | Denied:
        """The status of the servers and the last refusals, for an operator."""
        why = self._mistrust(client)
        if not why and client.certificate and client.role is not Role.OPERATOR:
            why = f"{client.name} is no operator: show a certificate of `upwash keys DIR --operator NAME`"
        if why:
            return self._denied(_ELSEWHERE, client.name, why, now_s)
        return self.servers(now_s=now_s), self._refusals.status(now_s=now_s)

    def servers(self, *, now_s: float) -> list[ServerStatus]:
        """The servers as they are now."""
        return [server.status(now_s=now_s) for server in self._servers.values()]

    def leases(self, server: str) -> frozenset[str]:
        """The names of the drones that hold a slot of the server."""
        return self._servers[server].leases.drones

    # --- who is refused, and why ----------------------------------------------------------------------------

    def _deny(self, name: str, services: Iterable[str], drone: Client, now_s: float) -> Denied | None:
        why, pause_s = self._mistrust(drone) or self._obstacle(name, services, drone), 0.0
        if not why:
            why, pause_s = self._servers[name].pause(services, drone, now_s=now_s)
        return self._denied(name, drone.name, why, now_s, pause_s=pause_s) if why else None

    def _denied(self, name: str, client: str, why: str, now_s: float, *, pause_s: float = 0.0) -> Denied:
        self.refused(name, client, why, now_s=now_s)
        return Denied(why, pause_s=pause_s)

    def _mistrust(self, client: Client) -> str:
        if client.certificate in self._revoked:
            return f"the certificate of {client.name} is revoked"
        return ""

    def _obstacle(self, name: str, services: Iterable[str], drone: Client) -> str:
        server = self._servers.get(name)
        if server is None:
            return f"no server {name} here; this daemon is {', '.join(self._servers)}"
        if self.closing:
            return self.closing
        if drone.role is not Role.DRONE:
            return f"{drone.name} is {_ROLES[drone.role]}, and {name} serves drones"
        missing = [service for service in services if service not in server.offer.images]
        return f"{name} has no image of {', '.join(missing)}" if missing else ""

    def _lease(
        self, name: str, services: Iterable[str], drone: Client, now_s: float
    ) -> tuple[Denied | None, list[Command]]:
        commands = self._end_leases(now_s)
        denied = self._deny(name, services, drone, now_s)
        if denied is None and drone.name not in self._servers[name].leases:
            denied, yielded = self._servers[name].ask_for_slot(drone.name, now_s=now_s)
            commands += yielded
            if denied is not None and denied.is_news:
                self.refused(name, drone.name, denied.why, now_s=now_s)
        if denied is None:
            commands += self._renew(self._servers[name], drone, now_s)
        return denied, commands

    def _renew(self, server: HostedServer, drone: Client, now_s: float) -> list[Admit]:
        known = server.leases.of(drone.name)
        if known is not None and known.held_by and known.drone == drone:
            self._peers.came(known.held_by)
        return server.renew(drone, now_s=now_s)

    def _end_leases(self, now_s: float) -> list[Command]:
        """End leases whose time is over; a drone that was expected in vain counts against its peer."""
        self._peers.forget(now_s=now_s)
        ended = self._end(lambda lease: lease.until_s <= now_s, now_s)
        for end in ended:
            if isinstance(end, LeaseEnded) and end.held_by:
                self._peers.missed(end.held_by, now_s=now_s)
        return ended

    def _end(self, which: Callable[[Lease], bool], now_s: float) -> list[Command]:
        ended = [server.leases.end(which, now_s=now_s) for server in self._servers.values()]
        return [command for commands in ended for command in commands]
