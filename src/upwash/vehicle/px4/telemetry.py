"""What the stand-in PX4 reports, message by message, and how often it does so on an onboard link."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import TypeAlias

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import Position
from upwash.mavlink_px4 import AVAILABLE_MODES, CURRENT_MODE, AvailableModesMessage, CurrentModeMessage, Mode
from upwash.vehicle.firmware import Message
from upwash.vehicle.px4.vehicle import Quadrotor

QuadrotorReport: TypeAlias = Callable[[Quadrotor, float], Message | None]

_BASE_MODES = {
    Mode.OFFBOARD: 0b0001_0001,  # stabilized, custom
    Mode.POSCTL: 0b0101_0001,  # and by hand
    Mode.ALTCTL: 0b0101_0001,
    Mode.STABILIZED: 0b0101_0001,
    Mode.ACRO: 0b0100_0001,
    Mode.MANUAL: 0b0100_0001,
}
_AUTO_BASE_MODE = 0b0001_1101  # stabilized, guided, auto, custom
_STANDARD_MODES = {
    Mode.POSCTL: 1,
    Mode.ALTCTL: 3,
    Mode.RTL: 5,
    Mode.MISSION: 6,
    Mode.LAND: 7,
    Mode.TAKEOFF: 8,
}
_MODE_NAMES = {
    Mode.MANUAL: "Manual",
    Mode.ALTCTL: "Altitude",
    Mode.POSCTL: "Position",
    Mode.MISSION: "Mission",
    Mode.LOITER: "Hold",
    Mode.RTL: "Return",
    Mode.ACRO: "Acro",
    Mode.OFFBOARD: "Offboard",
    Mode.STABILIZED: "Stabilized",
    Mode.TAKEOFF: "Takeoff",
    Mode.LAND: "Land",
}
_ADVANCED, _NOT_SELECTABLE = 1, 2  # MAV_MODE_PROPERTY
_SENSORS_UNCHECKED = 0x321_C83F  # as recorded, and so are the next four
_SENSORS, _SENSORS_ENABLED, _SENSORS_HEALTHY = 0x300_402F, 0x301_402F, 0x1320_C83F
_WITHOUT_POSITION = 0x20, 0x20, 0x4000  # cleared in present, in enabled, in health
_GPS_BIT = mavlink.MAV_SYS_STATUS_SENSOR_GPS
_STICKS_BIT = mavlink.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
_BATTERY_BIT = mavlink.MAV_SYS_STATUS_SENSOR_BATTERY
_ARMABLE_BIT = mavlink.MAV_SYS_STATUS_PREARM_CHECK
_ESTIMATES_ALL = 831  # attitude, velocities, positions; neither by dead reckoning nor with a GPS glitch
_ESTIMATES_WITHOUT_GPS = 165
_CAPABILITIES = 59_647  # as recorded
_VERSION_1_16_1 = 1 << 24 | 16 << 16 | 1 << 8 | 255
_ONLY_POSITION = 0b110111111000
_AT_HOME = Position(0.0, 0.0)


def heartbeat(copter: Quadrotor, now_s: float) -> Message | None:
    """HEARTBEAT: the mode, whether armed, and how it is; nothing in its first second."""
    copter.advance(now_s)
    if copter.booting(now_s):
        return None
    base_mode = _BASE_MODES.get(copter.mode, _AUTO_BASE_MODE)
    if copter.armed:
        base_mode |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED
        status = mavlink.MAV_STATE_CRITICAL if copter.fails_safe else mavlink.MAV_STATE_ACTIVE
    else:
        status = mavlink.MAV_STATE_STANDBY if copter.armable(now_s) else mavlink.MAV_STATE_UNINIT
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_PX4, base_mode, copter.mode, status, 3
    )


def current_mode(copter: Quadrotor, now_s: float) -> Message:
    """CURRENT_MODE: what it flies and what it was told; different in a fail-safe."""
    copter.advance(now_s)
    standard = 0 if copter.descends_blindly else _STANDARD_MODES.get(copter.mode, 0)
    return CurrentModeMessage(
        custom_mode=int(copter.mode), intended_custom_mode=int(copter.intended), standard_mode=standard
    )


def available_modes(index: int) -> tuple[Message, ...]:
    """AVAILABLE_MODES: the one with that index from 1 on, or all for 0."""
    modes = list(_MODE_NAMES)
    wanted = range(1, len(modes) + 1) if index == 0 else range(index, index + 1)
    return tuple(_available_mode(modes, each) for each in wanted if 1 <= each <= len(modes))


def _available_mode(modes: list[Mode], index: int) -> Message:
    mode = modes[index - 1]
    standard = _STANDARD_MODES.get(mode, 0)
    return AvailableModesMessage(
        custom_mode=int(mode),
        properties=_ADVANCED if mode in (Mode.OFFBOARD, Mode.ACRO, Mode.STABILIZED) else 0,
        number_modes=len(modes),
        mode_index=index,
        standard_mode=standard,
        mode_name=b"" if standard else _MODE_NAMES[mode].encode(),
    )


def sys_status(copter: Quadrotor, now_s: float) -> Message:
    """SYS_STATUS: which sensors are well, whether it could be armed (only `health` says that), and its battery."""
    copter.advance(now_s)
    present, enabled, health = _SENSORS, _SENSORS_ENABLED, _SENSORS_HEALTHY
    if not copter.checked(now_s):
        present, enabled, health = 0, 0, _SENSORS_UNCHECKED
    elif not copter.placed:
        present, enabled, health = present & ~0x20, enabled & ~0x20, health & ~0x4000
        if not copter.has_fix:
            enabled, health = enabled | _GPS_BIT, health & ~_GPS_BIT
    if copter.hears_sticks(now_s):
        present, health = present | _STICKS_BIT, health | _STICKS_BIT
    if copter.battery_level(now_s) > 1:
        health &= ~_BATTERY_BIT
    if not (copter.armed and copter.battery_level(now_s) < 3) and not copter.armable(now_s):
        health &= ~_ARMABLE_BIT
    return mavlink.MAVLink_sys_status_message(
        onboard_control_sensors_present=present,
        onboard_control_sensors_enabled=enabled,
        onboard_control_sensors_health=health,
        load=100,
        voltage_battery=round(copter.battery_v(now_s) * 1e3),
        current_battery=-100,
        battery_remaining=math.floor(copter.battery_percent(now_s)),
        drop_rate_comm=0,
        errors_comm=0,
        errors_count1=0,
        errors_count2=0,
        errors_count3=0,
        errors_count4=0,
    )


def battery_status(copter: Quadrotor, now_s: float) -> Message:
    """BATTERY_STATUS: how full it is, and how serious that is."""
    copter.advance(now_s)
    unknown_mv = 0xFFFF
    return mavlink.MAVLink_battery_status_message(
        id=0,
        battery_function=mavlink.MAV_BATTERY_FUNCTION_ALL,
        type=mavlink.MAV_BATTERY_TYPE_LIPO,
        temperature=0x7FFF,
        voltages=[round(copter.battery_v(now_s) * 1e3), *[unknown_mv] * 9],
        current_battery=-100,
        current_consumed=0,
        energy_consumed=-1,
        battery_remaining=math.floor(copter.battery_percent(now_s)),
        time_remaining=0,
        charge_state=copter.battery_level(now_s),
    )


def system_time(copter: Quadrotor, now_s: float) -> Message:
    """SYSTEM_TIME: the date, once it has had a fix, and since boot."""
    unix_us = round(time.time() * 1e6) if copter.ever_had_fix else 0
    return mavlink.MAVLink_system_time_message(unix_us, _boot_ms(copter, now_s))


def gps_raw(copter: Quadrotor, now_s: float) -> Message:
    """GPS_RAW_INT: the receiver's fix."""
    geo = copter.frame.geo(copter.position(now_s))
    velocity, fix = copter.velocity(now_s), copter.has_fix
    return mavlink.MAVLink_gps_raw_int_message(
        time_usec=round(copter.uptime_s(now_s) * 1e6),
        fix_type=mavlink.GPS_FIX_TYPE_3D_FIX if fix else mavlink.GPS_FIX_TYPE_NO_GPS,
        lat=_degrees_e7(geo.latitude_deg),
        lon=_degrees_e7(geo.longitude_deg),
        alt=_above_sea_mm(copter, copter.position(now_s)),
        eph=70 if fix else 10_000,
        epv=110 if fix else 10_000,
        vel=round(math.hypot(velocity.east_m_s, velocity.north_m_s) * 100),
        cog=round(math.degrees(math.atan2(velocity.east_m_s, velocity.north_m_s)) % 360 * 100) % 36_000,
        satellites_visible=round(copter.parameters["SIM_GPS_USED"]) % 255 if fix else 0,
    )


