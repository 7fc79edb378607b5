"""Whom a service instance answers, as its daemon has told it; every kind of instance asks here."""

from __future__ import annotations

from collections.abc import Iterable

from upwash.core.admission.clients import Client
from upwash.errors import NoLease, Refused


class InstanceGate:
    """Lets the drones in that have a lease; closed before any is admitted, and for good once it is drained."""

    def __init__(self) -> None:
        self._admitted: frozenset[str] = frozenset()
        self._finishing: frozenset[str] = frozenset()
        self._closed = ""

    @property
    def closed(self) -> str:
        """Why no call is answered any more; empty where some are."""
        return self._closed

    def admit(self, drones: Iterable[str], finishing: Iterable[str] = ()) -> None:
        """From now on only these drones, known by `Client.key`, get an answer.

        Those that are `finishing` get one to the calls that have arrived.
        """
        self._admitted, self._finishing = frozenset(drones), frozenset(finishing)

    def close(self, why: str) -> None:
        """Refuse every call from now on, for that reason."""
        self._closed = why

    def require(self, client: Client) -> None:
        """Raises Refused where the client gets no answer to a call that arrives, NoLease where it lacks that."""
        self._require(client, self._admitted)

    def require_still(self, client: Client) -> None:
        """The same once a call that has arrived is about to be computed: the lease may have ended in between."""
        self._require(client, self._admitted | self._finishing)

    def _require(self, client: Client, admitted: frozenset[str]) -> None:
        if self._closed:
            raise Refused(self._closed)
        if client.key not in admitted:
            raise NoLease(f"drone {client.name or '(unnamed)'} has no lease here")
