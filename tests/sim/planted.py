"""Defects planted in the programs, to see that the promises' checks find them.

    python -m tests.sim.planted        flies worlds with each until a promise is broken; prints a table

A defect is found where its worlds break a promise; without it they break none.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import logging
import math
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from importlib import import_module
from typing import Any
from unittest.mock import patch

import msgspec
from msgspec.structs import replace
from tests.sim import planted_vehicle as vehicle

from upwash.config import DroneConfig
from upwash.core.admission.admission import AdmissionController
from upwash.core.admission.clients import Client
from upwash.core.admission.instances import StartInstance
from upwash.core.admission.leases import Admit, Leases
from upwash.core.admission.peers import Peers
from upwash.core.admission.server import Command as AdmissionCommand
from upwash.core.admission.turns import Turns
from upwash.core.admission.watchdog import InstanceFailures as DaemonFailures
from upwash.core.admission.watchdog import Limit, Watch
from upwash.core.geo import Position, Waypoint
from upwash.core.knowledge.estimates import Estimates
from upwash.core.knowledge.servers import Server, ServerTable, State, Trigger
from upwash.core.planning.stay_or_go import Outlook, StayRule, StayVerdict
from upwash.core.policies.policy import CallInputs, Deadline, Decision, Remote, Wait, WaitRule
from upwash.core.selection.hedging import Hedging
from upwash.core.selection.radios import Radios
from upwash.core.selection.recovery import Probing, Recovery, ServerFailures
from upwash.drone.api import position_of
from upwash.drone.calling import Calling, Racing
from upwash.drone.decisions import Background, Decisions
from upwash.drone.pending import AnswerAction
from upwash.drone.resumption import waypoints_done
from upwash.drone.server_session import ServerSession
from upwash.errors import GarbledReply, LinkError, Refused, ServerFull
from upwash.eventlog import schema
from upwash.eventlog.schema import Event
from upwash.lab.faults import campaign as chaos
from upwash.lab.faults.display import is_replayed
from upwash.lab.faults.mission import Blurred
from upwash.lab.faults.promises import Broken
from upwash.rpc import protocol
from upwash.rpc.service import Method
from upwash.sim.journal import MemoryJournal

MOST_SEEDS = 3_000
_TINY_LEASE_S = 0.003  # for whatever is none: with less, virtual time would hardly go on
_LONG_LEASE_S = 1e5


@dataclass(frozen=True, slots=True)
class Defect:
    """What is wrong, and how it is put into the programs for a while."""

    what: str
    plant: Callable[[], contextlib.AbstractContextManager[object]]


def first_broken(defect: Defect) -> list[Broken]:
    """The promises that the planted defect breaks in the first world where it breaks any."""
    logging.getLogger("upwash.server").disabled = True
    with defect.plant(), _nothing_remembered():
        for seed in range(1, MOST_SEEDS + 1):
            if broken := chaos.judge(seed, replay=is_replayed(seed)).broken:
                return broken
    return []


@contextlib.contextmanager
def _nothing_remembered() -> Iterator[None]:
    """A flight from before a defect was planted is not one with it."""
    chaos._fly_calm.cache_clear()
    try:
        yield
    finally:
        chaos._fly_calm.cache_clear()


# --- the defects --------------------------------------------------------------------------------------------


def wait_without_bound() -> contextlib.AbstractContextManager[object]:
    decide = WaitRule.decide

    def patient(self: WaitRule, call: CallInputs) -> Decision:
        decision = decide(self, call)
        return Wait(decision.server, 1e3, decision.why) if isinstance(decision, Wait) else decision

    return patch.object(WaitRule, "decide", patient)


def wait_not_watched() -> contextlib.AbstractContextManager[object]:
    """The decision says how long, and the program waits longer."""
    wait = Decisions.wait

    async def patient(self: Decisions, operation: Any, decision: Wait) -> Decision:
        return await wait(self, operation, Wait(decision.server, decision.at_most_s * 3 + 1, decision.why))

    return patch.object(Decisions, "wait", patient)


def deadline_ignored() -> contextlib.AbstractContextManager[object]:
    call = ServerSession.call

    async def stubborn(
        self: ServerSession, service: str, method: str, request: bytes, *, deadline_s: float
    ) -> bytes:
        return await call(self, service, method, request, deadline_s=10 * deadline_s)

    return patch.object(ServerSession, "call", stubborn)


def deadline_of_the_wrong_estimate() -> contextlib.AbstractContextManager[object]:
    def seconds(self: Deadline, *, local_s: float, remote_s: float, is_first: bool) -> float:
        return max(self.least_s, self.factor * remote_s)

    return patch.object(Deadline, "seconds", seconds)


def every_call_the_first() -> contextlib.AbstractContextManager[object]:
    """The drone is patient with each call."""
    return patch.object(Estimates, "is_first_call", lambda *_: True)


def late_reply_delivered() -> contextlib.AbstractContextManager[object]:
    """What comes after the deadline answers the next call."""
    call, late = ServerSession.call, dict[tuple[int, str], bytes]()

    async def confused(
        self: ServerSession, service: str, method: str, request: bytes, *, deadline_s: float
    ) -> bytes:
        if (old := late.pop((id(self), method), None)) is not None:
            return old
        reply = await call(self, service, method, request, deadline_s=deadline_s)
        late[id(self), method] = reply
        return reply

    return patch.object(ServerSession, "call", confused)


def duplicate_result() -> contextlib.AbstractContextManager[object]:
    """A call that fell back is reported twice."""
    record = MemoryJournal.record

    def twice(self: MemoryJournal, event: Event) -> None:
        record(self, event)
        if isinstance(event, schema.Call) and event.fell_back:
            record(self, event)

    return patch.object(MemoryJournal, "record", twice)


def own_exception_swallowed() -> contextlib.AbstractContextManager[object]:
    """The mission gets another exception than the one that the service raised."""
    result = Method.result

    def bland(self: Method, decoded: Any) -> object:
        try:
            return result(self, decoded)
        except (Blurred, ValueError) as error:
            raise ValueError(str(error)) from None

    return patch.object(Method, "result", bland)


def remote_exception_believed() -> contextlib.AbstractContextManager[object]:
    """What a server says that the service raised reaches the mission."""
    return patch.object(Method, "raised", lambda *_: "")


def network_error_raised() -> contextlib.AbstractContextManager[object]:
    async def raising(_: Calling, attempt: Any) -> Any:
        operation, method = attempt.call.operation, attempt.call.method
        return method.decode(
            await attempt.session.call(
                operation.service, operation.method, attempt.call.request, deadline_s=attempt.deadline_s
            )
        )

    return patch.object(Calling, "at_server", raising)


def blacklist_ignored() -> contextlib.AbstractContextManager[object]:
    """A server that failed is as good as any other."""
    expire = ServerTable.expire

    def forgiving(self: ServerTable, now_s: float, *, probed: Any) -> Any:
        left_alone_s = max(server.left_alone_s for server in self.servers.values())
        return expire(self, now_s + left_alone_s * 0.9, probed=probed)

    return patch.object(ServerTable, "expire", forgiving)


def blacklisted_is_asked() -> contextlib.AbstractContextManager[object]:
    """The lease of a server that was given up is kept."""
    end = ServerSession.end

    async def clinging(self: ServerSession, *, in_range: bool) -> bool:
        if in_range:
            await self._quiet.wait()
            with contextlib.suppress(LinkError, Refused, AssertionError):
                await asyncio.sleep(0.2)
                await self._availability()
        return await end(self, in_range=in_range)

    return patch.object(ServerSession, "end", clinging)


def range_not_checked() -> contextlib.AbstractContextManager[object]:
    """A server once in range is in range for ever."""

    def everywhere(self: ServerTable, position: Position, now_s: float) -> bool:
        for name in self._ranges.crossed(position):
            server = self.servers[name]
            server.in_range_since_s = server.in_range_since_s or now_s
        self.in_range = [server for server in self.servers.values() if server.in_range]
        return False

    return patch.object(ServerTable, "locate", everywhere)


def two_servers_selected() -> contextlib.AbstractContextManager[object]:
    """A better server is selected without leaving the one before."""

    def forget(self: Radios, server: Server, why: str, now_s: float) -> list[Any]:
        self.selected.remove(server)
        return []

    return patch.object(Radios, "leave", forget)


def used_before_its_turn() -> contextlib.AbstractContextManager[object]:
    """Calls go to the server in preparation."""

    def last(self: Radios) -> Server | None:
        return self.selected[-1] if self.selected else None

    return patch.object(Radios, "in_use", property(last))


def transition_skipped() -> contextlib.AbstractContextManager[object]:
    """A server that stopped its services goes on as if they ran."""
    apply = Server.apply

    def hasty(self: Server, event: Trigger, *, now_s: float, why: str = "") -> Any:
        if event is Trigger.FOUND_STOPPED:
            self.state = State.CHECK
            return apply(self, Trigger.FOUND_RUNNING, now_s=now_s, why=why)
        return apply(self, event, now_s=now_s, why=why)

    return patch.object(Server, "apply", hasty)


def lease_leaked() -> contextlib.AbstractContextManager[object]:
    def keep(self: AdmissionController, now_s: float) -> list[AdmissionCommand]:
        return []

    return patch.object(AdmissionController, "_end_leases", keep)


def slots_over_admitted() -> contextlib.AbstractContextManager[object]:
    return patch.object(Turns, "rank", lambda *_, **__: -math.inf)


def turns_never_end() -> contextlib.AbstractContextManager[object]:
    """Whoever has a slot keeps it."""
    return patch.object(Turns, "over", lambda *_, **__: [])


def admitted_after_its_turn() -> contextlib.AbstractContextManager[object]:
    """A drone whose turn is over is served beside the one that has its slot."""
    admitted = Leases.admitted

    def generous(self: Leases) -> Admit:
        command = admitted(self)
        return Admit(command.server, command.drones | command.finishing)

    return patch.object(Leases, "admitted", generous)


def full_is_failed() -> contextlib.AbstractContextManager[object]:
    """A server without a free slot is taken for one that failed."""
    return patch.object(ServerSession, "_raise_if_full", lambda *_: None)


def asks_without_pause() -> contextlib.AbstractContextManager[object]:
    """A drone without a slot asks again at once."""
    raise_if_full = ServerSession._raise_if_full

    def eager(self: ServerSession, reply: Any) -> None:
        try:
            raise_if_full(self, reply)
        except ServerFull as refusal:
            refusal.ask_again_s = 0.01
            raise

    return patch.object(ServerSession, "_raise_if_full", eager)


def acts_on_the_spot() -> contextlib.AbstractContextManager[object]:
    """The drone does not come back for an answer that demands something."""

    def stay_away(self: AnswerAction[Any], waited_s: float) -> None:
        self._finish(waited_s)

    return patch.object(AnswerAction, "_come_back", stay_away)


def forgets_what_is_late() -> contextlib.AbstractContextManager[object]:
    """An answer that comes when the drone has left its waypoint counts as one that demands nothing."""
    finish = AnswerAction._finish

    def forgetful(self: AnswerAction[Any], waited_s: float) -> None:
        if self.is_away:
            self._demand._holds = False
        finish(self, waited_s)

    return patch.object(AnswerAction, "_finish", forgetful)


def acts_twice() -> contextlib.AbstractContextManager[object]:
    finish = AnswerAction._finish

    def eager(self: AnswerAction[Any], waited_s: float) -> None:
        finish(self, waited_s)
        if self.is_away and self._demand.holds():
            finish(self, waited_s)

    return patch.object(AnswerAction, "_finish", eager)


def last_waypoint_goes() -> contextlib.AbstractContextManager[object]:
    decide = StayRule.decide

    def hasty(self: StayRule, outlook: Outlook | None) -> StayVerdict:
        verdict = decide(self, outlook)
        return replace(verdict, goes=True) if self.manner == "go" else verdict

    return patch.object(StayRule, "decide", hasty)


def leaves_two_waypoints() -> contextlib.AbstractContextManager[object]:
    """The photo and the leg after the next waypoint do not wait for the answer that is open."""
    fly_on = AnswerAction.fly_on

    def further(self: AnswerAction[Any], place: Waypoint | Position) -> None:
        fly_on(self, place)
        if not self.is_over:
            self._vehicle.fly(Position(position_of(place).east_m + 30.0, 0.0, position_of(place).altitude_m))

    return patch.object(AnswerAction, "fly_on", further)


def done_before_its_answer() -> contextlib.AbstractContextManager[object]:
    """A flight that is taken up goes on behind the last waypoint that was left."""

    def hasty(events: Iterable[Event], config: DroneConfig) -> frozenset[int]:
        kept = (each for each in events if not isinstance(each, schema.CallStarted))
        return waypoints_done(kept, config)

    judging = import_module("upwash.lab.faults.call_promises")  # whose name is its function's, too
    return patch.object(judging, "waypoints_done", hasty)


def held_for_ever() -> contextlib.AbstractContextManager[object]:
    """A slot that is held for a drone waits until it comes."""
    hold = Leases.hold

    def patient(self: Leases, drone: Client, until_s: float, *, peer: str, now_s: float) -> Any:
        return hold(self, drone, until_s + 1e6, peer=peer, now_s=now_s)

    return patch.object(Leases, "hold", patient)


def held_everywhere() -> contextlib.AbstractContextManager[object]:
    """A drone may have as many slots held as it likes."""
    return patch.object(Peers, "elsewhere", lambda *_, **__: "")


def held_for_strangers() -> contextlib.AbstractContextManager[object]:
    """Any server may have a slot held."""
    return patch.object(Peers, "unknown", lambda _self, _peer: "")


def started_twice() -> contextlib.AbstractContextManager[object]:
    """An instance that is being started is not remembered to be."""
    start = AdmissionController.start

    def forgetful(
        self: AdmissionController, server: str, service: str, drone: Client, *, now_s: float
    ) -> Any:
        answer, commands = start(self, server, service, drone, now_s=now_s)
        if commands and isinstance(commands[-1], StartInstance):
            commands = [*commands, StartInstance(server, service, next(self._numbers))]
        return answer, commands

    return patch.object(AdmissionController, "start", forgetful)


def local_call_dawdles() -> contextlib.AbstractContextManager[object]:
    """Something slows every call on the drone a little."""
    call = Calling.onboard

    async def slow(self: Calling, asked: Any) -> Any:
        await asyncio.sleep(0.15)
        return await call(self, asked)

    return patch.object(Calling, "onboard", slow)


def long_farewell() -> contextlib.AbstractContextManager[object]:
    """The flight ends only when its last server has heard the goodbye."""
    return patch("upwash.drone.server_session._FAREWELL_S", 20.0)


def borders_not_watched() -> contextlib.AbstractContextManager[object]:
    """A vehicle that is silent for a moment ends offloading, as it once did."""

    async def watch(self: Background) -> None:
        while True:
            await self._autopilot.border_crossed(self._areas)

    return patch.object(Background, "watch_borders", watch)


def safe_end_forgotten() -> contextlib.AbstractContextManager[object]:
    async def leave(*_: Any, **__: Any) -> None:
        return None

    return patch("upwash.drone.flight.end_safely", leave)


def chance_from_outside() -> contextlib.AbstractContextManager[object]:
    """Something in a decision comes from nowhere: here, from the address of an object."""
    decide = WaitRule.decide

    def moody(self: WaitRule, call: CallInputs) -> Decision:
        decision = decide(self, call)
        if isinstance(decision, Remote):
            return Remote(
                decision.server, decision.deadline_s * (1 - (id(call) >> 4) % 97 / 1e6), decision.why
            )
        return decision

    return patch.object(WaitRule, "decide", moody)


def hedging_budget_ignored() -> contextlib.AbstractContextManager[object]:
    """What the drone computes for nothing is not counted."""

    def forget(self: Hedging, *_: object, **__: object) -> None:
        pass

    return patch.object(Hedging, "overtaken", forget)


def both_answers_delivered() -> contextlib.AbstractContextManager[object]:
    """The answer that a hedged call drops becomes the next call's."""
    drop, answer, late = Racing._drop, Racing.answer, dict[tuple[int, str], Any]()

    async def keep(self: Racing, operation: Any, local: Any) -> None:
        await drop(self, operation, local)
        late[id(self), operation.method] = local.result()

    async def confused(self: Racing, decision: Any, asked: Any) -> Any:
        found = await answer(self, decision, asked)
        if (old := late.pop((id(self), asked.operation.method), None)) is not None:
            return replace(found, reply=old)
        return found

    return patch.multiple(Racing, _drop=keep, answer=confused)


