"""The driver of an ArduCopter on virtual time, over links that lose, repeat and reorder packets, too."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import replace
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.played import played
from tests.ports.memory import AGILE, HASTY, HOME, Air, Bench, bench, driven
from tests.ports.steps import claim_and_arm, take_off

from upwash.core.geo import LocalFrame, Position, distance_m
from upwash.core.vehicle.control import Owner
from upwash.errors import (
    AutopilotError,
    AutopilotLost,
    AutopilotOverruled,
    AutopilotRefused,
    AutopilotTimeout,
)
from upwash.eventlog.schema import (
    ArmingDelayed,
    HomeMoved,
    LinkLost,
    LinkRestored,
    LinkTrouble,
    PositionDoubted,
    VehicleSaid,
)
from upwash.ports import VehicleNews
from upwash.real.mavlink import DriverPatience, FlightSettings, MavlinkAutopilot, connect_autopilot
from upwash.real.mavlink.arducopter import ARDUCOPTER
from upwash.real.mavlink.vehicle import MavlinkVehicle
from upwash.sim.loop import run_virtually
from upwash.vehicle.ardupilot.boot import Text
from upwash.vehicle.ardupilot.copter import FORCED_DISARM, Copter
from upwash.vehicle.ardupilot.settings import VehicleSettings
from upwash.vehicle.body.copter import FaultKind, Result, VehicleFault

FRAME = LocalFrame(HOME)
SPEEDUP = 10.0
FAITHFUL = VehicleSettings(
    home=HOME,
    speedup=SPEEDUP,
    armable_after_s=3.0,
    parameters={"DISARM_DELAY": 10.0 * SPEEDUP},  # as long on the driver's clock as a real one's
)
BRISK = FlightSettings(
    arm_again_s=0.1,
    progress_s=0.4,
    patience=DriverPatience(answer_s=0.15, effect_s=0.5, attempts=25, others_s=0.0, quiet_after_s=2.5),
)
HARD_OF_HEARING = replace(
    HASTY,
    patience=DriverPatience(answer_s=0.1, attempts=4, others_s=0.0, quiet_after_s=0.3, lost_after_s=10.0),
)
POSITION, HEARTBEAT = mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, mavlink.MAVLINK_MSG_ID_HEARTBEAT
Flight = Callable[[Bench, MavlinkAutopilot], Awaitable[None]]


def fly(
    flight: Flight,
    *,
    share: float = 0.0,
    vehicle: VehicleSettings = AGILE,
    settings: FlightSettings = BRISK,
    ground_speed_m_s: float = 40.0,
) -> None:
    async def flown() -> None:
        air = Air(share, seed=1)
        async with driven(vehicle, settings, ground_speed_m_s, air=air) as (made, autopilot):
            await flight(made, autopilot)

    run_virtually(flown())


def news_of(autopilot: MavlinkAutopilot) -> list[VehicleNews]:
    news: list[VehicleNews] = []
    autopilot.listen(news.append)
    return news


async def turns_true(look: Callable[[], object], *, within_s: float = 20.0) -> None:
    async with asyncio.timeout(within_s):
        while not look():  # noqa: ASYNC110
            await asyncio.sleep(0.02)


def mode_of(made: Bench) -> int:
    return int(made.copter.mode)


# --- missions on every link ---------------------------------------------------------------------------------


@pytest.mark.parametrize("share", [0.0, 0.05, 0.2])
def test_a_whole_mission_arrives_everywhere_whatever_the_link_does(share: float) -> None:
    async def mission(_: Bench, autopilot: MavlinkAutopilot) -> None:
        await claim_and_arm(autopilot)
        await autopilot.takeoff(10.0)
        assert autopilot.position.altitude_m == pytest.approx(10.0, abs=1.0)
        speeds_m_s: list[float] = []
        watching = asyncio.create_task(watch_speed(autopilot, speeds_m_s))
        for waypoint in Position(30.0, 0.0, 10.0), Position(30.0, 30.0, 12.0):
            await autopilot.goto(waypoint)
            assert distance_m(autopilot.position, waypoint) <= 1.0
        watching.cancel()
        assert sorted(speeds_m_s)[len(speeds_m_s) // 2] < 3.5  # it was told 3 m/s, and flies 5.4 by itself
        await autopilot.return_home_and_land()
        assert distance_m(autopilot.position, Position(0.0, 0.0)) <= 1.0
        await autopilot.disarm()
        assert autopilot.telemetry.battery_percent is not None
        assert 50 < autopilot.telemetry.battery_percent < 100

    fly(mission, share=share, vehicle=FAITHFUL, ground_speed_m_s=3.0)


async def watch_speed(autopilot: MavlinkAutopilot, speeds_m_s: list[float]) -> None:
    """How fast it moves, from position to position."""
    while True:
        before = autopilot.position
        await asyncio.sleep(0.1)
        speeds_m_s.append(distance_m(before, autopilot.position) / 0.1 / SPEEDUP)


@pytest.mark.parametrize("share", [0.0, 0.05, 0.2])
def test_what_the_vehicle_refuses_is_an_error_with_the_step(share: float) -> None:
    async def mission(_: Bench, autopilot: MavlinkAutopilot) -> None:
        await autopilot.claim(resumes=False)
        with pytest.raises(AutopilotRefused, match=r"takeoff to 5 m: .*MAV_RESULT_FAILED"):
            await autopilot.takeoff(5.0)
        await claim_and_arm(autopilot)
        await autopilot.takeoff(5.0)
        with pytest.raises(AutopilotRefused, match=r"takeoff to 9 m: .*MAV_RESULT_FAILED"):
            await autopilot.takeoff(9.0)
        with pytest.raises(AutopilotRefused, match=r"disarm: .*MAV_RESULT_FAILED"):
            await autopilot.disarm()
        await autopilot.land()
        await autopilot.disarm()

    fly(mission, share=share)


@pytest.mark.parametrize(
    ("command", "parameters", "result"),
    [
        (mavlink.MAV_CMD_DO_CHANGE_SPEED, (1, 0.0), "DENIED"),
        (mavlink.MAV_CMD_DO_PARACHUTE, (), "UNSUPPORTED"),
        (mavlink.MAV_CMD_NAV_TAKEOFF, (0, 0, 0, 0, 0, 0, 5.0), "FAILED"),
        (mavlink.MAV_CMD_DO_SET_MODE, (1, 99), "FAILED"),
    ],
)
@played(fly, share=0.2)
async def test_every_no_is_told_by_its_name(
    _: Bench, autopilot: MavlinkAutopilot, *, command: int, parameters: tuple[float, ...], result: str
) -> None:
    await autopilot.claim(resumes=False)
    with pytest.raises(AutopilotRefused, match=f"try: .*MAV_RESULT_{result}"):
        await autopilot.command(command, "try", parameters)


@played(fly, settings=HASTY, ground_speed_m_s=30.0)
async def test_the_ground_speed_holds_from_the_first_leg_on(made: Bench, autopilot: MavlinkAutopilot) -> None:
    await take_off(autopilot)
    begun_s = made.now_s
    await autopilot.goto(Position(12.0, 0.0, 5.0))
    assert made.now_s - begun_s < 1.8  # at the speed that the vehicle has by itself: 2.4 s
    await autopilot.set_ground_speed(10.0)
    begun_s = made.now_s
    await autopilot.goto(Position(0.0, 0.0, 5.0))
    assert 1.0 < made.now_s - begun_s < 2.2


# --- arming -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("share", [0.0, 0.2])
def test_arming_waits_for_the_position_estimate_and_the_reports_are_asked_for(share: float) -> None:
    async def mission(made: Bench, autopilot: MavlinkAutopilot) -> None:
        begun_s = made.now_s
        await claim_and_arm(autopilot)
        assert made.now_s - begun_s > 1.0
        assert autopilot.telemetry.battery_percent is not None
        assert autopilot.position == Position(0.0, 0.0)
        await autopilot.disarm()

    fly(mission, share=share, vehicle=replace(AGILE, armable_after_s=3.5))


def test_a_refusal_to_arm_carries_the_vehicles_reason() -> None:
    async def mission(made: Bench, autopilot: MavlinkAutopilot) -> None:
        with pytest.raises(AutopilotRefused) as caught:
            await claim_and_arm(autopilot)
        assert (caught.value.step, caught.value.vehicle_said) == ("arm", "Hardware safety switch")
        made.mend(FaultKind.ARMING)
        await claim_and_arm(autopilot)

    stubborn = replace(AGILE, faults=(VehicleFault(FaultKind.ARMING),))
    fly(mission, vehicle=stubborn, settings=replace(BRISK, ready_timeout_s=2.0))


def test_what_its_last_checks_object_to_is_told_and_it_is_armed_once_they_pass(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    refusals = 2
    arms = Copter.arm

    def reluctantly(self: Copter, now_s: float, *, forced: bool = False) -> Result:
        nonlocal refusals
        if refusals == 0:
            return arms(self, now_s, forced=forced)
        refusals -= 1
        self.say(Text("Arm: Throttle is not low"))
        return Result.FAILED

    monkeypatch.setattr(Copter, "arm", reluctantly)

    async def mission(_: Bench, autopilot: MavlinkAutopilot) -> None:
        news = news_of(autopilot)
        await claim_and_arm(autopilot)
        assert news.count(ArmingDelayed(reasons=("Throttle is not low",))) == 1
        assert autopilot.armed

    fly(mission, settings=HASTY)


@played(
    fly,
    vehicle=replace(FAITHFUL, armable_after_s=0.0),
    settings=replace(BRISK, ready_timeout_s=0.15),
    ground_speed_m_s=4.0,
)
async def test_without_gps_it_is_not_armed_and_in_flight_it_lands_by_itself(
    made: Bench, autopilot: MavlinkAutopilot
) -> None:
    made.fail(FaultKind.GPS)
    with pytest.raises(AutopilotRefused, match="GPS"):
        await claim_and_arm(autopilot)
    made.mend(FaultKind.GPS)
    await claim_and_arm(autopilot)
    await autopilot.takeoff(10.0)
    made.fail(FaultKind.GPS)
    with pytest.raises(AutopilotRefused, match=r"goto .*LAND.*EKF Failsafe"):
        await autopilot.goto(Position(4_000.0, 0.0, 10.0))


@played(fly, vehicle=replace(AGILE, parameters={"BATT_LOW_TIMER": 0}))
async def test_a_battery_that_runs_low_shows(made: Bench, autopilot: MavlinkAutopilot) -> None:
    news = news_of(autopilot)
    await claim_and_arm(autopilot)
    made.fail(FaultKind.BATTERY)
    await turns_true(lambda: (autopilot.telemetry.battery_percent or 100) <= 10)
    await turns_true(lambda: any("Battery 1 is low" in str(item) for item in news))


# --- silences and delays ------------------------------------------------------------------------------------


@played(fly)
async def test_a_lost_link_is_noticed_within_3_s_and_survived(
    made: Bench, autopilot: MavlinkAutopilot
) -> None:
    news = news_of(autopilot)
    await take_off(autopilot)
    leg = asyncio.create_task(autopilot.goto(Position(60.0, 0.0, 5.0)))
    made.fail(FaultKind.LINK)
    begun_s = made.now_s
    await autopilot.vehicle.link_lost()
    assert 2.0 < made.now_s - begun_s < 3.0
    assert not autopilot.vehicle.linked
    made.mend(FaultKind.LINK)
    await autopilot.vehicle.link_restored()
    await leg
    assert distance_m(autopilot.position, Position(60.0, 0.0, 5.0)) <= 1.0
    lost, restored = (item for item in news if isinstance(item, LinkLost | LinkRestored))
    assert isinstance(lost, LinkLost) and isinstance(restored, LinkRestored)
    assert 2.0 < lost.silent_s <= restored.silent_s


@pytest.mark.parametrize("verb", ["takeoff", "goto"])
def test_a_link_that_stays_lost_ends_the_verb(verb: str) -> None:
    async def mission(made: Bench, autopilot: MavlinkAutopilot) -> None:
        await claim_and_arm(autopilot)
        if verb == "goto":
            await autopilot.takeoff(5.0)
        made.fail(FaultKind.LINK)
        begun_s = made.now_s
        with pytest.raises(AutopilotLost, match=rf"{verb} .*: nothing was heard on memory for 1.5 s"):
            await (autopilot.takeoff(5.0) if verb == "takeoff" else autopilot.goto(Position(90.0, 0.0, 5.0)))
        assert made.now_s - begun_s < 3.0

    patience = replace(BRISK.patience, quiet_after_s=0.5, lost_after_s=1.5)
    fly(mission, settings=replace(BRISK, patience=patience))


def test_attempts_in_a_silence_of_the_link_do_not_count_against_a_command() -> None:
    async def mission(made: Bench, autopilot: MavlinkAutopilot) -> None:
        await take_off(autopilot)
        expected: list[float] = []

        def expect() -> None:
            expected.append(made.now_s)
            made.cut = len(expected) == 1  # when the first attempt is sent
            asyncio.get_running_loop().call_later(3.0, setattr, made, "cut", False)

        await autopilot.vehicle.command("speed", mavlink.MAV_CMD_DO_CHANGE_SPEED, 1, 5.0, -1, expect=expect)
        first_s, second_s = expected
        assert second_s - first_s > 2.9

    once = replace(HARD_OF_HEARING.patience, answer_s=0.5, attempts=1)
    fly(mission, settings=replace(HARD_OF_HEARING, patience=once))


@played(fly, settings=HARD_OF_HEARING)
async def test_a_command_that_is_not_answered_while_the_vehicle_reports_is_given_up(
    made: Bench, autopilot: MavlinkAutopilot
) -> None:
    await take_off(autopilot)
    hear = made.connection.hear

    def ignore_speeds(message: Any) -> None:
        if getattr(message, "command", 0) != mavlink.MAV_CMD_DO_CHANGE_SPEED:
            hear(message)

    made.connection.hear = ignore_speeds  # type: ignore[method-assign]
    with pytest.raises(AutopilotTimeout, match=r"no answer to MAV_CMD_DO_CHANGE_SPEED after 4 attempts"):
        await autopilot.command(mavlink.MAV_CMD_DO_CHANGE_SPEED, "speed", (1, 5.0, -1))


@pytest.mark.parametrize("silent_s", [0.0, 8.0])
@played(fly, settings=replace(HARD_OF_HEARING, margin_s=3.0, slowest_share=1e6))
async def test_the_time_of_a_verb_runs_on_except_in_a_silence(
    made: Bench, autopilot: MavlinkAutopilot, *, silent_s: float
) -> None:
    await take_off(autopilot)
    begun_s = made.now_s
    loop = asyncio.get_running_loop()
    loop.call_later(0.5, setattr, made, "cut", silent_s > 0)
    loop.call_later(0.5 + silent_s, setattr, made, "cut", False)
    with pytest.raises(AutopilotTimeout, match=r"goto .*: not done within \d+ s, in mode GUIDED"):
        await autopilot.goto(Position(9_000.0, 0.0, 5.0))
    assert made.now_s - begun_s == pytest.approx(3.1 + silent_s, abs=0.25)


@played(fly, settings=replace(BRISK, patience=replace(BRISK.patience, quiet_after_s=0.5)))
async def test_reports_that_stop_are_asked_for_again(_: Bench, autopilot: MavlinkAutopilot) -> None:
    vehicle = autopilot.vehicle
    vehicle.question(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, POSITION, -1)
    stopped_s = vehicle.now_s + 0.3
    assert await vehicle.happens("wait", lambda: vehicle.heard_since(POSITION, stopped_s), within_s=3.0)


# --- others who act on it -----------------------------------------------------------------------------------


def set_mode(mode: int) -> Any:
    return mavlink.MAVLink_set_mode_message(1, 1, mode)


@played(fly, settings=HASTY, ground_speed_m_s=10.0)
async def test_when_the_pilot_takes_over_the_leg_ends_and_the_vehicle_is_left_to_the_pilot(
    made: Bench, autopilot: MavlinkAutopilot
) -> None:
    await take_off(autopilot, 3.0)
    async with made.pilot() as pilot:
        leg = asyncio.create_task(autopilot.goto(Position(500.0, 0.0, 3.0)))
        await asyncio.sleep(0.2)
        pilot.send(set_mode(mavlink.COPTER_MODE_LOITER))
        with pytest.raises(
            AutopilotOverruled, match=r"goto .*the program has lost the vehicle.*LOITER .no report tells who"
        ):
            await leg
        pilot.send(set_mode(mavlink.COPTER_MODE_GUIDED))
        verbs: tuple[Callable[[], Awaitable[None]], ...] = (
            lambda: autopilot.goto(Position(0.0, 0.0, 3.0)),
            autopilot.hold,
            autopilot.land,
            autopilot.return_home_and_land,
            autopilot.disarm,
            lambda: autopilot.claim(resumes=True),
        )
        since_s = made.now_s
        for verb in verbs:
            with pytest.raises(AutopilotOverruled, match="nothing was sent"):
                await verb()
        assert made.commands(since_s) == []


@pytest.mark.parametrize("silent", [False, True], ids=["at once", "in a silence of the link"])
@played(fly, settings=HARD_OF_HEARING)
async def test_no_command_goes_out_on_a_report_from_before_the_pilot_took_over(
    made: Bench, autopilot: MavlinkAutopilot, *, silent: bool
) -> None:
    await take_off(autopilot, 3.0)
    async with made.pilot() as pilot:
        if silent:
            made.cut = True
            asyncio.get_running_loop().call_later(0.5, setattr, made, "cut", False)
            returning = asyncio.create_task(autopilot.return_home_and_land())
            await asyncio.sleep(0.1)
        pilot.send(set_mode(mavlink.COPTER_MODE_LOITER))
        with pytest.raises(AutopilotOverruled, match="the program has lost the vehicle"):
            await (returning if silent else autopilot.return_home_and_land())
        await asyncio.sleep(1.0)
        assert mode_of(made) == mavlink.COPTER_MODE_LOITER


def command_int(
    number: int, place: Position, *, frame: int, parameters: tuple[float, ...] = (0.0,) * 4
) -> Any:
    geo = FRAME.geo(place)
    degrees_e7 = round(geo.latitude_deg * 1e7), round(geo.longitude_deg * 1e7)
    return mavlink.MAVLink_command_int_message(
        1, 1, frame, number, 0, 0, *parameters, *degrees_e7, place.altitude_m
    )


ELSEWHERE = Position(-52.0, 0.0, 3.0)
TARGETS = {"in a leg": True, "between two verbs": False}


@pytest.mark.parametrize("flies", TARGETS.values(), ids=TARGETS)
@pytest.mark.parametrize("target", [ELSEWHERE, Position(0.0, 0.0, 30.0)], ids=["elsewhere", "higher"])
@played(fly, settings=HASTY, ground_speed_m_s=10.0)
async def test_a_target_of_a_ground_station_in_the_programs_mode_ends_what_the_program_sends(
    made: Bench, autopilot: MavlinkAutopilot, *, flies: bool, target: Position
) -> None:
    await take_off(autopilot, 3.0)
    await autopilot.goto(Position(1.0, 0.0, 3.0))
    async with made.pilot() as station:
        leg = asyncio.create_task(autopilot.goto(Position(500.0, 0.0, 3.0))) if flies else None
        await asyncio.sleep(0.4)
        station.send(
            command_int(
                mavlink.MAV_CMD_DO_REPOSITION,
                target,
                frame=mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT,
                parameters=(-1.0, 1.0, 0.0, 0.0),
            )
        )
        await turns_true(lambda: not autopilot.control.is_ours)
        if leg:
            with pytest.raises(AutopilotOverruled, match="a ground station or another program"):
                await leg
        assert autopilot.control.owner is Owner.GROUND_STATION
        with pytest.raises(AutopilotOverruled, match="from where the program sent it; nothing was sent"):
            await autopilot.goto(Position(0.0, 0.0, 3.0))
        await turns_true(lambda: distance_m(autopilot.position, target) <= 1)


@played(fly, settings=HASTY)
async def test_a_home_that_is_moved_in_flight_changes_no_altitude_and_is_where_it_returns_to(
    made: Bench, autopilot: MavlinkAutopilot
) -> None:
    news = news_of(autopilot)
    await take_off(autopilot, 15.0)
    await autopilot.goto(Position(5.0, 0.0, 15.0))
    new_home = Position(40.0, 30.0, -12.0)
    frame = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT
    async with made.pilot() as station:
        station.send(command_int(mavlink.MAV_CMD_DO_SET_HOME, new_home, frame=frame))
        await turns_true(lambda: any(isinstance(item, HomeMoved) for item in news))
    assert autopilot.position.altitude_m == pytest.approx(15.0, abs=0.5)
    await autopilot.goto(Position(10.0, 0.0, 15.0))
    assert made.copter.position(made.now_s).altitude_m == pytest.approx(15.0, abs=0.5)
    moved = [
        Position(item.east_m, item.north_m, item.altitude_m) for item in news if isinstance(item, HomeMoved)
    ]
    assert [distance_m(home, new_home) < 0.5 for home in moved] == [True]
    await autopilot.return_home_and_land()
    assert distance_m(made.copter.position(made.now_s), new_home.at_altitude(0.0)) < 1
    assert autopilot.control.is_ours


@pytest.mark.parametrize("ends", [True, False])
@played(fly, vehicle=FAITHFUL, settings=replace(HASTY, margin_s=4.0), ground_speed_m_s=5.0)
async def test_a_jump_of_the_position_is_no_arrival_whatever_the_vehicle_says_of_it(
    made: Bench, autopilot: MavlinkAutopilot, *, ends: bool
) -> None:
    waypoint, news = Position(0.0, 40.0, 5.0), news_of(autopilot)
    await take_off(autopilot, 5.0)
    made.fail(FaultKind.GLITCH)
    await turns_true(lambda: any(isinstance(item, PositionDoubted) for item in news))
    leg = asyncio.create_task(autopilot.goto(waypoint))
    await turns_true(
        lambda: any(isinstance(item, VehicleSaid) and item.text == "Glitch cleared" for item in news)
    )
    await asyncio.sleep(1.5)
    assert distance_m(autopilot.position, waypoint) < 1  # it says that it is there
    assert not leg.done()
    if ends:
        made.mend(FaultKind.GLITCH)
        await leg
        assert not autopilot.vehicle.hindrance()
    else:
        with pytest.raises(AutopilotTimeout, match=r"jumped 5[56] m, farther than it can fly"):
            await leg
        await autopilot.hold()


def test_a_place_that_the_vehicle_is_not_sure_of_is_no_arrival_and_a_hold_all_the_same() -> None:
    async def mission(made: Bench, autopilot: MavlinkAutopilot) -> None:
        await take_off(autopilot, 5.0)
        waypoint, sure = Position(10.0, 0.0, 5.0), [False]
        reports = made.firmware.reports
        number = mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT
        told = reports[number]
        made.firmware.reports = {**reports, number: lambda now_s: told(now_s) if sure[0] else unsure}
        await turns_true(lambda: autopilot.vehicle.telemetry.knows_its_place is False)
        leg = asyncio.create_task(autopilot.goto(waypoint))
        await asyncio.sleep(10.0)
        assert distance_m(autopilot.position, waypoint) < 1 and autopilot.telemetry.ground_speed_m_s == 0.0
        assert not leg.done()
        assert autopilot.vehicle.hindrance() == ": it is not sure of its position"
        leg.cancel()
        await autopilot.hold()
        leg = asyncio.create_task(autopilot.goto(waypoint))
        await asyncio.sleep(5.0)
        sure[0] = True
        await asyncio.wait_for(leg, 5.0)

    unsure = mavlink.MAVLink_ekf_status_report_message(mavlink.EKF_CONST_POS_MODE, *[0.0] * 5)
    fly(mission, settings=HASTY)


@played(fly, vehicle=replace(AGILE, climb_m_s=20.0), settings=HASTY)
async def test_motors_that_stop_in_the_air_are_no_pilots_act_and_no_landing(
    made: Bench, autopilot: MavlinkAutopilot
) -> None:
    await take_off(autopilot, 30.0)
    leg = asyncio.create_task(autopilot.goto(Position(500.0, 0.0, 30.0)))
    await asyncio.sleep(0.4)
    stop = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
    async with made.pilot() as station:
        station.send(mavlink.MAVLink_command_long_message(1, 1, stop, 0, 0, FORCED_DISARM, *(0.0,) * 5))
        with pytest.raises(AutopilotOverruled, match="its motors stopped in the air"):
            await leg
    assert autopilot.control.owner is Owner.UNKNOWN
    assert not autopilot.stands
    async with asyncio.timeout(10):
        await autopilot.stood()
    assert autopilot.stands


@pytest.mark.parametrize("flies", [True, False])
def test_an_autopilot_that_restarts_is_lost_in_flight_and_armed_before(flies: bool) -> None:
    async def mission(made: Bench, autopilot: MavlinkAutopilot) -> None:
        await (take_off(autopilot, 3.0) if flies else autopilot.claim(resumes=False))
        await asyncio.sleep(1.0)
        await made.switch_off()
        made.switch_on(AGILE)
        if flies:
            await turns_true(lambda: "its autopilot restarted" in autopilot.control.why)
            assert autopilot.control.owner is Owner.UNKNOWN
            with pytest.raises(AutopilotOverruled):
                await autopilot.claim(resumes=True)
        else:
            async with asyncio.timeout(20):
                await claim_and_arm(autopilot)
            assert autopilot.control.is_ours

    # a quick clock goes back by more than a late message does
    fly(mission, vehicle=replace(AGILE, speedup=20.0) if flies else AGILE, settings=HASTY)


class Half:
    """One of several vehicles on a program's line."""

    def __init__(self, line: Any) -> None:
        self.ended, self.datagram_received = line.ended, line.datagram_received
        self.write: Callable[[bytes], None]


