"""What the driver takes each report of a vehicle to say, report by report."""

from __future__ import annotations

import math
from datetime import datetime
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import GeoPosition, Velocity
from upwash.core.vehicle.telemetry import Attitude, FixKind, GpsFix
from upwash.eventlog.schema import VehicleSaid
from upwash.mavlink.px4 import CurrentModeMessage, EventMessage, Mode, event_text, px4_events
from upwash.real.mavlink.arducopter import ARDUCOPTER
from upwash.real.mavlink.px4_firmware import PX4
from upwash.real.mavlink.telemetry import VehicleTelemetry

ON_GROUND, IN_AIR, TAKEOFF, LANDING = 1, 2, 3, 4
PREARM = mavlink.MAV_SYS_STATUS_PREARM_CHECK
SURE = mavlink.EKF_POS_HORIZ_ABS


def taken(*messages: Any, at_s: float = 10.0) -> VehicleTelemetry:
    telemetry = VehicleTelemetry()
    for message in messages:
        telemetry.take(message, at_s)
    return telemetry


def position(lat: int = 393_666_001, lon: int = -229_507_003, hdg: int = 27_015) -> Any:
    return mavlink.MAVLink_global_position_int_message(
        1, lat, lon, alt=488_123, relative_alt=12_345, vx=-123, vy=456, vz=-78, hdg=hdg
    )


def home(latitude: int, longitude: int) -> Any:
    return mavlink.MAVLink_home_position_message(latitude, longitude, 488_123, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0)


def system_status(battery: int, *, present: int = 0, health: int = 0) -> Any:
    return mavlink.MAVLink_sys_status_message(present, 0, health, 0, 12_000, 0, battery, *[0] * 6)


def battery(percent: int, number: int = 0, function: int = 0) -> Any:
    return mavlink.MAVLink_battery_status_message(number, function, 0, 0, [0] * 10, 0, 0, 0, percent)


def landed(state: int) -> Any:
    return mavlink.MAVLink_extended_sys_state_message(0, state)


def beat(*, armed: bool = False, status: int = 4, mode: int = 4) -> Any:
    return mavlink.MAVLink_heartbeat_message(2, 3, 1 | (128 if armed else 0), mode, status, 3)


def ekf(flags: int) -> Any:
    return mavlink.MAVLink_ekf_status_report_message(flags, *[0.0] * 5)


def text(words: bytes, severity: int = 4, number: int = 0, chunk: int = 0) -> Any:
    sent = mavlink.MAVLink_statustext_message(severity, words, number, chunk)
    return mavlink.MAVLink(None).parse_char(sent.pack(mavlink.MAVLink(None, 1, 1)))


def test_a_position_is_in_degrees_and_metres_and_a_velocity_points_up() -> None:
    told = taken(position())
    assert told.position == GeoPosition(39.3666001, -22.9507003, 12.345)
    assert told.above_sea_m == 488.123
    assert told.home_above_sea_m == pytest.approx(475.778)
    assert told.velocity == Velocity(east_m_s=4.56, north_m_s=-1.23, up_m_s=0.78)
    assert told.heading_deg == 270.15
    assert told.speed_m_s == pytest.approx(math.hypot(4.56, 1.23, 0.78))


@pytest.mark.parametrize(("hdg", "heading_deg"), [(0, 0.0), (35_999, 359.99), (36_000, None), (65_535, None)])
def test_a_heading_beyond_the_circle_is_not_known(hdg: int, heading_deg: float | None) -> None:
    assert taken(position(hdg=hdg)).heading_deg == heading_deg


@pytest.mark.parametrize(("e7", "known"), [((0, 0), False), ((1, 0), True), ((0, 1), True), ((1, 1), True)])
def test_a_place_of_two_zeros_alone_is_not_known(e7: tuple[int, int], *, known: bool) -> None:
    told = taken(position(*e7), home(*e7))
    place = e7[0] / 1e7, e7[1] / 1e7
    assert told.position == (GeoPosition(*place, 12.345) if known else None)
    assert told.home == (GeoPosition(*place, 488.123) if known else None)
    assert told.home_above_sea_m == (pytest.approx(475.778) if known else 0.0)


