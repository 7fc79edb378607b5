"""What every Network does, and what the model adds: range."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

import pytest
from tests.played import played
from tests.system.fake_networkmanager import FakeDevice, FakeProfile, running

from upwash.core.geo import Circle, Position
from upwash.drone.networks import NetworkCell, NoNetwork, PositionNetwork
from upwash.errors import NetworkError
from upwash.ports import Network
from upwash.real.network.network import ManagedNetwork
from upwash.sim.journal import MemoryJournal
from upwash.sim.loop import run_virtually

INSIDE, OUTSIDE = Position(5.0, 0.0), Position(50.0, 0.0)
JOIN_S = 3.5


@dataclass(frozen=True)
class Stage:
    """A radio that can join the networks a and b, and a way to take a off the air."""

    network: Network
    take_off_the_air: Callable[[], None]


Scene = Callable[[Stage], Awaitable[None]]


def on_the_model(scene: Scene) -> None:
    async def play() -> None:
        off = asyncio.Event()

        async def goes_down() -> None:
            await off.wait()

        area = Circle(Position(0.0, 0.0), 10.0)
        cells = {
            "a": [NetworkCell(area, JOIN_S, is_up=lambda: not off.is_set(), goes_down=goes_down)],
            "b": [NetworkCell(area, JOIN_S)],
        }
        await scene(Stage(PositionNetwork(cells, lambda: INSIDE), off.set))

    run_virtually(play())


def on_networkmanager(scene: Scene) -> None:
    async def play() -> None:
        profiles = tuple(FakeProfile(name, f"{name}-uuid") for name in ("a", "b"))
        async with running(FakeDevice("wlan1"), profiles=profiles) as manager:
            network = ManagedNetwork(["wlan1"], ["a", "b"], MemoryJournal())
            await network.open()
            try:
                await scene(Stage(network, lambda: manager.take_off_the_air("a")))
            finally:
                await network.close()
                assert manager.active == []

    asyncio.run(play())


@pytest.fixture(
    params=["model", pytest.param("networkmanager", marks=[pytest.mark.system, pytest.mark.root])]
)
def play(request: pytest.FixtureRequest) -> Callable[[Scene], None]:
    if request.param == "model":
        return on_the_model
    request.getfixturevalue("private_bus")
    return on_networkmanager


@played("play")
async def test_networks_are_joined_and_left_one_after_the_other(stage: Stage) -> None:
    await stage.network.leave()  # none is joined
    for name in ("a", "b", "a"):
        await stage.network.join(name, timeout_s=10.0)
        await stage.network.leave()
        await stage.network.leave()


@played("play")
async def test_a_join_that_was_given_up_joined_nothing(stage: Stage) -> None:
    joining = asyncio.create_task(stage.network.join("a", timeout_s=10.0))
    await asyncio.sleep(0)
    joining.cancel()
    await asyncio.gather(joining, return_exceptions=True)
    await stage.network.leave()
    await stage.network.join("b", timeout_s=10.0)


@played("play")
async def test_one_radio_joins_one_network(stage: Stage) -> None:
    await stage.network.join("a", timeout_s=10.0)
    with pytest.raises(NetworkError, match="cannot join b while a is joined"):
        await stage.network.join("b", timeout_s=10.0)


@played("play")
async def test_what_is_not_joined_in_time_is_not_joined(stage: Stage) -> None:
    with pytest.raises(NetworkError, match=r"a was not joined within 0\.0 s"):
        await stage.network.join("a", timeout_s=0.0)
    await stage.network.join("b", timeout_s=10.0)


@played("play")
async def test_a_network_that_goes_off_the_air_is_lost_and_then_left(stage: Stage) -> None:
    await stage.network.join("a", timeout_s=10.0)
    lost = asyncio.create_task(stage.network.lost())
    await asyncio.sleep(0)
    assert not lost.done()
    stage.take_off_the_air()
    assert await lost
    assert await stage.network.lost(), "and stays so"
    await stage.network.leave()
    with pytest.raises(NetworkError):
        await stage.network.join("a", timeout_s=10.0)
    await stage.network.join("b", timeout_s=10.0)


# --- the model ----------------------------------------------------------------------------------------------


def model(position: Callable[[], Position] = lambda: INSIDE, *, is_up: bool = True) -> PositionNetwork:
    return PositionNetwork(
        {"a": [NetworkCell(Circle(Position(0.0, 0.0), 10.0), JOIN_S, lambda: is_up)]}, position
    )


def test_joining_takes_its_time_and_is_tried_where_the_drone_is_by_then() -> None:
    async def fly(*, arrives_s: float) -> float:
        clock = asyncio.get_running_loop().time
        await model(lambda: INSIDE if clock() >= arrives_s else OUTSIDE).join("a", timeout_s=10.0)
        return clock()

    assert run_virtually(fly(arrives_s=3.0)) == JOIN_S
    slow = NetworkCell(Circle(Position(0.0, 0.0), 10.0), JOIN_S, stretch=lambda: 4.0)
    with pytest.raises(NetworkError, match=r"network a was not joined within 10\.0 s"):
        run_virtually(PositionNetwork({"a": [slow]}, lambda: INSIDE).join("a", timeout_s=10.0))
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
        run_virtually(network.join(joined, timeout_s=10.0))


def test_a_network_that_is_left_keeps_the_radio_from_joining_the_next_one_for_its_time() -> None:
    async def scene(flies_on_s: float) -> float:
        clock = asyncio.get_running_loop().time
        cell = NetworkCell(Circle(Position(0.0, 0.0), 10.0), JOIN_S, leave_s=2.0)
        network = PositionNetwork({"a": [cell], "b": [cell]}, lambda: INSIDE)
        await network.leave()
        await network.join("a", timeout_s=JOIN_S)
        assert clock() == JOIN_S, "nothing was to be left"
        await network.leave()
        assert clock() == JOIN_S, "nobody waits for that but the next join"
        await asyncio.sleep(flies_on_s)
        await network.leave()
        await network.join("b", timeout_s=JOIN_S)
        return clock() - JOIN_S

    assert run_virtually(scene(0.5)) == run_virtually(scene(1.5)) == 2.0 + JOIN_S
    assert run_virtually(scene(3.0)) == 3.0 + JOIN_S


def test_a_network_of_several_servers_is_lost_with_the_last_of_them() -> None:
    async def scene() -> float:
        clock = asyncio.get_running_loop().time
        area = Circle(Position(0.0, 0.0), 10.0)

        def until(down_s: float) -> NetworkCell:
            async def goes_down() -> None:
                await asyncio.sleep(down_s - clock())

            return NetworkCell(area, 0.0, is_up=lambda: clock() < down_s, goes_down=goes_down)

        network = PositionNetwork({"a": [until(5.0), until(9.0), until(7.0)]}, lambda: INSIDE)
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(network.lost(), 1.0)  # nothing is joined
        await network.join("a", timeout_s=1.0)
        await network.lost()
        return clock()

    assert run_virtually(scene()) == 9.0


@pytest.mark.virtual
async def test_without_a_network_everything_is_always_joined() -> None:
    network = NoNetwork()
    await network.join("a", timeout_s=0.0)
    await network.leave()
    with pytest.raises(TimeoutError):
        async with asyncio.timeout(1e6):
            await network.lost()
