"""What the stand-in PX4 reports, message by message, and how often it does so on an onboard link."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import TypeAlias

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.mavlink.px4 import AVAILABLE_MODES, CURRENT_MODE, AvailableModesMessage, CurrentModeMessage, Mode
from upwash.vehicle.body import messages
from upwash.vehicle.body.firmware import Message
from upwash.vehicle.body.messages import above_sea_mm, boot_ms, degrees_e7
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


def heartbeat(copter: Quadrotor, now_s: float) -> Message | None:
    """HEARTBEAT: the mode, whether armed, and how it is; nothing in its first second."""
    copter.advance(now_s)
    if copter.health.booting(now_s):
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
    if not copter.health.checked(now_s):
        present, enabled, health = 0, 0, _SENSORS_UNCHECKED
    elif not copter.gps.placed:
        present, enabled, health = present & ~0x20, enabled & ~0x20, health & ~0x4000
        if not copter.gps.has_fix:
            enabled, health = enabled | _GPS_BIT, health & ~_GPS_BIT
    if copter.heard.hears_sticks(now_s):
        present, health = present | _STICKS_BIT, health | _STICKS_BIT
    if copter.health.battery_level(now_s) > 1:
        health &= ~_BATTERY_BIT
    if not (copter.armed and copter.health.battery_level(now_s) < 3) and not copter.armable(now_s):
        health &= ~_ARMABLE_BIT
    return messages.sys_status(copter, now_s, sensors=(present, enabled, health), current=-100)


def battery_status(copter: Quadrotor, now_s: float) -> Message:
    """BATTERY_STATUS: how full it is, and how serious that is."""
    copter.advance(now_s)
    return messages.battery_status(
        copter, now_s, current=-100, consumed=0, charge_state=copter.health.battery_level(now_s)
    )


def system_time(copter: Quadrotor, now_s: float) -> Message:
    """SYSTEM_TIME: the date, once it has had a fix, and since boot."""
    unix_us = round(time.time() * 1e6) if copter.gps.ever_had_fix else 0
    return mavlink.MAVLink_system_time_message(unix_us, boot_ms(copter, now_s))


def gps_raw(copter: Quadrotor, now_s: float) -> Message:
    """GPS_RAW_INT: the receiver's fix."""
    geo = copter.frame.geo(copter.position(now_s))
    velocity, fix = copter.velocity(now_s), copter.gps.has_fix
    return mavlink.MAVLink_gps_raw_int_message(
        time_usec=round(copter.uptime_s(now_s) * 1e6),
        fix_type=mavlink.GPS_FIX_TYPE_3D_FIX if fix else mavlink.GPS_FIX_TYPE_NO_GPS,
        lat=degrees_e7(geo.latitude_deg),
        lon=degrees_e7(geo.longitude_deg),
        alt=above_sea_mm(copter, copter.position(now_s)),
        eph=70 if fix else 10_000,
        epv=110 if fix else 10_000,
        vel=round(math.hypot(velocity.east_m_s, velocity.north_m_s) * 100),
        cog=round(math.degrees(math.atan2(velocity.east_m_s, velocity.north_m_s)) % 360 * 100) % 36_000,
        satellites_visible=round(copter.parameters["SIM_GPS_USED"]) % 255 if fix else 0,
    )


def estimator_status(copter: Quadrotor, now_s: float) -> Message:
    """ESTIMATOR_STATUS: what it knows of itself, as ESTIMATOR_STATUS_FLAGS."""
    copter.advance(now_s)
    flags = _ESTIMATES_ALL if copter.gps.placed else _ESTIMATES_WITHOUT_GPS
    return mavlink.MAVLink_estimator_status_message(
        round(copter.uptime_s(now_s) * 1e6), flags, *[0.02] * 6, 0.3, 0.4
    )


def attitude_quaternion(copter: Quadrotor, now_s: float) -> Message:
    """ATTITUDE_QUATERNION: the same as ATTITUDE."""
    half = math.radians(copter.heading_deg(now_s)) / 2
    return mavlink.MAVLink_attitude_quaternion_message(
        boot_ms(copter, now_s), math.cos(half), 0.0, 0.0, math.sin(half), 0.0, 0.0, 0.0
    )


def local_position(copter: Quadrotor, now_s: float) -> Message | None:
    """LOCAL_POSITION_NED: metres from where it was switched on, once it has had a fix."""
    return messages.local_position(copter, now_s) if copter.gps.ever_had_fix else None


def global_position(copter: Quadrotor, now_s: float) -> Message | None:
    """GLOBAL_POSITION_INT: where it is and how it moves, once it has had a fix."""
    if not copter.gps.ever_had_fix:
        return None
    above_home_mm = above_sea_mm(copter, copter.position(now_s)) - round(copter.home_altitude_m() * 1e3)
    return messages.global_position(copter, now_s, above_home_mm=above_home_mm)


def vfr_hud(copter: Quadrotor, now_s: float) -> Message:
    """VFR_HUD: speeds, heading and height, as a pilot reads them."""
    return messages.vfr_hud(copter, now_s, throttle=50 if copter.flying else 0)


def position_target_global(copter: Quadrotor, now_s: float) -> Message | None:
    """POSITION_TARGET_GLOBAL_INT: where it flies to, if anywhere."""
    copter.advance(now_s)
    target = copter.target()
    if target is None:
        return None
    return messages.position_target_global(copter, now_s, target, frame=mavlink.MAV_FRAME_GLOBAL_INT)


def position_target_local(copter: Quadrotor, now_s: float) -> Message | None:
    """POSITION_TARGET_LOCAL_NED: the same in metres."""
    copter.advance(now_s)
    target = copter.target()
    return None if target is None else messages.position_target_local(copter, now_s, target)


def gps_global_origin(copter: Quadrotor, now_s: float) -> Message | None:
    """GPS_GLOBAL_ORIGIN: what local positions count from, once that is known."""
    copter.advance(now_s)
    return messages.gps_global_origin(copter) if copter.gps.ever_had_fix else None


def home_position(copter: Quadrotor, now_s: float) -> Message | None:
    """HOME_POSITION: where it returns to; its height changes at the first arming."""
    copter.advance(now_s)
    if not copter.gps.ever_had_fix:
        return None
    return messages.home_position(
        copter,
        altitude_mm=round(copter.home_altitude_m() * 1e3),
        time_us=round(copter.uptime_s(now_s) * 1e6),
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


def autopilot_version(copter: Quadrotor, _now_s: float) -> Message:
    """AUTOPILOT_VERSION: what a client may expect."""
    return messages.autopilot_version(
        capabilities=_CAPABILITIES,
        version=copter.settings.version.number,
        middleware_version=copter.settings.version.number,
        board_version=1,
    )


REPORTS: dict[float, QuadrotorReport] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: heartbeat,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: sys_status,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: system_time,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: gps_raw,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: messages.attitude,
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