def test_a_vehicle_that_reports_nothing_is_nowhere_and_may_move() -> None:
    told = VehicleTelemetry()
    assert (told.speed_m_s, told.home_above_sea_m, told.stands) == (math.inf, 0.0, None)
    assert not told.on_ground and not told.in_the_air


def test_an_attitude_is_in_degrees_with_the_nose_between_0_and_360() -> None:
    told = taken(mavlink.MAVLink_attitude_message(1, 0.5, -0.25, -0.125, 0, 0, 0)).attitude
    assert told == Attitude(math.degrees(0.5), math.degrees(-0.25), 360 - math.degrees(0.125))


def quaternion(pitch_deg: float, yaw_deg: float) -> list[float]:
    pitch, yaw = math.radians(pitch_deg) / 2, math.radians(yaw_deg) / 2
    return [
        math.cos(pitch) * math.cos(yaw), -math.sin(pitch) * math.sin(yaw),
        math.sin(pitch) * math.cos(yaw), math.cos(pitch) * math.sin(yaw),
    ]  # fmt: skip


def rolled(q: list[float], roll_deg: float) -> list[float]:
    """The rotation after a roll about the camera's own axis."""
    w, x, y, z = q
    cos, sin = math.cos(math.radians(roll_deg) / 2), math.sin(math.radians(roll_deg) / 2)
    return [w * cos - x * sin, x * cos + w * sin, y * cos + z * sin, z * cos - y * sin]


def gimbal(flags: int, q: list[float]) -> Any:
    return mavlink.MAVLink_gimbal_device_attitude_status_message(0, 0, 1, flags, q, 0.0, 0.0, 0.0, 0)


@pytest.mark.parametrize(
    ("flags", "yaw_deg"),
    [
        (mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME, 30.0),
        (mavlink.GIMBAL_DEVICE_FLAGS_YAW_LOCK, 30.0),
        (mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME, 120.0),
        (mavlink.GIMBAL_DEVICE_FLAGS_YAW_LOCK | mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME, 120.0),
        (0, 120.0),
    ],
)
def test_a_gimbals_yaw_counts_from_north_or_from_the_nose_by_its_flags(flags: int, yaw_deg: float) -> None:
    east = mavlink.MAVLink_attitude_message(1, 0.3, -0.2, math.pi / 2, 0, 0, 0)
    told = taken(east, gimbal(flags, quaternion(-60.0, 30.0))).gimbal
    assert told is not None
    assert (told.roll_deg, told.pitch_deg, told.yaw_deg) == pytest.approx((0.0, -60.0, yaw_deg), abs=1e-6)


@pytest.mark.parametrize("roll_deg", [-120.0, 45.0])
@pytest.mark.parametrize("pitch_deg", [-89.0, 10.0])
@pytest.mark.parametrize("yaw_deg", [30.0, 200.0])
@pytest.mark.parametrize("length", [0.96, 1.0, 1.04])
def test_a_gimbals_attitude_is_its_rotation(
    roll_deg: float, pitch_deg: float, yaw_deg: float, length: float
) -> None:
    q = [length * part for part in rolled(quaternion(pitch_deg, yaw_deg), roll_deg)]
    told = taken(gimbal(mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME, q)).gimbal
    assert told is not None
    for angle_deg, expected_deg in (
        (told.roll_deg, roll_deg),
        (told.pitch_deg, pitch_deg),
        (told.yaw_deg, yaw_deg),
    ):
        assert math.remainder(angle_deg - expected_deg, 360) == pytest.approx(0.0, abs=1e-6)
    assert 0.0 <= told.yaw_deg <= 360.0


def test_a_gimbal_that_reports_no_rotation_or_counts_from_an_unknown_nose_is_not_known() -> None:
    from_north = mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME
    for q in ([0.0] * 4, [2.0, 0.0, 0.0, 0.0], [math.nan, 0.0, 0.0, 1.0]):
        assert taken(gimbal(from_north, q)).gimbal is None
    assert taken(gimbal(0, quaternion(-60.0, 30.0))).gimbal is None


