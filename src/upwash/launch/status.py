"""The status of an edge daemon, or of many, for an operator."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from pathlib import Path

import msgspec

from upwash.config.inventory import ListedServer
from upwash.config.values import is_address, is_on_this_machine
from upwash.errors import LinkError, Unreachable, UsageError
from upwash.real.link.link import GrpcDialer
from upwash.real.trust.credentials import read_credentials
from upwash.rpc.protocol import LONGEST_STATUS_BYTES, STATUS, StatusReply, StatusRequest, decode_reply

_STATUS_S = 10.0
_EACH_S = 5.0  # of many servers: some may be off
_MOST_AT_ONCE = 32


async def ask_each(
    servers: Sequence[ListedServer], *, operator: str, keys: Path | None
) -> list[StatusReply | LinkError]:
    """The status of each server's daemon, or why there is none, in their order; 32 requests run at once."""
    turn = asyncio.Semaphore(_MOST_AT_ONCE)

    async def ask(server: ListedServer) -> StatusReply | LinkError:
        async with turn:
            try:
                return await ask_status(
                    server.address, server=server.name, operator=operator, keys=keys, timeout_s=_EACH_S
                )
            except LinkError as error:
                return error

    return await asyncio.gather(*map(ask, servers))


async def ask_status(
    address: str, *, server: str, operator: str, keys: Path | None, timeout_s: float = _STATUS_S
) -> StatusReply:
    """The status of the daemon at the address, which acts as `server`; raises LinkError if it does not reply."""
    if not is_address(address):
        raise UsageError(f'"{address}" is no address: give host:port, or unix:path')
    if keys is None and not is_on_this_machine(address):
        raise UsageError(f"{address} is another machine: give --keys DIR, --operator NAME and --server NAME")
    if keys is not None and not server:
        raise UsageError("--server is missing: name a server that the daemon's certificate is for")
    credentials = keys and read_credentials(
        keys / "authority.pem", keys / f"{operator}.pem", keys / f"{operator}.key"
    )
    dialer = GrpcDialer(operator, credentials or None, max_message_bytes=LONGEST_STATUS_BYTES)
    link = dialer.dial(address, server=server or "daemon")
    try:
        reply = await link.request(STATUS, msgspec.msgpack.encode(StatusRequest()), timeout_s=timeout_s)
    except Unreachable as error:
        remedy = (
            "" if keys else "; a daemon that has certificates wants yours: give --keys DIR and --server NAME"
        )
        raise Unreachable(f"{error}{remedy}") from error
    finally:
        await link.close()
    return decode_reply(reply, StatusReply, sender=address)
