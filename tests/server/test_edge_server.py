"""The edge daemon's program, on virtual time, with a runtime that does what a test tells it."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar
from unittest.mock import patch

import msgspec
import pytest
from tests.played import played

from upwash.core.admission.admission import AdmissionController, AdmissionSettings
from upwash.core.admission.clients import Client, DroneUsage, InstanceStatus, Role, TeamUsage
from upwash.core.admission.server import Command, ServerOffer
from upwash.core.admission.watchdog import CALL_LIMIT_S, DENIALS
from upwash.errors import InstanceError, LinkError, Refused
from upwash.ports import Answered, AnsweredCall, InstanceSpec, Program, ignored
from upwash.rpc.protocol import (
    AVAILABILITY,
    DENY,
    HOLD,
    LEAVE,
    PREPARE,
    START,
    STATUS,
    AvailabilityReply,
    AvailabilityRequest,
    DenyRequest,
    HoldReply,
    HoldRequest,
    LeaveRequest,
    PrepareRequest,
    StartReply,
    StartRequest,
    StatusReply,
    StatusRequest,
)
from upwash.server.daemon import EdgeServer
from upwash.server.instances import Image, Observer
from upwash.sim.link import ModelDialer, ModelLink, Switchboard
from upwash.sim.loop import run_virtually

T = TypeVar("T")
COLD_START_S = 8.0
LEASE_S = 30.0
DRAIN_S = 10.0
STOP_S = 30.0
IMAGES = {name: Image(Program(f"somewhere:{name}")) for name in ("detector", "counter")}


class Instance:
    def __init__(self, endpoint: str) -> None:
        self.endpoint = endpoint
        self.admitted: frozenset[str] = frozenset()
        self.ended: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        self.deaf = False
        self.is_frozen = False
        self.stops_in_s = 1.0  # a real one takes its time as well
        self.is_removed = False
        self.refuses = ""  # every further call, for this reason
        self.call_ends_in_s = 0.0
        self.admits_in_s = 0.0

    async def admit(self, drones: frozenset[str], finishing: frozenset[str] = frozenset()) -> None:
        await asyncio.sleep(self.admits_in_s)
        if self.deaf:
            raise InstanceError("does not answer its runtime")
        self.admitted = drones

    async def drain(self, why: str) -> None:
        self.refuses = why
        await asyncio.wait([self.ended], timeout=self.call_ends_in_s)
        if self.ended.done():
            await asyncio.sleep(0.1)  # it is known a moment later, when the life's end may have begun
            raise InstanceError("it has ended")

    async def health(self) -> None:
        if self.is_frozen:
            await asyncio.get_running_loop().create_future()

    async def exited(self) -> str:
        return await asyncio.shield(self.ended)

    async def stop(self) -> None:
        await asyncio.sleep(self.stops_in_s)
        self.is_removed = True
        if not self.ended.done():
            self.ended.set_result("stopped")


class Runtime:
    """Starts instances after COLD_START_S, unless `broken` says why it cannot."""

    def __init__(self) -> None:
        self.instances: list[Instance] = []
        self.called: list[Callable[[str], None]] = []
        self.answered: list[Answered] = []
        self.broken = ""
        self.admits_in_s = 0.0
        self.removes_in_s = 0.0  # what a cancelled start has made
        self.removed = 0

    async def start(
        self, spec: InstanceSpec, *, called: Callable[[str], None], answered: Answered = ignored
    ) -> Instance:
        try:
            await asyncio.sleep(COLD_START_S)
        except asyncio.CancelledError:
            await asyncio.sleep(self.removes_in_s)
            self.removed += 1
            raise
        if self.broken:
            raise InstanceError(self.broken)
        self.instances.append(Instance(f"{spec.name}#{len(self.instances)}"))
        self.instances[-1].admits_in_s = self.admits_in_s
        self.called.append(called)
        self.answered.append(answered)
        return self.instances[-1]

    def living(self) -> list[Instance]:
        return [instance for instance in self.instances if not instance.ended.done()]


class Dialer:
    """Keeps the links that it opened."""

    def __init__(self, dialer: ModelDialer) -> None:
        self.dialer = dialer
        self.links: list[ModelLink] = []

    def dial(self, address: str, *, server: str) -> ModelLink:
        self.links.append(self.dialer.dial(address, server=server))
        return self.links[-1]


class Daemon:
    """An edge server and the drones that talk to it."""

    def __init__(self, *, slots: int = 1, start_timeout_s: float = 60.0) -> None:
        self.runtime = Runtime()
        self.observed: list[str] = []
        self.peer_answers_in_s = 0.0
        self.asked_to_hold: list[HoldRequest] = []
        switchboard = Switchboard(dict.fromkeys(("s2", "s3"), self._nothing_to_hold))
        self.dialer = Dialer(ModelDialer("s1", switchboard))
        self.core = AdmissionController(
            {"s1": ServerOffer(frozenset({"detector", "counter"}), slots)},
            AdmissionSettings(lease_s=LEASE_S, idle_stop_s=100),
            peers=["s2", "s3"],
        )
        self.edge = EdgeServer(
            self.core,
            images=IMAGES,
            runtime=self.runtime,
            dialer=self.dialer,
            peers={"s2": "s2", "s3": "s3"},
            start_timeout_s=start_timeout_s,
            drain_s=DRAIN_S,
            observer=Observer(
                started=lambda spec, took_s: self.observed.append(f"{spec.name} started in {took_s:.1f} s"),
                failed=lambda spec: self.observed.append(f"{spec.name} failed"),
                answered=lambda spec, call: self.observed.append(f"{spec.name} answered {call.drone}"),
            ),
        )

    async def ask(self, drone: str = "d1") -> AvailabilityReply:
        request = AvailabilityRequest("s1", ["detector"])
        reply = await self.edge.handle(AVAILABILITY, msgspec.msgpack.encode(request), Client(drone))
        return msgspec.msgpack.decode(reply, type=AvailabilityReply)

    async def start(self, drone: str = "d1", service: str = "detector") -> StartReply:
        request = StartRequest("s1", service)
        reply = await self.edge.handle(START, msgspec.msgpack.encode(request), Client(drone))
        return msgspec.msgpack.decode(reply, type=StartReply)

    async def hold(self, drone: str, *, for_s: float) -> HoldReply:
        request = HoldRequest("s1", drone, "", ["detector"], for_s)
        reply = await self.edge.handle(HOLD, msgspec.msgpack.encode(request), Client("s2", role=Role.SERVER))
        return msgspec.msgpack.decode(reply, type=HoldReply)

    async def prepare(self, peer: str, drone: str = "d1") -> HoldReply:
        request = PrepareRequest("s1", peer, ["detector"], arrives_in_s=20.0, hold_s=5.0)
        reply = await self.edge.handle(PREPARE, msgspec.msgpack.encode(request), Client(drone))
        return msgspec.msgpack.decode(reply, type=HoldReply)

    async def deny(self, drone: str = "d1") -> None:
        await self.edge.handle(DENY, msgspec.msgpack.encode(DenyRequest("s1", ["detector"])), Client(drone))

    async def _nothing_to_hold(self, path: str, body: bytes, client: Client) -> bytes:
        await asyncio.sleep(self.peer_answers_in_s)
        request = msgspec.msgpack.decode(body, type=HoldRequest)
        self.asked_to_hold.append(request)
        return msgspec.msgpack.encode(HoldReply(held=False, reason=f"{request.server} is full"))

    async def keep_asking(self, for_s: float) -> None:
        """Has the drone's lease renewed for so long, and a little longer."""
        until_s = asyncio.get_running_loop().time() + for_s
        while asyncio.get_running_loop().time() < until_s:
            await self.ask()
            await asyncio.sleep(min(10.0, for_s) + 0.01)

    async def leave(self, drone: str = "d1") -> None:
        await self.edge.handle(LEAVE, msgspec.msgpack.encode(LeaveRequest("s1")), Client(drone))


