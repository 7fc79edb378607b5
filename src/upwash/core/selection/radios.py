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
from collections.abc import Iterable

from upwash.core.knowledge.servers import Server, State, Trigger
from upwash.core.selection.commands import Check, Leave, Probe, Start
from upwash.core.selection.moment import Moment, Part
from upwash.core.selection.recovery import REST_S
from upwash.eventlog import schema

_CHECK_LEAST_S = 10.0
_CHECK_FACTOR = 3.0  # times the estimate: a check that takes longer has failed
MOST_SELECTED, SELECTED_IN_S = 4, 1.0


def check_limit_s(believed_s: float) -> float:
    """The longest time of a check, or of joining, from its expected time, in seconds."""
    return max(_CHECK_LEAST_S, _CHECK_FACTOR * believed_s)


class Radios(Part):
    """Gives servers their roles."""

    def __init__(self, moment: Moment) -> None:
        super().__init__(moment)
        self.selected: list[Server] = []  # the one in use, then the one in preparation
        self.probed: list[Server] = []
        self.put_off_until_s = (
            math.inf
        )  # when a server may be selected that was selected too soon after others
        self._checks = 0
        self._selected_s = deque([-math.inf] * MOST_SELECTED, MOST_SELECTED)

    @property
    def in_use(self) -> Server | None:
        """The server to which calls go once it is READY; None without one."""
        return self.selected[0] if self.selected else None

    @property
    def has_spare(self) -> bool:
        """Whether another server may be prepared beside the one in use."""
        return self._settings.radios > 1 and self.in_use is not None and self.in_use.state is State.READY

    def server_of(self, check: int) -> Server | None:
        """The server with that check or probe; None if it was left since."""
        return next((server for server in (*self.selected, *self.probed) if server.check == check), None)

    def ready(self, name: str, check: int) -> Server | None:
        """The server, READY since that check; None if it was left since."""
        server = self.server_of(check)
        is_ready = server is not None and server.name == name and server.state is State.READY
        return server if is_ready else None

    def use(self, server: Server, why: str, *, keep: bool) -> None:
        """Use the server from now on.

        With a spare radio and `keep`, the former server stays in use until the new server is READY.
        """
        if server not in self.selected and self._is_put_off():
            return
        is_ready = server in self.selected and server.state is State.READY
        if keep and self.has_spare and not is_ready:
            self.prepare(server, why)
            return
        for other in [other for other in self.selected if other is not server]:
            self.leave(other, f"{server.name} {why}")
        if not self.selected:
            self._check(server, why)

    def prepare(self, server: Server, why: str) -> None:
        """Check the server with a spare radio; leave the server that this radio prepared before."""
        if not self.has_spare or server in self.selected or server.state is State.BLACKLISTED:
            return
        if not self._is_put_off():
            for other in self.selected[1:]:
                self.leave(other, f"{server.name} {why}")
            self._check(server, why)

    def start(self) -> None:
        """Ask the selected servers that were found stopped to start the services, once in a check."""
        for server in self.selected:
            if server.state is State.CHECK and server.found_stopped and not server.start_requested:
                server.start_requested = True
                limit_s = self._limit_s(server, running=False)
                self._moment.effects.append(Start(server.name, server.check, limit_s))

    def prefer(self, server: Server, why: str) -> None:
        """Use a server that is READY in preparation, and keep the one in use as the one in preparation."""
        if server in self.selected[1:] and server.state is State.READY:
            self.selected.reverse()
            self._moment.effects.append(schema.Preferred(server=server.name, check=server.check, why=why))

    def ask_again(self, server: Server, why: str) -> None:
        """Ask a READY server for a new slot, as the drone's turn there is over; the radio stays."""
        server.check = self._next_number()
        server.joined_before = True
        server.full_s = self._now_s
        self._ask(server, Trigger.TURN_OVER, why)

    def leave(self, server: Server, why: str) -> None:
        """Leave a server in use or in preparation that has not failed."""
        self.selected.remove(server)
        self._moment.step(server, server.deselection, why)
        self._moment.effects.append(Leave(server.name, server.check))

    def fail(self, server: Server, trigger: Trigger, why: str, *, pause_s: float = 0.0) -> None:
        """Blacklist a server in use or in preparation; with probing its radio stays there.

        All operations are in doubt there from now on. With a `pause_s` the server is not probed for that time.
        """
        if pause_s:
            self._note_pause(server, pause_s, why)
        self.selected.remove(server)
        self._moment.step(server, trigger, why)
        server.left_alone_s = self._settings.blacklist_s
        is_probed = self._recovery.probing is not None and server.state is State.BLACKLISTED
        if is_probed:
            cost_a_call = trigger is not Trigger.NETWORK_LOST  # a lost network shows at once
            operations = self._estimates.operations
            self._recovery.failed(server.name, operations, counts=cost_a_call, now_s=self._now_s)
            server.left_alone_s = max(REST_S, self._recovery.alone_s(server.name, now_s=self._now_s))
        if is_probed and not pause_s:
            self._probe(server)
        else:
            server.leave_out(pause_s, self._now_s)
            self._moment.effects.append(Leave(server.name, server.check))

    def pause(self, server: Server, pause_s: float, why: str) -> None:
        """End the probe of a server that is not used for `pause_s`."""
        self._note_pause(server, pause_s, why)
        server.leave_out(pause_s, self._now_s)
        self.end_probes([server])

    def probe(self) -> None:
        """Probe failed servers in range, as far as radios are free."""
        if self._recovery.probing is None:
            return
        for server in self._table.in_range:
            is_left_alone = server in self.probed or server.left_out_until_s > self._now_s
            if server.state is State.BLACKLISTED and not is_left_alone and self._free > 0:
                self._probe(server)

    def end_probes(self, servers: Iterable[Server]) -> None:
        """End the probes of these servers, and leave their networks."""
        for server in list(servers):
            self.probed.remove(server)
            self._moment.effects.append(Leave(server.name, server.check))

    def _is_put_off(self) -> bool:
        allowed_s = self._selected_s[0] + SELECTED_IN_S
        if self._now_s < allowed_s:
            self.put_off_until_s = allowed_s
        return self._now_s < allowed_s

    @property
    def _free(self) -> int:
        return self._settings.radios - len(self.selected) - len(self.probed)

    def _check(self, server: Server, why: str) -> None:
        server.check = self._next_number()
        server.joined_before = server in self.probed
        if server.joined_before:
            self.probed.remove(server)
        if self._free < 1:
            self.end_probes(self.probed[:1])
        self.selected.append(server)
        self._selected_s.append(self._now_s)
        self._ask(server, Trigger.SELECTED, why)
        self._table.meet()

    def _ask(self, server: Server, trigger: Trigger, why: str) -> None:
        self._moment.step(server, trigger, why)
        self._moment.effects.append(Check(server.name, server.check, self._limit_s(server, running=True)))

    def _probe(self, server: Server) -> None:
        assert self._recovery.probing is not None  # noqa: S101 - else nothing is probed
        server.check = self._next_number()
        self.probed.append(server)
        self._moment.effects.append(
            Probe(
                server.name,
                server.check,
                self._limit_s(server, running=True),
                self._recovery.alone_s(server.name, now_s=self._now_s),
                self._recovery.probing,
            )
        )

    def _note_pause(self, server: Server, pause_s: float, why: str) -> None:
        self._moment.effects.append(
            schema.LeftOut(server=server.name, check=server.check, pause_s=pause_s, why=why)
        )

    def _limit_s(self, server: Server, *, running: bool) -> float:
        """The longest time (s) of joining and asking, if services are `running`, or of starting them."""
        return check_limit_s(self._estimates.check_s(server.name, running=running))

    def _next_number(self) -> int:
        self._checks += 1
        return self._checks