def estimator_status(copter: Quadrotor, now_s: float) -> Message:
    """ESTIMATOR_STATUS: what it knows of itself, as ESTIMATOR_STATUS_FLAGS."""
    copter.advance(now_s)
    flags = _ESTIMATES_ALL if copter.placed else _ESTIMATES_WITHOUT_GPS
    return mavlink.MAVLink_estimator_status_message(
        round(copter.uptime_s(now_s) * 1e6), flags, *[0.02] * 6, 0.3, 0.4
    )


def attitude(copter: Quadrotor, now_s: float) -> Message:
    """ATTITUDE: always level, nose ahead."""
    yaw = math.remainder(math.radians(copter.heading_deg(now_s)), math.tau)
    return mavlink.MAVLink_attitude_message(_boot_ms(copter, now_s), 0.0, 0.0, yaw, 0.0, 0.0, 0.0)


def attitude_quaternion(copter: Quadrotor, now_s: float) -> Message:
    """ATTITUDE_QUATERNION: the same."""
    half = math.radians(copter.heading_deg(now_s)) / 2
    return mavlink.MAVLink_attitude_quaternion_message(
        _boot_ms(copter, now_s), math.cos(half), 0.0, 0.0, math.sin(half), 0.0, 0.0, 0.0
    )


def local_position(copter: Quadrotor, now_s: float) -> Message | None:
    """LOCAL_POSITION_NED: metres from where it was switched on, once it has had a fix."""
    if not copter.ever_had_fix:
        return None
    position, velocity = copter.position(now_s), copter.velocity(now_s)
    return mavlink.MAVLink_local_position_ned_message(
        _boot_ms(copter, now_s),
        position.north_m,
        position.east_m,
        -position.altitude_m,
        velocity.north_m_s,
        velocity.east_m_s,
        -velocity.up_m_s,
    )


