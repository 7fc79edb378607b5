"""What `Selection` returns: commands for the radios, and events for the log."""

from __future__ import annotations

from msgspec import Struct

from upwash.core.selection.recovery import Probing
from upwash.eventlog.schema import Event


class RadioCommand(Struct, frozen=True):
    """The base of the commands; logs name `check`, the number of the server's latest check or probe, as the cause."""

    server: str
    check: int


class Leave(RadioCommand, frozen=True):
    """Give up the server: drop what is under way there, and leave its network."""


class Check(RadioCommand, frozen=True):
    """Join the server's network, in `join_limit_s` at most, and ask for its availability."""

    join_limit_s: float


class Probe(RadioCommand, frozen=True):
    """Join the network of a failed server, and ask for a sign of life after each pause of `probing`.

    The first pause is `alone_s` at least; joining may take `join_limit_s`.
    """

    join_limit_s: float
    alone_s: float
    probing: Probing


class Start(RadioCommand, frozen=True):
    """Ask the daemon to start the services that do not run, within `limit_s`."""

    limit_s: float


class Prepare(RadioCommand, frozen=True):
    """Ask `server`, which is in use, to announce the drone to its `peer`.

    The peer starts the services, and holds a slot until `hold_s` after the drone arrives there in `arrives_in_s`.
    """

    peer: str
    arrives_in_s: float
    hold_s: float


Effect = Event | RadioCommand
