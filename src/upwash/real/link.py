"""Links over gRPC: the drone's end.

The options are those that were measured on WiFi-like links. Without the keep-alive and reconnect settings a
channel needs almost as long to recover from a black-out as the black-out lasted; without a pool of its own a new
channel would share a dead connection with an old one. See docs/decisions/grpc.md.
"""

from __future__ import annotations

import asyncio
from typing import Any

import grpc
from grpc.experimental import ChannelOptions

from upwash.errors import DeadlineExceeded, GarbledReply, LinkError, Refused, Unreachable
from upwash.real.credentials import Credentials

DRONE_METADATA = "upwash-drone"  # says who calls where no certificate does: on a unix socket or on loopback

CHANNEL_OPTIONS: tuple[tuple[str, int], ...] = (
    ("grpc.keepalive_time_ms", 2000),
    ("grpc.keepalive_timeout_ms", 3000),
    ("grpc.keepalive_permit_without_calls", 1),
    ("grpc.http2.max_pings_without_data", 0),
    ("grpc.initial_reconnect_backoff_ms", 100),
    ("grpc.min_reconnect_backoff_ms", 1000),
    ("grpc.max_reconnect_backoff_ms", 1000),
    ("grpc.enable_http_proxy", 0),
    ("grpc.use_local_subchannel_pool", 1),
    (ChannelOptions.SingleThreadedUnaryStream, 1),
)


class GrpcDialer:
    """Opens links that show `drone`'s certificate and believe only servers of the same authority."""

    def __init__(self, drone: str, credentials: Credentials | None, *, max_message_bytes: int) -> None:
        self._drone = drone
        self._max_message_bytes = max_message_bytes
        self._credentials = (
            grpc.ssl_channel_credentials(
                root_certificates=credentials.authority,
                private_key=credentials.key,
                certificate_chain=credentials.certificate,
            )
            if credentials
            else None
        )

    def dial(self, address: str, *, server: str) -> GrpcLink:
        """A link to `HOST:PORT` or `unix:PATH` where only `server` is believed; connects when first used.

        A unix socket carries no certificates: the folder that it lies in says who may use it.
        """
        options: list[tuple[str, int | str]] = [
            *CHANNEL_OPTIONS,
            ("grpc.max_receive_message_length", self._max_message_bytes),
            ("grpc.max_send_message_length", self._max_message_bytes),
        ]
        if self._credentials is None or address.startswith("unix:"):
            channel = grpc.insecure_channel(address, options)
        else:
            options.append(("grpc.ssl_target_name_override", server))
            channel = grpc.secure_channel(address, self._credentials, options)
        return GrpcLink(channel, address=address, server=server, drone=self._drone)


class GrpcLink:
    """One channel; each request is sent from the event loop, and a thread of the loop's waits for its reply."""

    def __init__(self, channel: grpc.Channel, *, address: str, server: str, drone: str) -> None:
        self._channel = channel
        self._methods: dict[str, Any] = {}
        self._peer = f"{server} at {address}"
        self._metadata = ((DRONE_METADATA, drone),)

    async def request(self, path: str, body: bytes, *, timeout_s: float) -> bytes:
        """Sends one request and returns its reply; raises LinkError. Cancelling it cancels the call."""
        method = self._methods.get(path)
        if method is None:
            method = self._methods[path] = self._channel.unary_stream(path)
        try:
            call = method(body, timeout=timeout_s, metadata=self._metadata)
        except ValueError as error:  # gRPC's word for a closed channel
            raise Unreachable(f"{self._peer}: the link is closed") from error
        try:
            replies: list[bytes] = await asyncio.get_running_loop().run_in_executor(None, list, call)
        except asyncio.CancelledError:
            call.cancel()
            raise
        except grpc.RpcError as error:
            raise _error(error.code(), error.details(), self._peer, timeout_s) from error
        if len(replies) != 1:
            raise GarbledReply(f"{self._peer}: {len(replies)} replies to one request")
        return replies[0]

    async def close(self) -> None:
        """Breaks the connection off, with every request under way."""
        self._channel.close()


def _error(code: grpc.StatusCode, details: str, peer: str, timeout_s: float) -> LinkError:
    match code:
        case grpc.StatusCode.DEADLINE_EXCEEDED:
            return DeadlineExceeded(f"{peer}: no answer within {timeout_s:.1f} s")
        case grpc.StatusCode.UNAVAILABLE | grpc.StatusCode.CANCELLED:
            return Unreachable(f"{peer}: {details}")
        case _:
            return Refused(f"{peer}: {code.name}: {details}")
