"""The servers that a drone knows: which of them are in range, and what time alone does to their states."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence

from upwash.core.geo import Circle, Position
from upwash.core.knowledge.ranges import Ranges
from upwash.core.knowledge.servers import Change, Server, State, Trigger


class ServerTable:
    """One entry for each server, in the order of the configuration."""

    def __init__(self, areas: Mapping[str, Circle], *, idle_s: float) -> None:
        self.servers = {name: Server(name, area) for name, area in areas.items()}
        self.in_range: Sequence[Server] = ()
        self._met: Sequence[Server] = ()  # all that are not AVL: hundreds that were never met cost nothing
        self._ranges = Ranges(areas)
        self._idle_s = idle_s

    def locate(self, position: Position, now_s: float) -> bool:
        """The drone is there now; returns whether it has crossed the border of a server's range."""
        crossed = self._ranges.crossed(position)
        for name in crossed:
            server = self.servers[name]
            server.in_range_since_s = None if server.in_range else now_s
        if crossed:
            self.in_range = [server for server in self.servers.values() if server.in_range]
        return bool(crossed)

    @property
    def is_on_border(self) -> bool:
        """Whether the drone was on the border of a range at the last position given."""
        return self._ranges.is_on_border

    def meet(self) -> None:
        """A server has left AVL, so that time may change its state from now on."""
        self._met = [server for server in self.servers.values() if server.state is not State.AVL]

    @property
    def blacklisted(self) -> list[Server]:
        """The servers that failed lately."""
        return [server for server in self._met if server.state is State.BLACKLISTED]

    def next_expiry_s(self, *, probed: Collection[Server]) -> float:
        """Before this time nothing expires; infinite where nothing will."""
        return min(
            (
                server.since_s + (server.left_alone_s if server.state is State.BLACKLISTED else self._idle_s)
                for server in self._met
                if server.state is State.AVL_R or (server.state is State.BLACKLISTED and server not in probed)
            ),
            default=math.inf,
        )

    def expire(self, now_s: float, *, probed: Collection[Server]) -> list[Change]:
        """Ends the blacklisting of servers, but for the probed ones, and the belief that idle services still run."""
        changes = []
        for server in self._met:
            if server.state is State.BLACKLISTED:
                if server not in probed and now_s - server.since_s >= server.left_alone_s:
                    changes.append(server.apply(Trigger.BLACKLIST_EXPIRED, now_s=now_s))
            elif server.state is State.AVL_R and now_s - server.since_s >= self._idle_s:
                changes.append(server.apply(Trigger.IDLE_EXPIRED, now_s=now_s))
        return changes
