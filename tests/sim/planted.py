"""Defects planted in the programs, to see that the promises' checks find them.

    python -m tests.sim.planted           flies worlds with each until a promise is broken; prints a table
    python -m tests.sim.planted --keep    begins at the seeds that are known, and keeps it for docs/safety-case.md

A defect is found where its worlds break a promise; without it they break none.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import math
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any
from unittest.mock import patch

import msgspec
import tests.sim.planted_answers
import tests.sim.planted_deadlines
import tests.sim.planted_objects
import tests.sim.planted_rows
import tests.sim.planted_sending
import tests.sim.planted_servers
import tests.sim.planted_vehicle  # noqa: F401 - which declares defects, as the others do
from bench.results import leave
from msgspec.structs import replace
from tests.sim.planting import DEFECTS, FOUND_BY_SEED, Defect, Planting, plant, planted, planting

from upwash.config.drone import DroneConfig
from upwash.core.admission.admission import AdmissionController
from upwash.core.admission.clients import Client
from upwash.core.admission.instances import StartInstance
from upwash.core.admission.leases import Admit, Leases
from upwash.core.admission.peers import Peers
from upwash.core.admission.turns import Turns
from upwash.core.admission.watchdog import InstanceFailures as DaemonFailures
from upwash.core.admission.watchdog import Limit, Watch
from upwash.core.call import steps
from upwash.core.call.call import Call
from upwash.core.geo import Position, Waypoint
from upwash.core.knowledge.estimates import Estimates
from upwash.core.knowledge.servers import Server, ServerTable, State, Trigger
from upwash.core.planning.stay_or_go import Outlook, StayRule
from upwash.core.policies.policy import CallInputs, Deadline, Remote, Wait, WaitRule
from upwash.core.selection.hedging import Hedging
from upwash.core.selection.moment import Moment
from upwash.core.selection.radios import Radios
from upwash.core.selection.recovery import Probing, Recovery, ServerFailures
from upwash.drone import flight, server_session
from upwash.drone.answers import AnswerAction
from upwash.drone.looks import Looks
from upwash.drone.offloading import Offloading
from upwash.drone.places import position_of
from upwash.drone.server_session import ServerSession
from upwash.drone.settling import Settling
from upwash.drone.stops import Stops
from upwash.errors import GarbledReply, LinkError, Refused, ServerFull
from upwash.eventlog import schema
from upwash.eventlog.schema import Event
from upwash.lab.faults import call_promises
from upwash.lab.faults import campaign as chaos
from upwash.lab.faults.display import is_replayed
from upwash.lab.faults.mission import Blurred
from upwash.lab.faults.promises import Broken
from upwash.lab.outcome import quiet_daemons
from upwash.rpc import protocol, service
from upwash.rpc.service import Method
from upwash.sim import link
from upwash.sim.journal import MemoryJournal

MOST_SEEDS = 3_000
_TINY_LEASE_S = 0.05  # for whatever is none: with less, virtual time would hardly go on
_LONG_LEASE_S = 1e5


def first_broken(defect: Defect, *, since: int = 1) -> list[Broken]:
    """The promises that the planted defect breaks in the first world, from seed `since` on, where it breaks any."""
    with defect.plant(), _nothing_remembered(), quiet_daemons():
        for seed in range(since, MOST_SEEDS + 1):
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


@planted("the wait for a server has no bound", WaitRule, "decide")
def wait_without_bound(decide: Any, self: WaitRule, call: CallInputs) -> Any:
    decision = decide(self, call)
    return Wait(decision.server, 1e3, decision.why) if isinstance(decision, Wait) else decision


@planted("the program waits longer than was decided", Call, "decide")
def wait_not_watched(decide: Any, self: Call, **more: Any) -> None:
    decide(self, **more)
    self.check_until_s = self.calls.now_s + 3 * (self.check_until_s - self.calls.now_s) + 1


@planted("a remote call's deadline is ignored", ServerSession, "call")
async def deadline_ignored(
    call: Any, self: ServerSession, *about: Any, deadline_s: float, may_queue_s: float | None
) -> Any:
    return await call(self, *about, deadline_s=10 * deadline_s, may_queue_s=may_queue_s)


@planted("a remote call's deadline may exceed a local call", Deadline, "seconds")
def deadline_of_the_wrong_estimate(
    original: Any, self: Deadline, *, local_s: float, remote_s: float, is_first: bool
) -> Any:
    return max(self.least_s, self.factor * remote_s)


plant("every call has the patience of a first one", Estimates, "is_first_call", lambda *_: True)


@planting("an earlier reply answers a later call")
def late_reply_delivered() -> Planting:
    call, late = ServerSession.call, dict[tuple[int, str], bytes]()

    async def confused(
        self: ServerSession, service: str, method: str, request: bytes, **limits: Any
    ) -> bytes:
        if (old := late.pop((id(self), method), None)) is not None:
            return old
        reply = await call(self, service, method, request, **limits)
        late[id(self), method] = reply
        return reply

    return patch.object(ServerSession, "call", confused)


@planted("a call that fell back has two results", MemoryJournal, "record")
def duplicate_result(record: Any, self: MemoryJournal, event: Event) -> None:
    record(self, event)
    if isinstance(event, schema.Call) and event.fell_back:
        record(self, event)


@planted("the service's own exception is replaced", Method, "result")
def own_exception_swallowed(result: Any, self: Method, decoded: Any) -> Any:
    try:
        return result(self, decoded)
    except (Blurred, ValueError) as error:
        raise ValueError(str(error)) from None


plant("what a server says was raised is believed", Method, "raised", lambda *_: "")


@planted("a failed remote call raises in the mission", Offloading, "_send")
async def network_error_raised(send: Any, self: Offloading, told: steps.Send, session: Any) -> Any:
    event, opened = await send(self, told, session), self._open[told.attempt.call]
    if isinstance(event, steps.Failed) and not opened.answer.done():
        opened.answer.set_exception(LinkError(event.why))
    return event


@planted("the blacklist is left too early", ServerTable, "expired")
def blacklist_ignored(expired: Any, self: ServerTable, now_s: float, *, probed: Any) -> Any:
    left_alone_s = max(server.left_alone_s for server in self.servers.values())
    return expired(self, now_s + left_alone_s * 0.9, probed=probed)


@planted("a blacklisted server is asked once more", ServerSession, "end")
async def blacklisted_is_asked(end: Any, self: ServerSession, *, in_range: bool) -> Any:
    if in_range:
        await self._quiet.wait()
        with contextlib.suppress(LinkError, Refused, AssertionError):
            await asyncio.sleep(0.2)
            await self._availability()
    return await end(self, in_range=in_range)


@planted("the range is not checked after it was entered", ServerTable, "locate")
def range_not_checked(original: Any, self: ServerTable, position: Position, now_s: float) -> Any:
    for name in self.ranges.crossed(position):
        server = self.servers[name]
        server.in_range_since_s = server.in_range_since_s or now_s
    self.in_range = [server for server in self.servers.values() if server.in_range]
    return False


@planted("two servers are selected", Radios, "leave")
def two_servers_selected(original: Any, self: Radios, server: Server, why: str) -> None:
    self.selected.remove(server)


_LAST_SELECTED = property(lambda radios: radios.selected[-1] if radios.selected else None)
plant("calls go to the server in preparation", Radios, "in_use", _LAST_SELECTED)


@planted("a transition of the server table is skipped", Moment, "step")
def transition_skipped(step: Any, self: Moment, server: Server, trigger: Trigger, why: str = "") -> None:
    if trigger is Trigger.FOUND_STOPPED:
        server.state, trigger = State.CHECK, Trigger.FOUND_RUNNING
    step(self, server, trigger, why)


@planted("leases do not end", AdmissionController, "_end_leases")
def lease_leaked(original: Any, self: AdmissionController, now_s: float) -> Any:
    return []


plant("more drones are admitted than there are slots", Turns, "rank", lambda *_, **__: -math.inf)
plant("turns never end", Turns, "over", lambda *_, **__: [])


@planted("a drone is served after its turn", Leases, "admitted")
def admitted_after_its_turn(admitted: Any, self: Leases) -> Any:
    command = admitted(self)
    return Admit(command.server, command.drones | command.finishing)


plant("a server without a free slot counts as failed", ServerSession, "_raise_if_full", lambda *_: None)


@planted("a drone without a slot asks without pause", ServerSession, "_raise_if_full")
def asks_without_pause(raise_if_full: Any, self: ServerSession, reply: Any) -> None:
    try:
        raise_if_full(self, reply)
    except ServerFull as refusal:
        refusal.ask_again_s = 0.01
        raise


@planted("what an answer demands is done wherever the drone is", Settling, "come_back")
def acts_on_the_spot(original: Any, self: Settling, answer: AnswerAction[Any], waited_s: float = 0.0) -> None:
    answer.finish(waited_s)


@planted("an answer that comes after the waypoint is not acted upon", AnswerAction, "finish")
def forgets_what_is_late(finish: Any, self: AnswerAction[Any], waited_s: float) -> None:
    if self.is_away:
        self._holds = False
    finish(self, waited_s)


@planted("what an answer demands is done again on arrival", AnswerAction, "finish")
def acts_twice(finish: Any, self: AnswerAction[Any], waited_s: float) -> None:
    finish(self, waited_s)
    if self.is_away and self.holds():
        finish(self, waited_s)


@planted("the last waypoint does not wait", StayRule, "decide")
def last_waypoint_goes(decide: Any, self: StayRule, outlook: Outlook | None) -> Any:
    verdict = decide(self, outlook)
    return replace(verdict, goes=True) if self.manner == "go" else verdict


@planted("two waypoints may be left before the answer is there", Stops, "fly_on")
def leaves_two_waypoints(
    fly_on: Any, self: Stops, answer: AnswerAction[Any], place: Waypoint | Position
) -> None:
    fly_on(self, answer, place)
    if not answer.is_over:
        self.fly(Position(position_of(place).east_m + 30.0, 0.0, position_of(place).altitude_m))


@planted("a waypoint counts as done before its answer is there", call_promises, "waypoints_done")
def done_before_its_answer(done: Any, events: Iterable[Event], config: DroneConfig) -> Any:
    return done((event for event in events if not isinstance(event, schema.CallStarted)), config)


@planted("a slot is held until the drone comes", Leases, "hold")
def held_for_ever(hold: Any, self: Leases, drone: Client, until_s: float, *, peer: str, now_s: float) -> Any:
    return hold(self, drone, until_s + 1e6, peer=peer, now_s=now_s)


plant("a drone has several slots held at a time", Peers, "elsewhere", lambda *_, **__: "")
plant("a slot is held for a server that is no peer", Peers, "unknown", lambda _self, _peer: "")


@planted("one start makes two instances", AdmissionController, "start")
def started_twice(
    start: Any, self: AdmissionController, server: str, service: str, drone: Client, *, now_s: float
) -> Any:
    answer, commands = start(self, server, service, drone, now_s=now_s)
    if commands and isinstance(commands[-1], StartInstance):
        commands = [*commands, StartInstance(server, service, next(self._numbers))]
    return answer, commands


@planted("calls on the drone take longer than the service", Offloading, "_onboard_reply")
async def local_call_dawdles(reply: Any, self: Offloading, *call: Any) -> Any:
    await asyncio.sleep(0.15)
    return await reply(self, *call)


plant("the mission's end waits for a server's goodbye", server_session, "_FAREWELL_S", 20.0)


@planted("a silent vehicle ends the watch over ranges", Looks, "watch_borders")
async def borders_not_watched(original: Any, self: Looks) -> None:
    while True:
        await self.autopilot.border_crossed(self.areas)


@planted("a flight that fails ends without its safe action", flight, "end_safely")
async def safe_end_forgotten(*_: Any, **__: Any) -> None:
    pass


@planted("a decision depends on something besides the seed", WaitRule, "decide")
def chance_from_outside(decide: Any, self: WaitRule, call: CallInputs) -> Any:
    decision = decide(self, call)
    if isinstance(decision, Remote):
        return Remote(decision.server, decision.deadline_s * (1 - (id(call) >> 4) % 97 / 1e6), decision.why)
    return decision


@planted("hedging has no budget", Hedging, "overtaken")
def hedging_budget_ignored(original: Any, self: Hedging, *_: object, **__: object) -> None:
    pass


@planting("the answer that a hedged call drops answers the next")
def both_answers_delivered() -> Planting:
    compute, answer, late = Offloading._compute, Offloading._answer, dict[tuple[int, str], Any]()

    async def keep(self: Offloading, told: steps.Compute) -> Any:
        event = await compute(self, told)
        if told.computing.call.is_over:
            call = told.computing.call
            late[id(self), call.asked.operation.method] = self._open[call].replies[told.computing]
        return event

    def confused(self: Offloading, call: Call, reply: Any) -> None:
        answer(self, call, late.pop((id(self), call.asked.operation.method), reply))

    return patch.multiple(Offloading, _compute=keep, _answer=confused)


@planted("the bounds of a reply's fields are not checked", server_session, "decode_reply")
def bounds_not_checked(decode: Any, reply: bytes, expected: type[Any], *, sender: str) -> Any:
    try:
        return decode(reply, expected, sender=sender)
    except GarbledReply:
        plain = _plain(reply)
        if not isinstance(plain, dict) or not set(plain) <= set(expected.__struct_fields__):
            raise
        return expected(**(plain | ({"lease_s": _TINY_LEASE_S} if "lease_s" in plain else {})))


@planted("a lease may be as short as a server likes", server_session, "decode_reply")
def leases_as_told(decode: Any, reply: bytes, expected: type[Any], *, sender: str) -> Any:
    plain = _plain(reply)
    told_s = plain.pop("lease_s", None) if isinstance(plain, dict) else None
    if told_s is None:
        return decode(reply, expected, sender=sender)
    decoded = decode(msgspec.msgpack.encode(plain), expected, sender=sender)
    is_lie = not protocol.LEAST_LEASE_S <= told_s < _LONG_LEASE_S
    return msgspec.structs.replace(decoded, lease_s=_TINY_LEASE_S if is_lie else told_s)


def _plain(reply: bytes) -> Any:
    try:
        return msgspec.msgpack.decode(reply)
    except (msgspec.MsgspecError, UnicodeDecodeError):
        return None


@planted("services that nobody wants are dialled", ServerSession, "ask")
async def every_endpoint_dialled(ask: Any, self: ServerSession) -> Any:
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


@planted("a server says which host is called", server_session, "resolve")
def endpoints_believed(_: Any, endpoint: str, daemon: str) -> str:
    return daemon.rpartition(":")[0] + endpoint if endpoint.startswith(":") else endpoint


@planting("what a server says is logged as it is")
def texts_as_told() -> Planting:
    planted = contextlib.ExitStack()
    planted.enter_context(patch("upwash.rpc.protocol.escaped", lambda text: text))
    for place in ("rpc.protocol", "sim.link", "rpc.wire", "rpc.service"):
        planted.enter_context(patch(f"upwash.{place}.printable", lambda text, *_: text))
    return planted


plant("what a server says was raised is logged as it is", service, "printable", lambda text, _: text)
plant("why a request was refused is logged as it is", link, "printable", lambda text: text)
plant("a failed server is probed without pause", Probing, "pauses_s", lambda *_, **__: itertools.repeat(0.05))


@planted("a failed server is probed only once", Probing, "pauses_s")
def probed_once(pauses_s: Any, *how: Any, **more: Any) -> Any:
    return itertools.islice(pauses_s(*how, **more), 2)


plant("a server that keeps failing is not left alone for longer", ServerFailures, "alone_s", 0.0)
plant("a server that failed gets a call without a trial", Recovery, "in_doubt", lambda *_: False)
plant("an instance of no use is never replaced", Watch, "verdict", lambda *_, **__: None)
plant("an instance is replaced too early", Limit, "seconds", lambda *_: 1.0)
plant("a service that does not start is tried without pause", DaemonFailures, "pause_s", lambda *_, **__: 0.0)


@planted("a drone ignores the pause that a server names", Server, "leave_out")
def pause_ignored(original: Any, self: Server, pause_s: float, now_s: float) -> None:
    pass


@planting("a server that was found stopped counts as running, and nothing bounds the pace of selections")
def stopped_counts_as_running() -> Planting:
    leave, planted = Radios.leave, contextlib.ExitStack()

    def believed_running(self: Radios, server: Server, why: str) -> None:
        server.start_requested = server.start_requested or server.found_stopped
        leave(self, server, why)

    planted.enter_context(patch.object(Radios, "leave", believed_running))
    planted.enter_context(patch.object(Radios, "_is_put_off", lambda *_: False))
    return planted


def main() -> None:
    """Plants each defect, flies worlds until one breaks a promise, and prints or keeps the table."""
    keeps, kept = "--keep" in sys.argv, []
    sys.stdout.write("| planted defect | found by | at seed |\n|---|---|---|\n")
    for defect in DEFECTS:
        broken = first_broken(defect, since=FOUND_BY_SEED.get(defect.what, 1) if keeps else 1)
        promises = list(dict.fromkeys(each.promise for each in broken))
        kept.append({"what": defect.what, "promises": [promise.value for promise in promises]})
        names = ", ".join(map(str, promises))
        found = f"{names} | {broken[0].seed}" if broken else f"nothing | > {MOST_SEEDS}"
        sys.stdout.write(f"| {defect.what} | {found} |\n")
        sys.stdout.flush()
    if keeps:
        file = Path(__file__).with_name("planted.json")
        leave(file, command="python -m tests.sim.planted --keep", figures=kept)


if __name__ == "__main__":
    main()
