"""What a call asks for: the method of a service, and the value of its profile argument."""

from __future__ import annotations

import msgspec


class Operation(msgspec.Struct, frozen=True, order=True, gc=False):
    """What an estimate belongs to: a service's method, split further by the value of its profile argument."""

    service: str
    method: str
    key: str = ""

    def __str__(self) -> str:
        return f"{self.service}.{self.method}[{self.key}]" if self.key else f"{self.service}.{self.method}"