def serve(story: Callable[[Daemon], Coroutine[Any, Any, T]], *, looks: bool = True, **settings: Any) -> T:
    """Runs a story with a daemon that looks after itself, and checks that it leaves no instance."""

    async def run() -> T:
        daemon = Daemon(**settings)
        looking = asyncio.create_task(daemon.edge.run() if looks else asyncio.sleep(0))
        try:
            result = await story(daemon)
            assert not looks or not looking.done(), "a defect ended the daemon"
            return result
        finally:
            looking.cancel()
            await daemon.edge.close()
            assert daemon.runtime.living() == [], "an instance outlived its daemon"

    return run_virtually(run())


@played(serve)
async def test_a_cold_start_is_answered_when_the_service_is_ready(daemon: Daemon) -> None:
    assert (await daemon.ask()).endpoints == {}
    reply = await daemon.start()
    assert asyncio.get_running_loop().time() == pytest.approx(COLD_START_S)
    assert (await daemon.ask()).endpoints == {"detector": reply.endpoint}


@played(serve, slots=2)
async def test_two_starts_at_once_make_one_instance(daemon: Daemon) -> None:
    first, second = await asyncio.gather(daemon.start("d1"), daemon.start("d2"))
    assert first.endpoint == second.endpoint != ""
    assert len(daemon.runtime.instances) == 1


@played(serve, slots=2)
async def test_an_instance_admits_exactly_those_with_a_lease(daemon: Daemon) -> None:
    await daemon.start("d1")
    (instance,) = daemon.runtime.instances
    assert instance.admitted == {"d1"}
    await daemon.ask("d2")
    assert instance.admitted == {"d1", "d2"}
    await daemon.leave("d1")
    assert instance.admitted == {"d2"}
    await asyncio.sleep(31)
    assert instance.admitted == frozenset(), "the lease of a silent drone ends by itself"


