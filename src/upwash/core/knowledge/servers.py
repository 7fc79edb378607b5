"""The server table: what the drone knows of each server, and the only steps that change it.

A server is in one of six states (thesis figure 3.2). `-R` (running) means that the services are believed to run
there. TRANSITIONS has every possible step; any other is a programming error.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

from upwash.core.geo import Position, Reach
from upwash.core.knowledge.ranges import Ranges
from upwash.errors import TransitionError

_HISTORY_LENGTH = 20
_REMEMBERED_S = 60.0  # how long its answers about slots are believed
FULL_S = 15.0  # the expected wait for a slot: half a turn


class State(StrEnum):
    """The six states of a server, which say what the drone may do with it."""

    AVL = "AVL"  # believed available, services not running
    AVL_R = "AVL-R"  # believed available, services running
    CHECK = "CHECK"  # selected; being joined and asked, services to be started
    CHECK_R = "CHECK-R"  # selected; being joined and asked, services believed to run
    READY = "READY"  # selected; calls may be sent
    BLACKLISTED = "BLACKLISTED"  # failed lately; left alone, or asked for a sign of life


SELECTED = frozenset({State.CHECK, State.CHECK_R, State.READY})
CHECKING = frozenset({State.CHECK, State.CHECK_R})


class Trigger(StrEnum):
    """The events that change a server's state."""

    SELECTED = "selected"
    FOUND_STOPPED = "found_stopped"  # the daemon answers: available, but not all services run
    FOUND_RUNNING = "found_running"  # the daemon answers: available, and all run
    STARTED = "started"  # the services were started, their endpoints received
    CHECK_FAILED = "check_failed"  # cannot join, no answer in time, unavailable, start failed
    DESELECTED = "deselected"
    DESELECTED_AFTER_START = "deselected_after_start"  # as above, once the start was requested
    CALL_FAILED_IN_RANGE = "call_failed_in_range"
    CALL_FAILED_OUT_OF_RANGE = "call_failed_out_of_range"
    NETWORK_LOST = "network_lost"  # in range, though: out of range is a de-selection
    TURN_OVER = "turn_over"  # another drone has the slot now; the drone asks again
    BLACKLIST_EXPIRED = "blacklist_expired"
    PROBED = "probed"  # it gave a sign of life, and not all services run
    PROBED_RUNNING = "probed_running"  # the services that run there did, too
    IDLE_EXPIRED = "idle_expired"
    PREPARED = "prepared"  # a peer of it says that its services are being started


TRANSITIONS: dict[tuple[State, Trigger], State] = {
    (State.AVL, Trigger.SELECTED): State.CHECK,
    (State.AVL_R, Trigger.SELECTED): State.CHECK_R,
    (State.CHECK_R, Trigger.FOUND_STOPPED): State.CHECK,
    (State.CHECK, Trigger.FOUND_RUNNING): State.READY,
    (State.CHECK_R, Trigger.FOUND_RUNNING): State.READY,
    (State.CHECK, Trigger.STARTED): State.READY,
    (State.CHECK, Trigger.CHECK_FAILED): State.BLACKLISTED,
    (State.CHECK_R, Trigger.CHECK_FAILED): State.BLACKLISTED,
    (State.CHECK, Trigger.DESELECTED): State.AVL,
    (State.CHECK, Trigger.DESELECTED_AFTER_START): State.AVL_R,
    (State.CHECK_R, Trigger.DESELECTED): State.AVL_R,
    (State.READY, Trigger.DESELECTED): State.AVL_R,
    (State.READY, Trigger.CALL_FAILED_IN_RANGE): State.BLACKLISTED,
    (State.READY, Trigger.CALL_FAILED_OUT_OF_RANGE): State.AVL_R,
    (State.READY, Trigger.TURN_OVER): State.CHECK_R,
    (State.CHECK, Trigger.NETWORK_LOST): State.BLACKLISTED,
    (State.CHECK_R, Trigger.NETWORK_LOST): State.BLACKLISTED,
    (State.READY, Trigger.NETWORK_LOST): State.BLACKLISTED,
    (State.BLACKLISTED, Trigger.BLACKLIST_EXPIRED): State.AVL,
    (State.BLACKLISTED, Trigger.PROBED): State.AVL,
    (State.BLACKLISTED, Trigger.PROBED_RUNNING): State.AVL_R,
    (State.AVL_R, Trigger.IDLE_EXPIRED): State.AVL,
    (State.AVL, Trigger.PREPARED): State.AVL_R,
    (State.AVL_R, Trigger.PREPARED): State.AVL_R,
}