def bounds_not_checked() -> contextlib.AbstractContextManager[object]:
    """A reply is believed whatever stands in its fields, as long as there are such fields."""

    def credulous(reply: bytes, expected: type[Any], *, sender: str) -> Any:
        try:
            return protocol.decode_reply(reply, expected, sender=sender)
        except GarbledReply:
            plain = _plain(reply)
            if not isinstance(plain, dict) or not set(plain) <= set(expected.__struct_fields__):
                raise
            return expected(**(plain | ({"lease_s": _TINY_LEASE_S} if "lease_s" in plain else {})))

    return patch("upwash.drone.server_session.decode_reply", credulous)


def leases_as_told() -> contextlib.AbstractContextManager[object]:
    """A lease is renewed three times while it lasts, however short a server says that it is."""

    def hasty(reply: bytes, expected: type[Any], *, sender: str) -> Any:
        plain = _plain(reply)
        told_s = plain.pop("lease_s", None) if isinstance(plain, dict) else None
        if told_s is None:
            return protocol.decode_reply(reply, expected, sender=sender)
        decoded = protocol.decode_reply(msgspec.msgpack.encode(plain), expected, sender=sender)
        is_lie = not protocol.LEAST_LEASE_S <= told_s < _LONG_LEASE_S
        return msgspec.structs.replace(decoded, lease_s=_TINY_LEASE_S if is_lie else told_s)

    return patch("upwash.drone.server_session.decode_reply", hasty)


