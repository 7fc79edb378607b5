"""What the driver makes of a vehicle's parameters: under either name, missing, unanswered, and out of reason."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import replace
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.played import played
from tests.ports.memory import AGILE, Air, Bench, bench, driven
from tests.ports.steps import take_off

from upwash.core.geo import GeoPosition
from upwash.core.vehicle.way_home import EnergyFacts
from upwash.eventlog.schema import VehicleSetting
from upwash.mavlink.version import Version
from upwash.ports import VehicleNews
from upwash.real.mavlink import MavlinkAutopilot
from upwash.real.mavlink.parameters import read_parameters, set_parameter
from upwash.sim.loop import run_virtually
from upwash.vehicle.ardupilot.settings import VehicleSettings
from upwash.vehicle.body import connection
from upwash.vehicle.body.connection import PeerConnection
from upwash.vehicle.px4.settings import Px4Settings

OLD = {"RTL_ALT": 10_000, "RTL_SPEED": 200, "WPNAV_SPEED_DN": 100, "WPNAV_SPEED_UP": 120, "LAND_SPEED": 40}
NEW = {"RTL_ALT_M": 100, "RTL_SPEED_MS": 2, "WP_SPD_DN": 1, "WP_SPD_UP": 1.2, "LAND_SPD_MS": 0.4}
SLOW = replace(AGILE, parameters=OLD)
RELEASED = replace(AGILE, version=Version(4, 7), parameters=NEW)
Story = Callable[[Bench, MavlinkAutopilot], Awaitable[None]]


@pytest.fixture
def tell(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Runs a story with a stand-in ArduCopter and its driver, on virtual time."""

    def told(story: Story, settings: VehicleSettings = AGILE, air: Air | None = None) -> None:
        async def live() -> None:
            async with (
                bench(settings, air or Air(0.0, seed=1)) as made,
                made.program() as autopilot,
            ):
                await story(made, autopilot)

        run_virtually(live())

    return told


async def learnt(autopilot: MavlinkAutopilot) -> tuple[EnergyFacts, dict[str, str]]:
    """What it knows of the way home, and what it told of parameters that are not known."""
    news: list[VehicleNews] = []
    autopilot.listen(news.append)
    await autopilot.limits()
    unknown = {
        each.name: each.advice for each in news if isinstance(each, VehicleSetting) and each.value is None
    }
    return autopilot.energy, unknown


def forget(made: Bench, *names: str) -> None:
    for name in names:
        del made.copter.parameters.names[name]


@pytest.mark.parametrize("settings", [SLOW, RELEASED], ids=["names of 4.6", "names of 4.7"])
def test_the_way_home_is_read_by_the_names_of_either_version(
    settings: VehicleSettings, tell: Callable[..., None]
) -> None:
    async def story(_: Bench, autopilot: MavlinkAutopilot) -> None:
        energy, unknown = await learnt(autopilot)
        assert unknown == {}
        assert energy.guessed == ()
        way = energy.way_home
        assert way is not None
        assert (way.altitude_m, way.speed_m_s, way.descent_m_s) == (100.0, 2.0, 1.0)
        assert (way.climb_m_s, way.landing_m_s) == pytest.approx((1.2, 0.4))

    tell(story, settings)


@played("tell", replace(AGILE, parameters={"LAND_SPEED_HIGH": 60}))
async def test_a_landing_whose_first_part_has_a_speed_of_its_own_is_reckoned_with_it(
    _: Bench, autopilot: MavlinkAutopilot
) -> None:
    energy, _unknown = await learnt(autopilot)
    assert energy.way_home is not None
    assert energy.way_home.descent_m_s == 0.6


@played("tell", replace(AGILE, parameters={"RTL_ALT": 0}))
async def test_a_return_at_the_altitude_of_the_moment_is_no_guess(
    _: Bench, autopilot: MavlinkAutopilot
) -> None:
    energy, unknown = await learnt(autopilot)
    assert energy.way_home is not None
    assert (energy.way_home.altitude_m, unknown) == (0.0, {})


@played("tell")
async def test_a_parameter_under_none_of_its_names_is_told_and_guessed(
    made: Bench, autopilot: MavlinkAutopilot
) -> None:
    forget(made, "RTL_ALT", "BATT_LOW_MAH")
    energy, unknown = await learnt(autopilot)
    assert unknown == {
        "BATT_LOW_MAH": "the vehicle has no parameter BATT_LOW_MAH; the reserve does not count with this stage "
        "of the battery",
        "RTL_ALT": "the vehicle has no parameter RTL_ALT or RTL_ALT_M; the altitude of returns is guessed to be "
        "15 m",
    }
    assert energy.guessed == ("BATT_LOW_MAH", "RTL_ALT")


