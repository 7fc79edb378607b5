"""What the drone-side machine wants done: orders for the radio, and changes to be logged."""

from __future__ import annotations

from dataclasses import dataclass

from upwash.core.recovery import Probing
from upwash.core.servers import Change


@dataclass(frozen=True, slots=True)
class Leave:
    """Give up the server: drop what is under way there, leave its network."""

    server: str


@dataclass(frozen=True, slots=True)
class Check:
    """Join the server's network and ask for its availability."""

    server: str
    check: int


@dataclass(frozen=True, slots=True)
class Probe:
    """Ask the server, which failed, for a sign of life, after the pauses that `probing` allows; join it for that.

    The first pause is `alone_s` at least.
    """

    server: str
    check: int
    alone_s: float
    probing: Probing


@dataclass(frozen=True, slots=True)
class Start:
    """Ask the daemon to start the services that do not run."""

    server: str
    check: int


@dataclass(frozen=True, slots=True)
class Prepare:
    """Have the server of that check ask its peer to start the services, and to hold a slot until it is there."""

    server: str
    check: int
    peer: str
    arrives_in_s: float
    hold_s: float


Order = Check | Probe | Start | Prepare | Leave
Command = Change | Order
