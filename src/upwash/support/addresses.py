"""Addresses of this machine: sockets that listen there, and requests that mean this machine."""

from __future__ import annotations

import ipaddress
import socket
from collections.abc import Collection

WITHOUT_ZONE = "a link-local address needs the name of its interface, as in [fe80::1%eth0]:7070"
_BACKLOG = 512


def listening_at(listen: str) -> socket.socket:
    """A socket that listens at `HOST:PORT`, where no host, or `*`, is every address of this computer.

    Raises OSError.
    """
    host, _, port = listen.rpartition(":")
    host = host.strip("[]")
    if host in ("", "*"):  # glibc takes `*` for loopback
        host = "::" if socket.has_dualstack_ipv6() else "0.0.0.0"  # noqa: S104 - as the configuration says
    family, _, _, _, place = socket.getaddrinfo(host, int(port), type=socket.SOCK_STREAM)[0]
    is_any = family == socket.AF_INET6 and place[0] == "::"
    return socket.create_server(place, family=family, backlog=_BACKLOG, dualstack_ipv6=is_any)


def address_of(listening: socket.socket) -> str:
    """The `HOST:PORT` of a socket; a link-local IPv6 address has its zone."""
    numeric = socket.NI_NUMERICHOST | socket.NI_NUMERICSERV
    host, port = socket.getnameinfo(listening.getsockname(), numeric)
    return f"[{host}]:{port}" if listening.family == socket.AF_INET6 else f"{host}:{port}"


def lacks_zone(address: str) -> bool:
    """Whether `HOST:PORT` is a link-local IPv6 address that names no interface, so that no socket can use it."""
    try:
        host = ipaddress.IPv6Address(address.rpartition(":")[0].strip("[]"))
    except ValueError:
        return False
    return host.is_link_local and host.scope_id is None


def names_this_machine(host: str, *, known_as: Collection[str], reached_at: str) -> bool:
    """Whether a request's Host is localhost, a name of `known_as`, or the address where the request arrived.

    A page from elsewhere can have its own name point here (DNS rebinding) and would read the answers, but its browser
    sends that name. `reached_at` is this machine's IP address of the connection; each host may have a port.
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