@pytest.mark.virtual
async def test_two_vehicles_with_one_identity_are_not_armed() -> None:
    async with bench() as one, bench(replace(AGILE, home=FRAME.geo(Position(89.0, 0.0)))) as other:
        sent: list[bytes] = []

        async def open_line(line: Any) -> None:
            halves = [Half(line)]
            await one.open(halves[0])

            def join() -> None:
                halves.append(Half(line))
                asyncio.ensure_future(other.open(halves[1])).add_done_callback(
                    lambda _: [halves[1].write(data) for data in sent]
                )

            def write(data: bytes) -> None:
                sent.append(data)
                for half in halves:
                    half.write(data)

            line.write = write
            asyncio.get_running_loop().call_later(4.0, join)  # their numbers must differ

        autopilot = await connect_autopilot(open_line, frame=FRAME, ground_speed_m_s=5.0, settings=HASTY)
        await autopilot.claim(resumes=False)
        await asyncio.sleep(5.0)
        with pytest.raises(AutopilotRefused, match="two vehicles"):
            async with asyncio.timeout(20):
                await autopilot.ready()
                await autopilot.arm()
        assert not any(made.copter.armed(made.now_s) for made in (one, other))
        await autopilot.close()


# --- vehicles of single messages ----------------------------------------------------------------------------


