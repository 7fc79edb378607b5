"""Messages between drones and edge daemons, and their paths.

Each message is one MessagePack map; each exchange is one request and one reply on a gRPC path, so that a client or a
server in another language needs nothing but gRPC and MessagePack. The certificate names the drone, not the message.
Every field has its bounds where it is declared, every text is escaped as it arrives, and a message that breaks a
bound is refused.
"""

from __future__ import annotations

import math
import os
import re
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, TypeVar

import msgspec
from msgspec import Meta

from upwash.core.admission.clients import DoorStatus, RefusalStatus, ServerStatus
from upwash.core.admission.limits import Limits
from upwash.errors import GarbledReply, Refused
from upwash.rpc.wire import Encoding
from upwash.support.text import LONGEST_TEXT, escaped, printable

AVAILABILITY = "/upwash.Daemon/Availability"
START = "/upwash.Daemon/Start"
LEAVE = "/upwash.Daemon/Leave"
DENY = "/upwash.Daemon/Deny"
PREPARE = "/upwash.Daemon/Prepare"
HOLD = "/upwash.Daemon/Hold"
STATUS = "/upwash.Daemon/Status"
# gRPC's standard question to a daemon or an instance of a service, and the answer where it serves.
HEALTH_CHECK = "/grpc.health.v1.Health/Check"
SERVING = b"\x08\x01"

# gRPC metadata, seconds as text: within what time a call must begin, with the request; how long it waited and what is
# in the queue now, with the reply. A peer that leaves them out queues calls for as long as their callers wait.
MAY_QUEUE_METADATA = "upwash-may-queue-s"
QUEUED_METADATA, QUEUE_METADATA = "upwash-queued-s", "upwash-queue-s"

LONGEST_REPLY_BYTES = 2**16  # of a daemon to a drone: results come from instances
LONGEST_STATUS_BYTES = 2**20  # of a daemon to an operator
LEAST_LEASE_S = 2.0  # a drone renews it three times as often

T = TypeVar("T")
_PLAIN: Encoding[Any] = Encoding(Any)
_MOST_S = 86_400.0
_LONGEST_UP_S = 1e10
_PORT = re.compile(r":([1-9][0-9]{0,4})\Z")
_MOST_PORT = 65_535

NameText = Annotated[str, Meta(max_length=255)]  # it stands in logs and refusals
Names = Annotated[list[NameText], Meta(max_length=255)]
Reason = Annotated[str, Meta(max_length=LONGEST_TEXT)]
Endpoint = Annotated[str, Meta(max_length=255)]
Endpoints = Annotated[dict[NameText, Endpoint], Meta(max_length=255)]
Seconds = Annotated[float, Meta(ge=0, le=_MOST_S)]
Lease = Annotated[float, Meta(ge=LEAST_LEASE_S, le=_MOST_S)]
Waiting = Annotated[int, Meta(ge=0, le=65_535)]  # drones that wait for a slot
Time = Annotated[datetime, Meta(tz=True)]
Digest = Annotated[str, Meta(max_length=64)]  # of SHA-256, in hexadecimal digits


class AvailabilityRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A drone asks whether the server can serve it, and which of these services run already."""

    server: NameText
    services: Names


class AvailabilityReply(msgspec.Struct, frozen=True):
    """The server can serve the drone: endpoints of running services and the lease's length; or it cannot, and why.

    An endpoint is a port of the daemon's host, such as ":40000" (`resolve`). `peers` are the servers to which the
    daemon can announce the drone. `waiting` drones queue for a slot. A drone that is refused because there is no slot
    queues too, if it asks again after `ask_again_s`, which is 0 for other refusals. A service that keeps failing is
    not started for another `pause_s`.
    """

    available: bool
    reason: Reason = ""
    endpoints: Endpoints = {}
    lease_s: Lease = LEAST_LEASE_S
    peers: Names = []
    waiting: Waiting = 0
    ask_again_s: Seconds = 0.0
    pause_s: Seconds = 0.0


class StartRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A drone asks the server to start this service; the reply comes when it can be called."""

    server: NameText
    service: NameText


class StartReply(msgspec.Struct, frozen=True):
    """The endpoint to call; or why there is none, and when to ask again if only a slot is missing.

    A service that keeps failing is not started for another `pause_s`.
    """

    endpoint: Endpoint = ""
    reason: Reason = ""
    waiting: Waiting = 0
    ask_again_s: Seconds = 0.0
    pause_s: Seconds = 0.0


class LeaveRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A drone gives up its slot, or its place in the queue."""

    server: NameText


class LeaveReply(msgspec.Struct, frozen=True):
    """The server has received the message."""


class DenyRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Calls of these services raised on the server, but not on the drone, since the drone's last DenyRequest."""

    server: NameText
    services: Names


class DenyReply(msgspec.Struct, frozen=True):
    """The server has received the message."""


class PrepareRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A drone announces itself to a peer of the server, where it arrives in `arrives_in_s`.

    The server requests of the peer to start these services, and to hold a slot until `hold_s` after that.
    """

    server: NameText
    peer: NameText
    services: Names
    arrives_in_s: Seconds
    hold_s: Seconds


class HoldRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A daemon to its peer: start these services for this drone, and hold a slot for it for `for_s`."""

    server: NameText
    drone: NameText
    certificate: NameText
    services: Names
    for_s: Seconds


class HoldReply(msgspec.Struct, frozen=True):
    """The slot is held and the services start or run; or why not."""

    held: bool
    reason: Reason = ""


class StatusRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """An operator asks for the daemon's state; others are refused."""


class CertificateStatus(msgspec.Struct, frozen=True):
    """A certificate that the daemon uses, and its expiry."""

    holder: NameText
    expires: Time


class PartStatus(msgspec.Struct, frozen=True):
    """What is in force of one part of the operator's orders, and since when.

    `refused` is why the last reload left the part as it was; it is empty after a reload that read the part.
    """

    digest: Digest
    since: Time
    refused: Reason = ""


class ReloadStatus(msgspec.Struct, frozen=True):
    """The last reload: when and `by` whom it was ordered, and when it ended; None while it is under way."""

    asked: Time
    by: NameText
    ended: Time | None = None


class DaemonStatus(msgspec.Struct, frozen=True):
    """The program of a daemon, its clock, and the operator's orders that are in force.

    `parts` are "revocations", "keys", "configuration", and "service NAME" for each service. Their digests are those
    of the sorted fingerprints, of the authority's and the certificate's file, of the file, and of the service's code
    and files.
    `clock_is_kept` is whether a program, such as NTP, keeps the clock in time; None if the kernel does not report.
    """

    version: NameText
    commit: NameText
    code: Digest
    sandbox: NameText
    time: Time
    clock_is_kept: bool | None
    revoked: Annotated[int, Meta(ge=0, le=2**20)]
    parts: Annotated[dict[NameText, PartStatus], Meta(max_length=511)] = {}
    reload: ReloadStatus | None = None


class StatusReply(msgspec.Struct, frozen=True):
    """The daemon's servers, its last refusals, its certificates, and how long it has run.

    `at_door` are connections that were refused before any request; `limits` hold for each instance of a service;
    `daemon` is what runs and is in force. Replies of earlier daemons lack these.
    """

    up_s: Annotated[float, Meta(ge=0, le=_LONGEST_UP_S)]
    servers: list[ServerStatus]
    refusals: list[RefusalStatus]
    certificates: list[CertificateStatus]
    closing: Reason = ""
    at_door: list[DoorStatus] = []
    limits: dict[NameText, Limits] = {}
    daemon: DaemonStatus | None = None


def service_path(service: str, method: str) -> str:
    """The path of a service's method."""
    return f"/upwash.service.{service}/{method}"


def decode_reply(reply: bytes, expected: type[T], *, sender: str) -> T:
    """A daemon's reply as a value, its texts escaped; raises GarbledReply naming the sender."""
    try:
        return _decode(reply, expected)
    except msgspec.MsgspecError as error:
        raise GarbledReply(
            f"{sender} sent a reply that cannot be decoded: {printable(str(error))}"
        ) from error


def decode_request(request: bytes, expected: type[T]) -> T:
    """A request to a daemon as a value, its texts escaped; raises Refused."""
    try:
        return _decode(request, expected)
    except msgspec.MsgspecError as error:
        raise Refused(f"undecodable request: {printable(str(error))}") from error


def _decode(message: bytes, expected: type[T]) -> T:
    try:
        return msgspec.convert(_clean(_PLAIN.decode(message)), expected)
    except RecursionError as error:
        raise msgspec.DecodeError("nested too deeply") from error


def _clean(value: object) -> object:
    """The plain value with each text in it escaped; raises ValidationError for numbers that are not finite."""
    match value:
        case str():
            return escaped(value)
        case float() if not math.isfinite(value):
            raise msgspec.ValidationError("Expected a finite number")
        case list():
            return [_clean(item) for item in value]
        case dict():
            return {_clean(key): _clean(item) for key, item in value.items()}
    return value


def resolve(endpoint: str, daemon_address: str) -> str:
    """The address of an endpoint that a daemon gave, which must be a port of the daemon's own host.

    For a daemon on a unix socket it must be a socket in the same folder or below. Raises GarbledReply for any other
    endpoint: a server must not choose another host, or how its name is looked up.
    """
    if daemon_address.startswith("unix:"):
        if endpoint.startswith("unix:") and _path(daemon_address).parent in _path(endpoint).parents:
            return endpoint
    elif (port := _PORT.match(endpoint)) and int(port[1]) <= _MOST_PORT:
        return daemon_address.rpartition(":")[0] + endpoint
    raise GarbledReply(
        f"the daemon at {daemon_address} gave the endpoint {printable(endpoint)}, which is not its own"
    )


def _path(address: str) -> Path:
    return Path(os.path.abspath(address.removeprefix("unix:")))  # noqa: PTH100 - which resolves ".."