def test_a_receivers_own_error_is_told_where_it_is_known() -> None:
    def fix(h_acc: int) -> Any:
        return mavlink.MAVLink_gps_raw_int_message(1, 3, 1, 1, 0, 90, 0, 0, 0, 9, 0, h_acc)

    assert [told.error_m for mm in (0, 1_250) if (told := taken(fix(mm)).gps)] == [None, 1.25]


@pytest.mark.parametrize(
    ("kind", "named"),
    [
        (0, "none"),
        (1, "none"),
        (2, "2d"),
        (3, "3d"),
        (4, "dgps"),
        (5, "rtk-float"),
        (6, "rtk-fixed"),
        (7, "3d"),
    ],
)
def test_a_fix_has_its_kind_its_satellites_and_its_dilution(kind: int, named: FixKind) -> None:
    def fix(eph: int, satellites: int) -> Any:
        return mavlink.MAVLink_gps_raw_int_message(1, kind, 1, 1, 0, eph, 0, 0, 0, satellites)

    assert taken(fix(121, 14)).gps == GpsFix(named, satellites=14, hdop=1.21)
    assert taken(fix(65_535, 255)).gps == GpsFix(named, satellites=None, hdop=None)


@pytest.mark.parametrize(
    ("state", "stands", "flies"),
    [
        (0, None, False),
        (ON_GROUND, True, False),
        (IN_AIR, False, True),
        (TAKEOFF, False, True),
        (LANDING, False, True),
    ],
)
def test_a_landed_state_says_whether_it_stands_or_flies(
    state: int, stands: bool | None, *, flies: bool
) -> None:
    told = taken(landed(state))
    assert (told.stands, told.in_the_air) == (stands, flies)
    assert told.airborne_s == (10.0 if flies else -math.inf)


def charges(*reports: tuple[float, Any]) -> dict[int, float | None]:
    """What is known of the batteries after reports, each with its time."""
    telemetry = VehicleTelemetry()
    for now_s, report in reports:
        telemetry.take(report, now_s)
    return telemetry.batteries.charges_percent


@pytest.mark.parametrize(("percent", "known"), [(57, {1: 57.0}), (0, {1: 0.0}), (-1, {})])
def test_a_battery_has_its_percent_unless_that_is_not_known(
    percent: int, known: dict[int, float | None]
) -> None:
    assert charges((1.0, system_status(percent))) == known
    assert charges((1.0, battery(percent))) == (known or {1: None})


def test_the_lowest_of_two_messages_counts_and_one_that_does_not_know_is_no_news() -> None:
    assert charges((1.0, system_status(-1)), (1.1, battery(91)), (2.0, system_status(-1))) == {1: 91.0}
    assert charges((1.0, battery(-1)), (1.1, system_status(91)), (2.0, battery(-1))) == {1: 91.0}
    assert charges((1.0, system_status(57)), (1.1, battery(56))) == {1: 56.0}, "each rounds in its own way"
    assert charges((1.0, system_status(30)), (1.1, battery(91))) == {1: 30.0}
    assert charges((1.0, system_status(30)), (1.1, battery(60, number=1))) == {1: 30.0, 2: 60.0}
    assert charges((1.0, system_status(60)), (1.1, battery(60, number=1))) == {2: 60.0}, "a PX4's lowest"


def test_each_battery_that_the_vehicle_flies_with_is_known_by_its_number() -> None:
    reports = (battery(50), battery(8, number=9), battery(-1, number=3), battery(5, number=1, function=4))
    assert charges(*((1.0, report) for report in reports)) == {1: 50.0, 4: None, 10: 8.0}
    avionics = battery(5, number=1, function=3)
    assert charges((1.0, avionics)) == {2: 5.0}, "without its autopilot no vehicle flies"


@pytest.mark.parametrize(("silent_s", "known"), [(20.0, 8.0), (21.0, None)])
def test_a_charge_that_nothing_confirms_is_not_believed_for_ever(
    silent_s: float, known: float | None
) -> None:
    last_s = 10.0 + silent_s
    unknown = (last_s, battery(-1, number=1))
    assert charges((10.0, battery(8, number=1)), (last_s, battery(50))) == {1: 50.0, 2: known}
    assert charges((10.0, battery(8, number=1)), (last_s, battery(50)), unknown) == {1: 50.0, 2: known}


