"""The drone-side machine: events in, commands out (thesis sections 3.2 to 3.4).

Laws:
- every change of a state is one of `servers.TRANSITIONS`; no more servers are selected than there are radios;
- the first of them is in use: calls go there alone; a second one is in preparation, and follows when that one goes;
- a check is known by its number, and what arrives for a check that is over changes nothing;
- a server that failed is left alone for a fixed time, or probed where a radio is free for it (recovery.py);
- with probing a call that runs on the drone is sent to a server too that becomes of use before the drone is done;
- what a server says a service raised counts as an answer where it raised on the drone too, and as a failed call else;
- after whatever it is told, the selection is looked at again at once; a decision only leaves, it selects nothing;
- commands are to be carried out in their order; without a spare radio a server is selected after the old one is left.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeGuard

from upwash.core.estimates import Estimates, Operation
from upwash.core.geo import Circle, Position
from upwash.core.happenings import (
    Arrived,
    CheckAnswered,
    CheckFailed,
    CourseLost,
    Happening,
    LegBegun,
    LocalCallEnded,
    Looked,
    MissionEnded,
    NetworkLost,
    Prepared,
    ProbeAnswered,
    RemoteCallCut,
    RemoteCallEnded,
    RemoteCallFailed,
    RemoteCallRaised,
    RemoteFaultTested,
    ServicesStarted,
)
from upwash.core.herald import Herald
from upwash.core.itinerary import Itinerary, MissionBeliefs
from upwash.core.orders import Check, Command, Leave, Prepare, Probe, Start
from upwash.core.outlook import Outlook, look_out
from upwash.core.policy import Call, Choice, Coming, Decision, Local, Option, Policy, Remote, Situation, Wait
from upwash.core.ranges import Ranges
from upwash.core.recovery import REST_S, Probing, Recovery
from upwash.core.servers import CHECKING, SELECTED, Change, Event, Server, State


@dataclass(frozen=True, slots=True)
class SelectionSettings:
    """How long the machine remembers, and how many servers it may have selected at a time.

    Where there is `probing`, `blacklist_s` does not count.
    """

    blacklist_s: float = 60.0
    idle_s: float = 180.0
    retry_s: float = 300.0
    radios: int = 1
    probing: Probing | None = None


_TRIAL_S = 10.0  # for which a server's answer to a call on trial is waited for, beside the drone's own


class Selection:
    """Keeps the server table of one drone and decides which server is selected."""

    def __init__(
        self,
        areas: Mapping[str, Circle],
        *,
        estimates: Estimates,
        policy: Policy,
        settings: SelectionSettings | None = None,
        mission: MissionBeliefs | None = None,
    ) -> None:
        self.servers = {name: Server(name, area) for name, area in areas.items()}
        self.estimates = estimates
        self.policy = policy
        self._checks = 0
        self._settings = settings or SelectionSettings()
        self._recovery = Recovery(self._settings.probing) if self._settings.probing else None
        self._selected: list[Server] = []  # in use, and in preparation
        self._probed: list[Server] = []  # each by a radio of its own
        self._ranges = Ranges(areas)
        self._in_range: Sequence[Server] = ()  # this and the next in the order of the table
        self._met: Sequence[Server] = ()  # those whose state may change by time alone, or as the selected one
        self._itinerary = Itinerary(mission or MissionBeliefs(), areas)
        self._under_way: Decision | None = None  # of the call that goes on now
        self._changed = True  # whether anything has changed since the policy was last asked
        self._herald = Herald()
        self._ended = False

    @property
    def current(self) -> Server | None:
        """The server in use, if any is selected."""
        return self._selected[0] if self._selected else None

    @property
    def in_range(self) -> Sequence[Server]:
        """The servers in whose range the drone was at the last position given."""
        return self._in_range

    @property
    def overtakes(self) -> bool:
        """Whether calls that run on the drone may be sent to a server too."""
        return self._recovery is not None

    def handle(self, happening: Happening, *, now_s: float, position: Position) -> list[Command]:
        """Takes in what happened by now, with the drone at the position; returns what is to be done."""
        self._locate(position, now_s)
        self._follow(happening, now_s, position)
        commands = self._take_in(happening, now_s)
        commands += self._let_go([each for each in self._probed if self._ended or not each.in_range])
        self._expire(commands, now_s)
        self._select(commands, now_s, position)
        commands += self._let_go([each for each in self._probed if each.state is not State.BLACKLISTED])
        commands += self._begin_probes(now_s)
        return commands

    def decide(
        self, operation: Operation, *, now_s: float, position: Position
    ) -> tuple[Decision, list[Command]]:
        """Where a call that is wanted now shall run."""
        decision, commands = self._decide(operation, now_s=now_s, position=position)
        self._itinerary.call_begun(operation, now_s=now_s)
        self._expect_end(decision, operation, now_s)
        return decision, commands

    def _decide(
        self, operation: Operation, *, now_s: float, position: Position
    ) -> tuple[Decision, list[Command]]:
        self._locate(position, now_s)
        current = self.current
        if current is None:
            return Local("no server selected"), []
        if not current.in_range:
            return Local(f"{current.name} is out of range"), self._deselect(current, "out of range", now_s)
        local_s = self.estimates.local_s(operation)
        remote_s = self.estimates.remote_s(current.name, operation)
        if local_s is None or remote_s is None:
            return Local(f"no estimate of {operation} on {current.name}"), []
        call = Call(
            server=current.name,
            state=current.state,
            local_s=local_s,
            remote_s=remote_s,
            check_expected_s=self.estimates.check_s(current.name, running=current.state is State.CHECK_R),
            check_elapsed_s=now_s - current.checked_since_s,
            is_first=self.estimates.is_first_call(current.name, operation),
        )
        return self._on_trial(current, operation, local_s, now_s) or self.policy.decide(call), []

    def _on_trial(
        self, server: Server, operation: Operation, local_s: float, now_s: float
    ) -> Decision | None:
        """Where a call runs for which the server is in doubt; None where it is not."""
        name, usual_s = server.name, self.estimates.usual_s(server.name, operation)
        if self._recovery is None or not self._recovery.in_doubt(name, operation):
            return None
        if usual_s is None or usual_s >= local_s:
            return Local(f"{name} failed or was slow, and is not faster")
        if server.state is not State.READY:
            return Local(f"{name} failed or was slow: it is not waited for")
        if self._recovery.trial_due_s(name, operation) > now_s:
            return Local(f"{name} failed or was slow: it is tried again soon")
        self._recovery.trial_begun(name)
        return Remote(name, max(_TRIAL_S, local_s), "on trial", raced=True)

    def overtake(
        self, operation: Operation, *, began_s: float, now_s: float, position: Position
    ) -> tuple[Remote | None, float]:
        """Where a call shall run too that the drone has been at since `began_s`.

        Returns None where no server would be sooner, and when to ask again if nothing happens until then.
        """
        self._locate(position, now_s)
        current = self.current
        if (
            self._recovery is None
            or current is None
            or not current.in_range
            or current.state is not State.READY
        ):
            return None, math.inf
        local_s = self.estimates.local_s(operation)
        usual_s = self.estimates.usual_s(current.name, operation)
        if local_s is None or usual_s is None or usual_s >= began_s + local_s - now_s:
            return None, math.inf
        due_s = self._recovery.trial_due_s(current.name, operation)
        if due_s > now_s:
            return None, due_s
        decision, _ = self._decide(operation, now_s=now_s, position=position)
        if not isinstance(decision, Remote):
            return None, math.inf
        decision = replace(decision, why=f"{current.name} is ready, and sooner", raced=True)
        self._under_way = decision
        return decision, math.inf

    def decide_after_wait(
        self, operation: Operation, check: int, *, now_s: float, position: Position
    ) -> tuple[Decision, list[Command]]:
        """Where a call shall run whose wait for that check is over; it does not wait again."""
        decision: Decision = Local("the check failed or was given up")
        commands: list[Command] = []
        if self.current is not None and self.current.check == check:
            decision, commands = self._decide(operation, now_s=now_s, position=position)
        if isinstance(decision, Remote):
            decision = replace(decision, why="server became ready")
        elif isinstance(decision, Wait):
            decision = Local("not ready in time")
        self._expect_end(decision, operation, now_s)
        return decision, commands

    def _expect_end(self, decision: Decision, operation: Operation, now_s: float) -> None:
        """Notes until when the mission is busy with the call, as far as is known now."""
        self._under_way = decision
        match decision:
            case Local():
                expected_s = self.estimates.local_s(operation)
            case Remote(server):
                expected_s = self.estimates.remote_s(server, operation)
            case Wait(_, at_most_s):
                expected_s = at_most_s
        self._itinerary.call_ends(now_s + (expected_s or 0.0))

    def is_checking(self, check: int) -> bool:
        """Whether that check is still under way."""
        return self._checked(check, CHECKING) is not None

    def _checked(self, check: int, states: Collection[State] = SELECTED) -> Server | None:
        """The server that was selected by that check and still is, if it is in one of the states."""
        return next((each for each in self._selected if each.check == check and each.state in states), None)

    def _probed_by(self, check: int) -> Server | None:
        """The server that failed, and that is probed by that number."""
        return next(
            (each for each in self._probed if each.check == check and each.state is State.BLACKLISTED), None
        )

    def _locate(self, position: Position, now_s: float) -> None:
        crossed = self._ranges.crossed(position)
        for name in crossed:
            server = self.servers[name]
            server.in_range_since_s = None if server.in_range else now_s
        if crossed:
            self._changed = True
            self._in_range = [server for server in self.servers.values() if server.in_range]

    def _take_in(self, happening: Happening, now_s: float) -> list[Command]:
        match happening:
            case Looked():
                pass  # the first case, as it is by far the most frequent
            case CheckAnswered(check, running, peers) if server := self._checked(check, CHECKING):
                server.peers = frozenset(peers) & self.servers.keys()
                return self._answered(server, running, now_s)
            case ServicesStarted(check) if server := self._checked(check, CHECKING):
                return [self._ready(server, Event.STARTED, now_s)]
            case ProbeAnswered(check, running) if server := self._probed_by(check):
                event = Event.PROBED_RUNNING if running else Event.PROBED
                return [server.apply(event, now_s=now_s, why="it gives a sign of life")]
            case CheckFailed(check, why) if server := self._checked(check, CHECKING):
                return self._failed(server, Event.CHECK_FAILED, why, now_s)
            case NetworkLost(check, why) if server := self._checked(check):
                return self._failed(server, Event.NETWORK_LOST, why, now_s)
            case Prepared(name, by) if self.servers[name].state in (State.AVL, State.AVL_R):
                change = self.servers[name].apply(Event.PREPARED, now_s=now_s, why=f"by {by}")
                self.estimates.services_started(name)
                self._meet()
                return [change]
            case RemoteCallFailed(name, check, why) | RemoteFaultTested(
                name, check, why=why, confirmed=False
            ) if (server := self._checked(check, (State.READY,))) and server.name == name:
                return self._call_failed(server, why, now_s)
            case MissionEnded():
                self._ended = True
            case _:
                self._learn(happening, now_s)
        return []

    def _learn(self, happening: Happening, now_s: float) -> None:
        """Learns what calls take."""
        if self._recovery is not None:
            self._learn_of_trials(self._recovery, happening, now_s)
        match happening:
            case RemoteCallCut(name, operation, waited_s):
                self.estimates.observe_remote_cut(name, operation, waited_s, now_s=now_s)
            case LocalCallEnded(operation, delay_s):
                self.estimates.observe_local(operation, delay_s)
            case RemoteCallEnded(name, operation, delay_s, late):
                self.estimates.observe_remote(name, operation, delay_s, now_s=now_s, late=late)
            case RemoteFaultTested(name, _, operation, delay_s, confirmed=True):
                self.estimates.observe_remote(name, operation, delay_s, now_s=now_s, late=True)

    def _learn_of_trials(self, recovery: Recovery, happening: Happening, now_s: float) -> None:
        match happening:
            case RemoteCallEnded(name, operation, delay_s) | RemoteFaultTested(
                name, _, operation, delay_s, confirmed=True
            ):
                local_s = self.estimates.local_s(operation) or 0.0
                recovery.answered(name, operation, delay_s, local_s=local_s, now_s=now_s)
            case RemoteCallFailed(name) | RemoteFaultTested(name):
                recovery.trial_over(name)

    def _follow(self, happening: Happening, now_s: float, position: Position) -> None:
        """Follows the mission over its legs and calls."""
        match happening:
            case (
                Looked()
                | CheckAnswered()
                | ServicesStarted()
                | CheckFailed()
                | ProbeAnswered()
                | NetworkLost()
                | Prepared()
            ):
                return  # what is under way concerns the mission only once it is over
            case LegBegun(target, ground_speed_m_s):
                self._itinerary.leg_begun(position, target, ground_speed_m_s, now_s=now_s)
            case Arrived():
                self._itinerary.arrived(now_s=now_s)
            case CourseLost():
                self._itinerary.lost()
            case RemoteCallEnded(late=True) | RemoteCallFailed(late=True):
                pass  # the mission has had its answer, and is at something else
            case LocalCallEnded() | RemoteCallEnded():
                self._itinerary.call_ends(now_s)
                self._under_way = None
            case RemoteCallFailed(why=why) | RemoteCallRaised(why=why):
                self._under_way = Local(why)
        self._changed = True

    def _answered(self, server: Server, running: bool, now_s: float) -> list[Command]:
        if running:
            return [self._ready(server, Event.FOUND_RUNNING, now_s)]
        if not server.in_range:
            return []  # about to be de-selected: nothing is started for a drone that is gone
        commands: list[Command] = []
        if server.state is State.CHECK_R:
            commands.append(server.apply(Event.FOUND_STOPPED, now_s=now_s))
        if not server.start_requested:
            server.start_requested = True
            commands.append(Start(server.name, server.check))
        return commands

    def _ready(self, server: Server, event: Event, now_s: float) -> Change:
        change = server.apply(event, now_s=now_s)
        if server.start_requested:
            self.estimates.services_started(server.name)
        announced = self._herald.has_announced(server.name, at_s=server.checked_since_s)
        # The rest of a start teaches nothing, nor does a check without joining.
        if not (announced and server.start_requested) and not server.joined_before:
            self.estimates.observe_check(
                server.name, now_s - server.checked_since_s, started=server.start_requested
            )
        return change

    def _failed(self, server: Server, event: Event, why: str, now_s: float) -> list[Command]:
        if not server.in_range:
            return self._deselect(server, "out of range", now_s)  # the server did nothing wrong
        return self._ban(server, event, why, now_s)

    def _call_failed(self, server: Server, why: str, now_s: float) -> list[Command]:
        event = Event.CALL_FAILED_IN_RANGE if server.in_range else Event.CALL_FAILED_OUT_OF_RANGE
        return self._ban(server, event, why, now_s)

    def _ban(self, server: Server, event: Event, why: str, now_s: float) -> list[Command]:
        """Has nothing more to do with the server for now, but for probes, for which the radio stays where it is."""
        self._selected.remove(server)
        change = server.apply(event, now_s=now_s, why=why)
        if self._recovery is None or server.state is not State.BLACKLISTED:
            return [change, Leave(server.name)]
        cost = event is not Event.NETWORK_LOST  # which shows at once, and is no call's loss by itself
        self._recovery.failed(server.name, self.estimates.operations, counts=cost, now_s=now_s)
        return [change, self._probe(server, self._recovery, now_s)]

    def _probe(self, server: Server, recovery: Recovery, now_s: float) -> Probe:
        self._checks += 1
        server.check = self._checks
        self._probed.append(server)
        return Probe(server.name, server.check, recovery.alone_s(server.name, now_s=now_s), recovery.probing)

    def _let_go(self, probed: Sequence[Server]) -> list[Command]:
        """Ends these probes, and leaves the networks that were joined for them."""
        for server in probed:
            self._probed.remove(server)
        return [Leave(server.name) for server in probed]

    def _begin_probes(self, now_s: float) -> list[Command]:
        """Has servers probed that failed and are in range, as far as there are radios."""
        if self._recovery is None or self._ended:
            return []
        failed = [
            each for each in self._in_range if each.state is State.BLACKLISTED and each not in self._probed
        ]
        recovery, free = self._recovery, max(0, self._free_radios())
        return [self._probe(server, recovery, now_s) for server in failed[:free]]

    def _free_radios(self) -> int:
        return self._settings.radios - len(self._selected) - len(self._probed)

    def _ban_s(self, server: Server) -> float:
        """For how long a server is blacklisted that nobody probes."""
        if self._recovery is None:
            return self._settings.blacklist_s
        return max(REST_S, self._recovery.alone_s(server.name, now_s=server.since_s))

    def _expire(self, commands: list[Command], now_s: float) -> None:
        for server in self._met:
            age_s = now_s - server.since_s
            if (
                server.state is State.BLACKLISTED
                and server not in self._probed
                and age_s >= self._ban_s(server)
            ):
                commands.append(server.apply(Event.BLACKLIST_EXPIRED, now_s=now_s))
            elif server.state is State.AVL_R and age_s >= self._settings.idle_s:
                commands.append(server.apply(Event.IDLE_EXPIRED, now_s=now_s))

    def _select(self, commands: list[Command], now_s: float, position: Position) -> None:
        if not (commands or self._is_due(now_s)):
            return
        self._changed = False
        choice = Choice(None, "mission ended") if self._ended else self._choose(now_s, position)
        if choice.server is None and self._is_worth_trials(self.current):
            choice = Choice(self.current.name, "slow lately, and no other is faster")
        for server in [each for each in self._selected if not each.in_range]:
            commands += self._deselect(server, "out of range", now_s)
        if choice.server is None:
            for server in list(self._selected):
                commands += self._deselect(server, choice.why, now_s)
        elif self.current is None or choice.server != self.current.name:
            commands += self._turn_to(self.servers[choice.server], choice.why, now_s)
        elif choice.coming is not None and self.servers[choice.coming.server] in self._in_range:
            commands += self._prepare(self.servers[choice.coming.server], "comes next", now_s)
        commands += self._announce(choice.coming, now_s)

    def _is_worth_trials(self, server: Server | None) -> TypeGuard[Server]:
        """Whether the server in use is slower than the drone by its last calls alone, and stays in use for trials."""
        return (
            self._recovery is not None
            and not self._ended
            and server is not None
            and server.in_range
            and server.state is State.READY
            and self._recovery.in_doubt(server.name)
        )

    def _turn_to(self, server: Server, why: str, now_s: float) -> list[Command]:
        """Uses the server from now on; with a spare radio from when it is ready, and the one before until then.

        One that no call would go to any more is not kept: as the selected one the next can be waited for.
        """
        current = self.current
        is_ready = server in self._selected and server.state is State.READY
        is_kept = (
            current is not None
            and self._has_spare_radio()
            and self.estimates.mean_call_s(current.name) < self.estimates.mean_call_s()
        )
        if is_kept and not is_ready:
            return self._prepare(server, why, now_s)
        commands = self._make_way(server, [each for each in self._selected if each is not server], why, now_s)
        return commands if self._selected else commands + self._check(server, why, now_s)

    def _prepare(self, server: Server, why: str, now_s: float) -> list[Command]:
        """Checks the server with a spare radio, while another one is in use; whatever that radio did is given up."""
        if not self._has_spare_radio() or server in self._selected or server.state is State.BLACKLISTED:
            return []
        return self._make_way(server, self._selected[1:], why, now_s) + self._check(server, why, now_s)

    def _has_spare_radio(self) -> bool:
        """Whether a server may be checked while another one is in use."""
        return self._settings.radios > 1 and self.current is not None and self.current.state is State.READY

    def _make_way(self, server: Server, others: Sequence[Server], why: str, now_s: float) -> list[Command]:
        """Leaves the others for the server."""
        return [
            command for other in others for command in self._deselect(other, f"{server.name} {why}", now_s)
        ]

    def _check(self, server: Server, why: str, now_s: float) -> list[Command]:
        self._checks += 1
        server.check = self._checks
        server.joined_before = server in self._probed
        if server.joined_before:
            self._probed.remove(server)
        leaving = [self._probed.pop(0)] if self._probed and self._free_radios() < 1 else []
        self._selected.append(server)
        change = server.apply(Event.SELECTED, now_s=now_s, why=why)
        self._meet()
        return [*(Leave(each.name) for each in leaving), change, Check(server.name, server.check)]

    def _meet(self) -> None:
        self._met = [server for server in self.servers.values() if server.state is not State.AVL]

    def _is_due(self, now_s: float) -> bool:
        """Whether the policy has to be asked: of what it is shown, time alone changes only what was forgotten."""
        retry_s = self._settings.retry_s
        if self._recovery is not None and self.current is None:
            retry_s = min(retry_s, REST_S)
        for server in self._in_range:
            if self.estimates.forget_slow_calls(server.name, now_s=now_s, retry_s=retry_s):
                self._changed = True
        return self._changed or self._herald.is_due(now_s)

    def _announce(self, coming: Coming | None, now_s: float) -> list[Prepare]:
        if coming is not None and self.servers[coming.server] in self._selected:
            coming = None  # it is being asked itself
        start_s = self.estimates.start_s(coming.server) if coming else 0.0
        return self._herald.announce(self.current, coming, start_s=start_s, now_s=now_s)

    def _choose(self, now_s: float, position: Position) -> Choice:
        options = [
            Option(server.name, self.estimates.mean_call_s(server.name), server.in_range_since_s)
            for server in self._in_range
            if server.in_range_since_s is not None and server.state is not State.BLACKLISTED
        ]
        return self.policy.choose(
            Situation(
                options,
                self.current.name if self.current else None,
                self.estimates.mean_call_s(),
                under_way=self._under_way,
                outlook=self._look_out(now_s, position),
            )
        )

    def _look_out(self, now_s: float, position: Position) -> Outlook | None:
        if not self.policy.horizon:
            return None
        return look_out(
            self._itinerary.coming(position, now_s=now_s, count=self.policy.horizon),
            self.servers,
            self.estimates,
            self._selected,
            now_s=now_s,
            banned_s={
                server.name: self._banned_s(server, now_s)
                for server in self._met
                if server.state is State.BLACKLISTED
            },
            idle_s=self._settings.idle_s,
        )

    def _banned_s(self, server: Server, now_s: float) -> float:
        """For how much longer the server will be blacklisted, as far as is known."""
        left_s = server.since_s + self._ban_s(server) - now_s
        return left_s if self._recovery is None else max(REST_S, left_s)

    def _deselect(self, server: Server, why: str, now_s: float) -> list[Command]:
        self._selected.remove(server)
        return [server.deselect(now_s=now_s, why=why), Leave(server.name)]