@played(serve, slots=2)
async def test_a_slot_that_a_peer_has_held_ends_in_its_time_also_where_that_is_less_than_a_leases(
    daemon: Daemon,
) -> None:
    await daemon.start("d1")
    assert (await daemon.hold("d2", for_s=5.0)).held
    (instance,) = daemon.runtime.instances
    assert instance.admitted == {"d1", "d2"}
    await asyncio.sleep(5.0)
    await asyncio.sleep(1.1)  # the least between two looks
    assert instance.admitted == {"d1"}


@pytest.mark.parametrize("request_", ["ask", "start", "prepare", "hold", "leave"])
@played(serve, looks=False, slots=2)
async def test_each_request_ends_the_leases_whose_time_is_over(daemon: Daemon, *, request_: str) -> None:
    await daemon.start("d1")
    await daemon.ask("d2")
    (instance,) = daemon.runtime.instances
    for _ in range(2):
        await asyncio.sleep(0.6 * LEASE_S)
        assert instance.admitted == {"d1", "d2"}
        daemon.edge.seen("s1", "d1")
    requests: dict[str, Callable[[], Coroutine[Any, Any, Any]]] = {
        "ask": daemon.ask,
        "start": daemon.start,
        "prepare": lambda: daemon.prepare("s2"),
        "hold": lambda: daemon.hold("d1", for_s=5.0),
        "leave": lambda: daemon.leave("d2"),
    }
    await requests[request_]()
    assert instance.admitted == {"d1"}


def test_a_daemon_without_leases_and_instances_looks_at_nothing() -> None:
    async def story(daemon: Daemon) -> int:
        looks = 0

        def look(*, now_s: float) -> list[Command]:
            nonlocal looks
            looks += 1
            return AdmissionController.look(daemon.core, now_s=now_s)

        with patch.object(daemon.core, "look", look):
            await daemon.start()
            await daemon.leave()
            await asyncio.sleep(105.0)
            assert daemon.runtime.living() == []
            before = looks
            await asyncio.sleep(1000.0)
            return looks - before

    assert serve(story) <= 1


@played(serve)
async def test_a_daemon_is_empty_once_no_drone_has_a_slot(daemon: Daemon) -> None:
    await daemon.edge.emptied()
    assert asyncio.get_running_loop().time() == 0.0
    await daemon.ask()
    await daemon.edge.emptied()
    assert LEASE_S <= asyncio.get_running_loop().time() <= LEASE_S + 2.0


@played(serve)
async def test_a_daemon_continues_what_the_former_one_counted(daemon: Daemon) -> None:
    used = DroneUsage("heron-1", "heron", None, 60.0, 7, 3.5, 1.0)
    daemon.edge.take_up_usage("s1", [used], [TeamUsage("heron", 0, 60.0, 7, 3.5, 1.0)])
    (server,) = daemon.edge.standing().servers
    assert [(drone.drone, drone.calls) for drone in server.drones] == [("heron-1", 7)]
    assert [(team.team, team.slot_s) for team in server.teams] == [("heron", 60.0)]


@played(serve)
async def test_starts_failures_and_answers_are_observed(daemon: Daemon) -> None:
    await asyncio.sleep(3.0)
    await daemon.start()
    daemon.runtime.answered[0](AnsweredCall("d1", "look", 0.0, 0.1))
    await daemon.leave()
    await asyncio.sleep(105.0)
    daemon.runtime.broken = "no such model"
    await daemon.start()
    assert daemon.observed == [
        f"detector@s1 started in {COLD_START_S:.1f} s",
        "detector@s1 answered d1",
        "detector@s1 failed",
    ]


@played(serve)
async def test_where_a_peer_holds_no_slot_another_peer_may(daemon: Daemon) -> None:
    await daemon.start()
    for peer in ("s2", "s3"):
        assert await daemon.prepare(peer) == HoldReply(held=False, reason=f"{peer} is full")
    on_its_way = HoldRequest("s2", "d1", "", ["detector"], for_s=20.0 + 5.0)
    assert daemon.asked_to_hold == [on_its_way, msgspec.structs.replace(on_its_way, server="s3")]
    for link in daemon.dialer.links:
        with pytest.raises(LinkError, match="the link is closed"):
            await link.request(HOLD, b"", timeout_s=1.0)


@played(serve)
async def test_what_the_daemon_sees_keeps_a_lease_alive_and_what_an_instance_says_does_not(
    daemon: Daemon,
) -> None:
    await daemon.start("d1")
    for _ in range(10):
        await asyncio.sleep(20)
        daemon.edge.seen("s1", "d1")
    assert daemon.runtime.instances[0].admitted == {"d1"}
    for _ in range(2):
        await asyncio.sleep(20)
        daemon.runtime.called[0]("d1")
    assert daemon.runtime.instances[0].admitted == set()


@played(serve, slots=2)
async def test_an_instance_that_confirms_slowly_holds_up_no_other(daemon: Daemon) -> None:
    await daemon.start("d1")
    await daemon.start("d1", "counter")
    for instance in daemon.runtime.instances:
        instance.admits_in_s = 4.0
    began_s = asyncio.get_running_loop().time()
    assert (await daemon.ask("d2")).available
    assert asyncio.get_running_loop().time() - began_s == pytest.approx(4.0)