@pytest.mark.parametrize(
    ("present", "health", "can"),
    [(0, PREARM, None), (PREARM, 0, False), (PREARM, PREARM, True), (1, PREARM, None)],
)
def test_an_arducopter_can_be_armed_if_its_checks_pass(present: int, health: int, can: bool | None) -> None:
    assert taken(system_status(50, present=present, health=health)).can_be_armed is can


@pytest.mark.parametrize(
    ("flags", "sure"),
    [
        (SURE, True),
        (SURE | mavlink.EKF_ATTITUDE, True),
        (0, False),
        (SURE | mavlink.EKF_CONST_POS_MODE, False),
        (SURE | 1 << 15, False),  # GPS glitching
        (mavlink.EKF_CONST_POS_MODE, False),
    ],
)
def test_an_arducopter_knows_its_place_by_its_filters_flags(flags: int, *, sure: bool) -> None:
    assert taken(ekf(flags)).knows_its_place is sure


def test_motors_stop_when_an_armed_vehicle_is_disarmed() -> None:
    told = taken(beat(status=3))
    assert (told.mode, told.armed, told.disarmed_s, told.system_status) == (4, False, -math.inf, 3)
    told.take(beat(armed=True), 11.0)
    assert (told.armed, told.disarmed_s) == (True, -math.inf)
    told.take(beat(armed=True), 12.0)
    told.take(beat(), 13.0)
    assert told.armed
    assert told.disarms
    told.take(beat(), 14.0)
    assert (told.armed, told.disarms, told.disarmed_s) == (False, False, 13.0)


def test_one_disarmed_heartbeat_between_armed_ones_says_nothing() -> None:
    told = taken(beat(armed=True))
    for now_s in 11.0, 13.0, 15.0:  # a bridge repeats an old one, of another mode
        told.take(beat(mode=9), now_s)
        told.take(beat(armed=True), now_s + 1.0)
        assert (told.armed, told.disarms, told.mode) == (True, False, 4)


@pytest.mark.parametrize(
    ("from_deg", "towards"), [(0.0, (0.0, -5.0)), (90.0, (-5.0, 0.0)), (225.0, (3.5355, 3.5355))]
)
def test_wind_blows_away_from_its_direction(from_deg: float, towards: tuple[float, float]) -> None:
    wind = taken(mavlink.MAVLink_wind_message(from_deg, 5.0, 0.0)).wind
    assert wind is not None
    assert (wind.east_m_s, wind.north_m_s) == pytest.approx(towards, abs=1e-4)


def test_wind_of_a_px4_is_a_velocity() -> None:
    told = taken(mavlink.MAVLink_wind_cov_message(1, 3.0, 4.0, 0.5, 0, 0, 0, 0, 0))
    assert told.wind == Velocity(east_m_s=4.0, north_m_s=3.0)


def test_a_breached_fence_and_a_time_are_told_and_forgotten() -> None:
    told = taken(
        mavlink.MAVLink_fence_status_message(1, 1, 1, 1),
        mavlink.MAVLink_system_time_message(1_770_000_000_500_000, 1),
    )
    assert (told.fence_breached, told.unix_s) == (True, 1_770_000_000.5)
    told.take(mavlink.MAVLink_fence_status_message(0, 1, 1, 1), 11.0)
    told.take(mavlink.MAVLink_system_time_message(0, 1), 11.0)
    assert (told.fence_breached, told.unix_s) == (False, None)


@pytest.mark.parametrize(
    "date", ["1970-01-01T00:00:42", "1980-01-06T00:00", "2006-05-21T00:00", "2080-01-06T00:00"]
)
def test_a_receiver_without_a_time_tells_none(date: str) -> None:
    unix_us = round(datetime.fromisoformat(f"{date}+00:00").timestamp() * 1e6)
    assert taken(mavlink.MAVLink_system_time_message(unix_us, 1)).unix_s is None


