"""What a program and the service instances that it started say to each other: lines of JSON.

A process hears its program over a socket pair, a container over TLS. Either is also the leash: when the program dies,
however it dies, the instance reads an end of file and ends.

The service is in the same process as the instance's end and may write whatever it likes, so the program believes only
what can be so, and hangs up on an instance that says more than `MOST_REPORTS_PER_S`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec

from upwash.real.limits import Limits

MOST_REPORTS_PER_S = 1000  # one for each call, and one a second for each drone


class Begin(msgspec.Struct, frozen=True, tag="begin"):
    """To the instance, first: what to be.

    gRPC listens at `listen`. What comes to the inherited socket is handed on to there; in a container what comes to
    the address `outside` from who holds the same `leash`. Each such connection announces who calls if it
    `is_announced`.
    """

    program: str
    settings: dict[str, Any]
    service: str
    listen: str
    max_message_bytes: int
    pace_s: Mapping[str, float]
    is_announced: bool = False
    outside: str = ""
    leash: str = ""
    limits: Limits | None = None  # in a sandbox


class Admit(msgspec.Struct, frozen=True, tag="admit"):
    """To the instance: answer these drones and no others."""

    drones: list[str]


class Drain(msgspec.Struct, frozen=True, tag="drain"):
    """To the instance: refuse every further call for this reason, and say when none is under way."""

    why: str


class Ready(msgspec.Struct, frozen=True, tag="ready"):
    """From the instance: it can be called at this address."""

    address: str


class Failed(msgspec.Struct, frozen=True, tag="failed"):
    """From the instance: it cannot serve."""

    why: str


class Admitted(msgspec.Struct, frozen=True, tag="admitted"):
    """From the instance: the oldest Admit that was not acknowledged yet is in force."""


class Drained(msgspec.Struct, frozen=True, tag="drained"):
    """From the instance: no call is under way, and none will be."""


class Called(msgspec.Struct, frozen=True, tag="called"):
    """From the instance: this drone, known by `Visitor.key`, called."""

    drone: str


class Answered(msgspec.Struct, frozen=True, tag="answered"):
    """From the instance: a call of this method has an answer, after so long in the service."""

    method: str
    took_s: float


class Said(msgspec.Struct, frozen=True, tag="said"):
    """From a container: what the service in it printed."""

    output: bytes


class Ended(msgspec.Struct, frozen=True, tag="ended"):
    """From a container, last: the service in it ended with this code, or by that signal if negative."""

    code: int


FromInstance = Ready | Failed | Admitted | Drained | Called | Answered | Said | Ended

_encoder = msgspec.json.Encoder()
to_instance = msgspec.json.Decoder(Begin | Admit | Drain)
from_instance: msgspec.json.Decoder[FromInstance] = msgspec.json.Decoder(FromInstance)


def line(message: Begin | Admit | Drain | FromInstance) -> bytes:
    """A message as one line of JSON."""
    return _encoder.encode(message) + b"\n"