@played(serve)
async def test_without_a_free_slot_the_answer_is_no_with_the_reason(daemon: Daemon) -> None:
    await daemon.start("d1")
    refused = await daemon.ask("d2")
    assert not refused.available
    assert "no free slot" in refused.reason
    assert "no free slot" in (await daemon.start("d2")).reason
    await daemon.leave("d1")
    assert (await daemon.ask("d2")).available


@played(serve)
async def test_a_start_that_fails_is_answered_with_its_reason_and_may_be_tried_again(
    daemon: Daemon, *, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, logger="upwash.server")
    daemon.runtime.broken = "no such model"
    failed = await daemon.start()
    assert "version" not in caplog.text, "there is no other"
    assert (failed.reason, failed.pause_s) == ("no such model", 10.0)
    assert daemon.edge.standing().refused["s1"] == 1
    daemon.runtime.broken = ""
    paused = await daemon.ask()
    assert (paused.available, paused.pause_s) == (False, 10.0)
    await asyncio.sleep(10.0)
    assert (await daemon.start()).endpoint


@played(serve, slots=2)
async def test_a_drone_whose_start_has_failed_while_others_were_informed_hears_why(daemon: Daemon) -> None:
    await daemon.start("d1", "counter")
    daemon.runtime.instances[0].admits_in_s = COLD_START_S + 1.0
    daemon.runtime.broken = "no such model"
    first = asyncio.create_task(daemon.start("d1"))
    await asyncio.sleep(1.0)
    reply = await daemon.start("d2")
    assert reply.reason == "s1 leaves detector alone, which failed: no such model"
    assert reply.pause_s == pytest.approx(10.0 - 2.0)
    assert (await first).reason == "no such model"


@played(serve)
async def test_a_start_that_fails_again_and_again_is_tried_in_growing_pauses(daemon: Daemon) -> None:
    daemon.runtime.broken = "no such model"
    pauses_s = []
    for _ in range(4):
        pauses_s.append((await daemon.start()).pause_s)
        assert (await daemon.start()).pause_s == pauses_s[-1], "nothing was tried meanwhile"
        await asyncio.sleep(pauses_s[-1])
    assert pauses_s == [10.0, 20.0, 40.0, 80.0]


@played(serve, start_timeout_s=5.0)
async def test_a_start_that_takes_too_long_is_given_up(daemon: Daemon) -> None:
    reply = await daemon.start()
    assert "not ready within 5 s" in reply.reason
    assert asyncio.get_running_loop().time() == pytest.approx(5.0)


@played(serve)
async def test_a_crashed_instance_is_absent_and_started_again_on_request(daemon: Daemon) -> None:
    first = await daemon.start()
    daemon.runtime.instances[0].ended.set_result("killed by SIGKILL")
    await asyncio.sleep(0.1)
    assert (await daemon.ask()).endpoints == {}
    second = await daemon.start()
    assert second.endpoint not in ("", first.endpoint)


@played(serve)
async def test_what_a_crashed_instance_leaves_is_removed_though_the_daemon_closes(daemon: Daemon) -> None:
    await daemon.start()
    daemon.runtime.instances[0].ended.set_result("killed by SIGKILL")
    await asyncio.sleep(0.1)
    await daemon.edge.close()
    assert daemon.runtime.instances[0].is_removed


@played(serve)
async def test_what_a_cancelled_start_leaves_is_removed_though_the_daemon_closes(daemon: Daemon) -> None:
    daemon.runtime.removes_in_s = 5.0
    waiting = asyncio.create_task(daemon.start())
    await asyncio.sleep(1.0)
    await reload(daemon, "2")
    await asyncio.sleep(1.0)
    await daemon.edge.close()
    assert daemon.runtime.removed == 1
    assert (await waiting).reason == "this daemon has ended"


@played(serve)
async def test_an_instance_that_a_call_keeps_busy_is_replaced_and_the_next_one_served(
    daemon: Daemon,
    *,
    caplog: pytest.LogCaptureFixture,
) -> None:
    first = await daemon.start()
    daemon.runtime.called[0]("d1")
    daemon.runtime.instances[0].call_ends_in_s = 1e6
    await daemon.keep_asking(CALL_LIMIT_S + 5.1)
    assert daemon.runtime.instances[0].refuses.startswith("detector of s1 is replaced: a call has kept it")
    await daemon.keep_asking(2.0 + 1.0 + COLD_START_S)
    assert (await daemon.ask()).endpoints["detector"] not in ("", first.endpoint)
    assert daemon.edge.standing().servers[0].instances[1].replaced == 1
    assert "stopping detector@s1: detector of s1 is replaced: a call has kept it" in caplog.text
    await daemon.keep_asking(200.0)
    assert len(daemon.runtime.instances) == 2, "one that is well stays"