def _plain(reply: bytes) -> Any:
    try:
        return msgspec.msgpack.decode(reply)
    except (msgspec.MsgspecError, UnicodeDecodeError):
        return None


def every_endpoint_dialled() -> contextlib.AbstractContextManager[object]:
    """All that a reply offers is got ready, wanted or not."""
    ask = ServerSession.ask

    async def greedy(self: ServerSession) -> Any:
        wanted, answered = self._server, ServerSession._availability

        async def availability(session: ServerSession, daemon: Any = None) -> Any:
            answer = await answered(session, daemon)
            self._server = replace(wanted, services=(*wanted.services, *answer.endpoints))
            return answer

        with patch.object(ServerSession, "_availability", availability):
            try:
                return await ask(self)
            finally:
                self._server = wanted

    return patch.object(ServerSession, "ask", greedy)


def endpoints_believed() -> contextlib.AbstractContextManager[object]:
    """A server says where its services are called."""

    def believed(endpoint: str, daemon: str) -> str:
        return daemon.rpartition(":")[0] + endpoint if endpoint.startswith(":") else endpoint

    return patch("upwash.drone.server_session.resolve", believed)


def texts_as_told() -> contextlib.AbstractContextManager[object]:
    """What a server says is written into the log as it is."""
    planted = contextlib.ExitStack()
    planted.enter_context(patch("upwash.rpc.protocol.escaped", lambda text: text))
    for place in ("rpc.protocol", "sim.link", "rpc.wire", "rpc.service"):
        planted.enter_context(patch(f"upwash.{place}.printable", lambda text, *_: text))
    return planted