class Scripted:
    """A vehicle that answers each datagram of the driver with some messages."""

    def __init__(self, answers: Callable[[Any], list[Any]]) -> None:
        self.line: Any = None
        self.codec = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        self._answers = answers

    async def open(self, line: Any) -> None:
        def write(data: bytes) -> None:
            for message in mavlink.MAVLink(None).parse_buffer(data) or ():
                self.say(*self._answers(message))

        self.line, line.write = line, write

    def say(self, *messages: Any) -> None:
        for message in messages:
            packet = bytes(message.pack(self.codec))
            self.codec.seq = (self.codec.seq + 1) % 256
            asyncio.get_running_loop().call_soon(self.line.datagram_received, packet, ("", 1))


def beat(mode: int = 0, autopilot: int = 3, kind: int = 2) -> Any:
    return mavlink.MAVLink_heartbeat_message(kind, autopilot, 81, mode, 3, 3)


@pytest.mark.parametrize(("autopilot", "kind"), [(12, 1), (4, 2), (3, 1), (3, 10)])
@pytest.mark.virtual
async def test_what_cannot_be_flown_is_refused(autopilot: int, kind: int) -> None:
    other = Scripted(lambda _: [beat(autopilot=autopilot, kind=kind)])
    with pytest.raises(AutopilotError, match="only multicopters with ArduCopter or PX4"):
        await connect_autopilot(other.open, frame=FRAME, ground_speed_m_s=4.0)