def global_position(copter: Quadrotor, now_s: float) -> Message | None:
    """GLOBAL_POSITION_INT: where it is and how it moves, once it has had a fix."""
    if not copter.ever_had_fix:
        return None
    position, velocity = copter.position(now_s), copter.velocity(now_s)
    geo = copter.frame.geo(position)
    above_sea_mm = _above_sea_mm(copter, position)
    return mavlink.MAVLink_global_position_int_message(
        time_boot_ms=_boot_ms(copter, now_s),
        lat=_degrees_e7(geo.latitude_deg),
        lon=_degrees_e7(geo.longitude_deg),
        alt=above_sea_mm,
        relative_alt=above_sea_mm - round(copter.home_altitude_m() * 1e3),
        vx=round(velocity.north_m_s * 100),
        vy=round(velocity.east_m_s * 100),
        vz=round(-velocity.up_m_s * 100),
        hdg=round(copter.heading_deg(now_s) * 100) % 36_000,
    )


def vfr_hud(copter: Quadrotor, now_s: float) -> Message:
    """VFR_HUD: speeds, heading and height, as a pilot reads them."""
    velocity = copter.velocity(now_s)
    ground_m_s = math.hypot(velocity.east_m_s, velocity.north_m_s)
    return mavlink.MAVLink_vfr_hud_message(
        ground_m_s,
        ground_m_s,
        round(copter.heading_deg(now_s)) % 360,
        50 if copter.flying else 0,
        _above_sea_mm(copter, copter.position(now_s)) / 1e3,
        velocity.up_m_s,
    )


def position_target_global(copter: Quadrotor, now_s: float) -> Message | None:
    """POSITION_TARGET_GLOBAL_INT: where it flies to, if anywhere."""
    copter.advance(now_s)
    target = copter.target()
    if target is None:
        return None
    geo = copter.frame.geo(target)
    return mavlink.MAVLink_position_target_global_int_message(
        _boot_ms(copter, now_s),
        mavlink.MAV_FRAME_GLOBAL_INT,
        _ONLY_POSITION,
        _degrees_e7(geo.latitude_deg),
        _degrees_e7(geo.longitude_deg),
        _above_sea_mm(copter, target) / 1e3,
        *[0.0] * 8,
    )


def position_target_local(copter: Quadrotor, now_s: float) -> Message | None:
    """POSITION_TARGET_LOCAL_NED: the same in metres."""
    copter.advance(now_s)
    target = copter.target()
    if target is None:
        return None
    return mavlink.MAVLink_position_target_local_ned_message(
        _boot_ms(copter, now_s),
        mavlink.MAV_FRAME_LOCAL_NED,
        _ONLY_POSITION,
        target.north_m,
        target.east_m,
        -target.altitude_m,
        *[0.0] * 8,
    )


