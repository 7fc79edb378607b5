"""What a program sees of the stand-in PX4, row by row what a real one was seen to do."""

from __future__ import annotations

import asyncio
import math
from dataclasses import replace

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.played import played
from tests.vehicle.px4.client import (
    FRAME,
    HOME_ALTITUDE_M,
    SETTINGS,
    VELOCITY_ONLY,
    Px4Client,
    talk,
)

from upwash.core.geo import Position, ground_distance_m
from upwash.errors import UsageError
from upwash.mavlink.px4 import (
    AVAILABLE_MODES,
    Mode,
    float_of_bytes,
)
from upwash.vehicle.body.connection import StandIn
from upwash.vehicle.body.copter import FaultKind

NAN, IGNORED = math.nan, 2**31 - 1
ARMABLE = mavlink.MAV_SYS_STATUS_PREARM_CHECK
TAKEOFF, REPOSITION = mavlink.MAV_CMD_NAV_TAKEOFF, mavlink.MAV_CMD_DO_REPOSITION
FENCE = mavlink.MAV_MISSION_TYPE_FENCE
FAR = Position(120.0, 0.0, 10.0)


@played(talk)
async def test_it_is_a_px4_that_can_be_armed_after_some_seconds_and_says_why_not_before(
    client: Px4Client,
) -> None:
    await client.until(lambda: client.all("HEARTBEAT"))
    beat = client.all("HEARTBEAT")[0]
    assert (beat.autopilot, client.heartbeat()) == (12, (29, 0x03040000, 0))
    await asyncio.sleep(1.5)
    assert await client.arm() == 1  # temporarily rejected
    await client.says("arming denied")
    assert "no valid position estimate" in [text for _, text in client.said]
    assert not client.all("SYS_STATUS")[-1].onboard_control_sensors_health & ARMABLE
    await client.armable()
    assert client.now_s() < 6.0
    assert client.all("SYS_STATUS")[-1].onboard_control_sensors_health & ARMABLE
    assert not client.all("SYS_STATUS")[-1].onboard_control_sensors_enabled & ARMABLE  # never
    assert await client.arm() == 0
    await client.until(lambda: client.heartbeat() == (157, 0x03040000, 4))


@played(talk)
async def test_its_heartbeat_is_1_hz_whatever_is_asked_and_it_streams_by_itself(client: Px4Client) -> None:
    await asyncio.sleep(10.0)
    assert 9 <= len(client.all("HEARTBEAT")) <= 10
    rates = {"ATTITUDE": 100, "GLOBAL_POSITION_INT": 50, "LOCAL_POSITION_NED": 30, "SYS_STATUS": 5}
    known = {kind: len(client.all(kind)) for kind in rates}
    await asyncio.sleep(4.0)
    for kind, rate in rates.items():
        assert len(client.all(kind)) - known[kind] == pytest.approx(4 * rate, rel=0.03, abs=1), kind
    kinds = {message.get_type() for message in client.heard}
    assert {"CURRENT_MODE", "ESTIMATOR_STATUS", "HOME_POSITION", "GPS_RAW_INT", "VFR_HUD"} <= kinds
    assert client.all("SYSTEM_TIME")[-1].time_unix_usec > 1.7e15
    assert client.all("ESTIMATOR_STATUS")[-1].flags & mavlink.ESTIMATOR_POS_HORIZ_ABS
    assert await client.long(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 30, -1) == 0
    known["ATTITUDE"] = len(client.all("ATTITUDE"))
    await asyncio.sleep(1.0)
    assert len(client.all("ATTITUDE")) == known["ATTITUDE"]


@played(talk)
async def test_a_mode_is_answered_twice_and_only_the_mode_tells_the_truth(client: Px4Client) -> None:
    await client.take_off()
    assert await client.mode(Mode.MISSION) == [0, 1]  # it has no mission
    assert await client.mode(Mode.OFFBOARD) == [0, 1]  # nobody streams setpoints
    assert await client.mode(Mode.POSCTL) == [0, 1]  # there are no sticks
    assert client.changes[-1][1] == Mode.LOITER
    assert await client.mode(Mode.RTL) == [0, 0]
    await client.in_mode(Mode.RTL)