@played(serve)
async def test_a_call_that_takes_too_long_is_noticed_within_5_s(daemon: Daemon) -> None:
    await daemon.start()
    await asyncio.sleep(2.9)
    daemon.runtime.called[0]("d1")
    for _ in range(3):
        await asyncio.sleep(CALL_LIMIT_S / 3)
        daemon.edge.seen("s1", "d1")
        assert not daemon.runtime.instances[0].refuses
    await asyncio.sleep(2.2)  # it was looked at 2.9 s before the call, and every 5 s since
    assert daemon.runtime.instances[0].refuses


@played(serve)
async def test_a_drone_that_waits_for_the_next_instance_gets_it_also_where_the_former_crashes_in_its_last_call(
    daemon: Daemon,
) -> None:
    first = await daemon.start()
    daemon.runtime.called[0]("d1")
    daemon.runtime.instances[0].call_ends_in_s = 1e6
    while not daemon.runtime.instances[0].refuses:
        await daemon.keep_asking(1.0)
    starting = asyncio.create_task(daemon.start())
    await asyncio.sleep(0.1)
    daemon.runtime.instances[0].ended.set_result("killed by SIGKILL")
    assert (await starting).endpoint not in ("", first.endpoint)


@played(serve)
async def test_an_instance_of_no_use_has_2_s_for_other_calls_and_30_s_to_be_gone(daemon: Daemon) -> None:
    await daemon.start()
    (instance,) = daemon.runtime.instances
    instance.call_ends_in_s = instance.stops_in_s = 1e6
    daemon.runtime.called[0]("d1")
    while not instance.refuses:
        await daemon.keep_asking(0.09)
    began_s = asyncio.get_running_loop().time()
    while len(daemon.runtime.instances) == 1:
        await daemon.keep_asking(0.09)
    replaced_s = asyncio.get_running_loop().time() - began_s
    assert replaced_s == pytest.approx(2.0 + STOP_S + COLD_START_S, abs=0.3)
    instance.ended.set_result("at last")


@played(serve)
async def test_a_peer_that_is_silent_is_waited_for_as_long_as_it_may_take(daemon: Daemon) -> None:
    await daemon.start()
    daemon.peer_answers_in_s = 2.9
    assert (await daemon.prepare("s2")).reason == "s2 is full"
    daemon.peer_answers_in_s = 3.1
    began_s = asyncio.get_running_loop().time()
    reply = await daemon.prepare("s2")
    assert "no answer within 3.0 s" in reply.reason
    assert not reply.held
    assert asyncio.get_running_loop().time() - began_s == pytest.approx(3.0)


@played(serve)
async def test_a_slot_that_is_not_there_is_not_held(daemon: Daemon) -> None:
    await daemon.start()
    reply = await daemon.hold("d2", for_s=5.0)
    assert (reply.held, "no free slot" in reply.reason) == (False, True)
    reply = await daemon.prepare("s9")
    assert (reply.held, "s9" in reply.reason) == (False, True)


@played(serve)
async def test_an_instance_without_a_sign_of_life_is_replaced(daemon: Daemon) -> None:
    await daemon.start()
    await daemon.keep_asking(1000.0)
    daemon.runtime.instances[0].is_frozen = True
    await daemon.keep_asking(CALL_LIMIT_S - 5.0)
    assert len(daemon.runtime.living()) == 1, "it may be busy"
    await daemon.keep_asking(30.0)
    assert [instance.ended.done() for instance in daemon.runtime.instances] == [True, False]


@played(serve)
async def test_an_instance_that_raises_what_drones_deny_is_replaced(daemon: Daemon) -> None:
    await daemon.start()
    for _ in range(DENIALS):
        assert len(daemon.runtime.living()) == 1
        daemon.runtime.called[0]("d1")
        daemon.runtime.answered[0](AnsweredCall("d1", "look", 0.0, 0.1, "raised"))
        await daemon.deny()
    await daemon.keep_asking(1.0 + COLD_START_S)
    assert [instance.ended.done() for instance in daemon.runtime.instances] == [True, False]


@played(serve)
async def test_an_instance_that_does_not_end_is_left_behind_and_another_one_started(
    daemon: Daemon,
    *,
    caplog: pytest.LogCaptureFixture,
) -> None:
    await daemon.start()
    stuck = daemon.runtime.instances[0]
    stuck.stops_in_s = 1e6
    daemon.runtime.called[0]("d1")
    await daemon.keep_asking(CALL_LIMIT_S + 5.1)
    await daemon.keep_asking(STOP_S + COLD_START_S)
    assert daemon.runtime.living()[1:], "another one runs"
    assert "is left behind" in caplog.text
    stuck.ended.set_result("at last")


