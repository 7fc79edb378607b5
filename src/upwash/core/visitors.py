"""Who asks something of a daemon, and what it shows to those who may look."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum

_MOST_REFUSALS = 20


class Role(StrEnum):
    """What a certificate is for."""

    DRONE = "drone"
    OPERATOR = "operator"
    SERVER = "server"


@dataclass(frozen=True, slots=True)
class Visitor:
    """A drone, an operator or another daemon: the name in its certificate, and the certificate's fingerprint.

    The fingerprint is empty where no certificates are used, which is on one machine only.
    """

    name: str
    certificate: str = ""
    role: Role = Role.DRONE

    @property
    def key(self) -> str:
        """What instances know it by: a name may be given again after a theft, a fingerprint is never."""
        return self.certificate or self.name


@dataclass(frozen=True, slots=True)
class LeaseStatus:
    """A drone that holds a slot; `held_by` is the peer that asked for it, for a drone that is expected."""

    drone: str
    certificate: str
    ends_in_s: float
    held_by: str = ""


@dataclass(frozen=True, slots=True)
class InstanceStatus:
    """A service of a server and where its instance is in its life; unused for so long if it runs."""

    service: str
    state: str
    endpoint: str
    unused_s: float


@dataclass(frozen=True, slots=True)
class ServerStatus:
    """One of the servers that a daemon acts as."""

    name: str
    slots: int
    leases: Sequence[LeaseStatus]
    instances: Sequence[InstanceStatus]


@dataclass(frozen=True, slots=True)
class RefusalStatus:
    """What a visitor was refused, how often, and how long ago last."""

    server: str
    visitor: str
    why: str
    times: int
    ago_s: float


@dataclass(slots=True)
class _Refusal:
    last_s: float
    times: int = 0


@dataclass(slots=True)
class Refusals:
    """The last different refusals."""

    _known: dict[tuple[str, str, str], _Refusal] = field(default_factory=dict)

    def note(self, server: str, visitor: str, why: str, *, now_s: float) -> None:
        """Takes in one more; a repetition counts with the first."""
        what = (server, visitor, why)
        refusal = self._known.pop(what, _Refusal(now_s))
        refusal.times += 1
        refusal.last_s = now_s
        self._known[what] = refusal
        if len(self._known) > _MOST_REFUSALS:
            del self._known[next(iter(self._known))]

    def status(self, *, now_s: float) -> list[RefusalStatus]:
        """What is known, the latest first."""
        return [
            RefusalStatus(*what, times=refusal.times, ago_s=now_s - refusal.last_s)
            for what, refusal in reversed(self._known.items())
        ]
