"""The leases of one server: which drones hold a slot, and until when.

A slot is held for a drone that is expected too, for the peer that asked for it, until the drone comes itself. A drone
whose turn is over holds none any more, and its calls that are under way are still answered.
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
    """From now on the server's instances answer these drones, known by `Client.key`, and no others.

    Of those that are `finishing` they answer the calls that are under way, and no further ones.
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
    """The slots of one server that are taken; what changes whom its instances answer returns that as a command."""

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
        """The same drones, by `Client.key`."""
        return frozenset(lease.drone.key for lease in self._leases.values())

    def of(self, drone: str) -> Lease | None:
        """The lease of the drone of that name; None without one."""
        return self._leases.get(drone)

    def by_key(self, key: str, *, now_s: float) -> Lease | None:
        """The lease of the drone with that `Client.key`, unless its time is over."""
        return next(
            (lease for lease in self._leases.values() if lease.drone.key == key and lease.until_s > now_s),
            None,
        )

    def held_by(self, peer: str, *, except_for: str) -> int:
        """How many slots the peer has held for other drones."""
        return sum(lease.held_by == peer for name, lease in self._leases.items() if name != except_for)

    def until_s(self) -> list[float]:
        """When each lease ends, and the time for the last calls of a turn."""
        return [*(lease.until_s for lease in self._leases.values()), *self._finishing.values()]

    def renew(self, drone: Client, until_s: float, *, now_s: float) -> list[Admit]:
        """The drone itself is here, and has a lease until then."""
        return self._put(Lease(drone, until_s), now_s)

    def hold(self, drone: Client, until_s: float, *, peer: str, now_s: float) -> list[Admit]:
        """Hold a slot for an announced drone until then; a lease of its own never gets shorter."""
        known = self.of(drone.name)
        if known is not None and not known.held_by:
            known.until_s = max(known.until_s, until_s)
            return []
        return self._put(Lease(drone, until_s, held_by=peer), now_s)

    def over(self, now_s: float) -> list[Lease]:
        """The leases whose time is over."""
        return [lease for lease in self._leases.values() if lease.until_s <= now_s]

    def end(self, which: Callable[[Lease], bool], *, now_s: float) -> list[Admit | LeaseEnded]:
        """End these leases, and finished grace periods after turns."""
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
        """Ends the leases that were given for these certificates, and the time for last calls."""
        for certificate in certificates & self._finishing.keys():
            self._finishing[certificate] = now_s
        return self.end(lambda lease: lease.drone.certificate in certificates, now_s=now_s)

    def end_turn(self, drone: str, *, now_s: float) -> list[Admit | LeaseEnded]:
        """Ends the lease of the drone, whose calls that are under way are still answered."""
        lease = self._leases[drone]
        self._finishing[lease.drone.key] = now_s + _FINISH_S
        self._turns.yields(drone, expected_until_s=lease.until_s)
        return self.end(lambda lease: lease.drone.name == drone, now_s=now_s)

    def admitted(self) -> Admit:
        """Whom the server's instances answer."""
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
