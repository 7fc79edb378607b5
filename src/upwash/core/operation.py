"""What a call asks for, and the name of the place where it runs.

A call runs at a server, known by its name, or on the drone, which is None. In files and messages the drone has a
name that no server may have: the configuration refuses it.
"""

from __future__ import annotations

from collections.abc import Collection

import msgspec

ON_DRONE = "local"


def name_of(server: str | None) -> str:
    """The name of a call's place: the server's, or "local" for the drone, given as None."""
    return ON_DRONE if server is None else server


def server_of(name: str) -> str | None:
    """The server of that name; None for "local", the drone."""
    return None if name == ON_DRONE else name


class Operation(msgspec.Struct, frozen=True, order=True, gc=False):
    """A service's method whose delay is estimated; `key` is the value of the method's profile argument, if any."""

    service: str
    method: str
    key: str = ""

    def __str__(self) -> str:
        return f"{self.service}.{self.method}[{self.key}]" if self.key else f"{self.service}.{self.method}"


def title_of(operation: str) -> str:
    """What people call a written operation: its service, and the value of its profile argument."""
    return _title(operation, with_method=False)


def titles(operations: Collection[str]) -> dict[str, str]:
    """The title of each operation, with its method if two have one title."""
    short = [title_of(operation) for operation in operations]
    several = len(set(short)) < len(short)
    return {operation: _title(operation, with_method=several) for operation in operations}


def _title(operation: str, *, with_method: bool) -> str:
    called, _, key = operation.removesuffix("]").partition("[")
    service, _, method = called.partition(".")
    words = f"{service} {method}" if with_method else service
    return words.replace("_", " ").rstrip() + (f" ({key})" if key else "")