def faults_as_told() -> contextlib.AbstractContextManager[object]:
    """What a server says was raised is written into the log as it is."""
    return patch("upwash.rpc.service.printable", lambda text, _: text)


def refusals_as_told() -> contextlib.AbstractContextManager[object]:
    """Why a request was refused is written into the log as it is."""
    return patch("upwash.sim.link.printable", lambda text: text)


def probed_without_pause() -> contextlib.AbstractContextManager[object]:
    """A failed server is asked again and again."""
    return patch.object(Probing, "pauses_s", lambda *_, **__: itertools.repeat(0.05))


def probed_once() -> contextlib.AbstractContextManager[object]:
    """A failed server that gives no sign of life at once is given up."""
    pauses_s = Probing.pauses_s
    return patch.object(Probing, "pauses_s", lambda *how, **more: itertools.islice(pauses_s(*how, **more), 2))


def trusted_however_often_it_fails() -> contextlib.AbstractContextManager[object]:
    """A server that keeps failing is asked as soon as one that failed once."""
    return patch.object(ServerFailures, "alone_s", 0.0)


def trusted_without_trial() -> contextlib.AbstractContextManager[object]:
    """A server that failed costs time again before it has answered a call."""
    return patch.object(Recovery, "in_doubt", lambda *_: False)


