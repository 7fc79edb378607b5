"""When the server in use is asked to have the next one prepare for the drone, where the two are peers."""

from __future__ import annotations

import math

from upwash.core.knowledge.servers import Server, State
from upwash.core.policies.policy import Coming
from upwash.core.selection.commands import Prepare

_EARLY_S = 10.0  # that a server is prepared before it has to be, as legs and calls take as long as they take
_HOLD_S = 15.0  # that its slot is held after the drone should be there


class PrewarmNotifier:
    """Knows what was announced where, and when it is time for the next announcement."""

    def __init__(self) -> None:
        self.due_s = math.inf  # when an announcement is to be made that was too early before
        self._held_until_s: dict[str, float] = {}

    def is_due(self, now_s: float) -> bool:
        """Whether it is time for an announcement that was too early before."""
        return now_s >= self.due_s

    def has_announced(self, server: str, *, at_s: float) -> bool:
        """Whether the server should have held a slot then, and may have begun to start its services."""
        return self._held_until_s.get(server, -math.inf) > at_s

    def announce(
        self, current: Server | None, coming: Coming | None, *, start_s: float, now_s: float
    ) -> list[Prepare]:
        """The announcement to make now, if any: by a server in use that is READY, and not again while a slot is held.

        `start_s` is how long the coming server needs to start its services.
        """
        self.due_s = math.inf
        if coming is None or current is None or current.state is not State.READY:
            return []
        if coming.server not in current.peers:
            return []
        due_s = max(
            now_s + coming.in_s - start_s - _EARLY_S, self._held_until_s.get(coming.server, -math.inf)
        )
        if due_s > now_s:
            self.due_s = due_s
            return []
        self._held_until_s[coming.server] = now_s + coming.in_s + _HOLD_S
        return [Prepare(current.name, current.check, coming.server, coming.in_s, _HOLD_S)]