@pytest.mark.parametrize("altitude_m", [0.0, 10.0, -5.0, 1e6, math.inf])
@played(talk)
async def test_a_take_off_to_a_relative_altitude_is_accepted_and_stays_on_the_ground(
    client: Px4Client, *, altitude_m: float
) -> None:
    await client.quietly()
    await client.armable()
    assert await client.arm() == 0
    assert await client.long(TAKEOFF, 0, 0, 0, 0, 0, 0, altitude_m) == 0
    await client.hears("auto preflight disarming")
    assert client.here().altitude_m < 0.1
    assert client.states[-1][1] == 1


@played(talk)
async def test_a_take_off_without_altitude_goes_to_the_usual_one_and_then_it_holds(client: Px4Client) -> None:
    await client.quietly()
    await client.armable()
    assert await client.arm() == 0
    assert await client.long(TAKEOFF, NAN, 0, 0, NAN, NAN, NAN, NAN) == 0
    await client.in_mode(Mode.TAKEOFF)
    await client.in_mode(Mode.LOITER)
    await asyncio.sleep(5.0)
    assert client.here().altitude_m == pytest.approx(2.5, abs=0.2)
    assert [state for _, state in client.states] == [1, 3, 2]


@played(talk)
async def test_a_take_off_is_accepted_disarmed_and_does_nothing_when_armed_later(client: Px4Client) -> None:
    await client.quietly()
    await client.armable()
    assert await client.long(TAKEOFF, NAN, 0, 0, NAN, NAN, NAN, HOME_ALTITUDE_M + 10) == 0
    await client.until(lambda: client.heartbeat()[1] == Mode.TAKEOFF)
    assert await client.arm() == 0
    await client.hears("auto preflight disarming")
    assert client.here().altitude_m < 0.1


@played(talk)
async def test_home_rises_before_the_flight(client: Px4Client) -> None:
    await client.armable()
    before_m = await client.home_altitude_m()
    assert await client.arm() == 0
    assert await client.home_altitude_m() - before_m == pytest.approx(0.3)


@played(talk)
async def test_a_reposition_needs_its_flag_and_here_is_a_stop(client: Px4Client) -> None:
    await client.take_off()
    assert await client.placed(REPOSITION, 0, 393_667_000, 229_507_000, 498.0, flags=0) == 3
    assert await client.reposition(FAR) == 0
    await client.until(lambda: client.speed_m_s() > 3.3)
    left = client.here()
    say = mavlink.MAVLink_command_int_message
    client.say(say(1, 1, 0, REPOSITION, 0, 0, -1, 1, 0, NAN, IGNORED, IGNORED, NAN))
    assert (await client.next("COMMAND_ACK")).result == 0
    await asyncio.sleep(12.0)
    assert client.speed_m_s() < 0.3
    assert ground_distance_m(left, client.here()) < 8.0
    assert await client.placed(REPOSITION, 0, 0x7FF80000, 0x7FF80000, 498.0, flags=1) == 2


@played(talk)
async def test_hold_by_its_mode_does_not_stop_a_reposition(client: Px4Client) -> None:
    await client.take_off()
    assert await client.reposition(FAR) == 0
    await client.until(lambda: client.speed_m_s() > 3.3)
    left = client.here()
    assert await client.mode(Mode.LOITER) == [0, 0]
    await asyncio.sleep(6.0)
    assert ground_distance_m(left, client.here()) > 16.0


@played(talk)
async def test_a_speed_is_lost_before_take_off_and_kept_by_the_next_reposition_in_hold(
    client: Px4Client,
) -> None:
    await client.armable()
    await client.arm()
    assert await client.long(mavlink.MAV_CMD_DO_CHANGE_SPEED, 1, 3.0, -1) == 0
    await client.take_off()
    assert await client.reposition(Position(40.0, 0.0, 10.0), speed_m_s=-1.0) == 0
    await asyncio.sleep(8.0)
    assert client.speed_m_s() > 3.9
    await asyncio.sleep(20.0)
    assert await client.long(mavlink.MAV_CMD_DO_CHANGE_SPEED, 1, 3.0, -1) == 0
    assert await client.reposition(Position(0.0, 0.0, 10.0), speed_m_s=-1.0) == 0
    await asyncio.sleep(9.0)
    assert 2.5 < client.speed_m_s() < 3.05


