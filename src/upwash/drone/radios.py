"""The drone's radios: each has a worker, and each command goes to the worker that is at its server.

The core decides for which servers there is a radio (core/selection/radios.py); this finds the radio.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from upwash.core.selection.commands import Check, Command, Leave, Probe
from upwash.core.selection.events import Event
from upwash.drone.radio_worker import RadioWorker
from upwash.drone.server_session import ServerEndpoint
from upwash.ports import Dialer, Journal, Network


class Radios:
    """One worker for each network that the drone can be in at a time."""

    def __init__(
        self,
        in_range: Callable[[str], bool],
        endpoints: Mapping[str, ServerEndpoint],
        *,
        networks: Sequence[Network],
        dialer: Dialer,
        journal: Journal,
        tell: Callable[[Event], None],
    ) -> None:
        self.workers = [
            RadioWorker(in_range, endpoints, network=network, dialer=dialer, journal=journal, tell=tell)
            for network in networks
        ]
        self._worker_of: dict[str, RadioWorker] = {}  # by the server that they are at, or were at last
        self._visited: list[str] = []  # the servers that a worker is at

    def worker_at(self, server: str) -> RadioWorker:
        """The worker that is at the server, or was there last."""
        return self._worker_of[server]

    def send(self, command: Command) -> None:
        """Gives the command to the worker that is at its server.

        A server where none is gets a free one: best the one that was there last, which says goodbye, if it still has
        to, before it comes again.
        """
        if isinstance(command, (Check, Probe)) and command.server not in self._visited:
            busy = [self._worker_of[server] for server in self._visited]
            free = [worker for worker in self.workers if worker not in busy]
            last = self._worker_of.get(command.server)
            self._worker_of[command.server] = last if last in free else free[0]
            self._visited.append(command.server)
        self._worker_of[command.server].send(command)
        if isinstance(command, Leave):
            self._visited.remove(command.server)

    async def done(self) -> None:
        """Returns when every command is carried out; while the workers run."""
        for worker in self.workers:
            await worker.done()
