"""Which user of this machine holds the other end of a connection over loopback."""

from __future__ import annotations

import socket
from pathlib import Path

_CONNECTIONS = (Path("/proc/net/tcp"), Path("/proc/net/tcp6"))
_IN_SIX = "0000000000000000FFFF0000"  # before an IPv4 address in IPv6
_LOCAL, _REMOTE, _USER = 1, 2, 7  # columns
Address = tuple[str, int]


def user_of(client: Address, server: Address) -> int | None:
    """The number of the user whose socket `client` is, connected to `server`; None if no such socket is here.

    Raises OSError where the system does not say.
    """
    ends = [_written(client), _written(server)]
    for file in _CONNECTIONS:
        if not file.exists():  # without IPv6
            continue
        for line in file.read_text(encoding="ascii").splitlines()[1:]:
            columns = line.split()
            if [columns[each].removeprefix(_IN_SIX) for each in (_LOCAL, _REMOTE)] == ends:
                return int(columns[_USER])
    return None


def _written(address: Address) -> str:
    """The IPv4 address and the port as the system writes them: the bytes of the address as one number."""
    host, port = address
    return f"{int.from_bytes(socket.inet_aton(host), 'little'):08X}:{port:04X}"
