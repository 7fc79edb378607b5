"""The server-side machine: whom the servers of a daemon serve, and what runs there.

A daemon acts as one or several servers; each has its own images (services it can run), instances (at most one
of each service) and slots (drones that it serves at the same time). A slot is held by a drone as a lease. The daemon
of the server that a drone comes from, a peer, may ask for one beforehand, with the instances that it will call.
The parts stand in leases.py, turns.py, usage.py, slots.py, instances.py and peers.py; here it is decided who gets
what.

Laws:
- a server gives no lease while it has as many as slots, and only drones with a lease are admitted to its instances;
- where more drones ask than there are slots they take turns (turns.py), and no turn ends a call that is under way;
- a certificate that is revoked holds no lease, and a daemon that closes gives none;
- what a drone tells the daemon renews its lease, and what the daemon sees of it; what an instance says does not;
- a peer gets a lease for a drone where the drone itself would, for a bounded time, and nothing else;
- a drone may have peers hold one slot at a time, and only while it has a lease here;
- an instance goes absent, starting, running, stopping, absent; it may fall back to absent at any time;
- an instance is known by its number, and what arrives for another number changes nothing;
- one of another version takes a place when it is ready, and the former serves for another lease, as drones ask for
  addresses within that time;
- commands are to be carried out in their order.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

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
from upwash.core.admission.instances import Instances, InstanceState, StartInstance, StopInstance
from upwash.core.admission.leases import Admit, Leases
from upwash.core.admission.peers import Peers
from upwash.core.admission.slots import MeasuredSlots
from upwash.core.admission.turns import ASK_AGAIN_S, Turns
from upwash.core.admission.usage import LeaseEnded, Usage
from upwash.core.admission.watchdog import CALL_LIMIT_S, Useless

_ROLES = {Role.OPERATOR: "an operator", Role.SERVER: "a server"}
_ELSEWHERE = ""  # where a request is counted that is for no server here


@dataclass(frozen=True, slots=True)
class ServerOffer:
    """What one server offers: its services, how many drones it serves at once, and the length of a turn.

    With "auto" slots the server measures their number. `lanes` has the calls that an instance of a service computes
    at a time, unless one. `call_limits_s` bounds how long a call may keep an instance busy.
    """

    images: frozenset[str]
    slots: int | Literal["auto"] = 1
    turn_s: float = 30.0
    lanes: Mapping[str, int] = field(default_factory=dict)
    call_limits_s: Mapping[str, float] = field(default_factory=dict)

    @property
    def lanes_of_each(self) -> dict[str, int]:
        """The lanes of every service."""
        return {service: self.lanes.get(service, 1) for service in self.images}


class AdmissionSettings(Struct, frozen=True):
    """How long a lease lasts without a request, an instance without a call, and a slot for a peer's drone at most."""

    lease_s: float = 30.0
    idle_stop_s: float = 600.0
    hold_s: float = 60.0


class Available(Struct, frozen=True):
    """The server can serve the drone; `endpoints` of its running services. `waiting` other drones queue."""

    endpoints: Mapping[str, str]
    waiting: int = 0


class Denied(Struct, frozen=True):
    """The server cannot serve the drone, and why.

    If the server is full, `waiting` drones queue, this drone included; retry after `ask_again_s`. A service that
    keeps failing is left alone for another `pause_s`. `is_news` is False if the drone was refused for the same reason
    before.
    """

    why: str
    waiting: int = 0
    ask_again_s: float = 0.0
    is_news: bool = True
    pause_s: float = 0.0


class ServiceRunning(Struct, frozen=True):
    """The service can be called at the endpoint."""

    endpoint: str


class StartPending(Struct, frozen=True):
    """The instance of that number starts or still stops; ask again when it is ready or gone."""

    number: int
    stopping: bool


class Held(Struct, frozen=True):
    """A slot is held for the drone."""


Command = StartInstance | StopInstance | Admit | LeaseEnded