@pytest.mark.parametrize(("component", "ours"), [(0, True), (191, True), (1, False), (190, False)])
def test_an_answer_counts_if_it_is_to_all_or_to_this_program(component: int, *, ours: bool) -> None:
    told = taken(mavlink.MAVLink_command_ack_message(400, 4, 0, 0, 255, component))
    assert told.answers == ({400: 4} if ours else {})


def test_channels_of_a_remote_control_are_compared() -> None:
    still, moved = ([level_us] * 18 for level_us in (1500, 1600))
    told = taken(*(mavlink.MAVLink_rc_channels_message(0, 18, *channels, 255) for channels in (still, moved)))
    assert told.remote.moved(10.0) is True


# --- texts --------------------------------------------------------------------------------------------------


def words(*messages: Any) -> list[str]:
    return [heard.text for _, heard in taken(*messages).texts]


def test_a_text_in_chunks_is_one_text_and_an_interrupted_one_is_none() -> None:
    long, longer = b"x" * 50, b"y" * 50
    assert words(text(long)) == ["x" * 50]
    assert words(text(long, number=7), text(b"end", number=7, chunk=1)) == ["x" * 50 + "end"]
    assert words(text(long, number=7), text(longer, number=7, chunk=1), text(b"", number=7, chunk=2)) == [
        "x" * 50 + "y" * 50
    ]
    assert words(text(long, number=7), text(b"other", number=8)) == ["other"]
    assert words(text(long, number=7), text(b"its end", number=8, chunk=1)) == ["its end"]
    assert words(text(long, number=7), text(longer, number=7), text(b"end", number=7, chunk=1)) == [
        "y" * 50 + "end"
    ]
    assert words(text(b"one", number=7), text(b"two", number=7, chunk=1)) == ["one", "two"]


def test_texts_are_told_by_their_severity_for_three_seconds_and_once() -> None:
    told = taken(text(b"bad", 3), text(b"worse", 2), text(b"bad", 3), text(b"odd", 200))
    assert told.said_lately(13.0) == "worse (critical); bad (error); odd (debug)"
    assert told.said_since(10.0) == told.said_lately(13.0)
    assert told.said_lately(13.1) == told.said_since(10.1) == ""
    assert told.texts_heard == 4


def test_the_last_32_texts_are_kept() -> None:
    assert words(*(text(b"%d" % number) for number in range(33))) == [str(number) for number in range(1, 33)]


def test_a_dead_man_may_explain_the_mode_for_three_seconds() -> None:
    told = taken(text(b"upwash: companion silent, RTL"))
    assert told.dead_man == "its dead man, which did not hear this program"
    told.take(beat(armed=True), 13.0)
    assert told.dead_man
    told.take(beat(armed=True), 13.1)
    assert told.dead_man == ""
    assert taken(text(b"upwash: well"), beat()).dead_man == ""


# --- PX4 ----------------------------------------------------------------------------------------------------


def px4(*messages: Any, **before: Any) -> VehicleTelemetry:
    telemetry = VehicleTelemetry(**before)
    for message in messages:
        PX4.take(telemetry, message, 10.0)
    return telemetry


def flown(mode: int, intended: int) -> Any:
    return CurrentModeMessage(standard_mode=0, custom_mode=mode, intended_custom_mode=intended)


@pytest.mark.parametrize(("state", "mode"), [(ON_GROUND, Mode.LAND), (IN_AIR, Mode.LOITER), (0, Mode.LOITER)])
def test_in_the_air_the_mode_of_a_px4_is_that_of_its_last_report(state: int, mode: Mode) -> None:
    told = px4(flown(Mode.LOITER, Mode.OFFBOARD), mode=Mode.LAND, landed_state=state)
    assert (told.mode, told.flown_and_intended_mode) == (mode, (Mode.LOITER, Mode.OFFBOARD))


