"""What `Selection` returns: commands for the radios, and changes for the log."""

from __future__ import annotations

from collections.abc import Sequence

from msgspec import Struct

from upwash.core.knowledge.coverage import MeasuredPlace
from upwash.core.knowledge.servers import Change
from upwash.core.selection.recovery import Probing


class Leave(Struct, frozen=True):
    """Give up the server: drop what is under way there, and leave its network.

    `check`, in every command, is the number of the server's latest check or probe, which logs name as the cause.
    """

    server: str
    check: int


class Check(Struct, frozen=True):
    """Join the server's network, in `join_limit_s` at most, and ask for its availability."""

    server: str
    check: int
    join_limit_s: float


class Probe(Struct, frozen=True):
    """Join the network of a failed server, and ask for a sign of life after each pause of `probing`.

    The first pause is `alone_s` at least; joining may take `join_limit_s`.
    """

    server: str
    check: int
    join_limit_s: float
    alone_s: float
    probing: Probing


class Start(Struct, frozen=True):
    """Ask the daemon to start the services that do not run, within `limit_s`."""

    server: str
    check: int
    limit_s: float


class Prepare(Struct, frozen=True):
    """Ask `server`, which is in use, to announce the drone to its `peer`.

    The peer starts the services, and holds a slot until `hold_s` after the drone arrives there in `arrives_in_s`.
    """

    server: str
    check: int
    peer: str
    arrives_in_s: float
    hold_s: float


class Full(Struct, frozen=True):
    """For the log: the server has no slot for the drone, and `waiting` drones queue; the drone goes on asking."""

    server: str
    check: int
    waiting: int


class ServerPaused(Struct, frozen=True):
    """For the log: the server is not used for `pause_s`, because a service keeps failing there."""

    server: str
    check: int
    pause_s: float
    why: str


class Preferred(Struct, frozen=True):
    """For the log: calls go first to this server from now on; the other READY server is kept."""

    server: str
    check: int
    why: str


class ExpectedTimes(Struct, frozen=True):
    """For the log: the expected times (s after arming) at each waypoint and of the mission's end, calls as asked for.

    `lightest_s` is the end with every call lighter, if the mission has a `finish_by_s`.
    """

    reached_s: Sequence[float]
    as_asked_s: float
    lightest_s: float | None = None
    finish_by_s: float | None = None


class Mapped(Struct, frozen=True):
    """For the log: the measurements of a server at a place."""

    server: str
    place: MeasuredPlace


Command = Check | Probe | Start | Prepare | Leave
Effect = Change | Full | ServerPaused | Preferred | ExpectedTimes | Mapped | Command
