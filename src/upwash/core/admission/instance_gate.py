"""The drones that a service instance answers, as its daemon decides; every kind of instance asks here."""

from __future__ import annotations

from collections.abc import Iterable

from upwash.core.admission.clients import Client
from upwash.errors import NoLease, Refused


class InstanceGate:
    """Lets calls of admitted drones through; none is admitted at first, and `close` refuses all for good."""

    def __init__(self) -> None:
        self._admitted: frozenset[str] = frozenset()
        self._finishing: frozenset[str] = frozenset()
        self.closed = ""  # why no call is answered any more; empty where some are

    def admit(self, drones: Iterable[str], finishing: Iterable[str] = ()) -> None:
        """Answer only these drones from now on, given by `Client.key`; `require` refuses all others.

        The `finishing` drones get answers to calls that have already arrived, and to no new calls.
        """
        self._admitted, self._finishing = frozenset(drones), frozenset(finishing)

    def close(self, why: str) -> None:
        """Refuse every call from now on, for the reason `why`."""
        self.closed = why

    def require(self, client: Client) -> None:
        """Check a call that arrives: raises Refused after `close`, NoLease if the client is not admitted."""
        self._require(client, self._admitted)

    def require_still(self, client: Client) -> None:
        """Check an arrived call before it is computed; as `require`, but `finishing` drones pass too."""
        self._require(client, self._admitted | self._finishing)

    def _require(self, client: Client, admitted: frozenset[str]) -> None:
        if self.closed:
            raise Refused(self.closed)
        if client.key not in admitted:
            raise NoLease(f"drone {client.name or '(unnamed)'} has no lease here")