@pytest.mark.parametrize(
    ("told", "why"),
    [
        ({}, ""),
        ({"system_status": mavlink.MAV_STATE_CRITICAL}, "its system status is critical"),
        ({"system_status": mavlink.MAV_STATE_EMERGENCY}, ""),
        ({"flown_and_intended_mode": (Mode.RTL, Mode.RTL)}, ""),
        ({"flown_and_intended_mode": (Mode.RTL, 0)}, ""),  # it does not tell
        ({"flown_and_intended_mode": (Mode.RTL, Mode.LOITER)}, "a fail-safe chose it, AUTO.LOITER was set"),
        ({"flown_and_intended_mode": (Mode.RTL, 12345)}, "a fail-safe chose it, number 0x3039 was set"),
        ({"flown_and_intended_mode": (Mode.LAND, Mode.LOITER)}, ""),  # of another mode than the heartbeat's
        (
            {"flown_and_intended_mode": (Mode.RTL, Mode.RTL), "system_status": mavlink.MAV_STATE_CRITICAL},
            "",
        ),
    ],
)
def test_a_px4_flies_a_mode_that_nobody_set_by_a_fail_safe(told: dict[str, Any], why: str) -> None:
    assert PX4.failsafe(VehicleTelemetry(mode=Mode.RTL, **told), "AUTO.RTL") == why


@pytest.mark.parametrize(("health", "can"), [(0, False), (PREARM, True), (PREARM | 1, True), (1, False)])
def test_a_px4_can_be_armed_if_its_check_is_healthy(health: int, *, can: bool) -> None:
    assert px4(system_status(50, health=health)).can_be_armed is can


ABSOLUTE, CONSTANT, GLITCH = (
    mavlink.ESTIMATOR_POS_HORIZ_ABS,
    mavlink.ESTIMATOR_CONST_POS_MODE,
    mavlink.ESTIMATOR_GPS_GLITCH,
)


@pytest.mark.parametrize(
    ("flags", "state", "sure"),
    [
        (ABSOLUTE, IN_AIR, True),
        (0, IN_AIR, False),
        (ABSOLUTE | CONSTANT, IN_AIR, False),
        (ABSOLUTE | CONSTANT, ON_GROUND, True),  # where its place is constant
        (ABSOLUTE | mavlink.ESTIMATOR_ATTITUDE, ON_GROUND, True),
        (ABSOLUTE | GLITCH, ON_GROUND, False),
        (ABSOLUTE | GLITCH, IN_AIR, False),
        (0, ON_GROUND, False),
    ],
)
def test_a_px4_knows_its_place_by_its_estimators_flags(flags: int, state: int, *, sure: bool) -> None:
    status = mavlink.MAVLink_estimator_status_message(1, flags, *[0.0] * 8)
    assert px4(status, landed_state=state).knows_its_place is sure


@pytest.mark.parametrize(
    ("number", "name"),
    [
        (mavlink.COPTER_MODE_GUIDED, "GUIDED"),
        (mavlink.COPTER_MODE_SMART_RTL, "SMART_RTL"),
        (99, "number 99"),
    ],
)
def test_a_mode_of_an_arducopter_has_its_name(number: int, name: str) -> None:
    assert ARDUCOPTER.mode_name(number) == name


def said(*texts: str, at_s: float = 58.0, severity: int = 4) -> list[tuple[float, Any]]:
    return [
        (at_s, heard)
        for words_of in texts
        for _, heard in taken(text(words_of.encode(), severity=severity)).texts
    ]


POSITION, BATTERY, CRITICAL = (
    "its position estimate failed",
    "its battery is low",
    "its system status is critical",
)


