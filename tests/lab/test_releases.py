"""Drones and daemons of this release and of the last one, which knew no turns, understand each other.

The last release took every refusal for a failed check or a failed call. What a program of it does with what it hears
is what today's does with what is left of that once it has been through the last release's messages.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from typing import Any, NamedTuple, TypeVar

import msgspec
import pytest
from tests.events import written
from tests.scenarios import scenario, server
from tests.server.test_edge_server import Daemon

from upwash.core.admission.clients import Client
from upwash.errors import NoLease, Refused
from upwash.lab import run as lab
from upwash.lab.observer import Observation
from upwash.lab.run import Run, simulate_fleet
from upwash.ports import Link
from upwash.rpc import protocol
from upwash.rpc.protocol import AVAILABILITY, START, decode_reply
from upwash.sim.link import ModelDialer
from upwash.sim.loop import run_virtually

T = TypeVar("T")

TURN_S = 30.0


class AvailabilityRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    server: str
    services: list[str]


class AvailabilityReply(msgspec.Struct, frozen=True):
    available: bool
    reason: str = ""
    endpoints: dict[str, str] = {}
    lease_s: float = 2.0
    peers: list[str] = []


class StartRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    server: str
    service: str


class StartReply(msgspec.Struct, frozen=True):
    endpoint: str = ""
    reason: str = ""


MESSAGES: dict[str, tuple[type[msgspec.Struct], type[msgspec.Struct]]] = {
    AVAILABILITY: (AvailabilityRequest, AvailabilityReply),
    START: (StartRequest, StartReply),
}


class FormerLink:
    """A link one end of which is of the last release."""

    def __init__(self, link: Link) -> None:
        self._link = link
        self.is_far = link.is_far

    async def request(
        self, path: str, body: bytes, *, timeout_s: float, may_queue_s: float | None = None
    ) -> bytes:
        asked, answered = MESSAGES.get(path, (None, None))
        if asked is not None:
            msgspec.msgpack.decode(body, type=asked)
        try:
            reply = await self._link.request(path, body, timeout_s=timeout_s, may_queue_s=may_queue_s)
        except NoLease as error:
            raise Refused(str(error)) from error
        return msgspec.msgpack.encode(decode_reply(reply, answered, sender="s1")) if answered else reply

    async def close(self) -> None:
        await self._link.close()


class Dialer(ModelDialer):
    """Has FormerLinks for drones with such names."""

    def dial(self, address: str, *, server: str) -> Any:
        link = ModelDialer.dial(self, address, server=server)
        return FormerLink(link) if self.drone.startswith("former") else link


@pytest.fixture(autouse=True)
def former_drones(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lab, "ModelDialer", Dialer)


# --- whole flights ----------------------------------------------------------------------------------------------


class Stint(NamedTuple):
    """A drone's time in the one slot."""

    drone: str
    from_s: float
    to_s: float


def fly(
    *names: str, policy: str = "look-ahead", turn_s: float = TURN_S
) -> tuple[dict[str, Run], list[Stint]]:
    """Drones over the same field with one server and one slot."""
    config = scenario(
        server("s1", 40.0, 20.0, range_m=500.0, truth={"slots": 1, "turn_s": turn_s}),
        columns=8,
        rows=4,
        policy={"name": policy},
    )
    seen: list[Observation] = []
    runs = simulate_fleet([msgspec.structs.replace(config, name=name) for name in names], seen=seen)
    assert [run.failure for run in runs] == [""] * len(runs)
    return dict(zip(names, runs, strict=True)), list(stints(seen))


def stints(seen: list[Observation]) -> Iterator[Stint]:
    admitted = [(each.t, each.drones) for each in seen if each.event == "admitted"]
    changes = [next(same) for _, same in itertools.groupby(admitted, key=lambda each: each[1])]
    for (from_s, drones), (to_s, _) in itertools.pairwise(changes):
        for drone in drones:
            yield Stint(drone, from_s, to_s)


def kinds(run: Run) -> set[str]:
    return {event["event"] for event in written(run.events)}


