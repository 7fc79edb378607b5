"""What the driver makes of a vehicle's parameters: under either name, missing, unanswered, and out of reason."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import replace
from typing import Any

import pytest
from msgspec import structs
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.played import played
from tests.ports.memory import AGILE, Air, Bench, bench, driven
from tests.ports.scripted import SYSTEM, Px4Script, Script, scripted
from tests.ports.steps import take_off

from upwash.core.geo import GeoPosition, Position, ground_distance_m
from upwash.core.vehicle.course import Abilities
from upwash.core.vehicle.way_home import ARDUCOPTER, PX4, EnergyFacts, WayHome
from upwash.errors import AutopilotTimeout
from upwash.eventlog.schema import VehicleSetting
from upwash.mavlink.version import Version
from upwash.ports import VehicleNews
from upwash.real.mavlink import MavlinkAutopilot
from upwash.real.mavlink.parameters import read_parameters, read_quantities, set_parameter
from upwash.real.mavlink.way_home import PX4_QUANTITIES, px4_abilities
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
            assert autopilot.energy.home is not None
            assert ground_distance_m(autopilot.energy.home, Position(0.0, 0.0)) <= 0.1


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


# --- parameters of a vehicle of single messages -------------------------------------------------------------

NAMES_4_6 = {
    "BATT_CAPACITY": 5000.0,
    "BATT_LOW_MAH": 1000.0,
    "BATT_CRT_MAH": 500.0,
    "RTL_ALT": 2500.0,
    "RTL_SPEED": 400.0,
    "WPNAV_SPEED": 700.0,
    "WPNAV_SPEED_UP": 300.0,
    "WPNAV_SPEED_DN": 200.0,
    "WPNAV_ACCEL": 500.0,
    "RTL_LOIT_TIME": 3000.0,
    "RTL_ALT_FINAL": 0.0,
    "LAND_SPEED_HIGH": 180.0,
    "LAND_ALT_LOW": 800.0,
    "LAND_SPEED": 40.0,
}
NAMES_4_7 = {
    "BATT_CAPACITY": 5000.0,
    "BATT_LOW_MAH": 1000.0,
    "BATT_CRT_MAH": 500.0,
    "RTL_ALT_M": 25.0,
    "RTL_SPEED_MS": 4.0,
    "WP_SPD": 7.0,
    "WP_SPD_UP": 3.0,
    "WP_SPD_DN": 2.0,
    "WP_ACC": 5.0,
    "RTL_LOIT_TIME": 3000.0,
    "RTL_ALT_FINAL_M": 0.0,
    "LAND_SPD_HIGH_MS": 1.8,
    "LAND_ALT_LOW_M": 8.0,
    "LAND_SPD_MS": 0.4,
}
OF_PX4 = {
    "BAT_LOW_THR": 0.25,
    "BAT_CRIT_THR": 0.125,
    "RTL_RETURN_ALT": 40.0,
    "RTL_LAND_DELAY": 0.0,
    "RTL_DESCEND_ALT": 30.0,
    "MPC_XY_CRUISE": 6.0,
    "MPC_XY_VEL_MAX": 9.0,
    "MPC_Z_V_AUTO_UP": 2.0,
    "MPC_Z_V_AUTO_DN": 1.0,
    "MPC_ACC_HOR": 2.5,
}
WAY = WayHome(
    25.0, 3.0, 4.0, 2.0, 8.0, 1.8, 8.0, 0.4
)  # twice the usual acceleration, 2 s less of the usual wait


async def told_by(
    parameters: dict[str, float], kind: type[Script] = Script
) -> tuple[EnergyFacts, dict[str, str]]:
    """What the driver knows of the way home of a vehicle with these parameters, and what it tells as unknown."""
    async with scripted(kind=kind) as script:
        script.parameters |= parameters
        return await learnt(script.autopilot)


@pytest.mark.parametrize(
    ("named", "changed", "way"),
    [
        (NAMES_4_6, {}, WAY),
        (NAMES_4_7, {}, WAY),
        (NAMES_4_6, {"RTL_SPEED": 0.0}, structs.replace(WAY, speed_m_s=7.0)),  # that of legs
        (NAMES_4_6, {"LAND_SPEED_HIGH": 0.0}, structs.replace(WAY, descent_m_s=2.0)),  # that of descents
    ],
)
@pytest.mark.virtual
async def test_the_way_home_of_an_arducopter_is_in_metres_and_seconds(
    named: dict[str, float], changed: dict[str, float], way: WayHome
) -> None:
    energy, unknown = await told_by(named | changed)
    assert unknown == {}
    assert (energy.low_percent, energy.critical_percent, energy.guessed) == (20.0, 10.0, ())
    assert energy.way_home is not None
    assert structs.astuple(energy.way_home) == pytest.approx(structs.astuple(way))


@pytest.mark.virtual
async def test_what_an_arducopter_does_not_have_is_as_usual() -> None:
    energy, unknown = await told_by({"WP_SPD": 7.0, "WP_SPD_DN": 2.0})
    assert len(unknown) == len(energy.guessed) == 12
    assert (energy.low_percent, energy.critical_percent) == (None, None)
    assert energy.way_home == structs.replace(ARDUCOPTER, speed_m_s=7.0, descent_m_s=2.0)


@pytest.mark.virtual
async def test_the_way_home_and_the_abilities_of_a_px4_are_in_metres_and_seconds() -> None:
    async with scripted(kind=Px4Script) as script:
        script.parameters |= OF_PX4
        energy, unknown = await learnt(script.autopilot)
        abilities = px4_abilities(await read_quantities(script.autopilot.vehicle, PX4_QUANTITIES))
    assert (unknown, energy.low_percent, energy.critical_percent) == ({}, 25.0, 12.5)
    assert energy.way_home == structs.replace(PX4, altitude_m=40.0, speed_m_s=6.0, descent_m_s=1.0)
    assert abilities == Abilities(9.0, 2.0, 1.0, 2.5)


@pytest.mark.parametrize(
    ("name", "value", "sensible"),
    [
        ("BATT_CAPACITY", 1e7, True),
        ("BATT_CAPACITY", 1e7 + 1, False),
        ("RTL_ALT_M", 10_000.0, True),
        ("RTL_ALT_M", 10_000.5, False),
        ("RTL_ALT_M", -0.5, False),
        ("RTL_LOIT_TIME", 3_600_000.0, True),
        ("RTL_LOIT_TIME", 3_600_500.0, False),
        ("WP_SPD", 100.0, True),
        ("WP_SPD", 100.5, False),
        ("WP_SPD", 0.5, True),
        ("WP_SPD", 0.005, False),
        ("WP_ACC", 250.0, True),
        ("WP_ACC", 251.5, False),  # 100.6 m/s² of that
        ("WP_ACC", 0.5, True),
        ("WP_ACC", 0.02, False),
    ],
)
@pytest.mark.virtual
async def test_a_value_that_no_vehicle_can_have_counts_as_unknown(
    name: str, value: float, *, sensible: bool
) -> None:
    energy, unknown = await told_by(NAMES_4_7 | {name: value})
    assert len(unknown) == (0 if sensible else 1)
    assert bool(energy.guessed) is not sensible
    assert all("makes no sense" in why for why in unknown.values())


@pytest.mark.parametrize(("share", "sensible"), [(1.0, True), (1.005, False)])
@pytest.mark.virtual
async def test_a_stage_above_a_full_battery_counts_as_unknown(share: float, *, sensible: bool) -> None:
    energy, unknown = await told_by(OF_PX4 | {"BAT_LOW_THR": share}, Px4Script)
    assert (energy.low_percent, bool(unknown)) == (100.0 if sensible else None, not sensible)


def asked(script: Script, name: str) -> list[float]:
    """When the driver asked for a parameter."""
    return [
        at_s
        for at_s, message in script.sent
        if message.get_type() == "PARAM_REQUEST_READ" and message.param_id == name
    ]


@pytest.mark.parametrize(
    ("a_after_s", "last_after_s", "times"), [(0.9, 0.9, 1), (0.08, 0.0, 1), (0.12, 0.0, 2), (0.0, 0.9, 1)]
)
@pytest.mark.virtual
async def test_a_slow_answer_is_waited_for(a_after_s: float, last_after_s: float, times: int) -> None:
    async with scripted() as script:
        script.parameters["A"] = 5.0
        script.tells_after_s = {"A": a_after_s, "FRAME_CLASS": last_after_s}
        begun_s = script.now_s
        assert await read_parameters(script.autopilot.vehicle, ["A"]) == {"A": 5.0}
        assert len(asked(script, "A")) == times
        assert script.now_s - begun_s == pytest.approx(a_after_s)
        (question, *_) = script.of_kind("PARAM_REQUEST_READ")
        assert (question.target_system, question.target_component, question.param_index) == (SYSTEM, 1, -1)


@pytest.mark.parametrize(
    ("deaf_for_s", "slow", "rounds", "took_s"),
    [
        (0.0, {}, 3, 0.3),
        (0.5, {}, 7, 1.7),  # a lost answer makes six rounds of three
        (0.0, {"B": 0.15}, 6, 0.6),  # as does one that comes late
        (60.0, {}, 12, 13.2),
    ],
)
@pytest.mark.virtual
async def test_a_parameter_is_missing_after_three_rounds_or_six_on_a_link_that_loses(
    deaf_for_s: float, slow: dict[str, float], rounds: int, took_s: float
) -> None:
    async with scripted() as script:
        script.parameters["B"], begun_s = 1.0, script.now_s
        script.tells_after_s = slow
        last = script.parameters
        if deaf_for_s:
            script.parameters = {}
        reading = asyncio.ensure_future(read_parameters(script.autopilot.vehicle, ["A", "B"]))
        await asyncio.sleep(deaf_for_s)
        script.parameters = last
        found = await reading
        assert ("A" in found.absent) == (deaf_for_s < 10)
        assert len(asked(script, "A")) == rounds
        assert script.now_s - begun_s == pytest.approx(max(took_s, deaf_for_s), abs=0.01)


NOT_THERE, DENIED = mavlink.MAV_PARAM_ERROR_DOES_NOT_EXIST, mavlink.MAV_PARAM_ERROR_PERMISSION_DENIED


@pytest.mark.parametrize(("error", "times"), [(NOT_THERE, 1), (DENIED, 3)])
@pytest.mark.virtual
async def test_a_vehicle_that_says_so_is_not_asked_again(error: int, times: int) -> None:
    class Refusing(Script):
        def _answer(self, message: Any) -> None:
            if getattr(message, "param_id", "") == "A":
                self._send([mavlink.MAVLink_param_error_message(255, 191, b"A", -1, error)])
            super()._answer(message)

    async with scripted(kind=Refusing) as script:
        reading = await read_parameters(script.autopilot.vehicle, ["A", "B"])
        assert reading.absent == {"A", "B"}
        assert (len(asked(script, "A")), len(asked(script, "B"))) == (times, 3)


@pytest.mark.virtual
async def test_a_setting_is_sent_three_times_until_it_is_read_back() -> None:
    async with scripted() as script:
        script.parameters |= {"A": 5.0, "B": 5.0001}
        vehicle, change = script.autopilot.vehicle, "PARAM_SET"
        await set_parameter(vehicle, "A", 5.0)
        (sent,) = script.of_kind(change)
        real = mavlink.MAV_PARAM_TYPE_REAL32
        assert (sent.param_id, sent.param_value, sent.param_type) == ("A", 5.0, real)
        with pytest.raises(AutopilotTimeout, match="B was not set to 5"):
            await set_parameter(vehicle, "B", 5.0)
        assert len(script.of_kind(change)) == 4