@played(serve)
async def test_an_idle_instance_is_stopped_and_a_start_meanwhile_waits_for_a_new_one(
    daemon: Daemon, *, caplog: pytest.LogCaptureFixture
) -> None:
    first = await daemon.start()
    daemon.runtime.instances[0].call_ends_in_s = 1000.0  # a call of a drone without a slot
    await daemon.leave()
    await asyncio.sleep(100.5)  # idle_stop_s, and a look; it takes another second to stop
    assert len(daemon.runtime.living()) == 1
    began_s = asyncio.get_running_loop().time()
    second = await daemon.start()
    assert second.endpoint not in ("", first.endpoint)
    assert len(daemon.runtime.living()) == 1
    assert asyncio.get_running_loop().time() - began_s <= 1.0 + COLD_START_S
    assert "stopping" not in caplog.text, "there is nothing to say"


@played(serve)
async def test_a_daemon_that_closes_waits_for_an_instance_that_is_being_stopped(daemon: Daemon) -> None:
    await daemon.start()
    await daemon.leave()
    await asyncio.sleep(100.5)
    assert len(daemon.runtime.living()) == 1
    await daemon.edge.close()
    assert daemon.runtime.living() == []


@played(serve)
async def test_a_daemon_that_closes_ends_what_it_drains(
    daemon: Daemon, *, caplog: pytest.LogCaptureFixture
) -> None:
    await daemon.start()
    daemon.runtime.instances[0].call_ends_in_s = 1e6
    draining = asyncio.create_task(daemon.edge.drain("shutting down"))
    await asyncio.sleep(1.0)
    await daemon.edge.close()
    assert draining.done()
    assert asyncio.get_running_loop().time() == pytest.approx(COLD_START_S + 1.0 + 1.0)
    await asyncio.sleep(1.0)
    assert "it has ended" not in caplog.text, "the daemon ended it"


@played(serve, slots=2)
async def test_an_instance_that_cannot_be_told_whom_to_admit_is_stopped(daemon: Daemon) -> None:
    await daemon.start("d1")
    daemon.runtime.instances[0].deaf = True
    await daemon.ask("d2")
    await asyncio.sleep(2)
    assert daemon.runtime.living() == []


@pytest.mark.parametrize(
    ("path", "body", "drone", "reason"),
    [
        (AVAILABILITY, b"\xc1garbage", "d1", "undecodable"),
        (AVAILABILITY, msgspec.msgpack.encode({"server": "s1"}), "d1", "undecodable"),
        (AVAILABILITY, msgspec.msgpack.encode(AvailabilityRequest("s1", [])), "", "names no drone"),
        ("/upwash.Daemon/Reboot", b"", "d1", "no such request"),
    ],
)
@played(serve)
async def test_what_is_not_understood_is_refused(
    daemon: Daemon,
    *,
    path: str,
    body: bytes,
    drone: str,
    reason: str,
) -> None:
    with pytest.raises(Refused, match=reason):
        await daemon.edge.handle(path, body, Client(drone))


@played(serve)
async def test_a_server_that_is_not_here_is_named_with_those_that_are(daemon: Daemon) -> None:
    request = msgspec.msgpack.encode(AvailabilityRequest("s9", ["detector"]))
    reply = msgspec.msgpack.decode(
        await daemon.edge.handle(AVAILABILITY, request, Client("d1")), type=AvailabilityReply
    )
    assert not reply.available
    assert "s9" in reply.reason and "s1" in reply.reason


# ---- the operator


@played(serve)
async def test_a_drain_lets_the_call_under_way_end_and_refuses_what_is_new(
    daemon: Daemon,
    *,
    caplog: pytest.LogCaptureFixture,
) -> None:
    await daemon.start()
    (instance,) = daemon.runtime.instances
    instance.call_ends_in_s = 3.0
    draining = asyncio.create_task(daemon.edge.drain("shutting down"))
    await asyncio.sleep(1.0)
    assert instance.refuses == "shutting down"
    assert (await daemon.ask()).reason == "shutting down"
    assert (await daemon.start()).reason == "shutting down"
    assert not instance.ended.done(), "stopped in a call"
    await draining
    assert asyncio.get_running_loop().time() == pytest.approx(COLD_START_S + 3.0)
    assert "stopping" not in caplog.text, "the operator knows"


@played(serve)
async def test_a_drain_waits_for_no_call_longer_than_it_may(daemon: Daemon) -> None:
    await daemon.start()
    daemon.runtime.instances[0].call_ends_in_s = 1000.0
    await daemon.edge.drain("shutting down")
    assert asyncio.get_running_loop().time() == pytest.approx(COLD_START_S + DRAIN_S)


@played(serve)
async def test_a_drain_gives_up_what_starts_and_says_why_to_the_drone_that_waits(daemon: Daemon) -> None:
    starting = asyncio.create_task(daemon.start())
    await asyncio.sleep(1.0)
    await daemon.edge.drain("shutting down")
    assert (await starting).reason == "shutting down"
    assert daemon.runtime.instances == []


@played(serve)
async def test_a_daemon_that_is_closed_while_a_drone_waits_starts_nothing_more(daemon: Daemon) -> None:
    starting = asyncio.create_task(daemon.start())
    await asyncio.sleep(1.0)
    await daemon.edge.close()
    assert (await starting).reason == "this daemon has ended"


