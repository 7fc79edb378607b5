"""The leases of one server: which drones hold a slot, and until when.

At the request of a peer a slot is also held for a drone that is expected, until it comes. A drone whose turn is over
has no slot any more; its calls under way are still answered.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from msgspec import Struct

from upwash.core.admission.clients import Client, LeaseStatus
from upwash.core.admission.turns import Turns
from upwash.core.admission.usage import LeaseEnded, Usage

_FINISH_S = 10.0  # after a turn, for calls under way


class Admit(Struct, frozen=True):
    """The server's instances answer exactly these drones from now on, given by `Client.key`.

    `finishing` drones get answers to calls under way, and to no new calls.
    """

    server: str
    drones: frozenset[str]
    finishing: frozenset[str] = frozenset()


@dataclass(slots=True)
class Lease:
    """A slot that a drone holds, or that is held for it."""

    drone: Client
    until_s: float
    held_by: str = ""  # the peer that asked for it, until the drone comes itself


class Leases:
    """The taken slots of one server; methods that change which drones its instances answer return an `Admit`."""

    def __init__(self, server: str, turns: Turns, usage: Usage) -> None:
        self._server = server
        self._turns = turns
        self._usage = usage
        self._leases: dict[str, Lease] = {}  # by drone
        self._finishing: dict[str, float] = {}  # by `Client.key`: until when

    def __len__(self) -> int:
        return len(self._leases)

    def __contains__(self, drone: str) -> bool:
        return drone in self._leases

    @property
    def drones(self) -> frozenset[str]:
        """The names of the drones that hold a slot."""
        return frozenset(self._leases)

    @property
    def keys(self) -> frozenset[str]:
        """The `Client.key` of each drone that holds a slot."""
        return frozenset(lease.drone.key for lease in self._leases.values())

    def of(self, drone: str) -> Lease | None:
        """The lease of the drone of that name; None without one."""
        return self._leases.get(drone)

    def is_of(self, drone: Client) -> bool:
        """Whether the drone, with this certificate, holds a slot."""
        lease = self._leases.get(drone.name)
        return lease is not None and lease.drone == drone

    def by_key(self, key: str, *, now_s: float) -> Lease | None:
        """The lease of the drone with that `Client.key`; None without one, or if its time is over."""
        present = (lease for lease in self._leases.values() if lease.until_s > now_s)
        return next((lease for lease in present if lease.drone.key == key), None)

    def held_by(self, peer: str, *, except_for: str) -> int:
        """How many slots are held at the peer's request, without the drone `except_for`."""
        return sum(lease.held_by == peer for name, lease in self._leases.items() if name != except_for)

    def until_s(self) -> list[float]:
        """When each lease ends, and when each drone's time for last calls after a turn ends."""
        return [*(lease.until_s for lease in self._leases.values()), *self._finishing.values()]

    def renew(self, drone: Client, until_s: float, *, now_s: float) -> list[Admit]:
        """Give the drone itself a lease until `until_s`, or extend it."""
        return self._put(Lease(drone, until_s), now_s)

    def hold(self, drone: Client, until_s: float, *, peer: str, now_s: float) -> list[Admit]:
        """Hold a slot for an announced drone until `until_s`; a lease of the drone itself never gets shorter."""
        known = self.of(drone.name)
        if known is not None and not known.held_by:
            known.until_s = max(known.until_s, until_s)
            return []
        return self._put(Lease(drone, until_s, held_by=peer), now_s)

    def end(self, which: Callable[[Lease], bool], *, now_s: float) -> list[Admit | LeaseEnded]:
        """End the leases that `which` selects, and last calls whose time is over."""
        ended = []
        for name, lease in [item for item in self._leases.items() if which(item[1])]:
            del self._leases[name]
            self._turns.gave_back(name, now_s=now_s)
            ended.append(self._usage.gave_back(name, held_by=lease.held_by, now_s=now_s))
        finished = [key for key, until_s in self._finishing.items() if until_s <= now_s]
        for key in finished:
            del self._finishing[key]
        return [*ended, self.admitted()] if ended or finished else []

    def revoke(self, certificates: frozenset[str], *, now_s: float) -> list[Admit | LeaseEnded]:
        """End the leases of these certificates, and their time for last calls."""
        self._finishing |= dict.fromkeys(certificates & self._finishing.keys(), now_s)
        return self.end(lambda lease: lease.drone.certificate in certificates, now_s=now_s)

    def end_turn(self, drone: str, *, now_s: float) -> list[Admit | LeaseEnded]:
        """End the drone's lease; its calls under way are answered for 10 s more."""
        lease = self._leases[drone]
        self._finishing[lease.drone.key] = now_s + _FINISH_S
        self._turns.yields(drone, expected_until_s=lease.until_s)
        return self.end(lambda lease: lease.drone.name == drone, now_s=now_s)

    def admitted(self) -> Admit:
        """The drones that the server's instances answer now."""
        return Admit(self._server, self.keys, frozenset(self._finishing) - self.keys)

    def status(self, *, now_s: float) -> list[LeaseStatus]:
        """The leases for the status page."""
        return [
            LeaseStatus(name, lease.drone.certificate, lease.until_s - now_s, lease.held_by)
            for name, lease in sorted(self._leases.items())
        ]

    def _put(self, lease: Lease, now_s: float) -> list[Admit]:
        known = self._leases.get(lease.drone.name)
        self._leases[lease.drone.name] = lease
        self._usage.took(lease.drone, now_s=now_s)
        if known is None:
            self._turns.took(lease.drone.name, now_s=now_s)
        return [] if known is not None and known.drone == lease.drone else [self.admitted()]