@pytest.mark.parametrize(
    ("mode", "told", "why"),
    [
        ("RTL", {}, ""),
        ("LOITER", {"fence_breached": True, "dead_man": "x", "system_status": 5}, ""),
        ("RTL", {"fence_breached": True, "system_status": 5}, "it has left its fence"),
        ("RTL", {"dead_man": "its dead man", "fence_breached": True}, "its dead man"),
        ("LAND", {"system_status": 5}, "its system status is critical"),
        ("BRAKE", {"system_status": 6}, "its system status is critical"),
        ("AUTO", {"system_status": 4, "texts": said("Battery 1 is low")}, ""),
        ("AUTO_RTL", {"system_status": 5, "texts": said("Battery 1 is low")}, BATTERY),
        ("SMART_RTL", {"system_status": 5, "texts": said("EKF variance", "Ok")}, POSITION),
        ("LAND", {"texts": said("ADSB threat", at_s=60.0)}, "it avoids another aircraft"),
        # what a text says just before or after the mode, whatever else was said before
        ("RTL", {"texts": said("Battery Failsafe", at_s=60.6)}, BATTERY),
        ("RTL", {"texts": said("Radio Failsafe", at_s=59.5)}, "it does not hear its remote control"),
        ("LAND", {"texts": said("GCS Failsafe", at_s=60.0)}, "it does not hear its ground station"),
        ("LAND", {"texts": said("EKF Failsafe: changed to LAND Mode", at_s=60.0)}, POSITION),
        ("RTL", {"texts": said("Failsafe: Terrain data missing", at_s=60.0)}, "it lacks terrain data"),
        ("BRAKE", {"texts": said("Dead Reckoning started", at_s=60.0)}, POSITION),
        ("RTL", {"texts": said("EKF3 lane switch 1", "Battery Failsafe", at_s=60.4, severity=2)}, BATTERY),
        ("RTL", {"fence_breached": True, "texts": said("Battery Failsafe", at_s=60.1)}, BATTERY),
        ("RTL", {"texts": said("Radio Failsafe", at_s=59.1) + said("Battery Failsafe", at_s=60.1)}, BATTERY),
        # what is no cause
        ("RTL", {"system_status": 5, "texts": said("EKF variance", severity=6)}, CRITICAL),
        ("RTL", {"system_status": 5, "texts": said("EKF3 IMU0 stopped aiding")}, CRITICAL),
        ("RTL", {"system_status": 5, "texts": said("EKF variance", at_s=56.0)}, CRITICAL),
        ("RTL", {"system_status": 5, "texts": said("EKF variance", at_s=61.5)}, CRITICAL),
        ("RTL", {"texts": said("Battery Failsafe", at_s=58.0)}, ""),
        ("RTL", {"texts": said("Radio Failsafe Cleared", at_s=60.0)}, ""),
        ("RTL", {"texts": said("GCS Failsafe - Continuing Pilot Control", at_s=60.0)}, ""),
    ],
)  # fmt: skip
def test_a_fail_safe_of_an_arducopter_has_its_cause(mode: str, told: dict[str, Any], why: str) -> None:
    assert ARDUCOPTER.failsafe(VehicleTelemetry(mode_s=60.0, status_s=60.0, **told), mode) == why


@pytest.mark.parametrize(("critical_s", "why"), [(20.0, ""), (59.5, CRITICAL)])
def test_a_pilot_may_return_long_after_a_fail_safe_left_the_status_critical(
    critical_s: float, why: str
) -> None:
    telemetry = VehicleTelemetry(mode_s=60.0, status_s=critical_s, system_status=5)
    for now_s, switch_us in (59.0, 1500), (59.8, 1900):
        telemetry.take(mavlink.MAVLink_rc_channels_message(0, 18, *[switch_us] * 18, 255), now_s)
    assert ARDUCOPTER.failsafe(telemetry, "RTL") == why


@pytest.mark.parametrize(
    ("event", "arguments", "cause"),
    [
        ("commander_failsafe_enter", (0, 6, 4), "critical battery level"),
        ("commander_failsafe_enter", (0, 6, 2), "GCS connection loss"),
        ("check_gf_violation_max_alt", (0, 0), "geofence: too high above home"),
    ],
)
def test_a_fail_safe_of_a_px4_has_the_cause_that_its_event_says(
    event: str, arguments: tuple[int, ...], cause: str
) -> None:
    number, kind = next((number, kind) for number, kind in px4_events().items() if kind.name == event)
    words = event_text(
        EventMessage(
            id_of_event=number,
            event_time_boot_ms=0,
            sequence=0,
            destination_component=0,
            destination_system=0,
            log_levels=0x42,
            arguments=kind.packed(*arguments),
        )
    )
    telemetry = VehicleTelemetry(
        mode=Mode.RTL, mode_s=60.0, flown_and_intended_mode=(Mode.RTL, Mode.OFFBOARD), knows_its_place=False
    )
    telemetry.hear_text(VehicleSaid(severity=3, text=words), 60.5)
    assert PX4.failsafe(telemetry, "AUTO.RTL") == f"a fail-safe chose it ({cause}), OFFBOARD was set"
