"""The server table: what the drone knows of each server, and the only ways in which that may change.

A server is in one of six states (thesis figure 3.2). `-R` (running) means that the services are believed to run
there. TRANSITIONS is the whole law; anything else is a programming error.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from enum import StrEnum

from upwash.core.geo import Circle
from upwash.errors import TransitionError

_HISTORY_LENGTH = 20


class State(StrEnum):
    """What the drone may do with a server now."""

    AVL = "AVL"  # believed available, services not running
    AVL_R = "AVL-R"  # believed available, services running
    CHECK = "CHECK"  # selected; being joined and asked, services to be started
    CHECK_R = "CHECK-R"  # selected; being joined and asked, services believed to run
    READY = "READY"  # selected; calls may be sent
    BLACKLISTED = "BLACKLISTED"  # failed lately; left alone, or asked for a sign of life


SELECTED = frozenset({State.CHECK, State.CHECK_R, State.READY})
CHECKING = frozenset({State.CHECK, State.CHECK_R})


class Event(StrEnum):
    """What can happen to a server."""

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
    BLACKLIST_EXPIRED = "blacklist_expired"
    PROBED = "probed"  # it gave a sign of life, and not all services run
    PROBED_RUNNING = "probed_running"  # the services that run there did, too
    IDLE_EXPIRED = "idle_expired"
    PREPARED = "prepared"  # a peer of it says that its services are being started


TRANSITIONS: dict[tuple[State, Event], State] = {
    (State.AVL, Event.SELECTED): State.CHECK,
    (State.AVL_R, Event.SELECTED): State.CHECK_R,
    (State.CHECK_R, Event.FOUND_STOPPED): State.CHECK,
    (State.CHECK, Event.FOUND_RUNNING): State.READY,
    (State.CHECK_R, Event.FOUND_RUNNING): State.READY,
    (State.CHECK, Event.STARTED): State.READY,
    (State.CHECK, Event.CHECK_FAILED): State.BLACKLISTED,
    (State.CHECK_R, Event.CHECK_FAILED): State.BLACKLISTED,
    (State.CHECK, Event.DESELECTED): State.AVL,
    (State.CHECK, Event.DESELECTED_AFTER_START): State.AVL_R,
    (State.CHECK_R, Event.DESELECTED): State.AVL_R,
    (State.READY, Event.DESELECTED): State.AVL_R,
    (State.READY, Event.CALL_FAILED_IN_RANGE): State.BLACKLISTED,
    (State.READY, Event.CALL_FAILED_OUT_OF_RANGE): State.AVL_R,
    (State.CHECK, Event.NETWORK_LOST): State.BLACKLISTED,
    (State.CHECK_R, Event.NETWORK_LOST): State.BLACKLISTED,
    (State.READY, Event.NETWORK_LOST): State.BLACKLISTED,
    (State.BLACKLISTED, Event.BLACKLIST_EXPIRED): State.AVL,
    (State.BLACKLISTED, Event.PROBED): State.AVL,
    (State.BLACKLISTED, Event.PROBED_RUNNING): State.AVL_R,
    (State.AVL_R, Event.IDLE_EXPIRED): State.AVL,
    (State.AVL, Event.PREPARED): State.AVL_R,
    (State.AVL_R, Event.PREPARED): State.AVL_R,
}


@dataclass(frozen=True, slots=True)
class Change:
    """One step of one server through the table, and why."""

    server: str
    event: Event
    before: State
    after: State
    at_s: float
    why: str


@dataclass(slots=True)
class Server:
    """One entry of the server table."""

    name: str
    area: Circle
    state: State = State.AVL
    since_s: float = 0.0  # when the state was entered
    check: int = 0  # the number of the latest check of it
    checked_since_s: float = 0.0  # t_check: when it was last selected
    start_requested: bool = False  # during the check that runs, or the last one
    joined_before: bool = False  # that check, as the server was being probed
    in_range_since_s: float | None = None
    peers: frozenset[str] = frozenset()  # the servers that its daemon can have prepared, as it last said
    history: deque[Change] = field(default_factory=lambda: deque(maxlen=_HISTORY_LENGTH))

    @property
    def in_range(self) -> bool:
        """Whether the drone was in range at the last position given."""
        return self.in_range_since_s is not None

    def apply(self, event: Event, *, now_s: float, why: str = "") -> Change:
        """Takes the step that the table names; raises TransitionError, with the history, where it names none."""
        after = TRANSITIONS.get((self.state, event))
        if after is None:
            raise TransitionError(
                f"server {self.name}: {event} is impossible in {self.state}; before that: "
                + (
                    "; ".join(f"{c.at_s:.3f} {c.before} {c.event} {c.after}" for c in self.history)
                    or "nothing"
                )
            )
        change = Change(self.name, event, self.state, after, now_s, why)
        self.history.append(change)
        self.state = after
        self.since_s = now_s
        if event is Event.SELECTED:
            self.checked_since_s = now_s
            self.start_requested = False
        return change

    def deselect(self, *, now_s: float, why: str) -> Change:
        """Takes the de-selection step of the state that the server is in."""
        starting = self.state is State.CHECK and self.start_requested
        return self.apply(
            Event.DESELECTED_AFTER_START if starting else Event.DESELECTED, now_s=now_s, why=why
        )