def test_a_drone_of_the_last_release_has_its_turns_beside_one_of_today_and_yields_when_they_are_over() -> (
    None
):
    runs, held = fly("former", "today")
    both_s = min(run.events[-1].t for run in runs.values())
    shared = [each for each in held if each.to_s < both_s]
    assert len(shared) > 10
    assert all(one.drone != other.drone for one, other in itertools.pairwise(shared))
    assert max(each.to_s - each.from_s for each in shared) <= 1.5 * TURN_S + 2.0
    had_s = {name: sum(each.to_s - each.from_s for each in shared if each.drone == name) for name in runs}
    assert abs(had_s["former"] - had_s["today"]) <= 1.5 * TURN_S
    for run in runs.values():
        assert run.result.totals.remote["s1"] > run.result.totals.local
    assert "remote_failed" in kinds(runs["former"]), "its turn was over, and it knows nothing of turns"
    assert {"no_slot", "turn_over"} <= kinds(runs["today"]) - kinds(runs["former"])
    assert "remote_failed" not in kinds(runs["today"])


def test_one_that_leaves_a_server_alone_for_a_minute_waits_for_no_turn_and_has_what_is_free() -> None:
    runs, held = fly("former", "today", policy="location-aware")
    assert [each.drone for each in held] == ["former", "today", "former"]
    assert runs["former"].result.totals.remote["s1"] > 0


@pytest.mark.parametrize("policy", ["look-ahead", "location-aware"])
def test_drones_of_today_fail_their_checks_at_a_full_daemon_of_the_last_release(policy: str) -> None:
    """Its refusals say nothing of turns, of which it has none: the slot is the first one's until that leaves."""
    runs, held = fly("former-1", "former-2", policy=policy, turn_s=math.inf)
    first, second = (each.drone for each in held)
    assert "check_failed" in kinds(runs[second])
    assert not {"no_slot", "turn_over", "remote_failed"} & (kinds(runs[first]) | kinds(runs[second]))
    assert runs[first].result.totals.local == 0
    assert 0 < runs[second].result.totals.remote["s1"] < runs[second].result.totals.calls


# --- single messages --------------------------------------------------------------------------------------------


def heard(reply: bytes, expected: type[T]) -> T:
    return decode_reply(reply, expected, sender="s1")


def test_the_last_release_understands_every_reply_to_its_requests() -> None:
    async def story() -> None:
        at = Daemon()

        async def ask(drone: str) -> AvailabilityReply:
            request = msgspec.msgpack.encode(AvailabilityRequest("s1", ["detector"]))
            return heard(await at.edge.handle(AVAILABILITY, request, Client(drone)), AvailabilityReply)

        async def start(drone: str) -> StartReply:
            request = msgspec.msgpack.encode(StartRequest("s1", "detector"))
            return heard(await at.edge.handle(START, request, Client(drone)), StartReply)

        assert await ask("d1") == AvailabilityReply(available=True, lease_s=30.0, peers=["s2", "s3"])
        assert (await start("d1")).endpoint
        full = "s1 has no free slot: 1 of 1 in use"
        assert await ask("d2") == AvailabilityReply(available=False, reason=full)
        assert await start("d2") == StartReply(reason=full)
        assert (await ask("d1")).endpoints, "though another one waits"
        await at.edge.close()

    run_virtually(story())


def test_the_last_release_understands_every_request_and_is_understood() -> None:
    for today, former in (
        (protocol.AvailabilityRequest("s1", ["detector"]), AvailabilityRequest("s1", ["detector"])),
        (protocol.StartRequest("s1", "detector"), StartRequest("s1", "detector")),
    ):
        assert msgspec.msgpack.decode(msgspec.msgpack.encode(today), type=type(former)) == former
    full = msgspec.msgpack.encode(AvailabilityReply(available=False, reason="no free slot"))
    assert heard(full, protocol.AvailabilityReply).ask_again_s == 0.0
    assert heard(msgspec.msgpack.encode(StartReply()), protocol.StartReply).ask_again_s == 0.0