class Doubtful(Scripted):
    """Passes its checks and flies in GUIDED without knowing where it is, and takes no target."""

    def __init__(self) -> None:
        super().__init__(self._reply)
        self.asked: list[int] = []

    def report(self) -> None:
        """Sends the reports that it has, ten times a second: more often than the driver needs any."""
        checked = mavlink.MAV_SYS_STATUS_PREARM_CHECK
        self.say(
            beat(mavlink.COPTER_MODE_GUIDED),
            mavlink.MAVLink_sys_status_message(checked, checked, checked, 0, 12_000, 0, 99, *[0] * 6),
            mavlink.MAVLink_ekf_status_report_message(mavlink.EKF_CONST_POS_MODE, *[0.0] * 5),
        )
        asyncio.get_running_loop().call_later(0.1, self.report)

    async def open(self, line: Any) -> None:
        await super().open(line)
        self.report()

    def _reply(self, message: Any) -> list[Any]:
        if message.get_type() == "COMMAND_LONG":
            self.asked.append(int(message.param1))
        if message.get_type() != "COMMAND_INT":
            return []
        return [mavlink.MAVLink_command_ack_message(message.command, mavlink.MAV_RESULT_FAILED, 0, 0, 1, 191)]


@asynccontextmanager
async def doubtful_vehicle() -> AsyncIterator[tuple[list[int], MavlinkAutopilot]]:
    vehicle = Doubtful()
    autopilot = await connect_autopilot(
        vehicle.open,
        frame=FRAME,
        ground_speed_m_s=4.0,
        settings=replace(BRISK, ready_timeout_s=0.3, ask_again_s=0.1),
    )
    yield vehicle.asked, autopilot
    await autopilot.close()


