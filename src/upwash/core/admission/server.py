"""One of the servers that a daemon acts as: its services, instances, slots and the drones that hold them.

The parts stand in leases.py, turns.py, usage.py, slots.py and instances.py; here it is decided who gets what.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Literal

from msgspec import Struct

from upwash.core.admission.clients import Client, ServerStatus
from upwash.core.admission.instances import InstancePlace, InstanceState, StartInstance, StopInstance
from upwash.core.admission.leases import Admit, Leases
from upwash.core.admission.slots import MeasuredSlots
from upwash.core.admission.turns import ASK_AGAIN_S, Turns
from upwash.core.admission.usage import LeaseEnded, Usage
from upwash.core.admission.watchdog import CALL_LIMIT_S, Useless

Command = StartInstance | StopInstance | Admit | LeaseEnded


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


class HostedServer:
    """A server of the daemon, with leases of `lease_s`; each instance gets the next of the `numbers`."""

    def __init__(self, name: str, offer: ServerOffer, numbers: Iterator[int], *, lease_s: float) -> None:
        self.name = name
        self.offer = offer
        self.turns = Turns(offer.turn_s)
        self.usage = Usage(name)
        self.leases = Leases(name, self.turns, self.usage)
        self.closing = ""  # why drones are refused; empty while they are served
        self._turns_ended = 0
        self._measured = MeasuredSlots(offer.lanes_of_each)
        self._lease_s = lease_s
        self._numbers = numbers
        self._places: dict[str, InstancePlace] = {}
        self._make_places()

    # --- slots ----------------------------------------------------------------------------------------------

    @property
    def slots(self) -> int:
        """How many drones the server takes at once now."""
        return self._measured.count if self.offer.slots == "auto" else self.offer.slots

    def ask_for_slot(self, drone: str, *, now_s: float) -> tuple[Denied | None, list[Command]]:
        """Return why the drone, without a slot, may have none now, or None; and what a holder that yields must do."""
        is_news = self.turns.asked(drone, now_s=now_s)
        free = self.slots - len(self.leases)
        rank = self.turns.rank(drone, now_s=now_s)
        if rank < free:
            return None, []
        over, commands = self.turns.over(drone, now_s=now_s), list[Command]()
        if rank - max(0, free) < len(over):
            self._turns_ended += 1
            commands += self.leases.end_turn(over[0], now_s=now_s)
        if commands and len(self.leases) < self.slots:
            return None, commands
        waiting = len(self.turns.waiting(now_s=now_s))
        return Denied(self.full, waiting, ask_again_s=ASK_AGAIN_S, is_news=is_news), commands

    @property
    def full(self) -> str:
        """Why a drone gets no slot."""
        return f"{self.name} has no free slot: {len(self.leases)} of {self.slots} in use"

    def no_hold(self, drone: Client, peer: str, *, now_s: float) -> str:
        """Why the peer gets no slot held for the drone; drones that are here come first."""
        others = self.leases.held_by(peer, except_for=drone.name)
        if others >= max(1, self.slots // 2):
            return f"{peer} has {others} {'slot' if others == 1 else 'slots'} held, half of all"
        has_room = self.slots - len(self.leases) > len(self.turns.waiting(now_s=now_s))
        return "" if drone.name in self.leases or has_room else self.full

    def renew(self, drone: Client, *, now_s: float) -> list[Admit]:
        """Give the drone, which is here, a lease from now on."""
        if drone.name not in self.leases:
            self._measured.came(drone.key)
        return self.leases.renew(drone, now_s + self._lease_s, now_s=now_s)

    def seen(self, drone: str, *, now_s: float) -> None:
        """The daemon saw the drone with that `Client.key`: renew the drone's lease, if any."""
        if (lease := self.leases.by_key(drone, now_s=now_s)) is not None:
            lease.until_s = max(lease.until_s, now_s + self._lease_s)

    # --- instances ------------------------------------------------------------------------------------------

    def state(self, service: str) -> InstanceState:
        """The state of the service's instance."""
        return self._places[service].state

    def endpoints(self, services: Iterable[str]) -> dict[str, str]:
        """The endpoints of those of the services that run, by service."""
        places = (self._places[service] for service in services)
        return {place.service: place.endpoint for place in places if place.is_running}

    def begin(self, service: str) -> tuple[InstancePlace, list[StartInstance]]:
        """The place of the service, where an instance starts unless there is one."""
        place = self._places[service]
        return place, place.begin()

    def has_place(self, service: str, number: int) -> bool:
        """Whether drones are sent to the instance of that number; other instances end soon, or are starting."""
        return self._places[service].number == number

    def ready(self, service: str, number: int, endpoint: str, *, now_s: float) -> list[Command]:
        """The instance of that number can be called at the endpoint."""
        place, lanes = self._places[service], self.offer.lanes.get(service, 1)
        until_s = now_s + self._lease_s
        is_news = place.ready(number, endpoint, lanes=lanes, former_until_s=until_s, now_s=now_s)
        return [self.leases.admitted()] if is_news else []

    def gone(self, service: str, number: int, why: str = "", *, now_s: float = 0.0) -> list[StartInstance]:
        """The instance of that number ended: it failed for the reason `why`, or it was stopped.

        A useless instance is replaced if a drone with a slot may call it.
        """
        place = self._places[service]
        was_useless = place.gone(number, why, now_s=now_s)
        is_wanted = any(not place.failures.pause_s(key, now_s=now_s) for key in self.leases.keys)
        is_offered = not self.closing and service in self.offer.images
        return place.begin() if was_useless and is_wanted and is_offered else []

    def heard(self, service: str, number: int, *, now_s: float) -> None:
        """The instance of that number has given a sign of life."""
        if self.has_place(service, number):
            self._places[service].watch.heard(now_s)

    def watch(self, service: str, number: int, *, now_s: float) -> list[Command]:
        """Stop the running instance of that number if it is of no use."""
        place, at_most_s = self._places[service], self.offer.call_limits_s.get(service, CALL_LIMIT_S)
        if place.number != number or not place.is_running:
            return []
        useless = place.watch.verdict(place.limit.seconds(at_most_s), served=self.leases.keys, now_s=now_s)
        if useless is None:
            return []
        place.limit.cut(at_most_s)
        return self._condemn(place, useless, now_s)

    def silent(self, service: str, why: str, *, now_s: float) -> list[Command]:
        """Stop the running instance, because it did not confirm the drones that it must answer."""
        place = self._places[service]
        return self._condemn(place, Useless(why, place.watch.callers), now_s)

    def deny(self, services: Iterable[str], drone: Client, *, now_s: float) -> list[Command]:
        """Note that these services raised in calls of the drone, but not on the drone; stop useless instances."""
        commands: list[Command] = []
        if self.leases.by_key(drone.key, now_s=now_s) is not None:
            for service in sorted(self.offer.images & frozenset(services)):
                place = self._places[service]
                place.watch.denied(drone.key)
                commands += self.watch(service, place.number, now_s=now_s)
        return commands

    def called(self, service: str, number: int, drone: str, *, now_s: float) -> None:
        """Note that the instance began a call of the drone with that `Client.key`.

        If the drone has a lease, the service counts as used at `now_s`.
        """
        place = self._places[service]
        if place.number == number:
            place.watch.began(drone, now_s)
            if self.leases.by_key(drone, now_s=now_s) is not None:
                place.used_s = now_s

    def answered(
        self,
        service: str,
        number: int,
        drone: str,
        *,
        took_s: float,
        queued_s: float = 0.0,
        outcome: str = "value",
        now_s: float,
    ) -> None:
        """The instance, of any version, reports the end of a call of the drone with that `Client.key`."""
        place, is_answered = self._places[service], outcome != "dropped"
        self.usage.called(drone, took_s=took_s, is_answered=is_answered, now_s=now_s)
        if place.number != number:
            return
        place.watch.ended(drone, took_s=took_s, outcome=outcome, now_s=now_s)
        if outcome == "value":
            place.limit.answered(took_s)
        if is_answered and self.leases.by_key(drone, now_s=now_s) is not None:
            self._measured.answered(service, drone, took_s=took_s, queued_s=queued_s, now_s=now_s)

    def pause(self, services: Iterable[str], drone: Client, *, now_s: float) -> tuple[str, float]:
        """Which of the services is left alone for the drone, and for how long; 0 if none is."""
        for service in services:
            failures = self._places[service].failures
            if (pause_s := failures.pause_s(drone.key, now_s=now_s)) > 0:
                often = "" if failures.count == 1 else f" {failures.count} times in a row"
                why = f"{self.name} leaves {service} alone, which failed{often}"
                return f"{why}: {failures.why}", pause_s
        return "", 0.0

    def _condemn(self, place: InstancePlace, useless: Useless, now_s: float) -> list[Command]:
        commands: list[Command] = [*place.condemn(useless, now_s=now_s)]
        if commands:
            commands += self.leases.end(
                lambda lease: place.failures.pause_s(lease.drone.key, now_s=now_s) > 0, now_s=now_s
            )
        return commands

    # --- what the operator changes, and what ends by itself ---------------------------------------------------

    def change(self, offer: ServerOffer, *, outdated: frozenset[tuple[str, str]]) -> list[Command]:
        """Offer this from now on: stop withdrawn services, and replace those `outdated`, by server and service."""
        commands: list[Command] = []
        for service in sorted(self.offer.images):
            if service not in offer.images:
                commands += self._places[service].stop(f"{self.name} has no image of {service} any more")
            elif (self.name, service) in outdated:
                why = f"{self.name} has another version of {service} now"
                commands += self._places[service].renew(why)
        self.offer = offer
        self.turns.turn_s = offer.turn_s
        self._measured.offer(offer.lanes_of_each)
        self._make_places()
        return commands

    def close(self, why: str) -> list[StopInstance]:
        """Serve no drone from now on; every instance ends its calls and stops."""
        self.closing = why
        return [command for place in self._places.values() for command in place.stop(why)]

    def stop_unused(self, idle_s: float, *, now_s: float) -> list[StopInstance]:
        """Stop former instances whose time is over and, without leases, instances not called for that long."""
        places = self._places.values()
        commands = [command for place in places for command in place.stop_former(now_s=now_s)]
        for place in () if self.leases else places:
            if place.is_running and now_s - place.used_s >= idle_s:
                commands += place.stop()
        return commands

    @property
    def is_idle(self) -> bool:
        """Whether no drone has a slot and nothing runs."""
        places = self._places.values()
        return not self.leases and not any(place.is_running or place.former_s for place in places)

    def ends_s(self, idle_s: float) -> Iterator[float]:
        """When each lease and each former instance ends, and each running instance that is not called again."""
        yield from self.leases.until_s()
        for place in self._places.values():
            yield from place.former_s.values()
            if place.is_running:
                yield place.used_s + idle_s

    def status(self, *, now_s: float) -> ServerStatus:
        """The server's part of the status page, with withdrawn services whose instance has not ended."""
        shown = [
            place
            for service, place in sorted(self._places.items())
            if service in self.offer.images or place.state is not InstanceState.ABSENT
        ]
        return ServerStatus(
            self.name,
            self.slots,
            self.leases.status(now_s=now_s),
            [place.status(now_s=now_s) for place in shown],
            slots_why=self._measured.why if self.offer.slots == "auto" else "configured",
            turn_s=self.offer.turn_s if math.isfinite(self.offer.turn_s) else None,
            turns_ended=self._turns_ended,
            accounts=self.turns.status(now_s=now_s),
            drones=self.usage.drones(now_s=now_s),
            teams=self.usage.teams(now_s=now_s),
        )

    def _make_places(self) -> None:
        for service in sorted(self.offer.images):
            self._places.setdefault(service, InstancePlace(self.name, service, self._numbers))