def gps_global_origin(copter: Quadrotor, now_s: float) -> Message | None:
    """GPS_GLOBAL_ORIGIN: what local positions count from, once that is known."""
    copter.advance(now_s)
    if not copter.ever_had_fix:
        return None
    home = copter.settings.home
    return mavlink.MAVLink_gps_global_origin_message(
        _degrees_e7(home.latitude_deg), _degrees_e7(home.longitude_deg), _above_sea_mm(copter, _AT_HOME)
    )


def home_position(copter: Quadrotor, now_s: float) -> Message | None:
    """HOME_POSITION: where it returns to; its height changes at the first arming."""
    copter.advance(now_s)
    if not copter.ever_had_fix:
        return None
    home = copter.settings.home
    return mavlink.MAVLink_home_position_message(
        latitude=_degrees_e7(home.latitude_deg),
        longitude=_degrees_e7(home.longitude_deg),
        altitude=round(copter.home_altitude_m() * 1e3),
        x=0,
        y=0,
        z=0,
        q=[1, 0, 0, 0],
        approach_x=0,
        approach_y=0,
        approach_z=0,
        time_usec=round(copter.uptime_s(now_s) * 1e6),
    )


def extended_sys_state(copter: Quadrotor, now_s: float) -> Message:
    """EXTENDED_SYS_STATE: on the ground, in the air, or between."""
    copter.advance(now_s)
    return mavlink.MAVLink_extended_sys_state_message(
        mavlink.MAV_VTOL_STATE_UNDEFINED, copter.landed_state(now_s)
    )


def mission_current(_copter: Quadrotor, _now_s: float) -> Message:
    """MISSION_CURRENT: it has no mission."""
    return mavlink.MAVLink_mission_current_message(0, total=0xFFFF)


def autopilot_version(_copter: Quadrotor, _now_s: float) -> Message:
    """AUTOPILOT_VERSION: what a client may expect."""
    return mavlink.MAVLink_autopilot_version_message(
        capabilities=_CAPABILITIES,
        flight_sw_version=_VERSION_1_16_1,
        middleware_sw_version=_VERSION_1_16_1,
        os_sw_version=0,
        board_version=1,
        flight_custom_version=[0] * 8,
        middleware_custom_version=[0] * 8,
        os_custom_version=[0] * 8,
        vendor_id=0,
        product_id=0,
        uid=1,
    )


REPORTS: dict[float, QuadrotorReport] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: heartbeat,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: sys_status,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: system_time,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: gps_raw,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: attitude,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: attitude_quaternion,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: local_position,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: global_position,
    mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: mission_current,
    mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: gps_global_origin,
    mavlink.MAVLINK_MSG_ID_VFR_HUD: vfr_hud,
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: position_target_local,
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT: position_target_global,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: battery_status,
    mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: autopilot_version,
    mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: estimator_status,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: home_position,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: extended_sys_state,
    AVAILABLE_MODES: lambda _copter, _now_s: available_modes(1)[0],
    CURRENT_MODE: current_mode,
}
"""What can be asked for, by message number; a request's number arrives as a float."""

UNMODELLED: tuple[int, ...] = (
    mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET,
    mavlink.MAVLINK_MSG_ID_HIGHRES_IMU,
    mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR,
    mavlink.MAVLINK_MSG_ID_ALTITUDE,
    mavlink.MAVLINK_MSG_ID_ODOMETRY,
)
"""Streams that a PX4 has: an interval may be set for them, and nothing comes."""

UNASKED_S: dict[int, float] = {
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 0.2,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: 1.0,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 0.125,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: 0.01,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 0.02,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 1 / 30,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 0.02,
    mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: 1.0,
    mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: 1.0,
    mavlink.MAVLINK_MSG_ID_VFR_HUD: 0.1,
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: 0.1,
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT: 0.1,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: 2.0,
    mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: 1.0,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: 2.0,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 0.2,
    CURRENT_MODE: 2.0,
}
"""The onboard link's streams, as far as they are modelled."""


def _boot_ms(copter: Quadrotor, now_s: float) -> int:
    return round(copter.uptime_s(now_s) * 1e3) % 2**32


def _degrees_e7(degrees: float) -> int:
    return round(degrees * 1e7)


def _above_sea_mm(copter: Quadrotor, position: Position) -> int:
    return round((copter.settings.home_altitude_m + position.altitude_m) * 1e3)
