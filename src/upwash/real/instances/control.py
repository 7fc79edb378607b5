"""What a program and the service instances that it started say to each other: lines of JSON.

A process hears its program over a socket pair, a container over TLS. Either also ends the
instance: when the program dies, however it dies, the instance reads an end of file.

The service is in the same process as the instance's end and may write whatever it likes, so the program believes only
what can be so, and hangs up on an instance that says more than `MOST_REPORTS_PER_S`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, Literal

import msgspec

from upwash.core.admission.limits import Limits
from upwash.support.heat import Surroundings

if TYPE_CHECKING:  # an instance has no use for it
    from upwash.ports import InstanceSpec, Program

MOST_REPORTS_PER_S = 2000  # two for each call


class Begin(msgspec.Struct, frozen=True, tag="begin"):
    """To the instance, first: what to be.

    gRPC listens at `listen`. The inherited socket's connections are handed on to gRPC; in a container those of the
    address `outside`, from holders of the same `credentials`. Each connection announces its caller if it
    `is_announced`.
    Without `listen`, calls arrive over the inherited socket itself (`direct`).
    """

    program: str
    settings: dict[str, Any]
    service: str
    listen: str
    max_message_bytes: int
    pace_s: Mapping[str, float]
    heats: Surroundings | None = None
    is_announced: bool = False
    outside: str = ""
    credentials: str = msgspec.field(default="", name="leash")  # as images of earlier versions read it
    limits: Limits | None = None  # in a sandbox
    command: tuple[str, ...] = ()  # of a program in another language


def begin_of(
    spec: InstanceSpec,
    program: Program,
    *,
    listen: str,
    max_message_bytes: int,
    is_announced: bool,
    outside: str = "",
    limits: Limits | None = None,
) -> Begin:
    """What an instance of the spec is to be, with the program as it is where the instance runs."""
    return Begin(
        program=program.path,
        settings=dict(program.settings),
        command=program.command,
        service=spec.service,
        listen=listen,
        outside=outside,
        is_announced=is_announced,
        max_message_bytes=max_message_bytes,
        pace_s=spec.pace_s,
        heats=spec.heats,
        limits=limits,
    )


class Admit(msgspec.Struct, frozen=True, tag="admit"):
    """To the instance: answer these drones and no others, and of those that are finishing what has arrived."""

    drones: list[str]
    finishing: list[str] = []


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
    """From the instance: it begins to compute a call of this drone, known by `Client.key`."""

    drone: str


class Answered(msgspec.Struct, frozen=True, kw_only=True, tag="answered"):
    """From the instance: this drone's call of this method has its outcome.

    The call waited so long for its turn, and then was so long in the service.
    """

    drone: str = ""  # which instances in images of earlier versions do not say
    method: str
    queued_s: float = 0.0
    took_s: float
    outcome: Literal["value", "raised", "dropped"] = "value"


class Said(msgspec.Struct, frozen=True, tag="said"):
    """From a container: what the service in it printed, after as many bytes as were left out."""

    output: bytes
    left_out: Annotated[int, msgspec.Meta(ge=0)] = 0


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
