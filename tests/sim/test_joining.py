"""The drone's computer while a radio joins a network."""

from __future__ import annotations

import asyncio

import pytest

from upwash.errors import NetworkError
from upwash.sim.loop import run_virtually
from upwash.sim.world import JoinedSlowly, Joining


class Network:
    """Joins in 4 s, or not at all."""

    def __init__(self, *, works: bool = True) -> None:
        self._works = works

    async def join(self, network: str, *, timeout_s: float) -> None:
        await asyncio.sleep(4.0)
        if not self._works:
            raise NetworkError("out of range")

    async def lost(self) -> str:
        return "off the air"

    async def leave(self) -> None:
        await asyncio.sleep(1.0)


def work_s(slowdown: float, *joins_at_s: float, from_s: float = 0.0, works: bool = True) -> float:
    """How long 3 s of work take that begin then, with radios that begin to join at these times."""

    async def play() -> float:
        joining = Joining()

        async def join(at_s: float) -> None:
            await asyncio.sleep(at_s)
            await JoinedSlowly(Network(works=works), joining).join("a", timeout_s=10.0)

        joins = [asyncio.create_task(join(at_s)) for at_s in joins_at_s]
        await asyncio.sleep(from_s)
        began_s = asyncio.get_running_loop().time()
        await joining.work(3.0, slowdown)
        took_s = asyncio.get_running_loop().time() - began_s
        await asyncio.gather(*joins, return_exceptions=True)
        return took_s

    return run_virtually(play())


@pytest.mark.parametrize(
    ("joins_at_s", "from_s", "took_s"),
    [
        ((), 0.0, 3.0),
        ((0.0,), 0.1, 3.75),  # all of it
        ((1.0,), 0.0, 1 + 2 * 1.25),  # the end
        ((0.0,), 3.0, 1 + (3 - 1 / 1.25)),  # the beginning
        ((0.0, 0.1), 0.1, 3.75),  # two radios are no more load than one
        ((0.0, 3.0), 3.0, 3.75),  # ... and one of them is enough
        ((0.0,), 4.5, 3.0),
    ],
)
def test_work_is_slower_by_the_share_while_a_radio_joins(
    joins_at_s: tuple[float, ...], from_s: float, took_s: float
) -> None:
    assert work_s(0.25, *joins_at_s, from_s=from_s) == pytest.approx(took_s)


def test_a_join_that_fails_is_over_too() -> None:
    assert work_s(0.25, 0.0, from_s=3.0, works=False) == pytest.approx(1 + (3 - 1 / 1.25))


def test_work_that_joining_does_not_slow_down_takes_its_time() -> None:
    assert work_s(0.0, 0.0, from_s=0.5) == 3.0


def test_all_else_is_the_networks_own() -> None:
    async def play() -> tuple[str, float]:
        network = JoinedSlowly(Network(), Joining())
        why = await network.lost()
        await network.leave()
        return why, asyncio.get_running_loop().time()

    assert run_virtually(play()) == ("off the air", 1.0)
