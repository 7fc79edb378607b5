"""Modelled instances that compute several calls at a time, and calls that are elsewhere for part of their time."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from typing import Any

import pytest
from tests.played import played
from tests.scenarios import scenario, server

from upwash.config.truth import server_truth
from upwash.config.world import NoiseConfig
from upwash.core.admission.clients import Client
from upwash.core.operation import Operation
from upwash.errors import InstanceError, Refused
from upwash.ports import AnsweredCall, InstanceSpec, Program
from upwash.rpc.protocol import service_path
from upwash.rpc.service import service, spec_of
from upwash.sim.chance import Chance
from upwash.sim.faults import Faults
from upwash.sim.link import Switchboard
from upwash.sim.loop import run_virtually
from upwash.sim.runtime import ModelInstance, ModelRuntime
from upwash.sim.world import ServerComputer

COMPUTED_S = 2.0
BACK_S = 3.0


@service(concurrency=2)
class Counter:
    def count(self) -> int:
        """Nothing."""
        return 0


PATH = service_path("counter", "count")
REQUEST = spec_of(Counter).methods["count"].encode((), {})[1]


class Computer:
    """Computes for 2 s, and has the answer 3 s later; crashes in the calls that it is told to."""

    def __init__(self, crashes_in: int | None = None) -> None:
        self._crashes_in = crashes_in
        self._calls = 0

    async def start(self, spec: InstanceSpec) -> None:
        """At once."""

    async def compute(self, spec: InstanceSpec, operation: Operation, *, less: bool = False) -> float:
        self._calls += 1
        crashes = self._calls == self._crashes_in
        await asyncio.sleep(COMPUTED_S)
        if crashes:
            raise InstanceError("crashed in a call")
        return asyncio.get_running_loop().time() + BACK_S


@dataclass
class Bench:
    """An instance, and what came of the calls of drones that each made one."""

    instance: ModelInstance
    switchboard: Switchboard
    reported: list[AnsweredCall] = field(default_factory=list)
    ended_s: dict[str, float] = field(default_factory=dict)
    failed: dict[str, Exception] = field(default_factory=dict)

    async def call(self, drone: str, *, at_s: float = 0.0) -> None:
        await asyncio.sleep(at_s)
        try:
            await self.switchboard.handlers[self.instance.endpoint](PATH, REQUEST, Client(drone))
        except (InstanceError, Refused) as error:
            self.failed[drone] = error
        self.ended_s[drone] = asyncio.get_running_loop().time()


def at_bench(
    visit: Callable[[Bench], Awaitable[None]], *, lanes: int | None = None, crashes_in: int | None = None
) -> Bench:
    """Lets four drones visit an instance that computes so many calls at a time."""

    async def play() -> Bench:
        switchboard = Switchboard({})
        runtime = ModelRuntime({"counter": spec_of(Counter)}, Computer(crashes_in), switchboard, lanes=lanes)
        reported: list[AnsweredCall] = []
        instance = await runtime.start(
            InstanceSpec("s1", "counter", Program("")), called=lambda _: None, answered=reported.append
        )
        await instance.admit(frozenset("abcd"))
        bench = Bench(instance, switchboard, reported)
        await visit(bench)
        return bench

    return run_virtually(play())


async def all_at_once(bench: Bench) -> None:
    await asyncio.gather(*(bench.call(drone) for drone in "abcd"))


@pytest.mark.parametrize(
    ("lanes", "queued_s"),
    [(None, [0.0, 0.0, 2.0, 2.0]), (1, [0.0, 2.0, 4.0, 6.0]), (3, [0.0, 0.0, 0.0, 2.0])],
)
def test_calls_queue_for_lanes_in_the_order_in_which_they_came(
    lanes: int | None, queued_s: list[float]
) -> None:
    bench = at_bench(all_at_once, lanes=lanes)
    assert bench.reported == [
        AnsweredCall(drone, "count", waited_s, COMPUTED_S)
        for drone, waited_s in zip("abcd", queued_s, strict=True)
    ]
    assert list(bench.ended_s.values()) == [waited_s + COMPUTED_S + BACK_S for waited_s in queued_s]


def test_a_drained_instance_refuses_who_waits_and_ends_what_is_under_way() -> None:
    async def visit(bench: Bench) -> None:
        calls = asyncio.create_task(all_at_once(bench))
        await asyncio.sleep(1.0)
        await asyncio.gather(bench.instance.drain("shutting down"), bench.instance.drain("shutting down"))
        assert asyncio.get_running_loop().time() == COMPUTED_S + BACK_S
        await bench.instance.stop()
        await calls

    bench = at_bench(visit)
    assert {drone: str(error) for drone, error in bench.failed.items()} == dict.fromkeys(
        "cd", "shutting down"
    )


@played(at_bench)
async def test_an_instance_that_nobody_calls_is_drained_at_once(bench: Bench) -> None:
    await bench.call("a")
    now_s = asyncio.get_running_loop().time()
    await bench.instance.drain("shutting down")
    assert asyncio.get_running_loop().time() == now_s


def test_a_crash_in_one_call_fails_those_beside_it_and_those_that_wait() -> None:
    bench = at_bench(all_at_once, crashes_in=1)
    assert set(bench.failed) == set("abcd")
    assert [call.drone for call in bench.reported] == ["b"]
    assert bench.ended_s["c"] == bench.ended_s["d"] == COMPUTED_S


def test_a_call_that_is_given_up_leaves_its_lane_to_the_next() -> None:
    async def visit(bench: Bench) -> None:
        calls = {drone: asyncio.create_task(bench.call(drone)) for drone in "abc"}
        await asyncio.sleep(1.0)
        calls["a"].cancel()
        await asyncio.gather(calls["b"], calls["c"])

    bench = at_bench(visit)
    assert bench.ended_s["c"] == 1.0 + COMPUTED_S + BACK_S


# --- what of a call keeps a lane busy ------------------------------------------------------------------------


HEAVY = Operation("detector", "process_photo", "heavy")


def busy_and_whole_s(truth: dict[str, Any], **believed: Any) -> tuple[float, float]:
    """For how long a heavy call keeps a server's lane busy, and how long it takes."""
    there = server("s1", 0.0, 0.0, **{"remote_call_s": {"light": 0.3, "heavy": 0.7}, **believed}, truth=truth)
    config = scenario(there)
    computer = ServerComputer(
        "s1",
        server_truth(config.servers[0], config.services),
        faults=Faults([]),
        noise=NoiseConfig(),
        chance=Chance(1),
    )

    async def play() -> tuple[float, float]:
        spec = InstanceSpec("s1", "detector", Program(""))
        await computer.start(spec)
        began_s = asyncio.get_running_loop().time()
        answered_s = await computer.compute(spec, HEAVY)
        return asyncio.get_running_loop().time() - began_s, answered_s - began_s

    return run_virtually(play())


