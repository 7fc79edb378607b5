"""Servers of the networks that this computer is in, by multicast DNS: RFC 6762, and service discovery, RFC 6763.

Anybody in the network may announce anything. So what is found is an address and no more: whoever answers there has to
show the certificate of the server that was looked for.
"""

from __future__ import annotations

import contextlib
import socket
from collections.abc import AsyncIterator, Collection

import ifaddr
from zeroconf import IPVersion
from zeroconf.asyncio import AsyncServiceInfo, AsyncZeroconf

from upwash.errors import Unreachable

_KIND = "_upwash._tcp.local."


@contextlib.asynccontextmanager
async def announcing(names: Collection[str], host: str, port: int) -> AsyncIterator[None]:
    """Announces the servers of a daemon that listens there, until the end of the block."""
    everywhere = host in ("0.0.0.0", "[::]")  # noqa: S104 - compared, not listened at
    addresses = _own_addresses() if everywhere else [host]
    async with _opened(None if everywhere else host) as network:
        for name in names:
            info = AsyncServiceInfo(
                _KIND,
                f"{name}.{_KIND}",
                addresses=[socket.inet_aton(address) for address in addresses],
                port=port,
                server=f"{name}.upwash.local.",
            )
            # The daemon whose place this one takes announces the same for a moment.
            await (await network.async_register_service(info, cooperating_responders=True))
        yield


async def find(server: str, *, within_s: float, interface: str | None = None) -> str:
    """The address at which the server is announced; raises Unreachable where it is not in that time."""
    info = AsyncServiceInfo(_KIND, f"{server}.{_KIND}")
    async with _opened(interface) as network:
        await info.async_request(network.zeroconf, 1000 * within_s)
    address = _address_of(info)
    if address is None:
        raise Unreachable(
            f"{server}: nobody in this network announced it within {within_s:g} s: "
            "see that its daemon has announce = true"
        )
    return address


@contextlib.asynccontextmanager
async def _opened(interface: str | None) -> AsyncIterator[AsyncZeroconf]:
    """The network at the interface of that address, or at all of them, as they are now."""
    try:
        network = (
            AsyncZeroconf(ip_version=IPVersion.V4Only)
            if interface is None
            else AsyncZeroconf(interfaces=[interface], ip_version=IPVersion.V4Only)
        )
    except OSError as error:
        raise Unreachable(f"no network in which servers are announced: {error.strerror}") from error
    try:
        yield network
    finally:
        await network.async_close()


def _own_addresses() -> list[str]:
    return [str(each.ip) for adapter in ifaddr.get_adapters() for each in adapter.ips if each.is_IPv4]


def _address_of(info: AsyncServiceInfo) -> str | None:
    addresses = info.parsed_addresses(IPVersion.V4Only)
    return f"{addresses[0]}:{info.port}" if addresses and info.port else None