async def reload(daemon: Daemon, version: str, services: tuple[str, ...] = ("detector",)) -> None:
    offers = {"s1": ServerOffer(frozenset(services), 1)}
    images = {service: Image(Program("somewhere:Detector"), version=version) for service in services}
    daemon.edge.reload(offers, images=images)
    await asyncio.sleep(0)  # until it is carried out


def detector_of(daemon: Daemon) -> InstanceStatus:
    (status,) = [
        instance for instance in daemon.edge.standing().servers[0].instances if instance.service == "detector"
    ]
    return status


@played(serve)
async def test_another_version_takes_over_once_it_is_ready_and_the_former_ends_when_drones_know_its_address(
    daemon: Daemon,
) -> None:
    running = (await daemon.start()).endpoint
    (former,) = daemon.runtime.instances
    await reload(daemon, "2")
    await daemon.keep_asking(COLD_START_S - 1.0)
    assert (await daemon.ask()).endpoints == {"detector": running}
    await asyncio.sleep(2.0)
    (_, latter) = daemon.runtime.instances
    assert (await daemon.ask()).endpoints == {"detector": latter.endpoint}
    assert latter.admitted == former.admitted == {"d1"}
    await daemon.keep_asking(LEASE_S / 2)
    assert not former.refuses, "a drone may not have asked yet"
    await daemon.keep_asking(LEASE_S)
    assert "another version of detector" in former.refuses
    assert daemon.runtime.living() == [latter]
    assert detector_of(daemon).renewed == 1
    await reload(daemon, "2")
    await daemon.keep_asking(COLD_START_S + 1.0)
    assert daemon.runtime.living() == [latter], "nothing has changed"


@played(serve)
async def test_a_drone_meets_no_instance_of_another_version_that_does_not_know_it_yet(daemon: Daemon) -> None:
    await daemon.start()
    daemon.runtime.admits_in_s = 3.0
    await reload(daemon, "2")
    for _ in range(100):
        await asyncio.sleep(0.5)
        (endpoint,) = (await daemon.ask()).endpoints.values()
        (instance,) = [each for each in daemon.runtime.instances if each.endpoint == endpoint]
        assert instance.admitted == {"d1"}
    assert len(daemon.runtime.instances) == 2


@played(serve)
async def test_a_version_that_does_not_start_leaves_the_former_and_is_tried_again_at_the_next_reload(
    daemon: Daemon, *, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, logger="upwash.server")
    running = (await daemon.start()).endpoint
    daemon.runtime.broken = "detector@s1 did not start: a typing error"
    await reload(daemon, "2")
    await daemon.keep_asking(2 * LEASE_S)
    assert (await daemon.ask()).endpoints == {"detector": running}
    assert "detector@s1: another version starts beside the one that serves" in caplog.text
    assert "detector@s1 serves on in its former version" in caplog.text
    status = detector_of(daemon)
    assert (status.renewed, status.not_renewed) == (0, daemon.runtime.broken)
    assert (status.failures, status.paused_s) == (0, 0.0), "what serves did not fail"
    daemon.runtime.broken = ""
    await reload(daemon, "2")
    await daemon.keep_asking(COLD_START_S + 1.0)
    assert (await daemon.ask()).endpoints["detector"] != running
    status = detector_of(daemon)
    assert (status.renewed, status.not_renewed) == (1, "")


@played(serve)
async def test_of_several_versions_in_a_row_the_last_one_takes_over(daemon: Daemon) -> None:
    await daemon.start()
    for version in ("2", "3", "4"):
        await reload(daemon, version)
        await asyncio.sleep(COLD_START_S / 2)
    await daemon.keep_asking(2 * LEASE_S)
    assert len(daemon.runtime.instances) == 2
    assert detector_of(daemon).renewed == 1


@played(serve)
async def test_where_the_former_crashes_its_drone_waits_for_the_version_that_starts(daemon: Daemon) -> None:
    await daemon.start()
    (former,) = daemon.runtime.instances
    await reload(daemon, "2")
    await asyncio.sleep(COLD_START_S / 2)
    former.ended.set_result("it was killed")
    await asyncio.sleep(0.1)
    reply = await daemon.start()
    assert reply.endpoint == daemon.runtime.instances[1].endpoint
    assert len(daemon.runtime.instances) == 2


@played(serve)
async def test_a_former_version_that_cannot_be_told_whom_to_admit_is_stopped(daemon: Daemon) -> None:
    await daemon.start()
    await reload(daemon, "2")
    await asyncio.sleep(COLD_START_S + 1.0)
    former, latter = daemon.runtime.living()
    former.deaf = True
    await daemon.leave()
    await asyncio.sleep(2.0)
    assert daemon.runtime.living() == [latter]


