"""Promises 5, 6 and 7 and the bounds of waits and calls, under random flights, servers, failures and late answers.

Beside the machine under test flies a model of the drone program: it carries out the commands one after the other,
with one radio or two, and objects where they make no sense.
"""

from __future__ import annotations

import copy
from collections.abc import Collection
from dataclasses import dataclass

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule
from msgspec import structs

from upwash.core.geo import Circle, Position, Waypoint
from upwash.core.knowledge.estimates import Beliefs, Estimates
from upwash.core.knowledge.servers import CHECKING, SELECTED, TRANSITIONS, State, Trigger
from upwash.core.operation import Operation
from upwash.core.planning.mission_model import MissionBeliefs, StopCall
from upwash.core.policies.look_ahead import LookAhead
from upwash.core.policies.policy import (
    Decision,
    Local,
    LocalOnly,
    LocationAware,
    Opportunistic,
    Policy,
    Remote,
    Wait,
    WaitRule,
)
from upwash.core.selection.commands import Check, Effect, Leave, Prepare, Probe, Start
from upwash.core.selection.events import (
    CheckAnswered,
    LeaseRenewed,
    LegBegun,
    LegEnded,
    LocalCallEnded,
    NetworkGone,
    NoMoreCalls,
    PeerPrepared,
    ProbeAnswered,
    RemoteCallEnded,
    RemoteCallFailed,
    RemoteCallRaised,
    RemoteFaultTested,
    SelectionEvent,
    ServerUnusable,
    ServicesStarted,
    SlotRefused,
    SlotTaken,
    TargetUnknown,
    Tick,
)
from upwash.core.selection.radios import MOST_SELECTED, SELECTED_IN_S
from upwash.core.selection.recovery import REST_S, Probing
from upwash.core.selection.selection import Selection
from upwash.core.selection.settings import SelectionSettings
from upwash.eventlog.schema import ServerStep

OPERATIONS = [Operation("detector", "process_photo", "heavy"), Operation("counter", "count")]
GAIN_SWITCH = GAIN_WAIT = GAIN_SLOT = 0.25
POLICIES: list[Policy] = [
    LocationAware(gain_switch=GAIN_SWITCH, wait=WaitRule(GAIN_WAIT)),
    Opportunistic(wait=WaitRule(GAIN_WAIT)),
    LocalOnly(),
    LookAhead(reactive=LocationAware(gain_switch=GAIN_SWITCH, wait=WaitRule(GAIN_WAIT))),
]
SETTINGS = SelectionSettings(blacklist_s=60.0, idle_s=180.0, retry_s=300.0)

# Small numbers of values, so that ranges overlap, estimates tie, and times meet the limits.
coordinates_m = st.sampled_from([0.0, 30.0, 60.0, 90.0])
positions = st.builds(Position, coordinates_m, coordinates_m)
areas = st.builds(Circle, positions, st.sampled_from([30.0, 60.0, 90.0]))
delays_s = st.integers(1, 40).map(lambda quarters: quarters / 4)
steps_s = st.sampled_from([0.0, 0.5, 1.0, 2.0, 5.0, 59.5, 60.0, 180.0, 300.0])
operations = st.sampled_from(OPERATIONS)
BACK = st.sampled_from([0, 0, 0, 1, 2])  # how old a check an answer is for, how old a call that ends
beliefs = st.builds(
    Beliefs,
    check_s=st.sampled_from([2.0, 5.0, 11.5]),
    check_running_s=st.sampled_from([1.0, 3.5]),
    remote_s=st.dictionaries(operations, st.sampled_from([0.25, 1.0, 2.0, 4.0, 9.0]), min_size=1),
)


@dataclass(frozen=True)
class CallUnderWay:
    server: str
    check: int
    operation: Operation


