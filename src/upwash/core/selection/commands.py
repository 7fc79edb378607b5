"""What the drone-side machine wants done: commands for the radio, and changes to be logged."""

from __future__ import annotations

from collections.abc import Sequence

from msgspec import Struct

from upwash.core.knowledge.coverage import MeasuredPlace
from upwash.core.knowledge.servers import Change
from upwash.core.selection.recovery import Probing


class Leave(Struct, frozen=True):
    """Give up the server: drop what is under way there, leave its network.

    `check` is the latest check, or probe, of the server, here and in the other commands: the cause that logs name.
    """

    server: str
    check: int


class Check(Struct, frozen=True):
    """Join the server's network, in `join_limit_s` at most, and ask for its availability."""

    server: str
    check: int
    join_limit_s: float


class Probe(Struct, frozen=True):
    """Ask the server, which failed, for a sign of life, after the pauses that `probing` allows; join it for that.

    The first pause is `alone_s` at least; joining may take `join_limit_s`.
    """

    server: str
    check: int
    join_limit_s: float
    alone_s: float
    probing: Probing


class Start(Struct, frozen=True):
    """Ask the daemon to start the services that do not run; it may take `limit_s`."""

    server: str
    check: int
    limit_s: float


class Prepare(Struct, frozen=True):
    """Have the server of that check ask its peer to start the services, and to hold a slot until it is there."""

    server: str
    check: int
    peer: str
    arrives_in_s: float
    hold_s: float


class Full(Struct, frozen=True):
    """To be logged: the server has no slot for the drone, and `waiting` drones queue; the drone goes on asking."""

    server: str
    check: int
    waiting: int


class ServerPaused(Struct, frozen=True):
    """To be logged: the server is left out for `pause_s`, because a service keeps failing there."""

    server: str
    check: int
    pause_s: float
    why: str


class ExpectedTimes(Struct, frozen=True):
    """To be logged: the expected times at each waypoint and of the mission's end, with calls as asked for.

    `lightest_s` is the end with every call lighter, if the mission has a `finish_by_s`.
    """

    reached_s: Sequence[float]
    as_asked_s: float
    lightest_s: float | None = None
    finish_by_s: float | None = None


class Mapped(Struct, frozen=True):
    """To be logged: what is known now of a server at a place."""

    server: str
    place: MeasuredPlace


Command = Check | Probe | Start | Prepare | Leave
Effect = Change | Full | ServerPaused | ExpectedTimes | Mapped | Command
