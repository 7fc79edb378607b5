"""What every Network does, and what the model adds: range."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import pytest

from upwash.core.geo import Circle, Position
from upwash.errors import NetworkError
from upwash.ports import Network
from upwash.sim.loop import run_virtually
from upwash.sim.network import Cell, ModelNetwork, NoNetwork

INSIDE, OUTSIDE = Position(5.0, 0.0), Position(50.0, 0.0)


def model(position: Callable[[], Position] = lambda: INSIDE, *, is_up: bool = True) -> ModelNetwork:
    area = Circle(Position(0.0, 0.0), 10.0)
    return ModelNetwork({name: [Cell(area, 3.5, lambda: is_up)] for name in ("a", "b")}, position)


@pytest.mark.parametrize("make", [model, NoNetwork])
def test_networks_are_joined_and_left_one_after_the_other(make: Callable[[], Network]) -> None:
    async def visit() -> None:
        network = make()
        await network.leave()  # none is joined
        for name in ("a", "b", "a"):
            await network.join(name)
            await network.leave()
            await network.leave()

    run_virtually(visit())


@pytest.mark.parametrize("make", [model, NoNetwork])
def test_a_join_that_was_given_up_joined_nothing(make: Callable[[], Network]) -> None:
    async def hesitate() -> None:
        network = make()
        joining = asyncio.create_task(network.join("a"))
        await asyncio.sleep(0)
        joining.cancel()
        await asyncio.gather(joining, return_exceptions=True)
        await network.leave()
        await network.join("b")

    run_virtually(hesitate())


def test_joining_takes_its_time_and_is_tried_where_the_drone_is_by_then() -> None:
    async def fly(*, arrives_s: float) -> float:
        clock = asyncio.get_running_loop().time
        await model(lambda: INSIDE if clock() >= arrives_s else OUTSIDE).join("a")
        return clock()

    assert run_virtually(fly(arrives_s=3.0)) == 3.5
    with pytest.raises(NetworkError, match="network a is out of range"):
        run_virtually(fly(arrives_s=4.0))


@pytest.mark.parametrize(
    ("network", "joined", "problem"),
    [
        (model(), "c", "no network c is known"),
        (model(lambda: OUTSIDE), "a", "network a is out of range"),
        (model(is_up=False), "a", "network a is out of range"),
    ],
)
def test_what_cannot_be_joined(network: Network, joined: str, problem: str) -> None:
    with pytest.raises(NetworkError, match=problem):
        run_virtually(network.join(joined))


def test_one_radio_joins_one_network() -> None:
    async def greedy() -> None:
        network = model()
        await network.join("a")
        await network.join("b")

    with pytest.raises(NetworkError, match="cannot join b while a is joined"):
        run_virtually(greedy())