class Flights(RuleBasedStateMachine):
    """A drone that flies about, checks servers and calls services, while everything that can go wrong does."""

    @initialize(
        servers=st.lists(st.tuples(areas, beliefs), min_size=1, max_size=4),
        local_s=st.dictionaries(operations, st.sampled_from([3.0, 8.0, 10.0]), min_size=1),
        policy=st.sampled_from([POLICIES[0], POLICIES[-1], *POLICIES]),
        position=positions,
        plan=st.lists(positions, max_size=6),
        connected=st.booleans(),
        radios=st.sampled_from([1, 1, 2]),
        probing=st.sampled_from([None, Probing()]),
    )
    def take_off(
        self,
        servers: list[tuple[Circle, Beliefs]],
        local_s: dict[Operation, float],
        policy: Policy,
        position: Position,
        plan: list[Position],
        *,
        connected: bool,
        radios: int,
        probing: Probing | None,
    ) -> None:
        self.areas = {f"s{number}": area for number, (area, _) in enumerate(servers, start=1)}
        believed = {f"s{number}": belief for number, (_, belief) in enumerate(servers, start=1)}
        self.selection = Selection(
            self.areas,
            estimates=Estimates(local_s=local_s, servers=believed, slow_apart=probing is not None),
            policy=policy,
            settings=structs.replace(SETTINGS, radios=radios, probing=probing),
            mission=MissionBeliefs(
                [Waypoint(number, place) for number, place in enumerate(plan)],
                stop=[StopCall(operation, 1.0) for operation in sorted(local_s)],
            ),
        )
        self.plan = plan
        self.now_s = 0.0
        self.position = position
        self.ended = False
        self.states = dict.fromkeys(self.areas, State.AVL)
        self.radios = radios
        self.probing = probing
        self.joined: list[str] = []  # in use, and in preparation
        self.probed: dict[str, int] = {}  # by whom, as which check
        self.let_go_s: dict[str, float] = {}
        self.doubted: dict[str, set[Operation]] = {}  # those answered since the last failure, by server
        self.slow: set[tuple[str, Operation]] = set()  # no sooner there than on the drone, when last answered
        self.entered_s = dict.fromkeys(self.areas, 0.0)
        self.blacklisted_at_s: dict[str, float] = {}
        self.checks: list[int] = []
        self.selected_s: list[float] = []
        self.asked: dict[int, str] = {}  # by check
        self.peers = {name: {*self.areas, "elsewhere"} if connected else set() for name in self.areas}
        self.announced: list[tuple[str, str]] = []
        self.starts: list[int] = []
        self.calls: list[CallUnderWay] = []
        self.waits: list[tuple[Operation, int]] = []

    # ---- what happens

    @rule(position=positions)
    def fly(self, position: Position) -> None:
        self.position = position

    @rule(place=positions, number=st.integers(0, 5), ground_speed_m_s=st.sampled_from([None, 2.0, 10.0]))
    def leg_begins(self, place: Position, number: int, ground_speed_m_s: float | None) -> None:
        target = self.plan[number] if number < len(self.plan) else place
        self.happens(LegBegun(target, ground_speed_m_s))

    @rule(position=positions)
    def leg_ends(self, position: Position) -> None:
        self.fly(position)
        self.happens(LegEnded())

    @rule()
    def course_is_lost(self) -> None:
        self.happens(TargetUnknown())

    @rule(step_s=steps_s)
    def time_passes(self, step_s: float) -> None:
        self.now_s += step_s

    @rule(position=positions, step_s=steps_s)
    def fly_and_look(self, position: Position, step_s: float) -> None:
        self.fly(position)
        self.time_passes(step_s)
        self.happens(Tick())

    @rule()
    def look(self) -> None:
        self.happens(Tick())

    @precondition(lambda self: any(map(self.selection.is_awaited, self.checks)))
    @rule(running=st.booleans())
    def check_goes_on(self, *, running: bool) -> None:
        check = next(check for check in reversed(self.checks) if self.selection.is_awaited(check))
        self.happens(ServicesStarted(check) if check in self.starts else self.answer(check, running=running))

    @precondition(lambda self: self.checks)
    @rule(running=st.booleans(), back=BACK)
    def daemon_answers(self, back: int, *, running: bool) -> None:
        check = self.checks[-1 - back % len(self.checks)]
        self.happens(self.answer(check, running=running), check=check)

    def answer(self, check: int, *, running: bool) -> CheckAnswered:
        server = self.asked[check]
        return CheckAnswered(check, running, tuple(sorted(self.peers[server])))

    @precondition(lambda self: self.checks)
    @rule(back=BACK, waiting=st.integers(1, 3))
    def slot_is_refused(self, back: int, waiting: int) -> None:
        check = self.checks[-1 - back % len(self.checks)]
        self.happens(SlotRefused(check, waiting), check=check)

    @precondition(lambda self: self.checks)
    @rule(back=BACK, waiting=st.integers(0, 2))
    def lease_is_renewed(self, back: int, waiting: int) -> None:
        check = self.checks[-1 - back % len(self.checks)]
        self.happens(LeaseRenewed(check, waiting), check=check, states={State.READY})

    @precondition(lambda self: self.checks)
    @rule(back=BACK, in_call=st.booleans())
    def turn_is_over(self, back: int, *, in_call: bool) -> None:
        check = self.checks[-1 - back % len(self.checks)]
        self.happens(SlotTaken(check, "others wait", in_call), check=check, states={State.READY})

    @precondition(lambda self: self.announced)
    @rule()
    def peer_is_prepared(self) -> None:
        server, peer = self.announced.pop()
        self.happens(PeerPrepared(peer, server))

    @precondition(lambda self: self.starts)
    @rule(back=BACK)
    def daemon_has_started(self, back: int) -> None:
        check = self.starts[-1 - back % len(self.starts)]
        self.happens(ServicesStarted(check), check=check)

    @precondition(lambda self: self.checks)
    @rule(back=BACK)
    def check_fails(self, back: int) -> None:
        check = self.checks[-1 - back % len(self.checks)]
        self.happens(ServerUnusable(check, "no answer"), check=check)

    @precondition(lambda self: self.checks)
    @rule(back=BACK)
    def network_is_lost(self, back: int) -> None:
        check = self.checks[-1 - back % len(self.checks)]
        is_joined = self.asked[check] in self.joined and check == self.latest(self.asked[check])
        self.happens(NetworkGone(check, "no carrier"), check=None if is_joined else check)

    @precondition(lambda self: self.probed)
    @rule(running=st.booleans(), number=st.integers(0, 1))
    def probe_is_answered(self, number: int, *, running: bool) -> None:
        check = list(self.probed.values())[number % len(self.probed)]
        self.happens(ProbeAnswered(check, running))

    @rule(operation=operations, delay_s=delays_s)
    def local_call_ends(self, operation: Operation, delay_s: float) -> None:
        self.happens(LocalCallEnded(operation, delay_s))

    @precondition(lambda self: self.calls)
    @rule(back=BACK, delay_s=delays_s, failed=st.booleans())
    def remote_call_ends(self, back: int, delay_s: float, *, failed: bool) -> None:
        call = self.calls.pop(-1 - back % len(self.calls))
        if failed:
            self.happens(RemoteCallFailed(call.server, call.check, "deadline"))
        else:
            if call.server in self.doubted:
                self.doubted[call.server].add(call.operation)
            self.note_delay(call, delay_s)
            self.happens(RemoteCallEnded(call.server, call.operation, delay_s))

    @precondition(lambda self: self.calls)
    @rule(back=BACK, delay_s=delays_s, confirmed=st.booleans())
    def remote_call_raises(self, back: int, delay_s: float, *, confirmed: bool) -> None:
        call = self.calls.pop(-1 - back % len(self.calls))
        self.happens(RemoteCallRaised(call.server, "raised"))
        if confirmed and call.server in self.doubted:
            self.doubted[call.server].add(call.operation)
        if confirmed:
            self.note_delay(call, delay_s)
        tested = RemoteFaultTested(call.server, call.check, call.operation, delay_s, "raised", confirmed)
        self.happens(tested)
        self.happens(LocalCallEnded(call.operation, delay_s))

    @precondition(lambda self: len(self.checks) > 5)
    @rule()
    def mission_ends(self) -> None:
        self.ended = True
        self.happens(NoMoreCalls())

    @rule(operation=operations)
    def program_calls(self, operation: Operation) -> None:
        decision, commands = self.selection.decide(operation, now_s=self.now_s, position=self.position)
        self.carry_out(commands)
        self.judge(decision, operation)
        if isinstance(decision, Remote):
            self.calls.append(CallUnderWay(decision.server, self.latest(decision.server), operation))
        if isinstance(decision, Wait):
            self.waits.append((operation, self.latest(decision.server)))

    @rule(operation=operations, since_s=st.sampled_from([0.0, 1.0, 5.0]))
    def program_asks_who_overtakes(self, operation: Operation, since_s: float) -> None:
        decision, again_s = self.selection.overtake(
            operation, began_s=self.now_s - since_s, now_s=self.now_s, position=self.position
        )
        if decision is None:
            assert again_s > self.now_s
            return
        assert self.probing is not None and decision.raced
        self.judge(decision, operation)
        self.calls.append(CallUnderWay(decision.server, self.latest(decision.server), operation))

    @precondition(lambda self: self.waits)
    @rule(back=BACK)
    def wait_is_over(self, back: int) -> None:
        operation, check = self.waits.pop(-1 - back % len(self.waits))
        decision, commands = self.selection.decide_after_wait(
            operation, check, now_s=self.now_s, position=self.position
        )
        self.carry_out(commands)
        assert not isinstance(decision, Wait), "waits twice"
        self.judge(decision, operation)
        if isinstance(decision, Remote):
            assert check == self.latest(decision.server), "the server became ready by another check"
            self.calls.append(CallUnderWay(decision.server, check, operation))

    # ---- the drone program

    def note_delay(self, call: CallUnderWay, delay_s: float) -> None:
        """Notes whether the answer came sooner than the drone's own would have."""
        local_s = self.selection.estimates.local_s(call.operation)
        assert local_s is not None
        if delay_s < local_s:
            self.slow.discard((call.server, call.operation))
        else:
            self.slow.add((call.server, call.operation))

    def happens(
        self, event: SelectionEvent, *, check: int | None = None, states: Collection[State] = CHECKING
    ) -> None:
        """The machine takes it in; what belongs to a check that is over must be worth no more than a look."""
        if check is not None and not self.is_at(check, states):
            looked = copy.deepcopy(self.selection)
            expected = looked.handle(Tick(), now_s=self.now_s, position=self.position)
            commands = self.selection.handle(event, now_s=self.now_s, position=self.position)
            assert commands == expected
            assert self.selection.servers == looked.servers
        else:
            commands = self.selection.handle(event, now_s=self.now_s, position=self.position)
        self.carry_out(commands)
        self.nothing_is_remembered_too_long()
        self.nothing_better_is_left()
        self.a_look_before_the_next_one_finds_nothing()

    def is_at(self, check: int, states: Collection[State]) -> bool:
        """Whether that check is the server's latest, and the server, selected still, in one of the states."""
        server = self.asked[check]
        return check == self.latest(server) and server in self.joined and self.states[server] in states

    def carry_out(self, commands: list[Effect]) -> None:  # noqa: PLR0915 - one case for each command
        for command in commands:
            match command:
                case ServerStep(server=server, before=before, after=after):
                    assert self.states[server] is before
                    assert TRANSITIONS[before, Trigger(command.kind)] is after
                    self.states[server] = after
                    self.entered_s[server] = self.now_s
                    if after is State.BLACKLISTED:
                        self.blacklisted_at_s[server] = self.now_s
                        self.doubted[server] = set()
                case Leave(server):
                    assert server in self.joined or server in self.probed, "left what was not joined"
                    assert self.states[server] not in SELECTED
                    if self.probed.pop(server, None) is None:
                        self.joined.remove(server)
                    self.let_go_s[server] = self.now_s
                case Probe(server, check):
                    assert self.probing is not None
                    assert self.states[server] is State.BLACKLISTED
                    assert self.areas[server].contains(self.position)
                    if server in self.joined:
                        self.joined.remove(server)
                    self.probed[server] = check
                    assert len(self.joined) + len(self.probed) <= self.radios
                case Check(server, check) if server in self.joined:  # its turn is over
                    assert self.states[server] is State.CHECK_R
                    self.checks.append(check)
                    self.asked[check] = server
                case Check(server, check):
                    self.probed.pop(server, None)
                    assert len(self.joined) + len(self.probed) < self.radios, "joined one network too many"
                    assert all(self.states[other] is State.READY for other in self.joined)
                    assert self.states[server] in {State.CHECK, State.CHECK_R}
                    assert self.areas[server].contains(self.position)
                    assert check not in self.checks
                    self.contact(server)
                    self.joined.append(server)
                    self.selected_s.append(self.now_s)
                    self.checks.append(check)
                    self.asked[check] = server
                case Start(server, check):
                    assert server in self.joined
                    assert check == self.latest(server)
                    assert check not in self.starts, "started twice"
                    self.starts.append(check)
                case Prepare(server, check, peer, arrives_in_s, hold_s):
                    assert self.joined[:1] == [server]
                    assert check == self.latest(server)
                    assert self.states[server] is State.READY
                    assert peer in self.peers[server] - {server}
                    assert min(arrives_in_s, hold_s) >= 0
                    self.announced.append((server, peer))

    def latest(self, server: str) -> int:
        """The number of the latest check of the server."""
        return max(check for check, asked in self.asked.items() if asked == server)

    def contact(self, server: str) -> None:
        """Promise 7: a blacklisted server is not contacted before its time."""
        if self.probing is not None:
            assert self.states[server] is not State.BLACKLISTED
            return
        since_s = self.blacklisted_at_s.get(server)
        assert since_s is None or self.now_s - since_s >= SETTINGS.blacklist_s

    def judge(self, decision: Decision, operation: Operation) -> None:
        if isinstance(decision, Local):
            return
        local_s = self.selection.estimates.local_s(operation)
        remote_s = self.selection.estimates.remote_s(decision.server, operation)
        assert local_s is not None
        assert remote_s is not None
        assert self.joined[:1] == [decision.server]
        assert self.areas[decision.server].contains(self.position)
        if isinstance(decision, Remote):
            self.contact(decision.server)
            assert self.states[decision.server] is State.READY
            usual_s = self.selection.estimates.remote_s(decision.server, operation, slow=False)
            assert usual_s is not None
            if self.in_doubt(decision.server, operation):
                assert decision.raced and decision.deadline_s == max(10.0, local_s)
                assert usual_s < local_s
            else:
                assert decision.deadline_s == max(1.0, min(4 * remote_s, local_s))
            if self.probing is not None and decision.server in self.doubted and not decision.raced:
                assert operation in self.doubted[decision.server], "trusted before it has answered"
        else:
            trusted = operation in self.doubted.get(decision.server, OPERATIONS)
            assert self.probing is None or trusted, "waited for before it has answered"
            assert self.states[decision.server] in {State.CHECK, State.CHECK_R}
            assert 0 < decision.at_most_s <= local_s * (1 - GAIN_WAIT) - remote_s

    def nothing_is_remembered_too_long(self) -> None:
        for name, state in self.states.items():
            age_s = self.now_s - self.entered_s[name]
            if self.probing is None:
                assert state is not State.BLACKLISTED or age_s < SETTINGS.blacklist_s
            elif name not in self.probed:
                unprobed_s = min(age_s, self.now_s - self.let_go_s.get(name, self.entered_s[name]))
                assert state is not State.BLACKLISTED or unprobed_s < REST_S
            assert state is not State.AVL_R or age_s < SETTINGS.idle_s

    @property
    def selected_lately(self) -> int:
        return sum(self.now_s - at_s < SELECTED_IN_S for at_s in self.selected_s)

    def nothing_better_is_left(self) -> None:
        """After whatever happened the policy has its way at once, but for the pace of selections."""
        if self.selected_lately == MOST_SELECTED:
            return
        estimates, policy, current = self.selection.estimates, self.selection.policy, self.selection.current
        local_s = estimates.mean_call_s()
        reachable = {
            name
            for name, area in self.areas.items()
            if area.contains(self.position) and self.states[name] is not State.BLACKLISTED
        }
        if isinstance(policy, LocationAware | LookAhead):
            reachable = {name for name in reachable if estimates.mean_call_s(name) < local_s}
        servers = self.selection.servers
        for name in list(reachable):
            gain_s = local_s - estimates.mean_call_s(name)
            if servers[name].is_contended(self.now_s) and gain_s <= GAIN_SLOT * local_s:
                reachable.remove(name)
        if self.ended or isinstance(policy, LocalOnly):
            reachable = set()
        if current is not None and current.name not in reachable and self.is_tried(current.name):
            return  # it is kept for trials, and no other would do
        if not isinstance(policy, LookAhead):  # which knows better than to take whatever there is
            assert (current is None) == (not reachable)
        if current is not None:
            assert current.name in reachable
            if isinstance(policy, LocationAware) and len(self.joined) == 1:
                with_slots = {name for name in reachable if not servers[name].is_full(self.now_s)}
                assert current.name in (with_slots or reachable)
                best_s = min(estimates.mean_call_s(name) for name in with_slots or reachable)
                assert (estimates.mean_call_s(current.name) - best_s) / local_s <= GAIN_SWITCH

    def in_doubt(self, server: str, operation: Operation) -> bool:
        """Whether a call there is a trial."""
        unanswered = server in self.doubted and operation not in self.doubted[server]
        return self.probing is not None and (unanswered or (server, operation) in self.slow)

    def is_tried(self, server: str) -> bool:
        """Whether calls to the server may be trials: it failed, or an operation is slow there."""
        return self.probing is not None and (
            server in self.doubted or any(server == slow for slow, _ in self.slow)
        )

    # ---- what always holds

    def a_look_before_the_next_one_finds_nothing(self) -> None:
        next_s = self.selection.next_look_s(now_s=self.now_s)
        if next_s <= self.now_s:
            return
        early_s = min(next_s - 0.001, self.now_s + 1000.0)
        looked = copy.deepcopy(self.selection)
        assert looked.handle(Tick(), now_s=early_s, position=self.position) == []
        assert looked.next_look_s(now_s=early_s) == next_s

    @invariant()
    def the_selected_servers_are_those_that_are_joined(self) -> None:
        assert sorted(self.joined) == sorted(name for name, state in self.states.items() if state in SELECTED)
        assert len(self.joined) + len(self.probed) <= self.radios

    @invariant()
    def few_servers_are_selected_in_a_second(self) -> None:
        assert self.selected_lately <= MOST_SELECTED

    @invariant()
    def failed_servers_are_probed_as_far_as_there_are_radios(self) -> None:
        assert all(self.states[name] is State.BLACKLISTED for name in self.probed)

    @invariant()
    def the_one_in_use_was_joined_first(self) -> None:
        current = self.selection.current
        assert self.joined[:1] == ([current.name] if current else [])

    @invariant()
    def every_change_was_told(self) -> None:
        assert {name: server.state for name, server in self.selection.servers.items()} == self.states


class ManyFlights(Flights):
    """The same, with enough flights to meet what is rare."""


UNHURRIED = settings(stateful_step_count=50, deadline=None, suppress_health_check=[HealthCheck.too_slow])
A_FAILURE_IS_MADE_SMALL = pytest.mark.timeout(900)  # for up to 300 s
TestFlights = A_FAILURE_IS_MADE_SMALL(Flights.TestCase)
TestFlights.settings = settings(UNHURRIED, max_examples=100)
TestManyFlights = pytest.mark.nightly(A_FAILURE_IS_MADE_SMALL(ManyFlights.TestCase))
TestManyFlights.settings = settings(UNHURRIED, max_examples=1000)
