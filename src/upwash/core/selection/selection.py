"""The drone's machine: events in, commands out (thesis sections 3.2 to 3.4).

It joins the table of servers (servers.py), the roles of radios (radios.py), the choice of a server
(server_planning.py) and the places of calls (call_placement.py).

Laws, beside those of radios.py and recovery.py:
- every change of a state is one of `servers.TRANSITIONS`;
- a server without a slot has not failed: the drone goes on asking there, unless another server is better;
- with probing, a call on the drone also goes to a server that becomes READY before the drone is done;
- a reported exception counts as an answer if the drone's own service raises too, and as a failed call otherwise;
- during the descent no server is selected, unless a call is open or the mission calls again;
- a call that only servers compute waits for one, and has a server wanted until it is over;
- each event ends with a new look at the selection; a decision on a call may leave a server, but selects none;
- the services of a server that was found stopped are started after that look, if the server is still selected;
- commands are carried out in their order.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from msgspec import structs

from upwash.core.geo import Position, Reach
from upwash.core.knowledge.coverage import MeasuredPlace
from upwash.core.knowledge.estimates import Estimates
from upwash.core.knowledge.ranges import AreaIndex
from upwash.core.knowledge.servers import CHECKING, Server, ServerTable, State, Trigger
from upwash.core.operation import Operation
from upwash.core.planning.mission_model import MissionBeliefs, MissionModel
from upwash.core.policies.policy import Choice, Decision, Lightened, Local, Policy, Remote
from upwash.core.selection import events
from upwash.core.selection.call_placement import CallPlacement
from upwash.core.selection.commands import Effect
from upwash.core.selection.events import RadioEvent, SelectionEvent
from upwash.core.selection.mission_times import MissionTimes
from upwash.core.selection.moment import Moment, Part
from upwash.core.selection.radios import Radios
from upwash.core.selection.recovery import Recovery
from upwash.core.selection.server_planning import ServerPlanning
from upwash.core.selection.settings import SelectionSettings
from upwash.eventlog import schema
from upwash.eventlog.schema import MeasuredRecord

_LEAST_QUEUE_S = 1.0  # of a server that did not begin a call, which is not asked again at once
_MOST_TURNS_LOST = 2  # in a row, each at a call: a server that gives turns and no answers has failed


class Selection(Part):
    """Decides for one drone which server is selected, and where its calls run.

    `placement` and `planning` answer for the time and place of the latest call of this class.
    """

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
        table, index = ServerTable(areas, idle_s=settings.idle_s), AreaIndex(list(areas.values()))
        moment = Moment(policy, settings, table, estimates, Recovery(settings.probing))
        super().__init__(moment)
        self.policy, self.estimates, self.lanes = policy, estimates, moment.lanes
        self.two_answers = settings.two_answers
        self.servers: Mapping[str, Server] = table.servers
        self._radios = radios = Radios(moment)
        self.placement = CallPlacement(moment, radios)
        self.planning = planning = ServerPlanning(moment, radios, MissionModel(beliefs, areas, index))
        self._times = MissionTimes(moment, planning, beliefs, MissionModel(beliefs, areas, index))
        self._ended = False
        self._comes_down = False
        self._probed_at: dict[str, MeasuredPlace] = {}  # where the server was last probed in vain

    @property
    def current(self) -> Server | None:
        """The server in use, if any is selected."""
        return self._radios.in_use

    @property
    def _unneeded(self) -> str:
        """Why no call needs a server any more; "" while one may."""
        if self._ended:
            return "mission ended"
        needed = self.planning.under_way is not None or self.planning.waiting
        return "on the way down" if self._comes_down and not needed else ""

    def is_awaited(self, check: int) -> bool:
        """Whether a call may wait for that check; False once the server has refused a slot."""
        server = self._radios.server_of(check)
        return server is not None and server.state in CHECKING and not server.refused

    def locate(self, position: Position, now_s: float) -> None:
        """Note where the drone is now."""
        self._moment.locate(position, now_s)

    def handle(self, event: SelectionEvent, *, now_s: float, position: Position) -> list[Effect]:
        """Take in an event, with the drone at the position; return commands and events of the log in their order."""
        moment, radios, planning = self._moment, self._radios, self.planning
        moment.locate(position, now_s)
        if isinstance(event, events.MissionBegun):
            planning.mission.begun(event.pace)
            self._times.begin(event.vehicle, event.pace)
            return moment.effects
        self._take_in(event)
        radios.end_probes(server for server in radios.probed if self._unneeded or not server.in_range)
        for server, trigger in self._table.expired(now_s, probed=radios.probed):
            moment.step(server, trigger)
        if not moment.effects:  # else the policy decides anyway
            planning.forget_slow_calls()
        if moment.effects or planning.is_due:
            self._select()
            radios.start()
        radios.end_probes(server for server in radios.probed if server.state is not State.BLACKLISTED)
        if not self._unneeded:
            radios.probe()
        return moment.effects

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
            self._comes_down, self._moment.changed = False, True
        lightened = None
        if not self.estimates.needs_server(operation):  # else it was made before
            self.planning.mission.call_begun(operation, now_s=now_s)
            lightened = self._times.judge(operation)
        operation = lightened.operation if lightened else operation
        decision = self.placement.decide(operation, on_drone=on_drone, drone_is_busy=drone_is_busy)
        self.planning.decided(decision, operation)
        if lightened is not None:
            decision = replace(decision, inputs=structs.replace(decision.inputs, lightened=lightened))
        return decision, self._moment.effects

    def fall_back(self, operation: Operation, *, now_s: float, position: Position) -> Lightened | None:
        """The lighter operation of a call that the drone computes after its server failed; None: as asked."""
        if self._settings.lighter is None:
            return None
        self.locate(position, now_s)
        self.planning.mission.call_ends(now_s)
        lightened = self._times.judge(operation, on_drone=True)
        if lightened is not None:
            self.planning.decided(Local("no usable answer"), lightened.operation)
        return lightened

    def decide_after_wait(
        self, operation: Operation, check: int, *, now_s: float, position: Position
    ) -> tuple[Decision, list[Effect]]:
        """Decide where a call runs after its wait for that check; never another Wait."""
        self.locate(position, now_s)
        decision = self.placement.decide_after_wait(operation, check)
        self.planning.decided(decision, operation)
        return decision, self._moment.effects

    def overtake(
        self, operation: Operation, *, began_s: float, now_s: float, position: Position
    ) -> tuple[Remote | None, float]:
        """The server that should also compute a call, which the drone has computed since `began_s`; None without one.

        The second value is the time to ask again if no event comes before.
        """
        self.locate(position, now_s)
        decision, again_s = self.placement.overtake(operation, began_s)
        if decision is not None:
            self.planning.under_way = decision
        return decision, again_s

    # --- what arrives ---------------------------------------------------------------------------------------

    def _take_in(self, event: SelectionEvent) -> None:  # noqa: PLR0912, PLR0915
        """Learn from the event. The policy decides afterwards."""
        moment, planning = self._moment, self.planning
        match event:
            case events.Tick():  # first: by far the most frequent
                return
            case RadioEvent():
                self._hear(event)
                return
            case events.PeerPrepared(name, by):
                server = self.servers[name]
                if server.state in (State.AVL, State.AVL_R):
                    self.estimates.services_started(name)
                    moment.step(server, Trigger.PREPARED, f"by {by}")
                    self._table.meet()
                return
            case events.LegBegun() | events.LegEnded() | events.TargetUnknown():
                planning.mission_goes_on(event)
                return
            case events.DescentBegun():
                planning.mission.lost()
                self._comes_down = True
            case events.NoMoreCalls():
                self._ended = True
            case events.CallWaits() | events.CallOver():
                planning.waits(event)
            case events.LocalCallEnded(operation, delay_s, asked):
                self.estimates.observe_local(operation, delay_s, asked=asked)
                planning.answered()
            case events.PartFailed(service):
                self.estimates.part_failed(service)
            case events.RemoteCallEnded(name, operation, delay_s, late, less, queued_s, queue_s):
                self.lanes.waited(name, queued_s)
                if self.lanes.has_line:  # else the next call comes much later, and has the usual wait too
                    self.lanes.queue(name, queue_s, moment.now_s)
                    delay_s -= queued_s
                self._learn_remote(name, operation, delay_s, late=late, less=less)
                if not late:
                    if not self.estimates.needs_server(operation):
                        planning.answered()
                    self._radios.prefer(self.servers[name], "it answered first")
            case events.RemoteCallCut(name, operation, waited_s, less):
                self.estimates.observe_remote_cut(name, operation, waited_s, now_s=moment.now_s, less=less)
            case events.RemoteCallQueued(name, why, waited_s, queue_s, late):
                self.lanes.queue(name, max(queue_s, _LEAST_QUEUE_S), moment.now_s)
                if self.lanes.has_line:
                    self.lanes.waited(name, waited_s + queue_s)
                self._recovery.trials.discard(name)
                if not late:
                    planning.under_way = Local(why)
            case events.RemoteCallFailed(name, check, why, late):
                if not late:
                    planning.under_way = Local(why)
                self._call_failed(name, check, why)
            case events.RemoteCallRaised(_, why):
                planning.under_way = Local(why)
            case events.RemoteFaultTested(name, check, operation, delay_s, why, confirmed, less):
                if confirmed:
                    self._learn_remote(name, operation, delay_s, late=True, less=less)
                else:
                    self._call_failed(name, check, why)
            case events.Reached():
                self._reached(event)
        moment.changed = True

    def _hear(self, event: RadioEvent) -> None:
        """Take in what is reported of a server; it concerns the mission only once the server changes its state."""
        moment, server = self._moment, self._radios.server_of(event.check)
        if server is None:  # it was left since
            return
        if server in self._radios.probed:
            self._hear_of_probe(server, event)
            return
        is_checked, is_ready = server.state in CHECKING, server.state is State.READY
        match event:
            case events.CheckAnswered():
                self._check_answered(server, event)
            case events.ServicesStarted() if is_checked:
                self._ready(server, Trigger.STARTED)
            case events.SlotRefused(check, waiting) if is_checked:
                server.full_s = server.contended_s = moment.now_s
                if not server.refused:
                    server.refused = True
                    moment.effects.append(schema.NoSlot(server=server.name, check=check, waiting=waiting))
            case events.LeaseRenewed(_, waiting) if is_ready:
                server.contended_s = moment.now_s if waiting else -math.inf
                moment.changed = True
            case events.SlotTaken() if is_ready:
                self._turn_over(server, event)
            case events.ServerUnusable(_, why, unreached, pause_s):
                if unreached:
                    self._asked(server, answered=False)
                if is_checked:
                    self._server_failed(server, Trigger.CHECK_FAILED, why, pause_s)
            case events.NetworkGone(_, why):
                self._asked(server, answered=False)
                self._server_failed(server, Trigger.NETWORK_LOST, why)

    def _hear_of_probe(self, server: Server, event: RadioEvent) -> None:
        match event:
            case events.ProbeAnswered(_, running):
                trigger = Trigger.PROBED_RUNNING if running else Trigger.PROBED
                self._moment.step(server, trigger, "it gives a sign of life")
            case events.ProbeUnanswered():
                self._asked(server, answered=False, once=True)
            case events.ServerUnusable(_, why, _, pause_s):
                self._radios.pause(server, pause_s, why)

    def _check_answered(self, server: Server, answer: events.CheckAnswered) -> None:
        self._asked(server, answered=True)
        if server.state not in CHECKING:
            return
        server.peers = frozenset(answer.peers) & self.servers.keys()
        server.full_s, server.contended_s = -math.inf, self._now_s if answer.waiting else -math.inf
        self._moment.changed = True
        if answer.running:
            self._ready(server, Trigger.FOUND_RUNNING)
            return
        server.found_stopped = True
        if server.state is State.CHECK_R:
            self._moment.step(server, Trigger.FOUND_STOPPED)

    def _turn_over(self, server: Server, event: events.SlotTaken) -> None:
        if event.in_call:
            if self.planning.under_way is not None:
                self.planning.under_way = Local(event.why)
            self._recovery.trials.discard(server.name)
            server.turns_lost += 1
        if not server.in_range:
            self._radios.leave(server, "out of range")
        elif server.turns_lost > _MOST_TURNS_LOST:
            self._call_failed(server.name, event.check, event.why)
        else:
            self._radios.ask_again(server, event.why)

    def _ready(self, server: Server, trigger: Trigger) -> None:
        self._moment.step(server, trigger)
        started = server.start_requested
        if started:
            self.estimates.services_started(server.name)
        # An announced start, a check without a join and a wait for a slot teach nothing.
        since_s = server.checked_since_s
        announced = started and self.planning.prewarm.has_announced(server.name, at_s=since_s)
        if not announced and not server.joined_before and not server.refused:
            self.estimates.observe_check(server.name, self._now_s - since_s, started=started)

    def _server_failed(self, server: Server, trigger: Trigger, why: str, pause_s: float = 0.0) -> None:
        if server.in_range:
            self._radios.fail(server, trigger, why, pause_s=pause_s)
        else:  # the server did nothing wrong
            self._radios.leave(server, "out of range")

    def _call_failed(self, name: str, check: int, why: str) -> None:
        self._recovery.trials.discard(name)
        server = self._radios.ready(name, check)
        if server is not None:
            in_range = server.in_range
            trigger = Trigger.CALL_FAILED_IN_RANGE if in_range else Trigger.CALL_FAILED_OUT_OF_RANGE
            self._radios.fail(server, trigger, why)

    def _learn_remote(
        self, name: str, operation: Operation, delay_s: float, *, late: bool, less: bool
    ) -> None:
        needs_server, now_s = self.estimates.needs_server(operation), self._now_s
        local_s = math.inf if needs_server else self.estimates.local_s(operation) or 0.0
        self._recovery.answered(name, operation, delay_s, local_s=local_s, now_s=now_s)
        self.servers[name].turns_lost = 0
        self.estimates.observe_remote(name, operation, delay_s, now_s=now_s, late=late, less=less)

    def _asked(self, server: Server, *, answered: bool, once: bool = False) -> None:
        """Record whether the server answers here. With `once`, several failures at one place count as one."""
        coverage, here = self.estimates.coverage, self._moment.here
        if coverage is None or server.name not in coverage.servers:
            return
        known = coverage.at(server.name, here)
        if once and known is not None and known is self._probed_at.get(server.name):
            return
        place = coverage.asked(server.name, here, answered=answered)
        if once:
            self._probed_at[server.name] = place
            self._moment.changed = True
        self._moment.effects.append(schema.PlaceMeasured(server=server.name, place=MeasuredRecord.of(place)))

    def _reached(self, event: events.Reached) -> None:
        """Record the delay of the call at its place; a failed call counts the drone's own computing too."""
        coverage = self.estimates.coverage
        if coverage is None:
            return
        place = coverage.asked(event.server, event.position, answered=event.answered)
        came_to_s = event.delay_s
        if event.answered:
            place.carry(event.size_bytes, event.delay_s)
        else:
            came_to_s += self.estimates.local_s(event.operation) or 0.0
        if event.less:
            came_to_s = self.estimates.as_whole_s(event.server, event.operation, came_to_s)
        place.note(event.operation, came_to_s)
        self._moment.effects.append(schema.PlaceMeasured(server=event.server, place=MeasuredRecord.of(place)))

    # --- which server now? ----------------------------------------------------------------------------------

    def _select(self) -> None:
        radios, planning = self._radios, self.planning
        self._moment.changed, radios.put_off_until_s = False, math.inf
        choice = Choice(None, self._unneeded) if self._unneeded else planning.choose()
        for server in [server for server in radios.selected if not server.in_range]:
            radios.leave(server, "out of range")
        if choice.server is None:
            for server in list(radios.selected):
                radios.leave(server, choice.why)
        else:
            self._use(self.servers[choice.server], choice)
        planning.prewarm.announce(choice.coming)

    def _use(self, chosen: Server, choice: Choice) -> None:
        """Use the chosen server, and prepare another where a radio is free for it."""
        radios, with_second = self._radios, self._settings.with_second
        if with_second:
            radios.prefer(chosen, choice.why)
        if (current := radios.in_use) is not chosen:
            mean_call_s = self.estimates.mean_call_s
            keep = (  # the server in use, which saves time until the chosen one is READY
                current is not None
                and mean_call_s(current.name) < mean_call_s()
                and self.planning.is_worth_a_slot(current)
            )
            radios.use(chosen, choice.why, keep=keep)
        elif choice.coming is not None and self.servers[choice.coming.server].in_range:
            radios.prepare(self.servers[choice.coming.server], "comes next")
        elif with_second and len(radios.selected) == 1:
            beside = self.planning.beside(chosen)
            if beside is not None:
                radios.prepare(beside, f"for calls that {chosen.name} answers late")