@played(talk, replace(SETTINGS, parameters={"GF_MAX_HOR_DIST": 60.0}))
async def test_outside_the_fence_a_reposition_is_accepted_and_only_an_event_says_no(
    client: Px4Client,
) -> None:
    await client.take_off()
    await asyncio.sleep(5.0)
    assert await client.reposition(Position(100.0, 0.0, 10.0)) == 0
    await client.says("outside the geofence")
    await asyncio.sleep(5.0)
    assert ground_distance_m(client.here(), Position(0.0, 0.0)) < 0.5
    assert client.heartbeat()[1:] == (Mode.LOITER, 4)


@pytest.mark.parametrize(("action", "mode", "after_s"), [(2, Mode.LOITER, 0.0), (3, Mode.RTL, 5.0)])
def test_a_breach_in_offboard_holds_or_returns_after_a_hold(action: int, mode: Mode, after_s: float) -> None:
    async def scenario(client: Px4Client, _vehicle: StandIn) -> None:
        await client.take_off()
        client.setpoint(FAR)
        await asyncio.sleep(0.5)
        assert await client.mode(Mode.OFFBOARD) == [0, 0]
        await client.hears("too far from home")
        breached_s = client.now_s()
        assert client.here().east_m == pytest.approx(61.0, abs=1.5)
        await client.until(lambda: client.changes[-1][1] == Mode.LOITER)
        assert client.changes[-1][2] == Mode.OFFBOARD
        assert await client.in_mode(mode) - breached_s == pytest.approx(after_s, abs=0.3)
        await client.until(lambda: client.heartbeat()[2] == 5)
        assert await client.mode(Mode.RTL) == [0, 0]  # a person's wish ends it
        await client.says("took over from the fail-safe")
        await client.until(lambda: client.changes[-1][1:] == (Mode.RTL, Mode.RTL))

    talk(scenario, replace(SETTINGS, parameters={"GF_MAX_HOR_DIST": 60.0, "GF_ACTION": action}))


def fence_item(seq: int, command: int, first: float, place: Position) -> mavlink.MAVLink_message:
    geo = FRAME.geo(place)
    x, y = round(geo.latitude_deg * 1e7), round(geo.longitude_deg * 1e7)
    return mavlink.MAVLink_mission_item_int_message(
        1, 1, seq, 0, command, 0, 1, first, 0, 0, 0, x, y, 0, mission_type=FENCE
    )


def test_a_fence_is_uploaded_obeyed_downloaded_and_cleared() -> None:
    corners = [Position(-20, -20), Position(60, -20), Position(60, 60), Position(-20, 60)]
    items = [fence_item(seq, 5001, 4, corner) for seq, corner in enumerate(corners)]
    items.append(fence_item(4, 5004, 10, Position(30, 0)))

    async def scenario(client: Px4Client, _vehicle: StandIn) -> None:
        await client.take_off()
        client.say(mavlink.MAVLink_mission_count_message(1, 1, len(items), FENCE))
        for item in items:
            request = await client.next("MISSION_REQUEST_INT")
            assert (request.seq, request.mission_type) == (item.seq, FENCE)
            client.say(item)
        assert (await client.next("MISSION_ACK")).type == 0
        for place, allowed in (
            (Position(30, 5, 10), False),
            (Position(0, 70, 10), False),
            (Position(0, 40, 10), True),
        ):
            said = len([text for _, text in client.said if "outside the geofence" in text])
            assert await client.reposition(place) == 0
            await asyncio.sleep(3.0)
            refused = len([text for _, text in client.said if "outside the geofence" in text]) > said
            assert refused is not allowed
        client.say(mavlink.MAVLink_mission_request_list_message(1, 1, FENCE))
        assert (await client.next("MISSION_COUNT")).count == len(items)
        client.say(mavlink.MAVLink_mission_request_int_message(1, 1, 4, FENCE))
        back = await client.next("MISSION_ITEM_INT")
        assert (back.command, back.param1, back.x) == (5004, 10.0, items[4].x)
        client.say(mavlink.MAVLink_mission_clear_all_message(1, 1, FENCE))
        assert (await client.next("MISSION_ACK")).type == 0
        client.say(mavlink.MAVLink_mission_request_list_message(1, 1, FENCE))
        assert (await client.next("MISSION_COUNT")).count == 0

    talk(scenario)


