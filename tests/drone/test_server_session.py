"""The drone's session with one server, on virtual time; the server's replies are the test's."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

import msgspec
import pytest
from tests.scenarios import scenario, server

from upwash.core.selection.deadlines import AnswerDeadline
from upwash.drone.preparation import endpoints, make_estimates
from upwash.drone.server_session import MOST_MOVES, ServerEndpoint, ServerSession
from upwash.errors import (
    DeadlineExceeded,
    NotReadyInTime,
    Refused,
    ServerFull,
    ServicePaused,
    Unreachable,
)
from upwash.rpc.protocol import (
    AVAILABILITY,
    DENY,
    HEALTH_CHECK,
    LEAVE,
    PREPARE,
    START,
    AvailabilityReply,
    HoldReply,
    LeaveReply,
    StartReply,
)
from upwash.rpc.service import spec_of
from upwash.services import Detector
from upwash.sim.loop import run_virtually

READY = AvailabilityReply(
    available=True, endpoints={"detector": ":1", "counter": ":2"}, lease_s=30.0, peers=["s2"], waiting=3
)
FULL = AvailabilityReply(available=False, reason="full", waiting=2, ask_again_s=7.0)
DAEMON = "s1:7"
Reply = msgspec.Struct | Exception


class Link:
    """A connection of the field; every request is noted."""

    def __init__(self, field: Field, address: str) -> None:
        self.is_far = field.is_far
        self._field = field
        self._address = address

    async def request(
        self, path: str, body: bytes, *, timeout_s: float, may_queue_s: float | None = None
    ) -> bytes:
        self._field.said.append((self._address, path))
        self._field.bodies.append(msgspec.msgpack.decode(body) if body else None)
        self._field.timeouts_s.append(timeout_s)
        await asyncio.sleep(self._field.answers_in_s)
        reply = self._field.replies[path]
        if isinstance(reply, Exception):
            raise reply
        return msgspec.msgpack.encode(reply)

    async def close(self) -> None:
        self._field.closed.append(self._address)


class Field:
    """A network with a server, as dialer and as network."""

    def __init__(self, *, is_far: bool = True, connects: bool = False) -> None:
        self.is_far = is_far
        self.replies: dict[str, Reply] = {
            AVAILABILITY: READY,
            HEALTH_CHECK: Refused("no such method"),
            "/upwash.service.detector/look": LeaveReply(),
            LEAVE: LeaveReply(),
            DENY: LeaveReply(),
        }
        self.answers_in_s = 0.0
        self.dialled: list[str] = []
        self.closed: list[str] = []
        self.said: list[tuple[str, str]] = []
        self.bodies: list[Any] = []
        self.timeouts_s: list[float] = []
        self.network: list[str] = []
        self.ends: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        endpoint = ServerEndpoint("s1", "field", DAEMON, ("counter", "detector"), connects=connects)
        self.session = ServerSession(endpoint, network=self, dialer=self)

    def dial(self, address: str, *, server: str) -> Link:
        assert server == "s1"
        self.dialled.append(address)
        return Link(self, address)

    async def join(self, network: str, *, timeout_s: float) -> None:
        self.network.append(f"join {network} {timeout_s:g}")

    async def leave(self) -> None:
        self.network.append("leave")

    async def lost(self) -> str:
        return await self.ends


def tell(story: Callable[[Field], Awaitable[Any]]) -> Any:
    """Runs a story in a field of its own."""

    async def run() -> Any:
        return await story(Field())

    return run_virtually(run())


def now_s() -> float:
    return asyncio.get_running_loop().time()


@pytest.mark.parametrize("connects", [True, False])
def test_services_nearby_are_connected_before_the_first_call_if_calls_have_deadlines(connects: bool) -> None:
    async def story() -> list[tuple[str, str]]:
        field = Field(is_far=False, connects=connects)
        await field.session.ask()
        return field.said[1:]

    connected = [("s1:2", HEALTH_CHECK), ("s1:1", HEALTH_CHECK)]
    assert run_virtually(story()) == (connected if connects else [])


def test_a_network_is_joined_once_and_again_after_it_was_lost() -> None:
    async def story(field: Field) -> None:
        assert await field.session.join(timeout_s=5.0)
        assert not await field.session.join(timeout_s=5.0)
        await field.session.ask()
        field.ends.set_result("no beacon")
        assert await field.session.lost() == "no beacon"
        assert sorted(field.closed) == ["s1:1", "s1:2", DAEMON]
        field.replies["/upwash.service.detector/look"] = Unreachable("closed")
        with pytest.raises(Unreachable, match=r"^s1: its network was lost: no beacon"):
            await field.session.call("detector", "look", b"", deadline_s=1.0)
        assert await field.session.join(timeout_s=4.0)
        with pytest.raises(Unreachable, match=r"^closed"):
            await field.session.call("detector", "look", b"", deadline_s=1.0)
        assert field.network == ["join field 5", "leave", "join field 4"]

    tell(story)


def test_an_answer_is_connected_to_and_an_address_dialled_once() -> None:
    async def story(field: Field) -> None:
        field.answers_in_s = 0.25
        await asyncio.sleep(3.0)
        answer = await field.session.ask()
        assert (field.session.running, answer.peers, answer.waiting) == (True, ["s2"], 3)
        assert field.session.round_trip_s == pytest.approx(0.25)
        assert field.said == [(DAEMON, AVAILABILITY), ("s1:2", HEALTH_CHECK), ("s1:1", HEALTH_CHECK)]
        assert field.timeouts_s == [5.0] * 3
        await field.session.ask()
        assert field.dialled == [DAEMON, "s1:2", "s1:1"]
        field.replies[AVAILABILITY] = AvailabilityReply(available=True, endpoints={"detector": ":9"})
        await field.session.ask()
        assert field.session.running, "the counter's link is still there"
        assert (field.dialled[3:], field.closed) == (["s1:9"], ["s1:1"])

    tell(story)


@pytest.mark.parametrize("endpoints", [{}, {"detector": ":1"}, {"counter": ":2"}])
def test_a_server_on_which_a_service_is_missing_does_not_run_all(endpoints: dict[str, str]) -> None:
    async def story(field: Field) -> None:
        field.replies[AVAILABILITY] = AvailabilityReply(available=True, endpoints=endpoints)
        await field.session.ask()
        assert not field.session.running
        assert not await field.session.probe()

    tell(story)


def test_a_probe_has_connections_of_its_own_and_closes_them() -> None:
    async def story(field: Field) -> None:
        await field.session.ask()
        asked = len(field.dialled)
        assert await field.session.probe()
        assert sorted(field.dialled[asked:]) == sorted(field.closed) == ["s1:1", "s1:2", DAEMON]
        assert field.said[-3:] == [(DAEMON, AVAILABILITY), ("s1:2", HEALTH_CHECK), ("s1:1", HEALTH_CHECK)]
        field.replies[HEALTH_CHECK] = Unreachable("silent")
        with pytest.raises(Unreachable, match="silent"):
            await field.session.probe()
        field.replies[AVAILABILITY] = FULL
        assert not await field.session.probe()
        assert len(field.closed) == len(field.dialled) - asked

    tell(story)


@pytest.mark.parametrize(
    ("told_s", "kept_s"), [(1e-9, 0.5), (0.5, 0.5), (7.0, 7.0), (30.0, 30.0), (86_400.0, 30.0)]
)
def test_the_time_between_two_questions_for_a_slot_is_bounded(told_s: float, kept_s: float) -> None:
    async def story(field: Field) -> None:
        field.replies[AVAILABILITY] = msgspec.structs.replace(FULL, ask_again_s=told_s)
        with pytest.raises(ServerFull, match=r"^s1: full") as refusal:
            await field.session.ask()
        assert (refusal.value.ask_again_s, refusal.value.waiting) == (kept_s, 2)

    tell(story)


@pytest.mark.parametrize(("told_s", "kept_s"), [(1e-9, 1e-9), (600.0, 600.0), (86_400.0, 600.0)])
def test_the_time_that_a_server_asks_to_be_left_out_is_bounded(told_s: float, kept_s: float) -> None:
    async def story(field: Field) -> None:
        field.replies[AVAILABILITY] = AvailabilityReply(available=False, reason="broken", pause_s=told_s)
        with pytest.raises(ServicePaused, match=r"^s1 is left out for \d+ s: broken") as refusal:
            await field.session.ask()
        assert refusal.value.pause_s == kept_s

    tell(story)


def test_a_server_that_refuses_for_another_reason_is_unavailable() -> None:
    async def story(field: Field) -> None:
        field.replies[AVAILABILITY] = AvailabilityReply(available=False, reason="shutting down")
        with pytest.raises(Refused, match=r"^s1 is unavailable: shutting down$"):
            await field.session.ask()

    tell(story)


def test_only_the_services_that_do_not_run_are_started() -> None:
    async def story(field: Field) -> None:
        field.replies[AVAILABILITY] = AvailabilityReply(available=True, endpoints={"counter": ":2"})
        await field.session.ask()
        field.replies[START] = StartReply(endpoint=":5")
        await field.session.start(timeout_s=60.0)
        assert [said for said in field.said if said[1] == START] == [(DAEMON, START)]
        assert {"server": "s1", "service": "detector"} in field.bodies
        assert 60.0 in field.timeouts_s
        assert field.dialled == [DAEMON, "s1:2", "s1:5"]

    tell(story)


@pytest.mark.parametrize(
    ("reply", "error", "said"),
    [
        (StartReply(reason="no such model"), Refused, "^s1 cannot start counter: no such model$"),
        (StartReply(reason="full", ask_again_s=3.0), ServerFull, "^s1: full$"),
        (StartReply(reason="it crashes", pause_s=9.0), ServicePaused, "^s1 is left out for 9 s: it crashes$"),
    ],
)
def test_a_start_that_is_refused_says_why(reply: Reply, error: type[Exception], said: str) -> None:
    async def story(field: Field) -> None:
        field.replies |= {AVAILABILITY: AvailabilityReply(available=True), START: reply}
        await field.session.ask()
        with pytest.raises(error, match=said):
            await field.session.start(timeout_s=1.0)

    tell(story)


def test_a_patient_start_waits_longer_than_a_daemon_with_the_same_limit() -> None:
    async def story(field: Field) -> None:
        field.replies |= {AVAILABILITY: AvailabilityReply(available=True), START: DeadlineExceeded("late")}
        await field.session.ask()
        with pytest.raises(NotReadyInTime, match="counter and detector at s1"):
            await field.session.start_patiently(within_s=20.0)
        assert field.timeouts_s[-1] == 25.0

    tell(story)


def test_a_peer_is_prepared_through_the_server() -> None:
    async def story(field: Field) -> None:
        await field.session.ask()
        field.replies[PREPARE] = HoldReply(held=True)
        peer = ServerEndpoint("s2", "field", "s2:7", ("detector",))
        await field.session.prepare(peer, arrives_in_s=20.0, hold_s=5.0)
        asked = {"server": "s1", "peer": "s2", "services": ["detector"], "arrives_in_s": 20.0, "hold_s": 5.0}
        assert (field.said[-1], field.bodies[-1]) == ((DAEMON, PREPARE), asked)
        field.replies[PREPARE] = HoldReply(held=False, reason="s2 is full")
        with pytest.raises(Refused, match=r"^s2 is full$"):
            await field.session.prepare(peer, arrives_in_s=20.0, hold_s=5.0)

    tell(story)


def test_a_lease_is_renewed_three_times_in_its_time_until_the_turn_is_over() -> None:
    async def story(field: Field) -> None:
        await field.session.ask()
        renewed: list[tuple[float, int]] = []
        keeping = asyncio.create_task(
            field.session.keep_lease(lambda waiting: renewed.append((now_s(), waiting)))
        )
        await asyncio.sleep(15.0)
        field.replies[AVAILABILITY] = Unreachable("silent")
        await asyncio.sleep(10.0)
        field.replies[AVAILABILITY] = READY
        await asyncio.sleep(10.0)
        assert renewed == [(10.0, 3), (30.0, 3)]
        field.replies[AVAILABILITY] = FULL
        with pytest.raises(ServerFull):
            await keeping
        assert now_s() == 40.0

    tell(story)


def test_calls_follow_a_service_that_moves_but_not_from_port_to_port_for_ever() -> None:
    async def story(field: Field) -> None:
        await field.session.ask()
        moved: list[str] = []
        keeping = asyncio.create_task(field.session.keep_lease(moved=moved.append))
        call = asyncio.create_task(field.session.call("detector", "look", b"", deadline_s=99.0))
        field.answers_in_s = 12.0  # longer than to the first move
        await asyncio.sleep(1.0)
        field.answers_in_s = 0.0
        for port in range(100, 100 + MOST_MOVES + 5):
            field.replies[AVAILABILITY] = msgspec.structs.replace(
                READY, endpoints={"detector": f":{port}", "counter": ":2"}
            )
            await asyncio.sleep(10.0)
            if port == 100:
                assert not call.done() and field.closed == [], "the call may end there"
        await call
        assert moved == ["detector"] * MOST_MOVES
        await field.session.call("detector", "look", b"", deadline_s=1.0)
        assert field.said[-1] == (f"s1:{99 + MOST_MOVES}", "/upwash.service.detector/look")
        assert field.closed == ["s1:1", *(f"s1:{port}" for port in range(100, 99 + MOST_MOVES))]
        await field.session.ask()
        field.replies[AVAILABILITY] = READY
        await asyncio.sleep(10.0)
        assert len(moved) == MOST_MOVES + 1, "the count begins anew with each question"
        keeping.cancel()

    tell(story)


def test_a_call_of_a_service_that_does_not_run_there_is_refused() -> None:
    async def story(field: Field) -> None:
        await field.session.ask()
        with pytest.raises(Refused, match=r"^s1 does not run sorter$"):
            await field.session.call("sorter", "look", b"", deadline_s=1.0)
        await field.session.hang_up()
        assert sorted(field.closed) == ["s1:1", "s1:2", DAEMON]
        with pytest.raises(Refused, match=r"^s1 does not run detector$"):
            await field.session.call("detector", "look", b"", deadline_s=1.0)
        assert not await field.session.end(in_range=True), "a server that was given up hears no farewell"

    tell(story)


def test_what_a_drone_denies_is_reported_once_and_only_to_a_daemon_that_it_has_asked() -> None:
    async def story(field: Field) -> None:
        field.session.deny("detector")
        await field.session.tell_denied()
        assert field.said == []
        await field.session.ask()
        field.session.deny("sorter")
        field.session.deny("counter")
        field.replies[DENY] = Unreachable("silent")
        await field.session.tell_denied()
        await field.session.tell_denied()
        assert [said for said in field.said if said[1] == DENY] == [(DAEMON, DENY)]
        assert field.bodies[-1] == {"server": "s1", "services": ["counter", "sorter"]}
        assert field.timeouts_s[-1] == 0.5

    tell(story)


def test_in_range_a_session_ends_after_its_calls_and_with_a_word_to_the_daemon() -> None:
    async def story(field: Field) -> None:
        await field.session.ask()
        field.answers_in_s = 4.0
        calls = [asyncio.create_task(field.session.call("detector", "look", b"", deadline_s=9.0))]
        await asyncio.sleep(1.0)
        calls.append(asyncio.create_task(field.session.call("detector", "look", b"", deadline_s=9.0)))
        ending = asyncio.create_task(field.session.end(in_range=True))
        await asyncio.sleep(0.5)
        field.answers_in_s = 0.0
        field.session.deny("detector")
        assert await ending
        assert now_s() == 5.0
        assert [path for _, path in field.said[-2:]] == [DENY, LEAVE]
        assert (sorted(field.closed), field.network) == (["s1:1", "s1:2", DAEMON], ["leave"])
        await asyncio.gather(*calls)

    tell(story)


def test_out_of_range_a_session_ends_at_once_and_in_silence() -> None:
    async def story(field: Field) -> None:
        await field.session.ask()
        said = len(field.said)
        field.answers_in_s = 4.0
        call = asyncio.create_task(field.session.call("detector", "look", b"", deadline_s=9.0))
        await asyncio.sleep(0.0)
        assert not await field.session.end(in_range=False)
        assert (now_s(), field.network, len(field.said)) == (0.0, ["leave"], said + 1)
        await call

    tell(story)


def test_a_daemon_that_is_silent_or_expects_nothing_hears_no_farewell() -> None:
    async def story(field: Field) -> None:
        assert not await field.session.end(in_range=True)
        assert (field.said, field.network) == ([], ["leave"])
        await field.session.probe()
        assert await field.session.end(in_range=True), "it keeps a slot since the probe"
        assert field.said[-1] == (DAEMON, LEAVE)
        field.replies[LEAVE] = Unreachable("silent")
        assert not await field.session.end(in_range=True)

    tell(story)


@pytest.mark.parametrize("address", ["10.0.0.1:7070", "mdns"])
def test_only_a_server_without_an_address_of_its_own_is_looked_up(address: str) -> None:
    async def find(name: str) -> str:
        return f"{name}.found:7"

    config = scenario(server("s1", 0.0, 0.0))
    servers = [msgspec.structs.replace(each, address=address) for each in config.servers]
    config = msgspec.structs.replace(config, servers=servers)
    endpoint = endpoints(config, make_estimates(config, {"detector": spec_of(Detector)}), find)["s1"]
    assert (endpoint.finder is find) is (address == "mdns")
    assert endpoint.services == ("detector",)


@pytest.mark.parametrize("deadline", [AnswerDeadline(1.5, 0.99), None])
def test_deadlines_have_services_connected_before_the_first_call(deadline: AnswerDeadline | None) -> None:
    config = scenario(server("s1", 0.0, 0.0))
    services = [msgspec.structs.replace(each, deadline=deadline) for each in config.services]
    config = msgspec.structs.replace(config, services=services)
    endpoint = endpoints(config, make_estimates(config, {"detector": spec_of(Detector)}))["s1"]
    assert endpoint.connects == (deadline is not None)
