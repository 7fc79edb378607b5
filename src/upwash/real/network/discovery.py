"""Servers of the networks that this computer is in, by multicast DNS: RFC 6762, and service discovery, RFC 6763.

Any computer in the network may announce any server. So only an address is found: the program there must show the
certificate of that server.
"""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Collection
from ipaddress import IPv4Address, IPv6Address, ip_address

import ifaddr
from zeroconf import InterfaceChoice, IPVersion
from zeroconf.asyncio import AsyncServiceInfo, AsyncZeroconf

from upwash.errors import Unreachable

_KIND = "_upwash._tcp.local."


@contextlib.asynccontextmanager
async def announcing(names: Collection[str], host: str, port: int) -> AsyncIterator[None]:
    """Announces the servers of the daemon at that address, until the end of the block."""
    listens = ip_address(host.strip("[]").partition("%")[0])
    addresses = _own_addresses(listens.version) if listens.is_unspecified else [listens]
    at_one = isinstance(listens, IPv4Address) and not listens.is_unspecified
    # An IPv6 address is announced over IPv4 too: its interface may have several of those.
    async with _opened(str(listens) if at_one else None) as network:
        for name in names:
            info = AsyncServiceInfo(
                _KIND,
                f"{name}.{_KIND}",
                addresses=[address.packed for address in addresses],
                port=port,
                server=f"{name}.upwash.local.",
            )
            # The daemon before announces the same for a moment.
            await (await network.async_register_service(info, cooperating_responders=True))
        yield


async def find(server: str, *, within_s: float, interface: str | None = None) -> str:
    """The announced address of the server; raises Unreachable if it is not announced within that time."""
    info = AsyncServiceInfo(_KIND, f"{server}.{_KIND}")
    async with _opened(interface) as network:
        await info.async_request(network.zeroconf, 1000 * within_s)
    address = _address_of(info)
    if address is None:
        raise Unreachable(
            f"{server}: it was not announced in this network within {within_s:g} s: "
            "see that its daemon has announce = true"
        )
    return address


@contextlib.asynccontextmanager
async def _opened(interface: str | None) -> AsyncIterator[AsyncZeroconf]:
    """Multicast DNS on the interface of that address, or on all present interfaces."""
    interfaces = InterfaceChoice.All if interface is None else [interface]
    try:
        network = AsyncZeroconf(interfaces=interfaces, ip_version=IPVersion.V4Only)
    except OSError as error:
        raise Unreachable(f"servers cannot be announced in any network: {error.strerror}") from error
    try:
        yield network
    finally:
        await network.async_close()


def _own_addresses(version: int) -> list[IPv4Address | IPv6Address]:
    """This computer's addresses of that IP version, except link-local IPv6 addresses."""
    found = [known.ip for adapter in ifaddr.get_adapters() for known in adapter.ips]
    addresses = [ip_address(ip if isinstance(ip, str) else ip[0]) for ip in found]
    return [ip for ip in addresses if ip.version == version and not (version == 6 and ip.is_link_local)]


def _address_of(info: AsyncServiceInfo) -> str | None:
    addresses = info.ip_addresses_by_version(IPVersion.All)
    if not addresses or not info.port:
        return None
    first = addresses[0]
    return f"[{first}]:{info.port}" if first.version == 6 else f"{first}:{info.port}"