class _Server:
    """One of the servers that the daemon acts as."""

    def __init__(self, name: str, offer: ServerOffer, numbers: Iterator[int]) -> None:
        self.name = name
        self.offer = offer
        self.turns = Turns(offer.turn_s)
        self.turns_ended = 0
        self.measured = MeasuredSlots(offer.lanes_of_each)
        self.usage = Usage(name)
        self.leases = Leases(name, self.turns, self.usage)
        self.instances = Instances(name, offer.images, numbers)

    @property
    def slots(self) -> int:
        """How many drones it takes at once, now."""
        return self.measured.count if self.offer.slots == "auto" else self.offer.slots

    @property
    def slots_why(self) -> str:
        """What the number of slots follows from."""
        return self.measured.why if self.offer.slots == "auto" else "configured"

    def change(self, offer: ServerOffer) -> None:
        """Replace the offer."""
        self.offer = offer
        self.turns.turn_s = offer.turn_s
        self.measured.offer(offer.lanes_of_each)
        self.instances.offer(offer.images)

    def ask_for_slot(self, drone: str, *, now_s: float) -> tuple[Denied | None, list[Command]]:
        """Whether the drone, which holds no slot, may have one now; a holder may have to yield."""
        is_news = self.turns.asked(drone, now_s=now_s)
        free = self.slots - len(self.leases)
        rank = self.turns.rank(drone, now_s=now_s)
        if rank < free:
            return None, []
        over, commands = self.turns.over(drone, now_s=now_s), list[Command]()
        if rank - max(0, free) < len(over):
            self.turns_ended += 1
            commands += self.leases.end_turn(over[0], now_s=now_s)
        is_given = bool(commands) and len(self.leases) < self.slots
        return None if is_given else self._no_slot(now_s, is_news=is_news), commands

    def has_room(self, *, now_s: float) -> bool:
        """Whether a slot is free and no drone waits for it."""
        return self.slots - len(self.leases) > len(self.turns.waiting(now_s=now_s))

    def status(self, *, now_s: float) -> ServerStatus:
        """The server's part of the status page."""
        return ServerStatus(
            self.name,
            self.slots,
            self.leases.status(now_s=now_s),
            self.instances.status(self.offer.images, now_s=now_s),
            slots_why=self.slots_why,
            turn_s=self.offer.turn_s if math.isfinite(self.offer.turn_s) else None,
            turns_ended=self.turns_ended,
            accounts=self.turns.status(now_s=now_s),
            drones=self.usage.drones(now_s=now_s),
            teams=self.usage.teams(now_s=now_s),
        )

    def _no_slot(self, now_s: float, *, is_news: bool) -> Denied:
        waiting = len(self.turns.waiting(now_s=now_s))
        why = f"{self.name} has no free slot: {len(self.leases)} of {self.slots} in use"
        return Denied(why, waiting=waiting, ask_again_s=ASK_AGAIN_S, is_news=is_news)