PROCESSING = {"light": 0.2, "heavy": 0.6}
SLOW = {"light": 0.3, "heavy": 7.7}


@pytest.mark.parametrize(
    ("truth", "believed", "busy_s", "whole_s"),
    [
        ({}, {}, 0.7, 0.7),
        ({}, {"processing_s": PROCESSING}, 0.6, 0.7),
        ({"remote_call_s": SLOW}, {"processing_s": PROCESSING}, 7.7, 7.7),  # loaded, for all that is known
        ({"remote_call_s": SLOW, "processing_s": PROCESSING}, {}, 0.6, 7.7),
        ({"remote_call_s": SLOW, "processing_s": {"light": 9.0, "heavy": 9.0}}, {}, 7.7, 7.7),
        ({"processing_s": PROCESSING}, {"bandwidth_bit_s": 54e6}, 0.6, 0.6),  # and the link's time
        ({"radio": "disc54"}, {"processing_s": PROCESSING}, 0.6, 0.6),
        ({"radio": "disc54", "remote_call_s": SLOW, "processing_s": PROCESSING}, {}, 7.7, 7.7),
        ({"first_extra_s": 2.0}, {"processing_s": PROCESSING}, 2.6, 2.7),
    ],
)
def test_the_way_there_and_back_keeps_no_lane_busy(
    truth: dict[str, Any], believed: dict[str, Any], busy_s: float, whole_s: float
) -> None:
    assert busy_and_whole_s(truth, **believed) == pytest.approx((busy_s, whole_s))