@played(serve)
async def test_a_service_that_is_withdrawn_ends_in_every_version(daemon: Daemon) -> None:
    await daemon.start()
    await reload(daemon, "2")
    await asyncio.sleep(COLD_START_S + 1.0)
    await reload(daemon, "3")
    assert len(daemon.runtime.living()) == 2
    await reload(daemon, "3", ("counter",))
    await asyncio.sleep(COLD_START_S + 1.0)
    assert daemon.runtime.living() == []


@played(serve)
async def test_no_daemon_takes_anothers_place_without_a_service_that_ran_there(daemon: Daemon) -> None:
    daemon.runtime.broken = "detector@s1 did not start: no such model"
    with pytest.raises(InstanceError, match=r"the daemon before stays, whose services run: .* no such model"):
        await daemon.edge.take_up("s1", [Client("d1")], ["detector"])
    daemon.runtime.broken = ""
    await daemon.edge.take_up("s1", [Client("d1")], ["counter"])


@played(serve)
async def test_an_instance_that_starts_is_stopped_for_another_version_and_its_drone_waits_for_that(
    daemon: Daemon,
) -> None:
    waiting = asyncio.create_task(daemon.start())
    await asyncio.sleep(COLD_START_S / 2)
    await reload(daemon, "2")
    reply = await waiting
    assert [each.endpoint for each in daemon.runtime.living()] == [reply.endpoint]


@played(serve)
async def test_a_certificate_that_is_revoked_is_admitted_to_no_instance_any_more(daemon: Daemon) -> None:
    request = msgspec.msgpack.encode(StartRequest("s1", "detector"))
    await daemon.edge.handle(START, request, Client("d1", "0a"))
    (instance,) = daemon.runtime.instances
    assert instance.admitted == {"0a"}
    daemon.edge.revoke(frozenset({"0a"}))
    await asyncio.sleep(0.1)
    assert instance.admitted == frozenset()


@played(serve)
async def test_its_status_is_for_operators(daemon: Daemon) -> None:
    await daemon.start("d1")
    await daemon.ask("d2")
    request = msgspec.msgpack.encode(StatusRequest())
    with pytest.raises(Refused, match="d1 is no operator"):
        await daemon.edge.handle(STATUS, request, Client("d1", "0a"))
    reply = await daemon.edge.handle(STATUS, request, Client("alice", "0c", role=Role.OPERATOR))
    status = msgspec.msgpack.decode(reply, type=StatusReply)
    assert status.up_s == pytest.approx(COLD_START_S)
    reply = await Daemon().edge.handle(STATUS, request, Client("alice", "0c", role=Role.OPERATOR))
    assert msgspec.msgpack.decode(reply, type=StatusReply).up_s == 0.0
    assert [lease.drone for lease in status.servers[0].leases] == ["d1"]
    assert [refusal.why for refusal in status.refusals] == [
        "d1 is no operator: show a certificate of `upwash keys DIR --operator NAME`",
        "s1 has no free slot: 1 of 1 in use",
    ]


@pytest.mark.parametrize("defective", ["start", "exited", "drain"])
def test_a_defect_in_an_instances_life_ends_the_daemon_with_that_failure(
    monkeypatch: pytest.MonkeyPatch, defective: str
) -> None:
    async def fail(*_: object, **__: object) -> None:
        raise ZeroDivisionError("a defect")

    async def story() -> None:
        daemon = Daemon()
        if defective == "start":
            monkeypatch.setattr(daemon.runtime, "start", fail)
        else:
            monkeypatch.setattr(Instance, defective, fail)
        running = asyncio.create_task(daemon.edge.run())
        await daemon.ask()
        asking = asyncio.create_task(daemon.start())
        if defective == "drain":
            await asking
            daemon.edge.reload({"s1": ServerOffer(frozenset(), 1)}, images={})
        async with asyncio.timeout(60.0):
            with pytest.raises(ZeroDivisionError, match="a defect"):
                await running
        asking.cancel()
        await daemon.edge.close()

    run_virtually(story())


def test_the_log_says_at_the_end_of_each_lease_who_used_what(caplog: pytest.LogCaptureFixture) -> None:
    async def story(daemon: Daemon) -> None:
        await daemon.start("d1")
        for took_s in (0.5, 0.75):
            daemon.runtime.answered[0](AnsweredCall("d1", "process_photo", 0.0, took_s))
        await daemon.leave("d1")
        await daemon.hold("d2", for_s=3.0)
        await asyncio.sleep(3.5)
        await daemon.ask("d3")
        await asyncio.sleep(2.0)
        await daemon.edge.drain("it ends")

    with caplog.at_level(logging.INFO, logger="upwash.usage"):
        serve(story)
    said = [record.getMessage() for record in caplog.records if record.name == "upwash.usage"]
    assert said == [
        f"s1: d1 had a slot for {COLD_START_S:.1f} s: calls answered 2, seconds of computing 1.2",
        "s1: d2 did not come: a slot was held for 3.0 s, as s2 asked",
        "s1: d3 had a slot for 2.0 s: calls answered 0, seconds of computing 0.0",
    ]