def useless_for_ever() -> contextlib.AbstractContextManager[object]:
    """An instance is never replaced, as it once was not."""
    return patch.object(Watch, "verdict", lambda *_, **__: None)


def replaced_too_early() -> contextlib.AbstractContextManager[object]:
    """A call that takes longer than a second has its instance replaced."""
    return patch.object(Limit, "seconds", lambda *_: 1.0)


def tried_without_pause() -> contextlib.AbstractContextManager[object]:
    """A service that does not start is tried again at each request."""
    return patch.object(DaemonFailures, "pause_s", lambda *_, **__: 0.0)


def pause_ignored() -> contextlib.AbstractContextManager[object]:
    """A drone asks a server during the pause that the server named."""

    def forget(self: Server, pause_s: float, now_s: float) -> None:
        pass

    return patch.object(Server, "leave_out", forget)


DEFECTS = (
    Defect("the wait for a server has no bound", wait_without_bound),
    Defect("the program waits longer than was decided", wait_not_watched),
    Defect("a remote call's deadline is ignored", deadline_ignored),
    Defect("a remote call's deadline may exceed a local call", deadline_of_the_wrong_estimate),
    Defect("every call has the patience of a first one", every_call_the_first),
    Defect("an earlier reply answers a later call", late_reply_delivered),
    Defect("a call that fell back has two results", duplicate_result),
    Defect("the service's own exception is replaced", own_exception_swallowed),
    Defect("what a server says was raised is believed", remote_exception_believed),
    Defect("a failed remote call raises in the mission", network_error_raised),
    Defect("the blacklist is left too early", blacklist_ignored),
    Defect("a blacklisted server is asked once more", blacklisted_is_asked),
    Defect("the range is not checked after it was entered", range_not_checked),
    Defect("two servers are selected", two_servers_selected),
    Defect("calls go to the server in preparation", used_before_its_turn),
    Defect("a transition of the server table is skipped", transition_skipped),
    Defect("leases do not end", lease_leaked),
    Defect("more drones are admitted than there are slots", slots_over_admitted),
    Defect("turns never end", turns_never_end),
    Defect("a drone is served after its turn", admitted_after_its_turn),
    Defect("a server without a free slot counts as failed", full_is_failed),
    Defect("a drone without a slot asks without pause", asks_without_pause),
    Defect("what an answer demands is done wherever the drone is", acts_on_the_spot),
    Defect("an answer that comes after the waypoint is not acted upon", forgets_what_is_late),
    Defect("what an answer demands is done again on arrival", acts_twice),
    Defect("the last waypoint does not wait", last_waypoint_goes),
    Defect("two waypoints may be left before the answer is there", leaves_two_waypoints),
    Defect("a waypoint counts as done before its answer is there", done_before_its_answer),
    Defect("a slot is held until the drone comes", held_for_ever),
    Defect("a drone has several slots held at a time", held_everywhere),
    Defect("a slot is held for a server that is no peer", held_for_strangers),
    Defect("one start makes two instances", started_twice),
    Defect("calls on the drone take longer than the service", local_call_dawdles),
    Defect("the mission's end waits for a server's goodbye", long_farewell),
    Defect("a silent vehicle ends the watch over ranges", borders_not_watched),
    Defect("a flight that fails ends without its safe action", safe_end_forgotten),
    Defect("commands are sent whoever has the vehicle", vehicle.latch_not_asked),
    Defect("the program's mode alone gives the vehicle back", vehicle.latch_opens_again),
    Defect("a fail-safe's mode is overlooked", vehicle.failsafe_overlooked),
    Defect("a lost vehicle is commanded to end safely", vehicle.ended_safely_all_the_same),
    Defect("an arrival counts though the position jumped", vehicle.arrived_in_doubt),
    Defect("a doubt about the position is never over", vehicle.doubted_for_ever),
    Defect("the vehicle's target is not watched", vehicle.target_not_watched),
    Defect("a restart is taken for the pilot's act", vehicle.restart_blamed_on_pilot),
    Defect("an autopilot that restarted is flown on", vehicle.restart_overlooked),
    Defect("a restart on the ground ends the flight", vehicle.restart_on_ground_is_loss),
    Defect("altitudes follow a home that is moved", vehicle.altitudes_follow_home),
    Defect("another program's heartbeat is believed", vehicle.any_heartbeat_believed),
    Defect("hedging has no budget", hedging_budget_ignored),
    Defect("the answer that a hedged call drops answers the next", both_answers_delivered),
    Defect("the bounds of a reply's fields are not checked", bounds_not_checked),
    Defect("a lease may be as short as a server likes", leases_as_told),
    Defect("services that nobody wants are dialled", every_endpoint_dialled),
    Defect("a server says which host is called", endpoints_believed),
    Defect("what a server says is logged as it is", texts_as_told),
    Defect("why a request was refused is logged as it is", refusals_as_told),
    Defect("what a server says was raised is logged as it is", faults_as_told),
    Defect("a failed server is probed without pause", probed_without_pause),
    Defect("a failed server is probed only once", probed_once),
    Defect("a server that keeps failing is not left alone for longer", trusted_however_often_it_fails),
    Defect("a server that failed gets a call without a trial", trusted_without_trial),
    Defect("an instance of no use is never replaced", useless_for_ever),
    Defect("an instance is replaced too early", replaced_too_early),
    Defect("a service that does not start is tried without pause", tried_without_pause),
    Defect("a drone ignores the pause that a server names", pause_ignored),
    Defect("a decision depends on something besides the seed", chance_from_outside),
)


def main() -> None:
    """Plants each defect, flies worlds until one breaks a promise, and prints the table."""
    sys.stdout.write("| planted defect | found by | at seed |\n|---|---|---|\n")
    for defect in DEFECTS:
        broken = first_broken(defect)
        promises = ", ".join(dict.fromkeys(str(each.promise) for each in broken))
        found = f"{promises} | {broken[0].seed}" if broken else f"nothing | > {MOST_SEEDS}"
        sys.stdout.write(f"| {defect.what} | {found} |\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