@pytest.mark.virtual
async def test_a_vehicle_without_a_position_is_not_armed_and_its_refusal_of_a_target_is_explained() -> None:
    async with doubtful_vehicle() as (_, autopilot):
        news = news_of(autopilot)
        await autopilot.claim(resumes=False)
        with pytest.raises(AutopilotRefused, match="does not know its position yet") as caught:
            await autopilot.ready()
        assert caught.value.vehicle_said == ""  # those were not its words
        assert ArmingDelayed(reasons=("it does not know its position yet",)) in news
        with pytest.raises(AutopilotRefused, match=r"goto .*MAV_RESULT_FAILED.* outside its own fence"):
            await autopilot.goto(Position(10.0, 0.0, 5.0))


@pytest.mark.virtual
async def test_reports_that_never_come_are_asked_for_ever_more_rarely() -> None:
    async with doubtful_vehicle() as (asked, _):
        await turns_true(lambda: asked.count(mavlink.MAVLINK_MSG_ID_FENCE_STATUS) >= 11, within_s=60.0)
        asked.clear()
        await asyncio.sleep(50.0)
        assert asked.count(mavlink.MAVLINK_MSG_ID_FENCE_STATUS) <= 3
        assert not asked.count(mavlink.MAVLINK_MSG_ID_SYS_STATUS)


