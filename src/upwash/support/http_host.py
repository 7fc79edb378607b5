"""Whether who asks this machine over HTTP means this machine.

A page from elsewhere can have its own name lead here (DNS rebinding), and would then be let read what is answered:
but the browser says that name.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Collection


def names_this_machine(host: str, *, known_as: Collection[str], reached_at: str) -> bool:
    """Whether a request's Host is a name that this machine is known as, localhost, or where it was reached.

    `reached_at` is this machine's end of the connection, an IP address; each host may have a port.
    """
    name = _without_port(host)
    if name == "localhost" or name in map(_without_port, known_as):
        return True
    try:
        meant, reached = ipaddress.ip_address(name), ipaddress.ip_address(reached_at.partition("%")[0])
    except ValueError:
        return False
    return _plain(meant) == _plain(reached)


def _without_port(host: str) -> str:
    name, _, rest = host.lower().rpartition("]")
    if name:
        return name.removeprefix("[")
    name = rest if rest.count(":") > 1 else rest.partition(":")[0]
    return name.removesuffix(".")


def _plain(address: ipaddress.IPv4Address | ipaddress.IPv6Address) -> object:
    """An IPv4 address as such, also where a socket for both kinds has it."""
    return getattr(address, "ipv4_mapped", None) or address
