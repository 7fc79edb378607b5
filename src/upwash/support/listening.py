"""Sockets that listen where a configuration says."""

from __future__ import annotations

import socket

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
