"""Which server to use now: when the policy decides, and from which inputs.

The policy decides again after each change in its inputs. Time alone makes two changes: slow calls are
forgotten, so that a slow server gets another chance, and an announcement becomes due.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from statistics import fmean

from msgspec import structs

from upwash.core.knowledge.servers import FULL_S, SELECTED, Server, State
from upwash.core.operation import Operation
from upwash.core.planning.backlog import ServerBelief
from upwash.core.planning.forecast import Forecast, make_forecast, rest_of_check_s
from upwash.core.planning.legs import Leg, left_m
from upwash.core.planning.mission_model import ExpectedCall, MissionModel
from upwash.core.planning.stay_or_go import Outlook
from upwash.core.policies.policy import Choice, Coming, Decision, Local, Option, Remote, Situation, Wait
from upwash.core.selection.call_forecast import CallForecast, CallPlace
from upwash.core.selection.commands import Prepare
from upwash.core.selection.events import CallOver, CallWaits, LegBegun, LegEnded, TargetUnknown
from upwash.core.selection.moment import Moment, Part
from upwash.core.selection.radios import Radios
from upwash.core.selection.recovery import REST_S

_EARLY_S = 10.0  # that a server is prepared before it has to be, as legs and calls take as long as they take
_STILL_GAINS = 0.99  # of the time on the drone, at most, where another lane serves the drone's line anyway
_HOLD_S = 15.0  # that its slot is held after the drone should be there


class PrewarmNotifier(Part):
    """Announces the drone to the servers that it uses next, and knows when the next announcement is due."""

    def __init__(self, moment: Moment, radios: Radios) -> None:
        super().__init__(moment)
        self._radios = radios
        self.due_s = math.inf  # the time of the next announcement
        self._held_until_s: dict[str, float] = {}

    def has_announced(self, server: str, *, at_s: float) -> bool:
        """Whether the drone had been announced to the server, so that a slot was held at `at_s`."""
        return self._held_until_s.get(server, -math.inf) > at_s

    def announce(self, coming: Coming | None) -> None:
        """Announce the drone if it is time: by a READY server in use, unless a slot is held already."""
        self.due_s, current, now_s = math.inf, self._radios.in_use, self._now_s
        if coming is None or current is None or current.state is not State.READY:
            return
        name = coming.server
        if name not in current.peers or self._table.servers[name] in self._radios.selected:
            return  # the drone asks a selected server itself
        due_s = now_s + coming.in_s - self._estimates.start_s(name) - _EARLY_S
        due_s = max(due_s, self._held_until_s.get(name, -math.inf))
        if due_s > now_s:
            self.due_s = due_s
            return
        self._held_until_s[name] = now_s + coming.in_s + _HOLD_S
        self._moment.effects.append(Prepare(current.name, current.check, name, coming.in_s, _HOLD_S))


class ServerPlanning(Part):
    """Asks the policy which server to use, for a mission that it follows over its legs and calls."""

    def __init__(self, moment: Moment, radios: Radios, mission: MissionModel) -> None:
        super().__init__(moment)
        self._radios = radios
        self.mission = mission
        self.under_way: Decision | None = None  # on the call whose answer is not there yet
        self._operation: Operation | None = None  # of the call under way
        self.waiting = Counter[Operation]()  # calls that only servers compute
        self.prewarm = PrewarmNotifier(moment, radios)
        self._short: frozenset[tuple[str, bool, bool]] = frozenset()  # of slots, as the policy was last shown

    def decided(self, decision: Decision, operation: Operation) -> None:
        """Note that the mission has made a call, and where it runs."""
        needs_server = self._estimates.needs_server(operation)
        if needs_server and not isinstance(decision, Remote):
            return
        self.under_way, self._operation = decision, operation
        if needs_server:  # the mission does not wait for it, or not for long
            return
        match decision:
            case Local():
                expected_s = self._estimates.local_s(operation)
            case Remote(server):
                expected_s = self._estimates.remote_s(server, operation)
            case Wait(_, at_most_s):
                expected_s = at_most_s
        first = self._settings.two_answers.get(operation)
        if first is not None and (first_s := self._estimates.local_s(first.first)) is not None:
            expected_s = first_s if expected_s is None else min(expected_s, first_s)
        self.mission.call_ends(self._now_s + (expected_s or 0.0))

    def waits(self, event: CallWaits | CallOver) -> None:
        """Note that a call that only servers compute waits for one, waits again, or is over."""
        operation = event.operation
        if isinstance(event, CallWaits) and not event.again:
            self.waiting[operation] += 1
            self._estimates.call_waits(operation)
            self.mission.call_begun(operation, now_s=self._now_s)
            return
        if isinstance(event, CallOver):
            self.waiting -= Counter({operation: 1})
        if self._operation == operation:
            self.under_way = None

    def reach_s(self, operation: Operation) -> float | None:
        """Seconds until a server in range that the policy uses answers a call; None without a server."""
        server = self._radios.in_use
        if server is None or not server.in_range:
            name = self.choose().server
            server = self._table.servers[name] if name is not None else None
        remote_s = self._estimates.remote_s(server.name, operation) if server is not None else None
        return None if server is None or remote_s is None else self._ready_in_s(server) + remote_s

    def _ready_in_s(self, server: Server) -> float:
        """The expected seconds until the server is READY, from now on."""
        if server in self._radios.selected:
            return rest_of_check_s(server, self._estimates, self._now_s)
        return self._estimates.check_s(server.name, running=server.state is State.AVL_R)

    def answered(self) -> None:
        """Note that the mission has the answer to its call."""
        self.mission.call_ends(self._now_s)
        self.under_way = None

    def mission_goes_on(self, event: LegBegun | LegEnded | TargetUnknown) -> None:
        """Follow the mission; only a policy with a horizon sees it."""
        moment = self._moment
        match event:
            case LegBegun(target, ground_speed_m_s, back, via):
                self.mission.leg_begun(
                    moment.here, target, ground_speed_m_s, now_s=moment.now_s, back=back, via=via
                )
            case LegEnded():
                self.mission.arrived(now_s=moment.now_s)
            case TargetUnknown():
                self.mission.lost()
        moment.changed = moment.changed or self._policy.horizon > 0

    def outlook(self) -> Outlook | None:
        """What flying on before the open call is over would save and cost; None if nothing is known."""
        way = self.mission.next_leg()
        if way is None or self.under_way is None or self._operation is None:
            return None
        assert isinstance(way.leg, Leg)  # noqa: S101 - no row's: it begins at rest
        stay_s = go_s = self.mission.open_s(self._now_s)
        if not isinstance(self.under_way, Local):
            area = self._table.servers[self.under_way.server].area
            leaves_m = left_m(way.start, way.end, area)
            leaves_s = math.inf if leaves_m is None else way.leg.reached_s(leaves_m)
            if leaves_s < stay_s:
                go_s = leaves_s + (self._estimates.local_s(self._operation) or 0.0)
        return Outlook(way.leg, self.mission.photo_s, stay_s, go_s)

    def forget_slow_calls(self) -> None:
        """Give slow servers in range another chance when it is due."""
        for server in self._table.in_range:
            if self._estimates.forget_slow_calls(server.name, now_s=self._now_s, retry_s=self._slow_for_s):
                self._moment.changed = True

    @property
    def _slow_for_s(self) -> float:
        if self._recovery.probing is not None and self._radios.in_use is None:
            return min(self._settings.retry_s, REST_S)
        return self._settings.retry_s

    def next_look_s(self, now_s: float) -> float:
        """The time before which the policy need not decide again, unless an event comes first."""
        if self._moment.changed:
            return now_s
        look_s = min(self.prewarm.due_s, self._radios.put_off_until_s)
        for server in self._table.in_range:
            slow_until_s = self._estimates.next_forgetting_s(server.name, retry_s=self._slow_for_s)
            look_s = min(look_s, slow_until_s, server.asked_again_s(now_s))
        return look_s

    @property
    def is_due(self) -> bool:
        """Whether the policy must decide now."""
        due_s = min(self.prewarm.due_s, self._radios.put_off_until_s)
        return self._moment.changed or self._now_s >= due_s or self._short_of_slots() != self._short

    def choose(self) -> Choice:
        """The policy's choice; a slow server in use is kept for trials if the policy chooses none."""
        current = self._radios.in_use
        self._short = self._short_of_slots()
        choice = self._policy.choose(
            Situation(
                self._options(),
                current.name if current else None,
                self._estimates.mean_call_s(),
                under_way=self.under_way,
                forecast=self._forecast() if self._policy.horizon else None,
                now_s=self._now_s,
                position=self._moment.here,
            )
        )
        if choice.server is not None or current is None or not self._recovery.in_doubt(current.name):
            return choice
        if not current.in_range or current.state is not State.READY or not self.is_worth_a_slot(current):
            return choice
        return Choice(current.name, "slow lately, and no other is faster")

    def beside(self, first: Server) -> Server | None:
        """The fastest other server in range that has a slot; None without one."""
        options = [option for option in self._options() if option.server != first.name and not option.full]
        fastest = min(options, key=lambda option: option.mean_call_s, default=None)
        return None if fastest is None else self._table.servers[fastest.server]

    def made_now(self, operation: Operation) -> ExpectedCall:
        """The call that the mission makes now, as an expected call."""
        in_range_s = {
            server.name: self._now_s - server.in_range_since_s
            for server in self._table.in_range
            if server.in_range_since_s is not None
        }
        return ExpectedCall(operation, 0.0, in_range_s)

    def placing(self) -> CallForecast:
        """The forecast of where calls run from now on."""
        in_use = self._radios.in_use
        running = (State.AVL_R, *SELECTED)
        return CallForecast(
            self._policy,
            self._estimates,
            here=CallPlace() if in_use is None else CallPlace(in_use.name, self._ready_in_s(in_use)),
            running={server.name for server in self._table.servers.values() if server.state in running},
            unusable_s=dict(self._banned()),
            first={asked: two.first for asked, two in self._settings.two_answers.items()},
        )

    def believed(self, operations: Sequence[Operation]) -> dict[str, ServerBelief]:
        """The servers that may compute these operations, and the mean seconds of a call at each."""
        beliefs = {}
        for name, server in self._table.servers.items():
            times_s = [self._estimates.remote_s(name, operation) for operation in operations]
            known_s = [time_s for time_s in times_s if time_s is not None]
            if server.state is State.BLACKLISTED or not known_s or len(known_s) < len(times_s):
                continue
            beliefs[name] = ServerBelief(server.area, fmean(known_s), self._ready_in_s(server))
        return beliefs

    def _options(self) -> list[Option]:
        now_s, mean_call_s = self._now_s, self._estimates.mean_call_s
        return [
            Option(
                server.name,
                self._with_wait_s(server.name, mean_call_s(server.name), mean_call_s()),
                server.in_range_since_s,
                full=server.is_full(now_s),
                state=server.state,
                area=server.area,
            )
            for server in self._table.in_range
            if server.in_range_since_s is not None
            and server.state is not State.BLACKLISTED
            and self.is_worth_a_slot(server)
        ]

    def _short_of_slots(self) -> frozenset[tuple[str, bool, bool]]:
        now_s = self._now_s
        return frozenset(
            (server.name, server.is_full(now_s), server.is_contended(now_s))
            for server in self._table.in_range
            if server.is_full(now_s) or server.is_contended(now_s)
        )

    def is_worth_a_slot(self, server: Server) -> bool:
        """Whether the drone may take a slot there: the drone gains enough, or no other drone waits."""
        if not server.is_contended(self._now_s):
            return True
        local_s = self._estimates.mean_call_s()
        return local_s - self._estimates.mean_call_s(server.name) > self._settings.gain_slot * local_s

    def _forecast(self) -> Forecast:
        now_s, here = self._now_s, self._moment.here
        backlog = Counter(call.operation for call in self._lanes.line if not call.needs_server)
        near = {server.name: 0.0 for server in self._table.in_range}
        in_line = [ExpectedCall(operation, 0.0, near) for operation in backlog]
        waiting = [self.made_now(operation) for operation in self.waiting]
        forecast = make_forecast(
            [*in_line, *waiting, *self.mission.coming(here, now_s=now_s, count=self._policy.horizon)],
            self._table.servers,
            self._estimates,
            self._radios.selected,
            now_s=now_s,
            banned_s=dict(self._banned()),
            idle_s=self._settings.idle_s,
        )
        calls = list(forecast.calls)
        if self._lanes.has_line and any(map(self._lanes.usual_wait_s, forecast.checks)):
            for number, call in enumerate(calls):
                offers = [
                    structs.replace(offer, call_s=self._with_wait_s(offer.server, offer.call_s, call.local_s))
                    for offer in call.offers
                ]
                calls[number] = structs.replace(call, offers=offers)
        for number, count in enumerate(backlog.values()):
            calls[number] = calls[number].times(count)
        return replace(forecast, calls=calls)

    def _with_wait_s(self, server: str, call_s: float, local_s: float) -> float:
        """The seconds of a call there with the usual wait for others; a server that gains still gains."""
        wait_s = self._lanes.usual_wait_s(server) if self._lanes.has_line else 0.0
        return call_s if wait_s == 0 or call_s >= local_s else min(call_s + wait_s, _STILL_GAINS * local_s)

    def _banned(self) -> Iterator[tuple[str, float]]:
        now_s = self._now_s
        for server in self._table.blacklisted:
            left_s = server.since_s + server.left_alone_s - now_s
            yield server.name, left_s if self._recovery.probing is None else max(REST_S, left_s)
        for server in self._table.in_range:
            if server.state is State.BLACKLISTED:
                continue
            if not self.is_worth_a_slot(server):
                yield server.name, math.inf
            elif server.is_full(now_s):
                yield server.name, FULL_S
