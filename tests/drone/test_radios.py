"""What a radio does at a server by command, and what the core hears of it, on virtual time."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

import msgspec
import pytest
from tests.drone.test_server_session import DAEMON, FULL, READY, Field, now_s

from upwash.core.operation import Operation
from upwash.core.selection import events
from upwash.core.selection.commands import Check, Leave, Prepare, Probe, RadioCommand, Start
from upwash.core.selection.recovery import Probing
from upwash.drone.radios import RadioWorker, RadioWorkers
from upwash.drone.server_session import ServerEndpoint
from upwash.errors import NetworkError, Unreachable
from upwash.eventlog import schema
from upwash.rpc.protocol import AVAILABILITY, HEALTH_CHECK, LEAVE, PREPARE, START, HoldReply, StartReply
from upwash.rpc.protocol import AvailabilityReply as Answer
from upwash.sim.loop import run_virtually

CHECK = Check("s1", 4, 5.0)
PROBE = Probe("s1", 4, 5.0, 0.0, Probing(1.0, 1.0))
WANT = Prepare("s1", 4, "s2", 20.0, 5.0)
BYE = Leave("s1", 4)
JOINED = schema.Joined(server="s1", network="field", check=4)
RUNS = events.CheckAnswered(4, running=True, peers=("s2",), waiting=3)
CUT = events.RemoteCallCut("s1", Operation("detector", "look"), 2.0)


class Radio(Field):
    """A worker at the network with its server; it notes what the core is told, and when."""

    def __init__(self) -> None:
        super().__init__()
        self.told: list[tuple[float, Any]] = []
        self.in_range = True
        self.moves = asyncio.Event()
        self.joins_s = 0.0
        endpoint = ServerEndpoint("s1", "field", DAEMON, ("counter", "detector"))
        this: Any = self
        self.worker = RadioWorker(
            lambda _: self.in_range,
            {"s1": endpoint, "s2": msgspec.structs.replace(endpoint, name="s2", address="s2:7")},
            network=self,
            dialer=this,
            journal=self,
            tell=self.record,
            told=self.until_told,
        )

    def record(self, event: object) -> None:
        self.told.append((now_s(), event))

    async def until_told(self) -> None:
        await self.moves.wait()

    async def join(self, network: str, *, timeout_s: float) -> None:
        await asyncio.sleep(self.joins_s)
        if self.joins_s > timeout_s:
            raise NetworkError("too far")
        await super().join(network, timeout_s=timeout_s)

    async def sent(self, *commands: RadioCommand, lasts_s: float = 0.0) -> list[Any]:
        """What was told because of the commands, and until some time after."""
        for command in commands:
            self.worker.send(command)
        await self.worker.done()
        await asyncio.sleep(lasts_s + 1e-3)
        told, self.told = self.told, []
        return [event for _, event in told]


def tell(story: Callable[[Radio], Awaitable[None]]) -> None:
    async def run() -> None:
        radio = Radio()
        working = asyncio.create_task(radio.worker.run())
        await story(radio)
        working.cancel()
        await asyncio.gather(working, return_exceptions=True)

    run_virtually(run())


def test_a_check_joins_asks_and_keeps_the_lease_until_the_server_is_left() -> None:
    async def story(radio: Radio) -> None:
        radio.answers_in_s = 0.25
        assert await radio.sent(CHECK, lasts_s=1.0) == [JOINED, RUNS]
        assert radio.worker.round_trip_s("s1") == 0.25
        assert radio.worker.round_trip_s("s2") is None
        assert await radio.sent(lasts_s=21.0) == [events.LeaseRenewed(4, 3)] * 2
        assert await radio.sent(BYE, lasts_s=60.0) == []
        assert radio.ends.cancelled(), "its network is watched no more"
        assert radio.said[-1] == (DAEMON, LEAVE)
        assert (radio.network, radio.worker.session) == (["join field 5", "leave"], None)
        assert radio.worker.round_trip_s("s1") is None

    tell(story)


def test_waiting_drones_are_told_with_each_renewal_and_once_more_when_they_are_gone() -> None:
    async def story(radio: Radio) -> None:
        radio.replies[AVAILABILITY] = msgspec.structs.replace(READY, waiting=0)
        await radio.sent(CHECK)
        told = []
        for waiting in (0, 2, 2, 0, 0):
            radio.replies[AVAILABILITY] = msgspec.structs.replace(READY, waiting=waiting)
            told.append(await radio.sent(lasts_s=10.0))
        assert told == [[], *[[events.LeaseRenewed(4, count)] for count in (2, 2, 0)], []]

    tell(story)


def test_a_slot_that_is_taken_and_a_service_that_moves_are_told() -> None:
    async def story(radio: Radio) -> None:
        await radio.sent(CHECK)
        radio.replies[AVAILABILITY] = msgspec.structs.replace(
            READY, waiting=0, endpoints={"detector": ":9", "counter": ":2"}
        )
        assert await radio.sent(lasts_s=10.0) == [
            schema.ServiceMoved(server="s1", check=4, service="detector")
        ]
        radio.replies[AVAILABILITY] = FULL
        assert await radio.sent(lasts_s=10.0) == [events.SlotTaken(4, "s1: full")]
        asked = len(radio.said)
        await radio.sent(lasts_s=60.0)
        assert len(radio.said) == asked

    tell(story)


def test_a_full_server_is_asked_again_when_it_says_so() -> None:
    async def story(radio: Radio) -> None:
        radio.replies[AVAILABILITY] = FULL
        assert await radio.sent(CHECK, lasts_s=14.0) == [JOINED, *[events.SlotRefused(4, 2)] * 3]
        radio.replies[AVAILABILITY] = READY
        assert await radio.sent(lasts_s=7.0) == [RUNS]

    tell(story)


@pytest.mark.parametrize(
    ("reply", "unreached", "pause_s"),
    [
        (Unreachable("silent"), True, 0.0),
        (Answer(available=False, reason="closing"), False, 0.0),
        (Answer(available=False, reason="it crashes", pause_s=9.0), False, 9.0),
    ],
)
def test_a_check_that_fails_is_told_with_what_it_shows(reply: Any, unreached: bool, pause_s: float) -> None:
    async def story(radio: Radio) -> None:
        radio.replies[AVAILABILITY] = reply
        joined, failed = await radio.sent(CHECK)
        assert (joined, failed.check) == (JOINED, 4)
        assert (failed.unreached, failed.pause_s) == (unreached, pause_s)

    tell(story)


def test_a_network_that_cannot_be_joined_or_is_lost_is_told() -> None:
    async def story(radio: Radio) -> None:
        radio.joins_s = 6.0
        assert await radio.sent(CHECK, lasts_s=6.0) == [events.ServerUnusable(4, "too far", unreached=True)]
        radio.joins_s = 0.0
        await radio.sent(CHECK)
        radio.ends.set_result("no beacon")
        assert await radio.sent() == [events.NetworkGone(4, "no beacon")]

    tell(story)


def test_services_that_do_not_run_are_started_by_command_and_the_lease_is_kept_from_then_on() -> None:
    async def story(radio: Radio) -> None:
        radio.replies[AVAILABILITY] = Answer(available=True, lease_s=30.0, waiting=1)
        assert await radio.sent(CHECK, lasts_s=30.0) == [
            JOINED,
            events.CheckAnswered(4, running=False, waiting=1),
        ]
        radio.replies[START] = StartReply(reason="full", waiting=1, ask_again_s=3.0)
        assert await radio.sent(Start("s1", 4, 60.0)) == [events.SlotRefused(4, 1)]
        radio.replies[START] = StartReply(endpoint=":5")
        assert await radio.sent(lasts_s=3.0) == [events.ServicesStarted(4)]
        assert 60.0 in radio.timeouts_s
        assert await radio.sent(lasts_s=10.0) == [events.LeaseRenewed(4, 1)]

    tell(story)


def test_services_that_cannot_be_started_make_the_server_unusable() -> None:
    async def story(radio: Radio) -> None:
        radio.replies |= {
            AVAILABILITY: Answer(available=True, lease_s=30.0),
            START: StartReply(reason="no model"),
        }
        await radio.sent(CHECK)
        assert await radio.sent(Start("s1", 4, 60.0), lasts_s=60.0) == [
            events.ServerUnusable(4, "s1 cannot start counter: no model")
        ]

    tell(story)


def test_a_peer_is_prepared_and_only_the_latest_wish_is_told() -> None:
    async def story(radio: Radio) -> None:
        assert await radio.sent(WANT, Start("s1", 4, 60.0)) == [], "there is no session"
        await radio.sent(CHECK)
        radio.replies[PREPARE] = HoldReply(held=True)
        assert await radio.sent(WANT) == [events.PeerPrepared("s2", "s1")]
        radio.replies[PREPARE] = HoldReply(held=False, reason="s2 is full")
        assert await radio.sent(WANT) == [schema.NotPrepared(server="s2", by="s1", why="s2 is full")]
        radio.answers_in_s = 2.0
        assert await radio.sent(WANT, WANT, lasts_s=3.0) == [
            schema.NotPrepared(server="s2", by="s1", why="s2 is full")
        ]
        assert radio.bodies[-1]["arrives_in_s"] == 20.0
        radio.worker.send(WANT)
        assert await radio.sent(BYE, lasts_s=3.0) == [], "a server that is left is asked for nothing more"

    tell(story)


def test_a_check_takes_the_place_of_the_one_before() -> None:
    async def story(radio: Radio) -> None:
        radio.answers_in_s = 1.0
        await radio.sent(CHECK)
        radio.replies[AVAILABILITY] = msgspec.structs.replace(READY, endpoints={}, peers=[], waiting=0)
        again = Check("s1", 5, 5.0)
        assert await radio.sent(again, lasts_s=5.0) == [events.CheckAnswered(5, running=False)]

    tell(story)


def test_the_radios_are_done_once_each_has_left() -> None:
    async def story(radio: Radio) -> None:
        radio.answers_in_s = 0.25
        radios = RadioWorkers([radio.worker])
        radios.send(CHECK)
        await asyncio.sleep(1.0)
        radios.send(BYE)
        await radios.done()
        assert (radio.said[-1], radio.network[-1]) == ((DAEMON, LEAVE), "leave")

    tell(story)


def test_a_server_that_is_left_in_a_check_is_told_of_no_more() -> None:
    async def story(radio: Radio) -> None:
        radio.answers_in_s = 1.0
        assert await radio.sent(CHECK) == [JOINED]
        assert await radio.sent(BYE, lasts_s=60.0) == []
        assert await radio.sent(BYE) == [], "it is left already"

    tell(story)


@pytest.mark.parametrize("flies_out", [False, True])
def test_a_left_server_finishes_its_calls_unless_the_drone_flies_out_of_range_meanwhile(
    flies_out: bool,
) -> None:
    async def story(radio: Radio) -> None:
        await radio.sent(CHECK)
        assert radio.worker.session is not None
        radio.answers_in_s = 4.0
        call = asyncio.create_task(radio.worker.session.call("detector", "look", b"", deadline_s=9.0))
        await asyncio.sleep(1.0)
        radio.answers_in_s = 0.0
        radio.worker.send(BYE)
        await asyncio.sleep(1.0)
        radio.in_range = not flies_out
        radio.moves.set()
        radio.moves.clear()
        begun_s = now_s()
        await radio.worker.done()
        assert now_s() - begun_s == pytest.approx(0.0 if flies_out else 2.0, abs=0.01)
        assert (radio.said[-1] == (DAEMON, LEAVE)) == (not flies_out)
        assert (sorted(radio.closed), radio.network[-1]) == (["s1:1", "s1:2", DAEMON], "leave")
        await call

    tell(story)


@pytest.mark.parametrize(("in_range", "silent"), [(True, False), (True, True), (False, False)])
def test_a_call_that_was_cut_is_told_where_the_daemon_still_answers(in_range: bool, silent: bool) -> None:
    async def story(radio: Radio) -> None:
        await radio.sent(CHECK)
        radio.worker.cut = CUT
        radio.in_range = in_range
        if silent:
            radio.replies[LEAVE] = Unreachable("silent")
        assert await radio.sent(BYE) == ([CUT] if in_range and not silent else [])
        await radio.sent(CHECK)
        assert await radio.sent(BYE) == [], "and once"

    tell(story)


def test_probes_overlap_until_the_first_answer_on_connections_of_their_own() -> None:
    async def story(radio: Radio) -> None:
        await radio.sent(CHECK)
        radio.worker.cut = CUT
        assert radio.worker.session is not None
        radio.worker.session.deny("detector")
        connections = list(radio.dialled)
        radio.answers_in_s = 1.25
        assert await radio.sent(PROBE, lasts_s=2.0) == [events.ProbeUnanswered(4)]
        assert sorted(radio.closed) == sorted(connections)
        radio.answers_in_s = 0.0
        assert await radio.sent(lasts_s=0.5) == [events.ProbeAnswered(4, running=True)]
        assert radio.network == ["join field 5"]
        assert {"server": "s1", "services": ["detector"]} in radio.bodies, "what the drone denies is reported"
        asked = len(radio.said)
        assert await radio.sent(lasts_s=60.0) == []
        assert len(radio.said) == asked
        assert await radio.sent(BYE) == [], "what a probed server cut is nothing new"

    tell(story)


def test_a_probe_joins_where_it_must_and_again_where_it_could_not() -> None:
    async def story(radio: Radio) -> None:
        radio.joins_s = 6.0
        assert await radio.sent(PROBE, lasts_s=8.0) == [events.ProbeUnanswered(4)]
        radio.joins_s = 0.0
        assert await radio.sent(lasts_s=10.0) == [JOINED, events.ProbeAnswered(4, running=True)]

    tell(story)


def test_a_network_that_is_lost_in_a_probe_is_joined_again_and_no_news() -> None:
    async def story(radio: Radio) -> None:
        radio.replies[AVAILABILITY] = Unreachable("silent")
        await radio.sent(PROBE, lasts_s=1.5)
        radio.ends.set_result("no beacon")
        radio.ends = asyncio.get_running_loop().create_future()
        assert await radio.sent(lasts_s=1.0) == [events.ProbeUnanswered(4), JOINED]
        radio.ends.set_result("no beacon")
        radio.ends = asyncio.get_running_loop().create_future()
        assert await radio.sent(lasts_s=1.0) == [events.ProbeUnanswered(4), JOINED]

    tell(story)


def test_a_probe_that_is_told_of_a_pause_ends_with_it() -> None:
    async def story(radio: Radio) -> None:
        radio.replies[AVAILABILITY] = Answer(available=False, reason="it crashes", pause_s=9.0)
        (joined, paused) = await radio.sent(PROBE, lasts_s=60.0)
        assert (joined, paused.pause_s) == (JOINED, 9.0)

    tell(story)


@pytest.mark.parametrize("endpoints", [{}, {"detector": ":1", "counter": ":2"}])
def test_a_probe_says_whether_all_services_run(endpoints: dict[str, str]) -> None:
    async def story(radio: Radio) -> None:
        radio.replies[AVAILABILITY] = Answer(available=True, endpoints=endpoints)
        assert await radio.sent(PROBE, lasts_s=1.0) == [JOINED, events.ProbeAnswered(4, bool(endpoints))]
        assert [path for _, path in radio.said] == [AVAILABILITY, *[HEALTH_CHECK] * len(endpoints)]

    tell(story)


def test_a_server_has_the_radio_that_knows_it_if_that_is_free() -> None:
    class Worker:
        def __init__(self) -> None:
            self.sent: list[RadioCommand] = []

        def send(self, command: RadioCommand) -> None:
            self.sent.append(command)

    def leave(server: str) -> Leave:
        return Leave(server, 4)

    def check(server: str) -> Check:
        return Check(server, 4, 5.0)

    workers: list[Any] = [Worker(), Worker()]
    radios = RadioWorkers(workers)
    for command in (check("a"), check("b"), leave("a"), leave("b"), check("b"), check("a"), leave("b")):
        radios.send(command)
    assert workers[0].sent == [check("a"), leave("a"), check("a")]
    assert workers[1].sent == [check("b"), leave("b"), check("b"), leave("b")]
    assert workers.index(radios.worker_at("b")) == 1
    radios.send(leave("a"))
    radios.send(check("c"))
    radios.send(Probe("c", 4, 5.0, 0.0, Probing()))
    radios.send(check("a"))
    assert len(workers[0].sent) == 6, "a is where its radio is busy elsewhere"
    assert workers[1].sent[-1] == check("a")