@played(talk)
async def test_a_fence_item_that_got_lost_is_asked_for_again_and_missions_are_refused(
    client: Px4Client,
) -> None:
    await client.quietly()
    client.say(mavlink.MAVLink_mission_count_message(1, 1, 1, FENCE))
    first = await client.next("MISSION_REQUEST_INT")
    again = await client.next("MISSION_REQUEST_INT")
    assert (first.seq, again.seq) == (0, 0)
    client.say(fence_item(0, 5003, -1.0, Position(0, 0)))
    assert (await client.next("MISSION_ACK")).type == mavlink.MAV_MISSION_INVALID
    client.say(mavlink.MAVLink_mission_count_message(1, 1, 3, 0))
    assert (await client.next("MISSION_ACK")).type == mavlink.MAV_MISSION_UNSUPPORTED


@pytest.mark.parametrize(
    ("action", "mode"), [(0, Mode.POSCTL), (3, Mode.RTL), (4, Mode.LAND), (5, Mode.LOITER)]
)
def test_offboard_without_setpoints_fails_safe_and_resumes_by_itself(action: int, mode: Mode) -> None:
    async def scenario(client: Px4Client, _vehicle: StandIn) -> None:
        await client.take_off()
        client.setpoint(FAR)
        await asyncio.sleep(0.5)
        assert await client.mode(Mode.OFFBOARD) == [0, 0]
        await client.until(lambda: client.heartbeat() == (145, Mode.OFFBOARD, 4))
        await asyncio.sleep(3.0)
        client.stop("setpoints")
        await client.until(lambda: client.changes[-1][1:] == (mode, Mode.OFFBOARD))
        await client.until(lambda: client.heartbeat()[2] == 5)
        client.setpoint(FAR)
        await client.until(lambda: client.changes[-1][1:] == (Mode.OFFBOARD, Mode.OFFBOARD))
        await client.until(lambda: client.heartbeat()[2] == 4)

    talk(scenario, replace(SETTINGS, parameters={"COM_OBL_RC_ACT": action}))


@played(talk)
async def test_offboard_obeys_velocities_global_targets_and_yaw(client: Px4Client) -> None:
    await client.take_off()
    local = mavlink.MAVLink_set_position_target_local_ned_message
    client.keep("setpoints", lambda: local(0, 1, 1, 1, VELOCITY_ONLY, 0, 0, 0, 0, 3, 0, 0, 0, 0, 0, 0), 0.1)
    await asyncio.sleep(0.5)
    assert await client.mode(Mode.OFFBOARD) == [0, 0]
    await asyncio.sleep(12.0)
    report = client.all("GLOBAL_POSITION_INT")[-1]
    assert (report.vx, report.vy) == (pytest.approx(0, abs=5), pytest.approx(290, abs=15))
    geo = FRAME.geo(Position(0.0, 30.0))
    x, y = round(geo.latitude_deg * 1e7), round(geo.longitude_deg * 1e7)
    turned = mavlink.MAVLink_set_position_target_global_int_message(
        0, 1, 1, 6, 0b101111111000, x, y, 20.0, 0, 0, 0, 0, 0, 0, math.pi / 2, 0
    )
    client.keep("setpoints", lambda: turned, 0.1)
    await asyncio.sleep(25.0)
    here = client.here()
    assert ground_distance_m(here, Position(0.0, 30.0)) < 1.0
    assert here.altitude_m == pytest.approx(20.0, abs=0.5)
    assert client.all("GLOBAL_POSITION_INT")[-1].hdg == pytest.approx(9_000, abs=50)


