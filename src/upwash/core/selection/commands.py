"""What `Selection` returns: commands for the radios, and events for the log."""

from __future__ import annotations

from msgspec import Struct

from upwash.core.knowledge.servers import Change
from upwash.core.selection.recovery import Probing
from upwash.eventlog.schema import Event


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


Command = Check | Probe | Start | Prepare | Leave
Effect = Event | Command
Move = Change | Effect  # inside the selection: a change becomes an event, with the estimates of its moment
