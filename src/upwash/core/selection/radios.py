"""The roles of the drone's radios: each serves the server in use, the next server, or a failed server.

A server has one of three roles, or none. Each role takes one radio.

    role            its states        what the radio does
    in use          CHECK(-R), READY  calls go to this server alone
    in preparation  CHECK(-R), READY  joins and asks the next server, while another is in use; needs a second radio
    probed          BLACKLISTED       asks a server that failed for a sign of life; needs a radio that is free

              check                          check, with a spare radio
    (none) ──────────► IN USE ◄──────────── IN PREPARATION ◄────────── (none)
       ▲                │   the one in use       │
       │                │   is left              │
       │                ▼        a failure       ▼
       │◄── left      PROBED ◄───────────────────┘
       │                │
       └────────────────┴──► IN USE or IN PREPARATION, where it gave a sign of life and is chosen at once

Laws:
- no more servers have a role than there are radios;
- at most four servers are selected within one second, with any answers of servers;
- a check, and a probe, is known by its number; an answer to an earlier number finds no server here;
- without a spare radio a server is left before the next one is checked;
- a server that failed and was probed is left, unless its sign of life has it checked: then its network stays joined.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field

from upwash.core.knowledge.estimates import Estimates
from upwash.core.knowledge.servers import SELECTED, Server, ServerTable, State, Trigger
from upwash.core.operation import Operation
from upwash.core.selection.commands import Check, Leave, Move, Probe, Start
from upwash.core.selection.recovery import REST_S, Recovery
from upwash.core.selection.settings import SelectionSettings
from upwash.eventlog import schema

_CHECK_LEAST_S = 10.0
_CHECK_FACTOR = 3.0  # times the estimate: a check that takes longer has failed
MOST_SELECTED, SELECTED_IN_S = 4, 1.0


def check_limit_s(believed_s: float) -> float:
    """The longest time of a check, or of joining, from its expected time, in seconds."""
    return max(_CHECK_LEAST_S, _CHECK_FACTOR * believed_s)


@dataclass(slots=True, eq=False)
class Radios:
    """Gives servers their roles; each method returns the effects in their order."""

    _settings: SelectionSettings
    _table: ServerTable
    _estimates: Estimates
    _recovery: Recovery | None
    selected: list[Server] = field(default_factory=list)  # the one in use, then the one in preparation
    probed: list[Server] = field(default_factory=list)
    put_off_until_s: float = math.inf  # when a server may be selected that was selected too soon after others
    _checks: int = 0
    _selected_s: deque[float] = field(
        default_factory=lambda: deque([-math.inf] * MOST_SELECTED, MOST_SELECTED)
    )

    @property
    def in_use(self) -> Server | None:
        """The server to which calls go once it is READY; None without one."""
        return self.selected[0] if self.selected else None

    @property
    def has_spare(self) -> bool:
        """Whether another server may be prepared beside the one in use."""
        return self._settings.radios > 1 and self.in_use is not None and self.in_use.state is State.READY

    def selected_by(self, check: int, states: Collection[State] = SELECTED) -> Server | None:
        """The server selected by that check, if it is in one of the states."""
        return next(
            (server for server in self.selected if server.check == check and server.state in states), None
        )

    def probed_by(self, check: int) -> Server | None:
        """The server probed by that number that has not answered yet."""
        return next(
            (server for server in self.probed if server.check == check and server.state is State.BLACKLISTED),
            None,
        )

    def use(self, server: Server, why: str, now_s: float, *, keep: bool) -> list[Move]:
        """Use the server from now on.

        With a spare radio and `keep`, the former server stays in use until the new server is READY.
        """
        if server not in self.selected and self._is_put_off(now_s):
            return []
        is_ready = server in self.selected and server.state is State.READY
        if keep and self.has_spare and not is_ready:
            return self.prepare(server, why, now_s)
        effects = self._replace([other for other in self.selected if other is not server], server, why, now_s)
        return effects if self.selected else effects + self._check(server, why, now_s)

    def prepare(self, server: Server, why: str, now_s: float) -> list[Move]:
        """Check the server with a spare radio; leave the server that this radio prepared before."""
        if not self.has_spare or server in self.selected or server.state is State.BLACKLISTED:
            return []
        if self._is_put_off(now_s):
            return []
        effects = self._replace(self.selected[1:], server, why, now_s)
        return effects + self._check(server, why, now_s)

    def start(self) -> list[Move]:
        """Ask the selected servers that were found stopped to start the services, once in a check."""
        stopped = [
            server
            for server in self.selected
            if server.state is State.CHECK and server.found_stopped and not server.start_requested
        ]
        for server in stopped:
            server.start_requested = True
        return [Start(server.name, server.check, self.limit_s(server, running=False)) for server in stopped]

    def prefer(self, server: Server, why: str) -> list[Move]:
        """Use a server that is READY in preparation, and keep the one in use as the one in preparation."""
        if server not in self.selected[1:] or server.state is not State.READY:
            return []
        self.selected.reverse()
        return [schema.Preferred(server=server.name, check=server.check, why=why)]

    def ask_again(self, server: Server, why: str, now_s: float) -> list[Move]:
        """Ask a READY server for a new slot, as the drone's turn there is over; the radio stays."""
        server.check = self._next_number()
        server.joined_before = True
        server.full_s = now_s
        change = server.apply(Trigger.TURN_OVER, now_s=now_s, why=why)
        return [change, Check(server.name, server.check, self.limit_s(server, running=True))]

    def leave(self, server: Server, why: str, now_s: float) -> list[Move]:
        """Leave a server in use or in preparation that has not failed."""
        self.selected.remove(server)
        return [server.deselect(now_s=now_s, why=why), Leave(server.name, server.check)]

    def fail(
        self,
        server: Server,
        trigger: Trigger,
        why: str,
        now_s: float,
        *,
        operations: Iterable[Operation],
        pause_s: float = 0.0,
    ) -> list[Move]:
        """Blacklist a server in use or in preparation; with probing its radio stays there.

        The operations are in doubt there from now on. With a `pause_s` the server is not probed for that time.
        """
        self.selected.remove(server)
        change = server.apply(trigger, now_s=now_s, why=why)
        server.left_alone_s = self._settings.blacklist_s
        if self._recovery is None or server.state is not State.BLACKLISTED:
            return [change, *self.leave_out(server, pause_s, now_s)]
        cost_a_call = trigger is not Trigger.NETWORK_LOST  # a lost network shows at once
        self._recovery.failed(server.name, operations, counts=cost_a_call, now_s=now_s)
        server.left_alone_s = max(REST_S, self._recovery.alone_s(server.name, now_s=now_s))
        if pause_s:
            return [change, *self.leave_out(server, pause_s, now_s)]
        return [change, self._probe(server, self._recovery, now_s)]

    def leave_out(self, server: Server, pause_s: float, now_s: float) -> list[Move]:
        """Leave a blacklisted server, and do not probe it for its pause."""
        server.leave_out(pause_s, now_s)
        if server in self.probed:
            self.probed.remove(server)
        return [Leave(server.name, server.check)]

    def probe(self, now_s: float) -> list[Move]:
        """Probe failed servers in range, as far as radios are free."""
        if self._recovery is None:
            return []
        failed = [
            server
            for server in self._table.in_range
            if server.state is State.BLACKLISTED
            and server not in self.probed
            and server.left_out_until_s <= now_s
        ]
        recovery = self._recovery
        return [self._probe(server, recovery, now_s) for server in failed[: max(0, self._free)]]

    def end_probes(self, servers: Sequence[Server]) -> list[Move]:
        """End the probes of these servers, and leave their networks."""
        for server in servers:
            self.probed.remove(server)
        return [Leave(server.name, server.check) for server in servers]

    def _is_put_off(self, now_s: float) -> bool:
        allowed_s = self._selected_s[0] + SELECTED_IN_S
        if now_s < allowed_s:
            self.put_off_until_s = allowed_s
        return now_s < allowed_s

    @property
    def _free(self) -> int:
        return self._settings.radios - len(self.selected) - len(self.probed)

    def _replace(self, others: Sequence[Server], server: Server, why: str, now_s: float) -> list[Move]:
        return [effect for other in others for effect in self.leave(other, f"{server.name} {why}", now_s)]

    def _check(self, server: Server, why: str, now_s: float) -> list[Move]:
        server.check = self._next_number()
        server.joined_before = server in self.probed
        if server.joined_before:
            self.probed.remove(server)
        leaving = self.end_probes(self.probed[:1]) if self._free < 1 else []
        self.selected.append(server)
        self._selected_s.append(now_s)
        change = server.apply(Trigger.SELECTED, now_s=now_s, why=why)
        self._table.meet()
        return [*leaving, change, Check(server.name, server.check, self.limit_s(server, running=True))]

    def _probe(self, server: Server, recovery: Recovery, now_s: float) -> Probe:
        server.check = self._next_number()
        self.probed.append(server)
        return Probe(
            server.name,
            server.check,
            self.limit_s(server, running=True),
            recovery.alone_s(server.name, now_s=now_s),
            recovery.probing,
        )

    def limit_s(self, server: Server, *, running: bool) -> float:
        """The longest time (s) of joining and asking, if services are `running`, or of starting them."""
        return check_limit_s(self._estimates.check_s(server.name, running=running))

    def _next_number(self) -> int:
        self._checks += 1
        return self._checks