@played(talk)
async def test_a_cap_on_all_speeds_lowers_the_cruise_and_says_so(client: Px4Client) -> None:
    assert await client.set_parameter("MPC_XY_VEL_MAX", 4.0) == 4.0
    assert {message.param_id for message in client.all("PARAM_VALUE")} >= {"MPC_XY_CRUISE", "MPC_VEL_MANUAL"}
    assert await client.set_parameter("COM_OBL_RC_ACT", 5) == 5
    client.say(mavlink.MAVLink_param_request_read_message(1, 1, b"COM_OBL_RC_ACT", -1))
    told = await client.next("PARAM_VALUE")
    assert (told.param_value, told.param_type) == (float_of_bytes(5), mavlink.MAV_PARAM_TYPE_INT32)
    client.say(mavlink.MAVLink_param_request_list_message(1, 1))
    await client.until(
        lambda: len({message.param_index for message in client.all("PARAM_VALUE")}) == told.param_count
    )


@played(talk)
async def test_sticks_take_over_from_auto_modes_and_not_from_offboard(client: Px4Client) -> None:
    client.sticks()
    await client.take_off()
    assert await client.reposition(FAR) == 0
    await asyncio.sleep(3.0)
    client.sticks(forward=500)
    await client.hears("took over using sticks")
    await client.until(lambda: client.changes[-1][1:] == (Mode.POSCTL, Mode.POSCTL))
    client.sticks()
    await asyncio.sleep(1.0)
    assert await client.reposition(FAR) == 0  # takes the vehicle back at once
    await client.in_mode(Mode.LOITER)
    client.setpoint(FAR)
    await asyncio.sleep(0.5)
    assert await client.mode(Mode.OFFBOARD) == [0, 0]
    client.sticks(forward=500)
    await asyncio.sleep(3.0)
    assert client.changes[-1][1] == Mode.OFFBOARD
    assert await client.set_parameter("COM_RC_OVERRIDE", 3) == 3
    await client.in_mode(Mode.POSCTL)
    assert client.heartbeat()[1] in (Mode.OFFBOARD, Mode.POSCTL)


@played(talk)
async def test_lost_sticks_hold_and_then_return(client: Px4Client) -> None:
    client.sticks()
    await client.take_off()
    assert await client.mode(Mode.POSCTL) == [0, 0]
    await client.until(lambda: client.heartbeat()[0] == 209)
    client.stop("sticks")
    lost_s = await client.hears("manual control lost")
    await client.until(lambda: client.changes[-1][1:] == (Mode.LOITER, Mode.POSCTL))
    assert await client.in_mode(Mode.RTL) - lost_s == pytest.approx(5.0, abs=0.2)
    await client.disarmed()
    assert client.heartbeat() == (81, Mode.POSCTL, 0)


@played(talk, replace(SETTINGS, endurance_s=100.0))
async def test_a_full_battery_runs_down_through_warning_return_and_landing(client: Px4Client) -> None:
    await client.take_off(30.0)
    await client.stream(mavlink.MAVLINK_MSG_ID_BATTERY_STATUS)
    await client.hears("low battery level")
    assert client.all("BATTERY_STATUS")[-1].battery_remaining in (14, 15)
    assert client.changes[-1][1] == Mode.LOITER
    critical_s = await client.hears("critical battery level: switching to RTL in 5 seconds")
    await client.until(lambda: client.all("BATTERY_STATUS")[-1].charge_state == 3)
    assert client.all("BATTERY_STATUS")[-1].battery_remaining in (6, 7)
    assert client.changes[-1][1] == Mode.LOITER
    assert await client.in_mode(Mode.LAND) - critical_s == pytest.approx(5.0, abs=0.3)
    await client.says("emergency battery level: switching to Land")
    assert client.all("BATTERY_STATUS")[-1].charge_state == 4
    await client.disarmed()
    assert client.heartbeat()[1] == Mode.LOITER


@played(talk)
async def test_a_battery_that_fails_suddenly_is_flown_home(client: Px4Client, vehicle: StandIn) -> None:
    await client.take_off()
    vehicle.firmware.copter.fail(FaultKind.BATTERY, vehicle.now_s())
    await client.in_mode(Mode.RTL)
    assert client.changes[-1][2] == Mode.LOITER
    await client.disarmed()
    assert await client.arm() == 1


