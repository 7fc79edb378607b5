"""Where a call runs: at a server, which is known by its name, or on the drone, which is None.

In files and to people a place has a name. The drone's is one that no server may have: the configuration refuses it.
"""

from __future__ import annotations

ON_DRONE = "local"


def name_of(server: str | None) -> str:
    """The name of a place."""
    return ON_DRONE if server is None else server


def server_of(name: str) -> str | None:
    """The server at the place of that name, None where it is the drone."""
    return None if name == ON_DRONE else name