class AdmissionController:
    """Keeps the servers of one daemon and decides whom they serve and what runs."""

    def __init__(
        self,
        offers: Mapping[str, ServerOffer],
        settings: AdmissionSettings | None = None,
        *,
        peers: Iterable[str] = (),
    ) -> None:
        self.settings = settings or AdmissionSettings()
        self._peers = Peers(peers, hold_s=self.settings.hold_s)
        self._numbers = iter(range(1, sys.maxsize))  # of instances; Python 3.14 copies no itertools.count
        self.closing = ""  # why drones are refused; empty while they are served
        self._revoked: frozenset[str] = frozenset()
        self._refusals = Refusals()
        self._refused = dict.fromkeys([*offers, _ELSEWHERE], 0)  # how often, by server
        self._servers = {name: _Server(name, offer, self._numbers) for name, offer in offers.items()}

    @property
    def peers(self) -> tuple[str, ...]:
        """The servers that other daemons of the operator act as."""
        return self._peers.names

    # --- what drones ask ------------------------------------------------------------------------------------

    def availability(
        self, server: str, services: Iterable[str], drone: Client, *, now_s: float
    ) -> tuple[Available | Denied, list[Command]]:
        """Whether the server can serve the drone now; if so, the drone holds a slot until its lease ends."""
        wanted = sorted(set(services))
        denied, commands = self._lease(server, wanted, drone, now_s)
        if denied is not None:
            return denied, commands
        state = self._servers[server]
        waiting = len(state.turns.waiting(now_s=now_s))
        return Available(state.instances.endpoints(wanted), waiting), commands

    def start(
        self, server: str, service: str, drone: Client, *, now_s: float
    ) -> tuple[ServiceRunning | StartPending | Denied, list[Command]]:
        """Start the service for the drone; two starts of one service make one instance."""
        denied, commands = self._lease(server, [service], drone, now_s)
        if denied is not None:
            return denied, commands
        instances = self._servers[server].instances
        instance = instances[service]
        if instance.state is InstanceState.RUNNING:
            return ServiceRunning(instance.endpoint), commands
        commands += instances.begin(service)
        return StartPending(instance.number, stopping=instance.state is InstanceState.STOPPING), commands

    def send_ahead(
        self, server: str, peer: str, drone: Client, *, for_s: float, now_s: float
    ) -> tuple[Denied | None, list[Command]]:
        """Have the peer hold a slot for a drone that is served here; a drone may have one slot held at a time."""
        commands = self._end_leases(now_s)
        why = (
            self._mistrust(drone)
            or self._obstacle(server, (), drone)
            or self._peers.unknown(peer)
            or self._stranger(server, drone)
            or self._peers.elsewhere(drone.name, peer, now_s=now_s)
        )
        if why:
            return self._denied(server, drone.name, why, now_s), commands
        self._peers.ask(drone.name, peer, for_s=for_s, now_s=now_s)
        return None, commands

    def leave(self, server: str, drone: Client, *, now_s: float) -> list[Command]:
        """Free the drone's slot, or its place in the queue."""
        state = self._servers.get(server)
        if state is None:
            return []
        state.turns.gave_up(drone.name)
        return [*state.leases.end(lambda lease: lease.drone == drone, now_s=now_s)]

    def take_up(
        self, server: str, drones: Iterable[Client], services: Iterable[str], *, now_s: float
    ) -> list[Command]:
        """Serve the drones of a daemon that this daemon replaces, with the services that ran there."""
        state = self._servers.get(server)
        if state is None:
            return []
        commands: list[Command] = []
        for drone in drones:
            if not self._mistrust(drone):
                commands += self._renew(server, drone, now_s)
        for service in sorted(state.offer.images & frozenset(services)):
            commands += state.instances.begin(service)
        return commands

    def take_up_usage(
        self, server: str, drones: Sequence[DroneUsage], teams: Sequence[TeamUsage], *, now_s: float
    ) -> None:
        """Continue the usage that the former daemon counted, once its leases are taken up."""
        if server in self._servers:
            self._servers[server].usage.take_up(drones, teams, now_s=now_s)

    # --- what peers ask and answer --------------------------------------------------------------------------

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
    ) -> tuple[Held | Denied, list[Command]]:
        """Hold a slot and start the services for a drone that a peer announces, as if the drone had asked."""
        commands = self._end_leases(now_s)
        why = self._mistrust(peer) or self._peers.unknown(peer.name)
        if not why and peer.certificate and peer.role is not Role.SERVER:
            why = f"{peer.name} is no daemon: only a server's certificate may ask for another drone"
        if why:
            return self._denied(server, peer.name, why, now_s), commands
        wanted = sorted(set(services))
        denied = self._deny(server, wanted, drone, now_s) or self._impostor(server, drone, now_s)
        if denied is not None:
            return denied, commands
        why = (
            self._peers.mistrust(peer.name, now_s=now_s)
            or self._too_many(server, drone, peer.name)
            or self._no_room(server, drone, now_s)
        )
        if why:
            return self._denied(server, peer.name, why, now_s), commands
        state, until_s = self._servers[server], now_s + min(self.settings.hold_s, for_s)
        commands += state.leases.hold(drone, until_s, peer=peer.name, now_s=now_s)
        for service in wanted:
            commands += state.instances.begin(service)
        return Held(), commands

    # --- what becomes of instances --------------------------------------------------------------------------

    def ready(self, server: str, service: str, number: int, endpoint: str, *, now_s: float) -> list[Command]:
        """The instance of that number can be called at the endpoint."""
        state = self._servers[server]
        is_news = state.instances.ready(
            service,
            number,
            endpoint,
            lanes=state.offer.lanes.get(service, 1),
            former_until_s=now_s + self.settings.lease_s,
            now_s=now_s,
        )
        return [state.leases.admitted()] if is_news else []

    def admitted(self, server: str) -> Admit:
        """Whom instances of the server answer now."""
        return self._servers[server].leases.admitted()

    def has_place(self, server: str, service: str, number: int) -> bool:
        """Whether drones are sent to the instance of that number; others end soon, or are starting."""
        return self._servers[server].instances[service].number == number

    def gone(
        self, server: str, service: str, number: int, why: str = "", *, now_s: float = 0.0
    ) -> list[StartInstance]:
        """The instance of that number ended: it failed for the reason `why`, or it was stopped.

        A useless instance is replaced if a drone with a slot may call it.
        """
        state = self._servers[server]
        was_useless = state.instances.gone(service, number, why, now_s=now_s)
        failures = state.instances[service].failures
        is_wanted = any(not failures.pause_s(key, now_s=now_s) for key in state.leases.keys)
        if was_useless and is_wanted and not self.closing and service in state.offer.images:
            return state.instances.begin(service)
        return []

    def heard(self, server: str, service: str, *, now_s: float) -> None:
        """The running instance has given a sign of life."""
        self._servers[server].instances[service].watch.heard(now_s)

    def watch(self, server: str, service: str, *, now_s: float) -> list[Command]:
        """Stop the running instance if it is of no use."""
        state = self._servers[server]
        instance, at_most_s = state.instances[service], state.offer.call_limits_s.get(service, CALL_LIMIT_S)
        useless = instance.watch.verdict(
            instance.limit.seconds(at_most_s), served=state.leases.keys, now_s=now_s
        )
        if useless is None or instance.state is not InstanceState.RUNNING:
            return []
        instance.limit.cut(at_most_s)
        return self._condemn(state, service, useless, now_s)

    def silent(self, server: str, service: str, why: str, *, now_s: float) -> list[Command]:
        """Stop the running instance, which does not confirm whom it serves."""
        state = self._servers[server]
        useless = Useless(why, state.instances[service].watch.callers)
        return self._condemn(state, service, useless, now_s)

    def deny(self, server: str, services: Iterable[str], drone: Client, *, now_s: float) -> list[Command]:
        """These services raised in calls of the drone, but did not raise on the drone."""
        state, commands = self._servers.get(server), list[Command]()
        if state is None or state.leases.by_key(drone.key, now_s=now_s) is None:
            return []
        for service in sorted(state.offer.images & frozenset(services)):
            state.instances[service].watch.denied(drone.key)
            commands += self.watch(server, service, now_s=now_s)
        return commands

    def pause_s(self, server: str, services: Iterable[str], drone: Client, *, now_s: float) -> float:
        """How long the server leaves one of the services alone for the drone; 0 if it leaves none alone."""
        instances = self._servers[server].instances
        return max(
            (instances[service].failures.pause_s(drone.key, now_s=now_s) for service in services), default=0.0
        )

    def _condemn(self, state: _Server, service: str, useless: Useless, now_s: float) -> list[Command]:
        commands: list[Command] = [*state.instances.condemn(service, useless, now_s=now_s)]
        failures = state.instances[service].failures
        if commands:
            commands += state.leases.end(
                lambda lease: failures.pause_s(lease.drone.key, now_s=now_s) > 0, now_s=now_s
            )
        return commands

    def called(self, server: str, service: str, drone: str, *, now_s: float) -> None:
        """The instance reports a call of the drone with that `Client.key`; with a lease, it uses the service."""
        state = self._servers[server]
        state.instances[service].watch.began(drone, now_s)
        if state.leases.by_key(drone, now_s=now_s) is not None:
            state.instances[service].used_s = now_s

    def answered(
        self,
        server: str,
        service: str,
        drone: str,
        *,
        took_s: float,
        queued_s: float,
        outcome: str = "value",
        now_s: float,
    ) -> None:
        """The instance reports the end of a call of the drone with that `Client.key`."""
        state = self._servers[server]
        state.instances[service].watch.ended(drone, took_s=took_s, outcome=outcome, now_s=now_s)
        if outcome == "dropped":
            return
        if outcome == "value":
            state.instances[service].limit.answered(took_s)
        if state.leases.by_key(drone, now_s=now_s) is not None:
            state.measured.answered(service, drone, took_s=took_s, queued_s=queued_s, now_s=now_s)

    def used(self, server: str, drone: str, *, took_s: float, outcome: str, now_s: float) -> None:
        """An instance of any version computed a call of the drone with that `Client.key`, for `took_s`."""
        self._servers[server].usage.called(
            drone, took_s=took_s, is_answered=outcome != "dropped", now_s=now_s
        )

    def seen(self, server: str, drone: str, *, now_s: float) -> None:
        """The daemon saw the drone with that `Client.key`: renew the drone's lease, if any."""
        lease = self._servers[server].leases.by_key(drone, now_s=now_s)
        if lease is not None:
            lease.until_s = max(lease.until_s, now_s + self.settings.lease_s)

    # --- what the operator changes --------------------------------------------------------------------------

    def offer(
        self, offers: Mapping[str, ServerOffer], *, outdated: frozenset[tuple[str, str]]
    ) -> list[Command]:
        """Offer this from now on; stop running services that are withdrawn.

        New instances start before they replace `outdated` instances, given by server and service. A drone with a
        slot too many keeps it until its lease ends.
        """
        commands: list[Command] = []
        for name, offer in offers.items():
            server = self._servers[name]
            for service in sorted(server.offer.images):
                if service not in offer.images:
                    why = f"{name} has no image of {service} any more"
                    commands += server.instances.stop(service, why)
                elif (name, service) in outdated:
                    commands += server.instances.renew(
                        service, f"{name} has another version of {service} now"
                    )
            server.change(offer)
        return commands

    def revoke(self, certificates: frozenset[str], *, now_s: float) -> list[Command]:
        """Refuse exactly these certificates from now on; end the leases held by them."""
        self._revoked = certificates
        return [
            command
            for server in self._servers.values()
            for command in server.leases.revoke(certificates, now_s=now_s)
        ]

    def close(self, why: str) -> list[Command]:
        """Serve no drone from now on, for the first reason given; every instance ends its calls and stops."""
        self.closing = self.closing or why
        return [
            command
            for server in self._servers.values()
            for command in server.instances.stop_all(self.closing)
        ]

    def end_leases(self, *, now_s: float) -> list[Command]:
        """End every lease, as the daemon ends."""
        return [
            command
            for server in self._servers.values()
            for command in server.leases.end(lambda _: True, now_s=now_s)
        ]

    # --- what ends by itself --------------------------------------------------------------------------------

    def look(self, *, now_s: float) -> list[Command]:
        """End leases whose time is over; stop unused instances."""
        commands = self._end_leases(now_s)
        for server in self._servers.values():
            commands += server.instances.stop_former(now_s=now_s)
            if not server.leases:
                commands += server.instances.stop_idle(self.settings.idle_stop_s, now_s=now_s)
        return commands

    @property
    def is_idle(self) -> bool:
        """Whether no drone has a slot and nothing runs, so that nothing ends until a request arrives."""
        return not any(server.leases or server.instances.any_running for server in self._servers.values())

    def next_end_s(self, *, now_s: float) -> float:
        """The earliest time at which something ends by itself, except new holds for peers."""
        settings = self.settings
        ends_s = [now_s + settings.lease_s, now_s + settings.idle_stop_s]
        for server in self._servers.values():
            ends_s += [*server.leases.until_s(), *server.instances.former_until_s()]
            ends_s += [used_s + settings.idle_stop_s for used_s in server.instances.used_s()]
        return min(ends_s)

    # --- the status page ------------------------------------------------------------------------------------

    def refused(self, server: str, client: str, why: str, *, now_s: float) -> None:
        """Count a refused client; the controller need not know the reason."""
        self._refused[server if server in self._servers else _ELSEWHERE] += 1
        self._refusals.note(server, client, why, now_s=now_s)

    def show(
        self, client: Client, *, now_s: float
    ) -> tuple[list[ServerStatus], list[RefusalStatus]] | Denied:
        """The status of the servers and the last refusals, for an operator."""
        why = self._mistrust(client)
        if not why and client.certificate and client.role is not Role.OPERATOR:
            why = f"{client.name} is no operator: show a certificate of `upwash keys DIR --operator NAME`"
        if why:
            self.refused(_ELSEWHERE, client.name, why, now_s=now_s)
            return Denied(why)
        return self.servers(now_s=now_s), self._refusals.status(now_s=now_s)

    def servers(self, *, now_s: float) -> list[ServerStatus]:
        """The servers as they are now."""
        return [server.status(now_s=now_s) for server in self._servers.values()]

    @property
    def refused_times(self) -> Mapping[str, int]:
        """How often each server refused a client; under "" requests for no server of this daemon."""
        return self._refused

    def leases(self, server: str) -> frozenset[str]:
        """The names of the drones that hold a slot of the server."""
        return self._servers[server].leases.drones

    def state(self, server: str, service: str) -> InstanceState:
        """Where the instance of the service is in its life."""
        return self._servers[server].instances[service].state

    # --- who is refused, and why ----------------------------------------------------------------------------

    def _deny(self, name: str, services: Iterable[str], drone: Client, now_s: float) -> Denied | None:
        why = self._mistrust(drone) or self._obstacle(name, services, drone)
        return (
            self._denied(name, drone.name, why, now_s) if why else self._paused(name, services, drone, now_s)
        )

    def _denied(self, name: str, client: str, why: str, now_s: float, *, pause_s: float = 0.0) -> Denied:
        self.refused(name, client, why, now_s=now_s)
        return Denied(why, pause_s=pause_s)

    def _paused(self, name: str, services: Iterable[str], drone: Client, now_s: float) -> Denied | None:
        for service in services:
            pause_s = self.pause_s(name, [service], drone, now_s=now_s)
            if pause_s > 0:
                failures = self._servers[name].instances[service].failures
                why = f"{name} leaves {service} alone, which failed {failures.count} times in a row: {failures.why}"
                return self._denied(name, drone.name, why, now_s, pause_s=pause_s)
        return None

    def _mistrust(self, client: Client) -> str:
        if client.certificate in self._revoked:
            return f"the certificate of {client.name} is revoked"
        return ""

    def _stranger(self, name: str, drone: Client) -> str:
        lease = self._servers[name].leases.of(drone.name)
        return f"{drone.name} has no lease on {name}" if lease is None or lease.drone != drone else ""

    def _impostor(self, name: str, drone: Client, now_s: float) -> Denied | None:
        """Refuse a peer that asks for a drone which holds a lease itself, under another certificate."""
        lease = self._servers[name].leases.of(drone.name)
        if lease is None or lease.held_by or lease.drone == drone:
            return None
        return self._denied(
            name, drone.name, f"{drone.name} is here already, with another certificate", now_s
        )

    def _obstacle(self, name: str, services: Iterable[str], drone: Client) -> str:
        server = self._servers.get(name)
        if server is None:
            return f"no server {name} here; this daemon is {', '.join(self._servers)}"
        if self.closing:
            return self.closing
        if drone.role is not Role.DRONE:
            return f"{drone.name} is {_ROLES[drone.role]}, and {name} serves drones"
        missing = [service for service in services if service not in server.offer.images]
        if missing:
            return f"{name} has no image of {', '.join(missing)}"
        return ""

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
            commands += self._renew(name, drone, now_s)
        return denied, commands

    def _no_room(self, name: str, drone: Client, now_s: float) -> str:
        """Why no slot can be held for a drone on its way: drones that are here come first."""
        server = self._servers[name]
        if drone.name in server.leases or server.has_room(now_s=now_s):
            return ""
        return f"{name} has no free slot: {len(server.leases)} of {server.slots} in use"

    def _too_many(self, name: str, drone: Client, peer: str) -> str:
        server = self._servers[name]
        others = server.leases.held_by(peer, except_for=drone.name)
        most = max(1, server.slots // 2)
        return f"{peer} has {others} slots held, half of all" if others >= most else ""

    def _renew(self, name: str, drone: Client, now_s: float) -> list[Admit]:
        server = self._servers[name]
        known = server.leases.of(drone.name)
        if known is None:
            server.measured.came(drone.key)
        elif known.held_by and known.drone == drone:
            self._peers.came(known.held_by)
        return server.leases.renew(drone, now_s + self.settings.lease_s, now_s=now_s)

    def _end_leases(self, now_s: float) -> list[Command]:
        self._peers.forget(now_s=now_s)
        commands: list[Command] = []
        for server in self._servers.values():
            for lease in server.leases.over(now_s):
                if lease.held_by:
                    self._peers.missed(lease.held_by, now_s=now_s)
            commands += server.leases.end(lambda lease: lease.until_s <= now_s, now_s=now_s)
        return commands
