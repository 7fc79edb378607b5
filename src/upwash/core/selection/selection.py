"""The drone's machine: events in, commands out (thesis sections 3.2 to 3.4).

It joins the table of servers (servers.py), the roles of radios (radios.py), the choice of a server
(server_planning.py) and the places of calls (call_placement.py).

Laws:
- every change of a state is one of `servers.TRANSITIONS`; no more servers are selected than there are radios;
- the first selected server is in use: all remote calls go there; a second is in preparation, and follows it;
- a check is known by its number; what arrives for an old check changes nothing;
- a failed server is left alone for a fixed time, or probed if a radio is free (recovery.py);
- a server without a slot has not failed: the drone goes on asking there, unless another server is better;
- with probing, a call on the drone also goes to a server that becomes READY before the drone is done;
- a reported exception counts as an answer if the drone's own service raises too, and as a failed call otherwise;
- during the descent no server is selected, unless a call is open or the mission calls again;
- a call that only servers compute waits for one, and has a server wanted until it is over;
- each event ends with a new look at the selection; a decision on a call may leave a server, but selects none;
- the services of a server that was found stopped are started after that look, if the server is still selected;
- no more than four servers are selected within one second;
- commands are carried out in their order; with one radio a server is selected after the former is left.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from msgspec import structs

from upwash.core.geo import Position, Reach
from upwash.core.knowledge.coverage import MeasuredPlace
from upwash.core.knowledge.estimates import Estimates
from upwash.core.knowledge.ranges import AreaIndex
from upwash.core.knowledge.servers import CHECKING, SELECTED, Change, Server, ServerTable, State, Trigger
from upwash.core.operation import Operation
from upwash.core.planning.mission_model import MissionBeliefs, MissionModel
from upwash.core.policies.policy import Choice, Decision, Lightened, Local, Policy, Remote
from upwash.core.selection import events
from upwash.core.selection.call_placement import CallPlacement
from upwash.core.selection.commands import Effect, Move
from upwash.core.selection.events import SelectionEvent
from upwash.core.selection.lanes import Lanes
from upwash.core.selection.mission_times import Lighter, Timetable
from upwash.core.selection.radios import Radios
from upwash.core.selection.recovery import Recovery
from upwash.core.selection.server_planning import ServerPlanning
from upwash.core.selection.settings import SelectionSettings
from upwash.eventlog import schema
from upwash.eventlog.schema import Event, MeasuredRecord

_READY = frozenset({State.READY})
_LEAST_QUEUE_S = 1.0  # of a server that did not begin a call, which is not asked again at once
_MOST_TURNS_LOST = 2  # in a row, each at a call: a server that gives turns and no answers has failed


class Selection:
    """Decides for one drone which server is selected, and where its calls run."""

    def __init__(
        self,
        areas: Mapping[str, Reach],
        *,
        estimates: Estimates,
        policy: Policy,
        settings: SelectionSettings | None = None,
        mission: MissionBeliefs | None = None,
    ) -> None:
        settings, beliefs = settings or SelectionSettings(), mission or MissionBeliefs()
        self._settings = settings
        index = AreaIndex(list(areas.values()))
        self.estimates = estimates
        self.policy = policy
        self._recovery = recovery = Recovery(settings.probing) if settings.probing else None
        self._table = table = ServerTable(areas, idle_s=settings.idle_s)
        self.servers: Mapping[str, Server] = table.servers
        self._radios = radios = Radios(settings, table, estimates, recovery)
        self.lanes = Lanes()
        self.two_answers = settings.two_answers
        self.placement = CallPlacement(policy, radios, estimates, recovery, self.lanes, settings.two_answers)
        model = MissionModel(beliefs, areas, index)
        self.planning = planning = ServerPlanning(
            policy, settings, table, radios, estimates, recovery, self.lanes, mission=model
        )
        # A model of its own: it sees the whole mission, from the ground.
        self._timetable = Timetable(planning, beliefs, MissionModel(beliefs, areas, index), settings)
        self._lighter = Lighter(settings.lighter, planning) if settings.lighter else None
        self._ended = False
        self._comes_down = False
        self._probed_at: dict[str, MeasuredPlace] = {}  # where the server was last probed in vain

    @property
    def current(self) -> Server | None:
        """The server in use, if any is selected."""
        return self._radios.in_use

    @property
    def in_range(self) -> Sequence[Server]:
        """The servers in range at the last position."""
        return self._table.in_range

    @property
    def overtakes(self) -> bool:
        """Whether calls that run on the drone may be sent to a server too."""
        return self._recovery is not None

    @property
    def _unneeded(self) -> str:
        """Why no call needs a server any more; "" while one may."""
        if self._ended:
            return "mission ended"
        needed = self.planning.under_way is not None or self.planning.waiting
        return "on the way down" if self._comes_down and not needed else ""

    def is_awaited(self, check: int) -> bool:
        """Whether a call may wait for that check; False once the server has refused a slot."""
        server = self._radios.selected_by(check, CHECKING)
        return server is not None and not server.refused

    def handle(self, event: SelectionEvent, *, now_s: float, position: Position) -> list[Effect]:
        """Take in an event, with the drone at the position; return commands and events of the log in their order."""
        table, radios, planning = self._table, self._radios, self.planning
        if isinstance(event, events.MissionBegun):
            planning.mission.begun(event.pace)
            foreseen = self._timetable.begin(event.vehicle, event.pace, now_s=now_s, position=position)
            if self._lighter is not None:
                self._lighter.begun_s, self._lighter.home_s = now_s, self._timetable.after_s
            return [foreseen] if foreseen else []
        self.locate(position, now_s)
        effects = self._take_in(event, now_s, position)
        effects += radios.end_probes(
            [server for server in radios.probed if self._unneeded or not server.in_range]
        )
        effects += table.expire(now_s, probed=radios.probed)
        if not effects:  # else the policy decides anyway
            planning.forget_slow_calls(now_s)
        if effects or planning.is_due(now_s):
            effects += self._select(now_s, position)
            effects += radios.start()
        effects += radios.end_probes(
            [server for server in radios.probed if server.state is not State.BLACKLISTED]
        )
        if not self._unneeded:
            effects += radios.probe(now_s)
        return self._told(effects, position)

    def _told(self, effects: Sequence[Move], position: Position) -> list[Effect]:
        """The effects, with each change as the log has it: with the mean delays that are expected at this moment."""
        return [self._step(effect, position) if isinstance(effect, Change) else effect for effect in effects]

    def _step(self, change: Change, position: Position) -> Event:
        estimates = self.estimates
        return schema.STEPS[change.event](
            server=change.server,
            before=change.before,
            after=change.after,
            why=change.why,
            check=change.check,
            local_mean_call_s=estimates.mean_call_s(),
            mean_call_s={server.name: estimates.mean_call_s(server.name) for server in self.in_range},
            position=position,
        )

    def next_look_s(self, *, now_s: float) -> float:
        """The time before which a `Tick` changes nothing, unless an event or a crossed border comes first."""
        if self.estimates.coverage is not None or self._table.ranges.is_on_border:
            return now_s  # what is known of a server changes with the place, or a border is crossed unseen
        return min(self.planning.next_look_s(now_s), self._table.next_expiry_s(probed=self._radios.probed))

    def decide(
        self,
        operation: Operation,
        *,
        now_s: float,
        position: Position,
        on_drone: bool = False,
        drone_is_busy: bool = False,
    ) -> tuple[Decision, list[Effect]]:
        """Decide where a call made now runs; `inputs.lightened` of the decision is set if it runs lighter.

        With `on_drone` the drone takes the call out of the line.
        """
        self.locate(position, now_s)
        if self._comes_down:
            self._comes_down, self.planning.changed = False, True
        lightened = None
        if not self.estimates.needs_server(operation):  # else it was made before
            self.planning.mission.call_begun(operation, now_s=now_s)
            if self._lighter is not None:
                lightened = self._lighter.judge(operation, now_s=now_s, position=position)
        operation = lightened.operation if lightened else operation
        decision, effects = self.placement.decide(
            operation, now_s, on_drone=on_drone, drone_is_busy=drone_is_busy
        )
        self.planning.decided(decision, operation, now_s)
        if lightened is not None:
            decision = replace(decision, inputs=structs.replace(decision.inputs, lightened=lightened))
        return decision, self._told(effects, position)

    def fall_back(self, operation: Operation, *, now_s: float, position: Position) -> Lightened | None:
        """The lighter operation of a call that the drone computes after its server failed; None: as asked."""
        if self._lighter is None:
            return None
        self.planning.mission.call_ends(now_s)
        lightened = self._lighter.judge(operation, now_s=now_s, position=position, on_drone=True)
        if lightened is not None:
            self.planning.decided(Local("no usable answer"), lightened.operation, now_s)
        return lightened

    def decide_after_wait(
        self, operation: Operation, check: int, *, now_s: float, position: Position
    ) -> tuple[Decision, list[Effect]]:
        """Decide where a call runs after its wait for that check; never another Wait."""
        self.locate(position, now_s)
        decision, effects = self.placement.decide_after_wait(operation, check, now_s)
        self.planning.decided(decision, operation, now_s)
        return decision, self._told(effects, position)

    def overtake(
        self, operation: Operation, *, began_s: float, now_s: float, position: Position
    ) -> tuple[Remote | None, float]:
        """The server that should also compute a call, which the drone has computed since `began_s`; None without one.

        The second value is the time to ask again if no event comes before.
        """
        self.locate(position, now_s)
        decision, again_s = self.placement.overtake(operation, began_s, now_s)
        if decision is not None:
            self.planning.under_way = decision
        return decision, again_s

    def locate(self, position: Position, now_s: float) -> None:
        """Note where the drone is now."""
        if self._table.locate(position, now_s) | self.estimates.locate(position):
            self.planning.changed = True

    # --- what arrives ---------------------------------------------------------------------------------------

    def _take_in(self, event: SelectionEvent, now_s: float, position: Position) -> list[Move]:  # noqa: PLR0912, PLR0915
        """Learn from the event; return its own effects. The policy decides afterwards."""
        match event:
            # What the radios report concerns the mission only once a server changes its state.
            case events.Tick():  # first: by far the most frequent
                return []
            case events.CheckAnswered(check):
                return self._asked(check, position, answered=True) + self._check_answered(event, now_s)
            case events.ServicesStarted(check):
                server = self._radios.selected_by(check, CHECKING)
                return [self._ready(server, Trigger.STARTED, now_s)] if server else []
            case events.SlotRefused(check, waiting):
                return self._slot_refused(check, waiting, now_s)
            case events.LeaseRenewed(check, waiting):
                server = self._radios.selected_by(check, _READY)
                if server is None:
                    return []
                server.contended_s = now_s if waiting else -math.inf
            case events.SlotTaken():
                return self._turn_over(event, now_s)
            case events.ServerUnusable(check, why, unreached, pause_s):
                asked = self._asked(check, position, answered=False) if unreached else []
                return asked + self._server_failed(
                    check, CHECKING, Trigger.CHECK_FAILED, why, now_s, pause_s=pause_s
                )
            case events.NetworkGone(check, why):
                asked = self._asked(check, position, answered=False)
                return asked + self._server_failed(check, SELECTED, Trigger.NETWORK_LOST, why, now_s)
            case events.ProbeAnswered() | events.ProbePaused():
                return self._probe_answered(event, now_s)
            case events.ProbeUnanswered(check):
                return self._probed_in_vain(check, position)
            case events.PeerPrepared(name, by):
                return self._prepared(self.servers[name], by, now_s)
            case events.LegBegun() | events.LegEnded() | events.TargetUnknown():
                self.planning.mission_goes_on(event, position, now_s)
                return []
            case events.DescentBegun():
                self.planning.mission.lost()
                self._comes_down = True
            case events.NoMoreCalls():
                self._ended = True
            case events.CallWaits() | events.CallOver():
                self.planning.waits(event, now_s)
            case events.LocalCallEnded(operation, delay_s, asked):
                self.estimates.observe_local(operation, delay_s, asked=asked)
                self.planning.answered(now_s)
            case events.PartFailed(service):
                self.estimates.part_failed(service)
            case events.RemoteCallEnded(name, operation, delay_s, late, less, queued_s, queue_s):
                self.lanes.waited(name, queued_s)
                if self.lanes.has_line:  # else the next call comes much later, and has the usual wait too
                    self.lanes.queue(name, queue_s, now_s)
                    delay_s -= queued_s
                self._learn_remote(name, operation, delay_s, now_s, late=late, less=less)
                if not late and not self.estimates.needs_server(operation):
                    self.planning.answered(now_s)
                self.planning.changed = True
                return [] if late else self._radios.prefer(self.servers[name], "it answered first")
            case events.RemoteCallCut(name, operation, waited_s, less):
                self.estimates.observe_remote_cut(name, operation, waited_s, now_s=now_s, less=less)
            case events.RemoteCallQueued(name, why, waited_s, queue_s, late):
                self.lanes.queue(name, max(queue_s, _LEAST_QUEUE_S), now_s)
                if self.lanes.has_line:
                    self.lanes.waited(name, waited_s + queue_s)
                if self._recovery is not None:
                    self._recovery.trial_over(name)
                if not late:
                    self.planning.under_way = Local(why)
            case events.RemoteCallFailed(name, check, why, late):
                self.planning.changed = True
                if not late:
                    self.planning.under_way = Local(why)
                return self._call_failed(name, check, why, now_s)
            case events.RemoteCallRaised(_, why):
                self.planning.under_way = Local(why)
            case events.RemoteFaultTested(name, check, operation, delay_s, why, confirmed, less):
                self.planning.changed = True
                if not confirmed:
                    return self._call_failed(name, check, why, now_s)
                self._learn_remote(name, operation, delay_s, now_s, late=True, less=less)
            case events.Reached():
                self.planning.changed = True
                return self._reached(event)
        self.planning.changed = True
        return []

    def _check_answered(self, answer: events.CheckAnswered, now_s: float) -> list[Move]:
        server = self._radios.selected_by(answer.check, CHECKING)
        if server is None:
            return []
        server.peers = frozenset(answer.peers) & self.servers.keys()
        server.full_s, server.contended_s = -math.inf, now_s if answer.waiting else -math.inf
        self.planning.changed = True
        if answer.running:
            return [self._ready(server, Trigger.FOUND_RUNNING, now_s)]
        server.found_stopped = True
        return [server.apply(Trigger.FOUND_STOPPED, now_s=now_s)] if server.state is State.CHECK_R else []

    def _slot_refused(self, check: int, waiting: int, now_s: float) -> list[Move]:
        server = self._radios.selected_by(check, CHECKING)
        if server is None:
            return []
        is_news, server.refused = not server.refused, True
        server.full_s = server.contended_s = now_s
        return [schema.NoSlot(server=server.name, check=check, waiting=waiting)] if is_news else []

    def _turn_over(self, event: events.SlotTaken, now_s: float) -> list[Move]:
        server = self._radios.selected_by(event.check, _READY)
        if server is None:  # it was left since
            return []
        if event.in_call:
            if self.planning.under_way is not None:
                self.planning.under_way = Local(event.why)
            if self._recovery is not None:
                self._recovery.trial_over(server.name)
            server.turns_lost += 1
        if not server.in_range:
            return self._radios.leave(server, "out of range", now_s)
        if server.turns_lost > _MOST_TURNS_LOST:
            return self._call_failed(server.name, event.check, event.why, now_s)
        return self._radios.ask_again(server, event.why, now_s)

    def _probe_answered(self, answer: events.ProbeAnswered | events.ProbePaused, now_s: float) -> list[Move]:
        server = self._radios.probed_by(answer.check)
        if server is None:
            return []
        if isinstance(answer, events.ProbePaused):
            return [
                _left_out(server, answer.pause_s, answer.why),
                *self._radios.leave_out(server, answer.pause_s, now_s),
            ]
        trigger = Trigger.PROBED_RUNNING if answer.running else Trigger.PROBED
        return [server.apply(trigger, now_s=now_s, why="it gives a sign of life")]

    def _ready(self, server: Server, trigger: Trigger, now_s: float) -> Change:
        change = server.apply(trigger, now_s=now_s)
        if server.start_requested:
            self.estimates.services_started(server.name)
        # An announced start, a check without a join and a wait for a slot teach nothing.
        announced = server.start_requested and self.planning.was_announced(server)
        if not announced and not server.joined_before and not server.refused:
            self.estimates.observe_check(
                server.name, now_s - server.checked_since_s, started=server.start_requested
            )
        return change

    def _prepared(self, server: Server, by: str, now_s: float) -> list[Move]:
        if server.state not in (State.AVL, State.AVL_R):
            return []
        self.estimates.services_started(server.name)
        change = server.apply(Trigger.PREPARED, now_s=now_s, why=f"by {by}")
        self._table.meet()
        return [change]

    def _server_failed(
        self,
        check: int,
        states: frozenset[State],
        trigger: Trigger,
        why: str,
        now_s: float,
        *,
        pause_s: float = 0.0,
    ) -> list[Move]:
        server = self._radios.selected_by(check, states)
        if server is None:
            return []
        if not server.in_range:  # the server did nothing wrong
            return self._radios.leave(server, "out of range", now_s)
        paused = [_left_out(server, pause_s, why)] if pause_s else []
        return paused + self._radios.fail(
            server, trigger, why, now_s, operations=self.estimates.operations, pause_s=pause_s
        )

    def _call_failed(self, name: str, check: int, why: str, now_s: float) -> list[Move]:
        if self._recovery is not None:
            self._recovery.trial_over(name)
        server = self._radios.selected_by(check, _READY)
        if server is None or server.name != name:  # it was left since
            return []
        trigger = Trigger.CALL_FAILED_IN_RANGE if server.in_range else Trigger.CALL_FAILED_OUT_OF_RANGE
        return self._radios.fail(server, trigger, why, now_s, operations=self.estimates.operations)

    def _learn_remote(
        self,
        name: str,
        operation: Operation,
        delay_s: float,
        now_s: float,
        *,
        late: bool,
        less: bool = False,
    ) -> None:
        if self._recovery is not None:
            needs_server = self.estimates.needs_server(operation)
            local_s = math.inf if needs_server else self.estimates.local_s(operation) or 0.0
            self._recovery.answered(name, operation, delay_s, local_s=local_s, now_s=now_s)
        self.servers[name].turns_lost = 0
        self.estimates.observe_remote(name, operation, delay_s, now_s=now_s, late=late, less=less)

    def _probed_in_vain(self, check: int, position: Position) -> list[Move]:
        """Record a probe without an answer, once for each place."""
        server, coverage = self._radios.probed_by(check), self.estimates.coverage
        if server is None or coverage is None or server.name not in coverage.servers:
            return []
        here = coverage.at(server.name, position)
        if here is not None and here is self._probed_at.get(server.name):
            return []
        place = coverage.asked(server.name, position, answered=False)
        self._probed_at[server.name] = place
        self.planning.changed = True
        return [_measured(server.name, place)]

    def _asked(self, check: int, position: Position, *, answered: bool) -> list[Move]:
        server, coverage = self._radios.selected_by(check), self.estimates.coverage
        if server is None or coverage is None or server.name not in coverage.servers:
            return []
        return [_measured(server.name, coverage.asked(server.name, position, answered=answered))]

    def _reached(self, event: events.Reached) -> list[Move]:
        """Record the delay of the call at its place; a failed call counts the drone's own computing too."""
        coverage = self.estimates.coverage
        if coverage is None:
            return []
        place = coverage.asked(event.server, event.position, answered=event.answered)
        came_to_s = event.delay_s
        if event.answered:
            place.carry(event.size_bytes, event.delay_s)
        else:
            came_to_s += self.estimates.local_s(event.operation) or 0.0
        if event.less:
            came_to_s = self.estimates.as_whole_s(event.server, event.operation, came_to_s)
        place.note(event.operation, came_to_s)
        return [_measured(event.server, place)]

    # --- which server now? ----------------------------------------------------------------------------------

    def _select(self, now_s: float, position: Position) -> list[Move]:
        radios, planning = self._radios, self.planning
        planning.changed, radios.put_off_until_s = False, math.inf
        choice = Choice(None, self._unneeded) if self._unneeded else planning.choose(now_s, position)
        effects: list[Move] = []
        for server in [server for server in radios.selected if not server.in_range]:
            effects += radios.leave(server, "out of range", now_s)
        if choice.server is None:
            for server in list(radios.selected):
                effects += radios.leave(server, choice.why, now_s)
            return effects + planning.announce(choice.coming, now_s)
        chosen = self.servers[choice.server]
        if self._settings.with_second:
            effects += radios.prefer(chosen, choice.why)
        if chosen is not radios.in_use:
            keep = self._is_worth_keeping(radios.in_use, now_s)
            effects += radios.use(chosen, choice.why, now_s, keep=keep)
        elif choice.coming is not None and self.servers[choice.coming.server].in_range:
            effects += radios.prepare(self.servers[choice.coming.server], "comes next", now_s)
        elif (
            self._settings.with_second
            and len(radios.selected) == 1
            and (beside := planning.beside(chosen, now_s)) is not None
        ):
            effects += radios.prepare(beside, f"for calls that {chosen.name} answers late", now_s)
        effects += planning.announce(choice.coming, now_s)
        return effects

    def _is_worth_keeping(self, server: Server | None, now_s: float) -> bool:
        """Whether the server in use still saves time, so that it serves until the next one is READY."""
        return (
            server is not None
            and self.estimates.mean_call_s(server.name) < self.estimates.mean_call_s()
            and self.planning.is_worth_a_slot(server, now_s)
        )


def _left_out(server: Server, pause_s: float, why: str) -> Event:
    return schema.LeftOut(server=server.name, check=server.check, pause_s=pause_s, why=why)


def _measured(server: str, place: MeasuredPlace) -> Event:
    return schema.PlaceMeasured(server=server, place=MeasuredRecord.of(place))
