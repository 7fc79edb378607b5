"""The messages between a program and the service instances that it started: lines of JSON.

They pass over a socket pair to a process, and over TLS to a container. An instance ends when the line ends, however
its program died.

The service runs in the same process as the instance's end and may write anything there. So the program accepts only
possible reports, and hangs up on an instance that sends more than `MOST_REPORTS_PER_S`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, Literal

import msgspec

from upwash.core.admission.limits import Limits
from upwash.support.heat import Surroundings

if TYPE_CHECKING:  # instances need not load it
    from upwash.ports import InstanceSpec, Program

MOST_REPORTS_PER_S = 2000  # two for each call


class Begin(msgspec.Struct, frozen=True, tag="begin"):
    """To the instance, first: the service to run, and where to serve.

    gRPC listens at `listen`. It gets the connections of the inherited socket, or of the address `outside`, where TLS
    admits holders of the same `credentials` only. If `is_announced`, a connection's first line names its caller.
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
    credentials: str = msgspec.field(default="", name="leash")  # the key in images of earlier versions
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
    """The first message to an instance of the spec; the program's paths are those where the instance runs."""
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


class AdmitDrones(msgspec.Struct, frozen=True, tag="admit"):
    """To the instance: answer these drones only; of finishing drones, the calls that have arrived."""

    drones: list[str]
    finishing: list[str] = []


class Drain(msgspec.Struct, frozen=True, tag="drain"):
    """To the instance: refuse further calls for this reason, and report when no call is in progress."""

    why: str


class Ready(msgspec.Struct, frozen=True, tag="ready"):
    """From the instance: it can be called at this address."""

    address: str


class InstanceFailed(msgspec.Struct, frozen=True, tag="failed"):
    """From the instance: it cannot serve."""

    why: str


class Admitted(msgspec.Struct, frozen=True, tag="admitted"):
    """From the instance: the oldest unconfirmed AdmitDrones is in force."""


class Drained(msgspec.Struct, frozen=True, tag="drained"):
    """From the instance: no call is in progress, and none will be."""


class Called(msgspec.Struct, frozen=True, tag="called"):
    """From the instance: it begins to compute a call of this drone, known by `Client.key`."""

    drone: str


class Answered(msgspec.Struct, frozen=True, kw_only=True, tag="answered"):
    """From the instance: a call has its outcome, after it queued and was computed for these times."""

    drone: str = ""  # missing in images of earlier versions
    method: str
    queued_s: float = 0.0
    took_s: float
    outcome: Literal["value", "raised", "dropped"] = "value"


class Printed(msgspec.Struct, frozen=True, tag="said"):
    """From a container: output of the service, after `left_out` bytes that were dropped."""

    output: bytes
    left_out: Annotated[int, msgspec.Meta(ge=0)] = 0


class ServiceEnded(msgspec.Struct, frozen=True, tag="ended"):
    """From a container, last: the exit code of its service, or a negative signal number."""

    code: int


FromInstance = Ready | InstanceFailed | Admitted | Drained | Called | Answered | Printed | ServiceEnded

_encoder = msgspec.json.Encoder()
to_instance = msgspec.json.Decoder(Begin | AdmitDrones | Drain)
from_instance: msgspec.json.Decoder[FromInstance] = msgspec.json.Decoder(FromInstance)


def line(message: Begin | AdmitDrones | Drain | FromInstance) -> bytes:
    """A message as one line of JSON."""
    return _encoder.encode(message) + b"\n"
