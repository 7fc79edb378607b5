"""What a drone and an edge daemon say to each other: paths and messages.

Each message is one MessagePack map; each exchange is one request and one reply on a gRPC path, so that a client
or a server in another language needs nothing but gRPC and MessagePack. Who the drone is says its certificate,
not the message.
"""

from __future__ import annotations

from typing import TypeVar

import msgspec

from upwash.errors import GarbledReply
from upwash.wire import decode

AVAILABILITY = "/upwash.Daemon/Availability"
START = "/upwash.Daemon/Start"
LEAVE = "/upwash.Daemon/Leave"

T = TypeVar("T")


class AvailabilityRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Can this server serve me, and which of these services run already?"""

    server: str
    services: list[str]


class AvailabilityReply(msgspec.Struct, frozen=True):
    """Yes, with the endpoints of those that run and the length of the lease; or no, with the reason.

    An endpoint that begins with a colon is a port of the host that the daemon was reached at.
    """

    available: bool
    reason: str = ""
    endpoints: dict[str, str] = {}
    lease_s: float = 0.0


class StartRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Have this service running, and answer when it can be called."""

    server: str
    service: str


class StartReply(msgspec.Struct, frozen=True):
    """The endpoint to call; or why there is none."""

    endpoint: str = ""
    reason: str = ""


class LeaveRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """I need this server no more."""

    server: str


class LeaveReply(msgspec.Struct, frozen=True):
    """Noted."""


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
    """The address of an endpoint that a daemon gave: a bare port is one of the daemon's host."""
    if endpoint.startswith(":"):
        return daemon_address.rpartition(":")[0] + endpoint
    return endpoint
