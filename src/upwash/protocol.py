"""What a drone and an edge daemon say to each other: paths and messages.

Each message is one MessagePack map; each exchange is one request and one reply on a gRPC path, so that a client
or a server in another language needs nothing but gRPC and MessagePack. Who the drone is says its certificate,
not the message.
"""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, TypeVar

import msgspec

from upwash.core.visitors import RefusalStatus, ServerStatus
from upwash.errors import GarbledReply
from upwash.wire import decode

AVAILABILITY = "/upwash.Daemon/Availability"
START = "/upwash.Daemon/Start"
LEAVE = "/upwash.Daemon/Leave"
PREPARE = "/upwash.Daemon/Prepare"
HOLD = "/upwash.Daemon/Hold"
STATUS = "/upwash.Daemon/Status"

T = TypeVar("T")
NameText = Annotated[str, msgspec.Meta(max_length=255)]  # it stands in logs and refusals
Names = Annotated[list[NameText], msgspec.Meta(max_length=255)]
Seconds = Annotated[float, msgspec.Meta(ge=0)]


class AvailabilityRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Can this server serve me, and which of these services run already?"""

    server: NameText
    services: Names


class AvailabilityReply(msgspec.Struct, frozen=True):
    """Yes, with the endpoints of those that run and the length of the lease; or no, with the reason.

    An endpoint that begins with a colon is a port of the host that the daemon was reached at. `peers` are the servers
    that it can have prepared.
    """

    available: bool
    reason: str = ""
    endpoints: dict[str, str] = {}
    lease_s: float = 0.0
    peers: list[str] = []


class StartRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Have this service running, and answer when it can be called."""

    server: NameText
    service: NameText


class StartReply(msgspec.Struct, frozen=True):
    """The endpoint to call; or why there is none."""

    endpoint: str = ""
    reason: str = ""


class LeaveRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """I need this server no more."""

    server: NameText


class LeaveReply(msgspec.Struct, frozen=True):
    """Noted."""


class PrepareRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """I will be at your peer by then: have it start these services, and hold a slot for me for so long after."""

    server: NameText
    peer: NameText
    services: Names
    arrives_in_s: Seconds
    hold_s: Seconds


class HoldRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A daemon to its peer: start these services for this drone, and hold a slot for it for so long."""

    server: NameText
    drone: NameText
    certificate: NameText
    services: Names
    for_s: Seconds


class HoldReply(msgspec.Struct, frozen=True):
    """The slot is held and the services start or run; or why not."""

    held: bool
    reason: str = ""


class StatusRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How are you? Answered to operators only."""


class CertificateStatus(msgspec.Struct, frozen=True):
    """A certificate that the daemon relies on, and until when it can."""

    holder: str
    expires: datetime


class StatusReply(msgspec.Struct, frozen=True):
    """The daemon's servers, its last refusals and its certificates; and for how long it has run."""

    up_s: float
    servers: list[ServerStatus]
    refusals: list[RefusalStatus]
    certificates: list[CertificateStatus]
    closing: str = ""


def service_path(service: str, method: str) -> str:
    """The path of a service's method."""
    return f"/upwash.service.{service}/{method}"


def decode_reply(reply: bytes, expected: type[T], *, sender: str) -> T:
    """A daemon's reply as a value; raises GarbledReply naming the sender."""
    try:
        return decode(reply, msgspec.msgpack.Decoder(expected))
    except msgspec.MsgspecError as error:
        raise GarbledReply(f"{sender} sent a reply that cannot be decoded: {error}") from error


def resolve(endpoint: str, daemon_address: str) -> str:
    """The address of an endpoint that a daemon gave: a bare port is one of the daemon's host.

    Raises GarbledReply for a socket of this machine where the daemon is not on one: it would be called without
    certificates.
    """
    if endpoint.startswith(":"):
        return daemon_address.rpartition(":")[0] + endpoint
    if endpoint.startswith("unix:") and not daemon_address.startswith("unix:"):
        raise GarbledReply(
            f"the daemon at {daemon_address} gave the endpoint {endpoint}, which is not its own"
        )
    return endpoint
