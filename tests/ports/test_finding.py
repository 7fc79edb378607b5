"""From an autopilot that is not there yet to one that is flown, whoever else is on its link."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.played import played
from tests.ports.memory import AGILE, Air, Bench, bench
from tests.ports.steps import claim_and_arm, take_off

from upwash.core.geo import Position
from upwash.errors import AutopilotError, AutopilotNotHeard, AutopilotRefused
from upwash.eventlog.schema import LinkLost, LinkRestored, LinkTrouble
from upwash.mavlink.signing import Signing
from upwash.ports import VehicleNews
from upwash.real.mavlink import FlightSettings, MavlinkAutopilot
from upwash.sim.loop import run_virtually

CAUTIOUS = FlightSettings()
INVALID = mavlink.MAV_AUTOPILOT_INVALID
Story = Callable[[Bench], Awaitable[None]]
Tell = Callable[..., None]


@pytest.fixture
def tell(monkeypatch: pytest.MonkeyPatch) -> Tell:
    """Runs a story with a stand-in, on virtual time."""

    def told(story: Story, *, air: Air | None = None) -> None:
        async def live() -> None:
            async with bench(AGILE, air or Air(0.0, seed=1)) as made:
                await story(made)

        run_virtually(live())

    return told


def beat(system: int, autopilot: int = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, kind: int = 2) -> bytes:
    codec = mavlink.MAVLink(None, system, 1)
    return bytes(mavlink.MAVLink_heartbeat_message(kind, autopilot, 81, 0, 4, 3).pack(codec))


async def another(made: Bench, system: int = 2, **named: int) -> None:
    """Another vehicle, or program, on the same link; once a second, as heartbeats are."""
    while True:
        if hasattr(made, "arrive"):
            made.arrive(beat(system, **named))
        await asyncio.sleep(1.0)


async def flown(autopilot: MavlinkAutopilot) -> None:
    await autopilot.takeoff(5.0)
    await autopilot.goto(Position(30.0, 0.0, 5.0))
    await autopilot.return_home_and_land()


def heard(autopilot: MavlinkAutopilot) -> list[VehicleNews]:
    news: list[VehicleNews] = []
    autopilot.listen(news.append)
    return news


def troubles(news: list[VehicleNews]) -> list[str]:
    return [each.about for each in news if isinstance(each, LinkTrouble)]


# --- waiting ------------------------------------------------------------------------------------------------


@played("tell")
async def test_an_autopilot_that_is_switched_on_later_is_waited_for_and_told_of(made: Bench) -> None:
    made.powered = False
    waits: list[tuple[str, float]] = []
    loop = asyncio.get_running_loop()
    loop.call_later(100.0, setattr, made, "powered", True)
    named: dict[str, Any] = {"heartbeat_timeout_s": 120.0, "waiting": lambda *wait: waits.append(wait)}
    async with made.program(CAUTIOUS, **named) as autopilot:
        assert 100.0 < loop.time() < 110.0
        await claim_and_arm(autopilot)
        await flown(autopilot)
    assert [round(waited_s, -1) for _, waited_s in waits] == [0, 20, 30, 50, 60, 80, 90]
    assert all(why == "no autopilot was heard on memory (nobody listens)" for why, _ in waits)


@played("tell")
async def test_one_that_never_comes_is_told_from_one_that_is_not_right(made: Bench) -> None:
    made.powered = False
    with pytest.raises(
        AutopilotNotHeard, match=r"no autopilot was heard .*nobody listens.*120 s were waited"
    ):
        async with made.program(heartbeat_timeout_s=120.0):
            pass
    assert asyncio.get_running_loop().time() == pytest.approx(120.0, abs=1.0)


@played("tell")
async def test_what_no_patience_makes_right_ends_the_wait(made: Bench) -> None:
    made.mute = True
    rover = asyncio.create_task(another(made, kind=mavlink.MAV_TYPE_GROUND_ROVER))
    with pytest.raises(AutopilotError, match="MAV_TYPE_GROUND_ROVER was heard") as caught:
        async with made.program(heartbeat_timeout_s=120.0):
            pass
    assert not isinstance(caught.value, AutopilotNotHeard)
    assert 5.0 < asyncio.get_running_loop().time() < 15.0
    rover.cancel()


@played("tell")
async def test_a_system_that_is_not_there_yet_is_waited_for_beside_another(made: Bench) -> None:
    with pytest.raises(
        AutopilotNotHeard, match=r"system 7 was not heard .*; heard: 1 \(ArduCopter quadrotor\)"
    ):
        async with made.program(heartbeat_timeout_s=60.0, system=7):
            pass
    assert made.asked[mavlink.MAV_CMD_SET_MESSAGE_INTERVAL] == 0


# --- who else is there --------------------------------------------------------------------------------------


@played("tell")
async def test_of_two_vehicles_on_a_link_neither_is_asked_for_anything(made: Bench) -> None:
    neighbour = asyncio.create_task(another(made))
    said = r"system 1, component 1 \(ArduCopter quadrotor\); system 2, component 1 .*system = 1 or system = 2"
    with pytest.raises(AutopilotRefused, match=said):
        async with made.program(CAUTIOUS):
            pass
    assert set(made.asked) <= {0}, "heartbeats alone"
    neighbour.cancel()


@played("tell")
async def test_the_one_that_was_said_is_flown_beside_another(made: Bench) -> None:
    neighbour = asyncio.create_task(another(made))
    async with made.program(CAUTIOUS, system=1) as autopilot:
        news = heard(autopilot)
        await claim_and_arm(autopilot)
        await flown(autopilot)
        assert troubles(news) == []
    neighbour.cancel()


@played("tell")
async def test_another_that_comes_before_arming_keeps_it_from_that(made: Bench) -> None:
    async with made.program(CAUTIOUS) as autopilot:
        news = heard(autopilot)
        neighbour = asyncio.create_task(another(made))
        await asyncio.sleep(5.0)
        with pytest.raises(AutopilotRefused, match=r"arm: several vehicles .*system = 1 or system = 2"):
            await claim_and_arm(autopilot)
        assert not made.copter.armed(made.now_s)
        assert troubles(news) == ["another-vehicle"]
        neighbour.cancel()


@played("tell")
async def test_another_that_comes_in_flight_is_told_once_and_changes_nothing(made: Bench) -> None:
    async with made.program(CAUTIOUS) as autopilot:
        news = heard(autopilot)
        await claim_and_arm(autopilot)
        neighbour = asyncio.create_task(another(made))
        await flown(autopilot)
        assert troubles(news) == ["another-vehicle"]
        neighbour.cancel()


@played("tell")
async def test_another_programs_heartbeats_with_the_vehicles_ids_end_no_flight(made: Bench) -> None:
    async with made.program() as autopilot:
        news = heard(autopilot)
        await claim_and_arm(autopilot)
        program = asyncio.create_task(another(made, 1, autopilot=INVALID, kind=18))
        await flown(autopilot)
        assert troubles(news) == ["another-program"]
        program.cancel()


@played("tell")
async def test_they_are_no_sign_of_life_either(made: Bench) -> None:
    async with made.program() as autopilot:
        await take_off(autopilot)
        made.mute = True
        program = asyncio.create_task(another(made, 1, autopilot=INVALID, kind=18))
        await asyncio.sleep(5.0)
        assert not autopilot.vehicle.linked
        program.cancel()


# --- how the messages come ----------------------------------------------------------------------------------


class Bridge(Air):
    """Packs each of the vehicle's messages anew, with a number of its own."""

    def __init__(self, number: Callable[[int, int], int]) -> None:
        super().__init__(0.0, seed=1)
        self._number = number

    def carry(self, packet: bytes, send: Callable[[bytes], None]) -> None:
        for message in mavlink.MAVLink(None).parse_buffer(packet) or []:
            codec = mavlink.MAVLink(None, message.get_srcSystem(), message.get_srcComponent())
            codec.seq = self._number(message.get_seq(), message.get_msgId())
            send(bytes(message.pack(codec)))


@pytest.mark.parametrize(
    ("number", "told"),
    [
        pytest.param(lambda *_: 0, True, id="always 0"),
        pytest.param(lambda seq, _: seq * 2 % 256, False, id="by two"),
    ],
)
def test_over_a_bridge_with_numbers_of_its_own_a_flight_is_flown(
    tell: Tell, number: Callable[[int, int], int], told: bool
) -> None:
    async def story(made: Bench) -> None:
        async with made.program(CAUTIOUS) as autopilot:
            news = heard(autopilot)
            await asyncio.sleep(10.0)
            await claim_and_arm(autopilot)
            await flown(autopilot)
            assert troubles(news) == ["numbers"] * told
            assert not any(isinstance(each, LinkLost | LinkRestored) for each in news)

    tell(story, air=Bridge(number))


@played("tell")
async def test_a_vehicle_that_signs_and_obeys_whoever_speaks_over_its_cable_is_flown(made: Bench) -> None:
    made.vehicle.signing = Signing(bytes(range(32)))
    async with made.program() as autopilot:
        await claim_and_arm(autopilot)
        await flown(autopilot)