@pytest.mark.virtual
async def test_what_arrives_late_or_twice_changes_nothing() -> None:
    sender = Scripted(lambda _: [])
    vehicle = MavlinkVehicle(sender.open, DriverPatience(quiet_after_s=0.3), [ARDUCOPTER])
    await asyncio.sleep(0.1)
    for sequence, mode, then in (
        (255, 0, 0),
        (1, 4, 4),  # the count begins anew after 255
        (0, 0, 4),  # late
        (1, 0, 4),  # twice
        (2, 6, 6),
        (208, 9, 6),  # as late as 50 messages, of which a vehicle sends as many in a second
        (150, 9, 9),  # too far back to be late: the vehicle was restarted
    ):
        sender.codec.seq = sequence
        sender.say(beat(mode))
        await asyncio.sleep(0.02)
        assert vehicle.telemetry.mode == then
    await vehicle.link_lost()
    sender.codec.seq = 149
    sender.say(beat(5))  # after a silence, anything is news
    await vehicle.link_restored()
    assert vehicle.telemetry.mode == 5
    await vehicle.close()


def test_heartbeats_go_on_after_a_defect_which_is_told(caplog: pytest.LogCaptureFixture) -> None:
    async def scenario() -> None:
        came: list[str] = []

        def note(message: Any) -> list[Any]:
            came.append(message.get_type())
            return []

        receiver = Scripted(note)
        vehicle = MavlinkVehicle(receiver.open, DriverPatience(), [ARDUCOPTER])
        failed, news = asyncio.Event(), list[VehicleNews]()

        def fail_once() -> int:
            if not failed.is_set():
                failed.set()
                raise LookupError("a defect")
            return 0

        vehicle.heartbeat_word = fail_once
        vehicle.news.listen(news.append)
        await asyncio.sleep(5.0)
        assert failed.is_set() and came
        (trouble,) = news
        assert isinstance(trouble, LinkTrouble) and "LookupError: a defect" in trouble.why
        await vehicle.close()

    run_virtually(scenario())
    assert "the vehicle's link failed: LookupError: a defect" in caplog.text