@dataclass(slots=True)
class Server:
    """One entry of the server table."""

    name: str
    area: Reach
    state: State = State.AVL
    since_s: float = 0.0  # when the state was entered
    check: int = 0  # the number of the latest check of it
    checked_since_s: float = 0.0  # t_check: when it was last selected
    found_stopped: bool = False  # as its daemon answered in the check that runs, or the last one
    start_requested: bool = False  # during the check that runs, or the last one
    joined_before: bool = False  # its network was joined before that check, by a probe or a turn there
    refused: bool = False  # a slot, in the check that runs, or the last one
    full_s: float = -math.inf  # when it last said that it has no slot for the drone
    contended_s: float = -math.inf  # when it last said that others wait for a slot
    turns_lost: int = 0  # in a row, without an answer to a call
    left_alone_s: float = 0.0  # for how long it is blacklisted, where no probe finds it well before
    left_out_until_s: float = -math.inf  # as it said
    in_range_since_s: float | None = None
    peers: frozenset[str] = frozenset()  # the servers that its daemon can have prepared, as it last said
    history: deque[str] = field(default_factory=lambda: deque(maxlen=_HISTORY_LENGTH))

    @property
    def in_range(self) -> bool:
        """Whether the drone was in range at the last position given."""
        return self.in_range_since_s is not None

    def is_full(self, now_s: float) -> bool:
        """Whether the server reported within the last 60 s that it has no slot for the drone."""
        return now_s - self.full_s < _REMEMBERED_S

    def is_contended(self, now_s: float) -> bool:
        """Whether the server reported within the last 60 s that others wait for a slot."""
        return now_s - self.contended_s < _REMEMBERED_S

    def asked_again_s(self, now_s: float) -> float:
        """The time at which the next of its reports about slots is forgotten; infinite if none is remembered."""
        known_s = [said_s for said_s in (self.full_s, self.contended_s) if now_s - said_s < _REMEMBERED_S]
        return min(known_s, default=math.inf) + _REMEMBERED_S

    def apply(self, event: Trigger, *, now_s: float) -> None:
        """Change the state as TRANSITIONS says.

        Raises TransitionError, with the server's history, if the table has no such step.
        """
        after = TRANSITIONS.get((self.state, event))
        if after is None:
            impossible = f"server {self.name}: {event} is impossible in {self.state}"
            raise TransitionError(f"{impossible}; before that: {'; '.join(self.history) or 'nothing'}")
        self.history.append(f"{now_s:.3f} {self.state} {event} {after}")
        self.state, self.since_s = after, now_s
        if event in (Trigger.SELECTED, Trigger.TURN_OVER):
            self.checked_since_s = now_s
            self.found_stopped = self.start_requested = self.refused = False

    @property
    def deselection(self) -> Trigger:
        """The event that changes the selected server's state to AVL or AVL-R."""
        starting = self.state is State.CHECK and self.start_requested
        return Trigger.DESELECTED_AFTER_START if starting else Trigger.DESELECTED

    def leave_out(self, pause_s: float, now_s: float) -> None:
        """Keep the blacklisted server unprobed for the `pause_s` that it reported."""
        self.left_out_until_s = now_s + pause_s
        self.left_alone_s = max(self.left_alone_s, self.left_out_until_s - self.since_s)


class ServerTable:
    """One entry for each server, in the order of the configuration."""

    def __init__(self, areas: Mapping[str, Reach], *, idle_s: float) -> None:
        self.servers = {name: Server(name, area) for name, area in areas.items()}
        self.in_range: Sequence[Server] = ()
        self._met: Sequence[Server] = ()  # all that are not AVL: hundreds that were never met cost nothing
        self.ranges = Ranges(areas)
        self._idle_s = idle_s

    def locate(self, position: Position, now_s: float) -> bool:
        """Set where the drone is; return whether it has crossed the border of a server's range."""
        crossed = self.ranges.crossed(position)
        for name in crossed:
            server = self.servers[name]
            server.in_range_since_s = None if server.in_range else now_s
        if crossed:
            self.in_range = [server for server in self.servers.values() if server.in_range]
        return bool(crossed)

    def meet(self) -> None:
        """Note that a server has left AVL, so that time may change its state from now on."""
        self._met = [server for server in self.servers.values() if server.state is not State.AVL]

    @property
    def blacklisted(self) -> list[Server]:
        """The blacklisted servers."""
        return [server for server in self._met if server.state is State.BLACKLISTED]

    def next_expiry_s(self, *, probed: Collection[Server]) -> float:
        """The time before which nothing expires; infinite if nothing will."""
        return min((at_s for _, _, at_s in self._expiring(probed)), default=math.inf)

    def expired(self, now_s: float, *, probed: Collection[Server]) -> list[tuple[Server, Trigger]]:
        """The steps that are due: of blacklisted servers that are not probed, and of idle services."""
        return [(server, trigger) for server, trigger, at_s in self._expiring(probed) if now_s >= at_s]

    def _expiring(self, probed: Collection[Server]) -> Iterator[tuple[Server, Trigger, float]]:
        """The servers whose state time alone changes, how, and when."""
        for server in self._met:
            if server.state is State.AVL_R:
                yield server, Trigger.IDLE_EXPIRED, server.since_s + self._idle_s
            elif server.state is State.BLACKLISTED and server not in probed:
                yield server, Trigger.BLACKLIST_EXPIRED, server.since_s + server.left_alone_s