@played("tell", replace(AGILE, parameters={"WPNAV_SPEED_DN": 0}))
async def test_a_speed_that_is_none_is_told_and_guessed(_: Bench, autopilot: MavlinkAutopilot) -> None:
    energy, unknown = await learnt(autopilot)
    assert unknown == {
        "WPNAV_SPEED_DN": "0 m/s makes no sense; the speed of descents is guessed to be 1.5 m/s"
    }
    assert energy.guessed == ("WPNAV_SPEED_DN",)


def test_a_link_that_loses_much_is_no_reason_to_guess(tell: Callable[..., None]) -> None:
    async def story(_: Bench, autopilot: MavlinkAutopilot) -> None:
        energy, unknown = await learnt(autopilot)
        assert (energy.guessed, unknown) == ((), {})

    for seed in range(3):
        tell(story, SLOW, Air(0.2, seed=seed))


@played("tell")
async def test_a_question_that_is_never_answered_is_not_taken_for_a_parameter_that_is_not_there(
    made: Bench, autopilot: MavlinkAutopilot
) -> None:
    forget(made, *OLD, "FRAME_CLASS")  # no answer tells that the questions arrive
    _, unknown = await learnt(autopilot)
    assert "the vehicle did not answer what its RTL_ALT or RTL_ALT_M is" in unknown["RTL_ALT"]
    reading = await read_parameters(autopilot.vehicle, ["RTL_ALT"])
    assert reading.absent == frozenset()


def test_a_vehicle_that_says_so_has_no_such_parameter(
    tell: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []

    def refuse(asker: PeerConnection, message: Any) -> None:
        asked.append(message.param_id)
        asker.send(
            mavlink.MAVLink_param_error_message(
                1, 191, message.param_id.encode(), -1, mavlink.MAV_PARAM_ERROR_DOES_NOT_EXIST
            )
        )

    monkeypatch.setitem(connection._LISTENERS, "PARAM_REQUEST_READ", refuse)

    async def story(_: Bench, autopilot: MavlinkAutopilot) -> None:
        reading = await read_parameters(autopilot.vehicle, ["NOWHERE"])
        assert reading.absent == {"NOWHERE"}
        assert asked.count("NOWHERE") == 1

    tell(story)


def test_no_more_is_asked_at_once_than_an_autopilot_keeps(
    tell: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    waiting, most = [0], [0]
    heard = PeerConnection._hear_read_request

    def count(asker: PeerConnection, message: Any) -> None:
        waiting[0] += 1
        most[0] = max(most[0], waiting[0])
        asyncio.get_running_loop().call_later(0.02, answer, asker, message)

    def answer(asker: PeerConnection, message: Any) -> None:
        waiting[0] -= 1
        heard(asker, message)

    monkeypatch.setitem(connection._LISTENERS, "PARAM_REQUEST_READ", count)

    async def story(_: Bench, autopilot: MavlinkAutopilot) -> None:
        energy, _unknown = await learnt(autopilot)
        assert energy.guessed == ()
        assert 2 < most[0] <= 20

    tell(story)


@played("tell")
async def test_a_parameter_that_is_not_there_cannot_be_set(_: Bench, autopilot: MavlinkAutopilot) -> None:
    with pytest.raises(Exception, match="the vehicle has no parameter NOWHERE"):
        await set_parameter(autopilot.vehicle, "NOWHERE", 1.0)


@pytest.mark.virtual
async def test_a_flight_that_is_taken_up_in_the_air_knows_the_way_home(
    *, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with bench(SLOW) as made:
        async with made.program() as autopilot:
            await take_off(autopilot)
        async with made.program() as autopilot:
            await autopilot.claim(resumes=True)
            assert autopilot.energy.way_home is not None
            assert autopilot.energy.way_home.altitude_m == 100.0


@pytest.mark.virtual
async def test_a_px4_without_its_parameters_is_told_of() -> None:
    settings = Px4Settings(GeoPosition(39.3666, 22.9507), parameters={"COM_OBL_RC_ACT": 3.0})
    async with driven(settings) as (sky, autopilot):
        without(sky, "COM_OBL_RC_ACT", "RTL_RETURN_ALT", "BAT_LOW_THR")
        news: list[VehicleNews] = []
        autopilot.listen(news.append)
        await autopilot.claim(resumes=False)
        await autopilot.ready()
        await autopilot.limits()
        unknown = {each.name for each in news if isinstance(each, VehicleSetting) and each.value is None}
        assert unknown == {"COM_OBL_RC_ACT", "RTL_RETURN_ALT", "BAT_LOW_THR"}
        assert autopilot.energy.guessed == ("BAT_LOW_THR", "RTL_RETURN_ALT")


def without(sky: Bench, *names: str) -> None:
    parameters = sky.copter.parameters
    monkey = type(parameters).named

    class Fewer(type(parameters)):  # type: ignore[misc]
        def named(self, name: str) -> Any:
            return None if name in names else monkey(self, name)

    parameters.__class__ = Fewer
