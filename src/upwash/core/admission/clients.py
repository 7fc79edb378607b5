"""Clients of a daemon, and the values of its status page."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from typing import Literal, TypeAlias

from msgspec import Struct

_MOST_REFUSALS = 20


class Role(StrEnum):
    """What a certificate is for."""

    DRONE = "drone"
    OPERATOR = "operator"
    SERVER = "server"


class Client(Struct, frozen=True):
    """A drone, an operator or another daemon: the name in its certificate, and the certificate's fingerprint.

    The fingerprint is empty where no certificates are used, which is on one machine only.
    """

    name: str
    certificate: str = ""
    role: Role = Role.DRONE

    @property
    def key(self) -> str:
        """The identity that instances use: the certificate's fingerprint, or the name without certificates.

        After a theft a name may be given again, a fingerprint never.
        """
        return self.certificate or self.name


class LeaseStatus(Struct, frozen=True):
    """A drone that holds a slot; `held_by` is the peer that asked for it, for a drone that is expected."""

    drone: str
    certificate: str
    ends_in_s: float
    held_by: str = ""


class InstanceStatus(Struct, frozen=True):
    """A service of a server, the state of its instance, and for how long a running one is unused.

    `replaced` counts useless instances, `failures` those that failed in a row. The service is left alone for another
    `paused_s`. `renewed` counts new versions that took over; `not_renewed` says why the latest version did not. An
    earlier daemon leaves these out.
    """

    service: str
    state: str
    endpoint: str
    unused_s: float
    replaced: int = 0
    failures: int = 0
    last_failure: str = ""
    paused_s: float = 0.0
    renewed: int = 0
    not_renewed: str = ""


class AccountStatus(Struct, frozen=True):
    """A drone that holds a slot or waits for one, since when, and the slot time on its account."""

    drone: str
    had_s: float
    holds_s: float | None
    waits_s: float | None


class DroneUsage(Struct, frozen=True):
    """What a drone has used of a server: `slot_s` in all, and answered `calls` computed for `computed_s`.

    `holds_s` is the age of its present slot, None without a slot. Its last call ended `called_ago_s` ago.
    """

    drone: str
    team: str
    holds_s: float | None
    slot_s: float
    calls: int
    computed_s: float
    called_ago_s: float | None


class TeamUsage(Struct, frozen=True):
    """What all drones of a team have used of a server; the fields of `DroneUsage`. The team has `slots` now."""

    team: str
    slots: int
    slot_s: float
    calls: int
    computed_s: float
    called_ago_s: float | None


class ServerStatus(Struct, frozen=True):
    """The status of one server of a daemon; `slots_why` explains the number of slots.

    A turn lasts `turn_s`, None without end; `turns_ended` turns ended for other drones. A daemon without turns
    leaves these out, and an earlier daemon leaves out `drones` and `teams`.
    """

    name: str
    slots: int
    leases: Sequence[LeaseStatus]
    instances: Sequence[InstanceStatus]
    slots_why: str = ""
    turn_s: float | None = None
    turns_ended: int = 0
    accounts: Sequence[AccountStatus] = ()
    drones: Sequence[DroneUsage] = ()
    teams: Sequence[TeamUsage] = ()


class RefusalStatus(Struct, frozen=True):
    """Why a client was refused, `times` times, and the seconds since the last time."""

    server: str
    client: str
    why: str
    times: int
    ago_s: float


DoorReason: TypeAlias = Literal[
    "no_certificate", "other_authority", "expired", "not_yet_valid", "revoked", "shut_out", "no_handshake"
]


class DoorStatus(Struct, frozen=True):
    """How often connections were refused for a reason before any request, who was last, and how long ago.

    `last` is a name where a certificate of the authority was shown, otherwise an address.
    """

    reason: DoorReason
    times: int
    last: str
    ago_s: float


class Refusals:
    """The last 20 different refusals."""

    def __init__(self) -> None:
        self._known: dict[tuple[str, str, str], tuple[int, float]] = {}  # how often, and when last

    def note(self, server: str, client: str, why: str, *, now_s: float) -> None:
        """Add a refusal; the same refusal again raises its count."""
        times, _ = self._known.pop((server, client, why), (0, now_s))
        self._known[server, client, why] = times + 1, now_s
        if len(self._known) > _MOST_REFUSALS:
            del self._known[next(iter(self._known))]

    def status(self, *, now_s: float) -> list[RefusalStatus]:
        """The refusals, the latest first."""
        return [
            RefusalStatus(*what, times=times, ago_s=now_s - last_s)
            for what, (times, last_s) in reversed(self._known.items())
        ]