@played(talk)
async def test_without_gps_it_cannot_be_armed_and_in_flight_it_obeys_no_mode_that_needs_a_place(
    client: Px4Client, vehicle: StandIn
) -> None:
    await client.take_off()
    assert await client.set_parameter("SIM_GPS_USED", 0) == 0
    await client.in_mode(Mode.LAND)
    assert client.changes[-1][1:] == (Mode.LAND, Mode.LOITER)
    assert client.all("CURRENT_MODE")[-1].standard_mode == 0  # not a landing that anybody wished
    await client.until(lambda: client.heartbeat() == (157, Mode.LAND, 5))
    assert await client.mode(Mode.RTL) == [0, 1]
    assert await client.reposition(FAR) == 1
    await client.disarmed()
    assert [state for _, state in client.states] == [1, 3, 2, 1]  # it never says that it is landing
    assert await client.arm() == 1
    assert await client.set_parameter("SIM_GPS_USED", 10) == 10
    await client.armable()
    assert await client.arm() == 0


@played(talk, replace(SETTINGS, parameters={"NAV_DLL_ACT": 2}))
async def test_a_lost_ground_station_returns_the_vehicle_and_a_reposition_cancels_that(
    client: Px4Client,
) -> None:
    await client.quietly()
    await asyncio.sleep(6.0)
    assert await client.arm() == 1  # without a ground station it must not
    client.as_ground_station()
    await client.take_off()
    client.stop("ground station")
    await client.in_mode(Mode.RTL)
    assert client.changes[-1][2] == Mode.LOITER
    assert await client.reposition(FAR) == 0
    await client.until(lambda: client.changes[-1][1:] == (Mode.LOITER, Mode.LOITER))
    client.as_ground_station()
    await client.hears("ground station regained")


@played(talk)
async def test_words_come_only_where_a_ground_station_speaks_and_events_everywhere(client: Px4Client) -> None:
    client.as_companion()
    await asyncio.sleep(3.0)
    await client.arm()
    await client.says("arming denied")
    assert not client.all("STATUSTEXT")
    client.as_ground_station()
    await asyncio.sleep(0.5)
    assert await client.arm() == 1
    await client.until(lambda: client.all("STATUSTEXT"))


@played(talk)
async def test_the_checks_are_told_again_on_request_and_its_modes(client: Px4Client) -> None:
    await client.quietly()
    await client.armable()
    await asyncio.sleep(3.0)
    client.said.clear()
    assert await client.long(mavlink.MAV_CMD_RUN_PREARM_CHECKS) == 0
    assert "no valid mission available" in [text for _, text in client.said]
    assert await client.long(mavlink.MAV_CMD_REQUEST_MESSAGE, AVAILABLE_MODES, 0) == 0
    modes = {message.custom_mode: message for message in client.all("AVAILABLE_MODES")}
    assert {Mode.LOITER, Mode.OFFBOARD, Mode.RTL} <= set(modes)
    assert modes[Mode.LOITER].number_modes == len(modes)


@played(talk)
async def test_commands_that_it_cannot_obey_are_answered(client: Px4Client) -> None:
    assert await client.long(mavlink.MAV_CMD_DO_PARACHUTE) == 3
    assert await client.long(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, NAN) == 3
    assert await client.long(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 9999, 1e5) == 4
    assert await client.long(mavlink.MAV_CMD_REQUEST_MESSAGE, NAN) == 4
    await client.take_off()
    assert await client.long(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0) == 1  # in flight
    assert await client.long(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 21196) == 0  # forced: it falls
    await client.in_state(1)
    assert client.here().altitude_m == 0.0


@played(talk)
async def test_it_lands_where_it_is_told_and_goes_back_to_hold_when_disarmed(client: Px4Client) -> None:
    await client.take_off()
    assert await client.reposition(Position(20.0, 0.0, 10.0)) == 0
    await asyncio.sleep(20.0)
    assert await client.mode(Mode.LAND) == [0, 0]
    await client.in_state(4)
    await client.disarmed()
    assert client.here().east_m == pytest.approx(20.0, abs=1.0)
    assert client.heartbeat() == (29, Mode.LOITER, 3)


@pytest.mark.parametrize("parameters", [{"WPNAV_SPEED": 1.0}, {"GF_ACTION": math.nan}])
def test_a_parameter_that_it_has_not_is_refused_at_boot(parameters: dict[str, float]) -> None:
    with pytest.raises(UsageError, match="has no parameter"):
        talk(lambda _client, _vehicle: asyncio.sleep(0), replace(SETTINGS, parameters=parameters))
