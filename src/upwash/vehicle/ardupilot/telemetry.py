"""What the stand-in reports, message by message."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeAlias

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.vehicle.ardupilot.camera import CameraShot
from upwash.vehicle.ardupilot.copter import Copter
from upwash.vehicle.ardupilot.fence import Breach
from upwash.vehicle.ardupilot.settings import CopterMode
from upwash.vehicle.body import messages
from upwash.vehicle.body.condition import FaultKind
from upwash.vehicle.body.firmware import LandedState, Message
from upwash.vehicle.body.messages import above_sea_mm, boot_ms, degrees_e7, heading_cdeg

Report: TypeAlias = Callable[[Copter, float], Message]

_BASE_MODE = (
    mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
    | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
    | mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
)
_HOVERS_ONLY_WHEN_ARMED = (
    CopterMode.LOITER,
    CopterMode.RTL,
    CopterMode.LAND,
    CopterMode.POSHOLD,
    CopterMode.BRAKE,
)
_SENSORS = (
    mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG
    | mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
    | mavlink.MAV_SYS_STATUS_SENSOR_GPS
    | mavlink.MAV_SYS_STATUS_AHRS
    | mavlink.MAV_SYS_STATUS_SENSOR_BATTERY
    | mavlink.MAV_SYS_STATUS_PREARM_CHECK
)
_SATELLITES, _TOO_FEW_SATELLITES = 10, 3
_CAPABILITIES = (
    mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_FLOAT
    | mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
    | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_GLOBAL_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
)


def heartbeat(copter: Copter, now_s: float) -> Message:
    """HEARTBEAT: the mode, whether armed, whether flying."""
    armed, booting = copter.armed(now_s), copter.health.booting(now_s)
    base_mode = _BASE_MODE
    if armed:
        base_mode |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    if booting or copter.mode is CopterMode.GUIDED or (armed and copter.mode in _HOVERS_ONLY_WHEN_ARMED):
        base_mode |= mavlink.MAV_MODE_FLAG_GUIDED_ENABLED
    if copter.critical():
        status = mavlink.MAV_STATE_CRITICAL
    elif copter.landed_state(now_s) is not LandedState.ON_GROUND:
        status = mavlink.MAV_STATE_ACTIVE
    else:
        status = mavlink.MAV_STATE_BOOT if booting else mavlink.MAV_STATE_STANDBY
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, base_mode, copter.mode, status, 3
    )


def sys_status(copter: Copter, now_s: float) -> Message:
    """SYS_STATUS: whether its sensors and its checks before arming are well, and its battery."""
    health = _SENSORS
    if not copter.armable(now_s):
        health &= ~mavlink.MAV_SYS_STATUS_PREARM_CHECK
    if copter.suffers(FaultKind.GPS, now_s):
        health &= ~mavlink.MAV_SYS_STATUS_SENSOR_GPS
    if copter.suffers(FaultKind.BATTERY, now_s):
        health &= ~mavlink.MAV_SYS_STATUS_SENSOR_BATTERY
    return messages.sys_status(copter, now_s, sensors=(_SENSORS, _SENSORS, health), current=-1)


def battery_status(copter: Copter, now_s: float) -> Message:
    """BATTERY_STATUS: how full the battery is; it does not tell what is drawn from it."""
    return messages.battery_status(copter, now_s, current=-1, consumed=-1)


def system_time(copter: Copter, now_s: float) -> Message:
    """SYSTEM_TIME: since boot, and the date once its receiver has told it."""
    unix_us = round(copter.health.unix_s(now_s) * 1e6)
    return mavlink.MAVLink_system_time_message(unix_us, boot_ms(copter, now_s))


def gps_raw(copter: Copter, now_s: float) -> Message:
    """GPS_RAW_INT: the receiver's fix."""
    geo = copter.frame.geo(copter.position(now_s))
    blind = not copter.health.has_fix(now_s)
    hears = copter.health.hears_satellites(now_s)
    velocity = copter.velocity(now_s)
    return mavlink.MAVLink_gps_raw_int_message(
        time_usec=round(copter.uptime_s(now_s) * 1e6),
        fix_type=_fix_type(blind=blind, hears=hears),
        lat=0 if blind else degrees_e7(geo.latitude_deg),
        lon=0 if blind else degrees_e7(geo.longitude_deg),
        alt=above_sea_mm(copter, copter.position(now_s)),
        eph=121 if hears else 65535,
        epv=200 if hears else 65535,
        vel=round(math.hypot(velocity.east_m_s, velocity.north_m_s) * 100),
        cog=heading_cdeg(copter, now_s),
        satellites_visible=(_TOO_FEW_SATELLITES if blind else _SATELLITES) if hears else 0,
    )


def _fix_type(*, blind: bool, hears: bool) -> int:
    if not hears:
        return int(mavlink.GPS_FIX_TYPE_NO_GPS)
    return int(mavlink.GPS_FIX_TYPE_NO_FIX if blind else mavlink.GPS_FIX_TYPE_RTK_FIXED)


def ekf_status(copter: Copter, now_s: float) -> Message:
    """EKF_STATUS_REPORT: by what the position estimate goes."""
    return mavlink.MAVLink_ekf_status_report_message(
        copter.health.ekf_flags(now_s), 0.02, 0.02, 0.02, 0.02, 0.0
    )


def global_position(copter: Copter, now_s: float) -> Message:
    """GLOBAL_POSITION_INT: latitude and longitude are 0 until they are known."""
    known = copter.health.knows_its_place(now_s) or copter.health.has_fix(now_s)
    above_home_mm = round((copter.position(now_s).altitude_m - copter.home.altitude_m) * 1e3)
    return messages.global_position(copter, now_s, above_home_mm=above_home_mm, known=known)


def vfr_hud(copter: Copter, now_s: float) -> Message:
    """VFR_HUD: speeds, heading and height, as a pilot reads them."""
    return messages.vfr_hud(copter, now_s, throttle=35 if copter.flying(now_s) else 0)


def position_target(copter: Copter, now_s: float) -> Message | None:
    """POSITION_TARGET_GLOBAL_INT: the target in force, if there is one."""
    target = copter.target(now_s)
    if target is None:
        return None
    return messages.position_target_global(copter, now_s, target, frame=mavlink.MAV_FRAME_GLOBAL)


def position_target_local(copter: Copter, now_s: float) -> Message | None:
    """POSITION_TARGET_LOCAL_NED in GUIDED: its target or the top of its take-off; else that it has a velocity."""
    if copter.mode is not CopterMode.GUIDED or not copter.armed(now_s):
        return None
    return messages.position_target_local(copter, now_s, copter.target(now_s) or copter.climbs_to)


def gps_global_origin(copter: Copter, now_s: float) -> Message | None:
    """GPS_GLOBAL_ORIGIN: what local positions count from, once that is known."""
    return messages.gps_global_origin(copter) if copter.health.knows_its_place(now_s) else None


def home_position(copter: Copter, now_s: float) -> Message | None:
    """HOME_POSITION: where it returns to, once it knows where it is."""
    if not copter.health.knows_its_place(now_s):
        return None
    home = copter.home
    return messages.home_position(copter, altitude_mm=above_sea_mm(copter, home), place=home)


def extended_sys_state(copter: Copter, now_s: float) -> Message:
    """EXTENDED_SYS_STATE: on the ground, in the air, or between."""
    return mavlink.MAVLink_extended_sys_state_message(mavlink.MAV_VTOL_STATE_MC, copter.landed_state(now_s))


def fence_status(copter: Copter, now_s: float) -> Message:
    """FENCE_STATUS: whether it keeps to its fence."""
    fence, uptime_s = copter.fence, copter.uptime_s(now_s)
    return mavlink.MAVLink_fence_status_message(
        breach_status=int(fence.breach is not Breach.NONE),
        breach_count=fence.breaches,
        breach_type=fence.breach,
        breach_time=round((uptime_s - (now_s - fence.breached_s)) * 1e3) if fence.breaches else 0,
        breach_mitigation=mavlink.FENCE_MITIGATE_NONE,
    )


def wind(_copter: Copter, _now_s: float) -> None:
    """WIND: it estimates none."""


def mission_current(_copter: Copter, _now_s: float) -> Message:
    """MISSION_CURRENT: it has no mission."""
    return mavlink.MAVLink_mission_current_message(0)


def autopilot_version(copter: Copter, _now_s: float) -> Message:
    """AUTOPILOT_VERSION: what a client may expect."""
    return messages.autopilot_version(
        capabilities=_CAPABILITIES,
        version=copter.settings.version.number,
        middleware_version=0,
        board_version=0,
    )


def camera_feedback(copter: Copter, shot: CameraShot) -> Message:
    """CAMERA_FEEDBACK: a photo that was taken."""
    geo = copter.frame.geo(shot.position)
    return mavlink.MAVLink_camera_feedback_message(
        time_usec=round(copter.uptime_s(shot.taken_s) * 1e6),
        target_system=0,
        cam_idx=0,
        img_idx=shot.number,
        lat=degrees_e7(geo.latitude_deg),
        lng=degrees_e7(geo.longitude_deg),
        alt_msl=above_sea_mm(copter, shot.position) / 1e3,
        alt_rel=shot.position.altitude_m,
        roll=0.0,
        pitch=0.0,
        yaw=copter.heading_deg(shot.taken_s),
        foc_len=0.0,
        flags=mavlink.CAMERA_FEEDBACK_PHOTO,
        completed_captures=shot.number,
    )


REPORTS: dict[float, Report] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: heartbeat,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: sys_status,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: system_time,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: gps_raw,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: messages.attitude,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: messages.local_position,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: global_position,
    mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: mission_current,
    mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: gps_global_origin,
    mavlink.MAVLINK_MSG_ID_VFR_HUD: vfr_hud,
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT: position_target,
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: position_target_local,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: battery_status,
    mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: autopilot_version,
    mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: ekf_status,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: home_position,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: extended_sys_state,
    mavlink.MAVLINK_MSG_ID_FENCE_STATUS: fence_status,
    mavlink.MAVLINK_MSG_ID_WIND: wind,
}
"""What can be asked for, by message number; a request's number arrives as a float."""

STREAMS: dict[int, tuple[int, ...]] = {
    mavlink.MAV_DATA_STREAM_EXTENDED_STATUS: (
        mavlink.MAVLINK_MSG_ID_SYS_STATUS,
        mavlink.MAVLINK_MSG_ID_GPS_RAW_INT,
        mavlink.MAVLINK_MSG_ID_MISSION_CURRENT,
        mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT,
        mavlink.MAVLINK_MSG_ID_FENCE_STATUS,
    ),
    mavlink.MAV_DATA_STREAM_POSITION: (
        mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
        mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
    ),
    mavlink.MAV_DATA_STREAM_EXTRA1: (mavlink.MAVLINK_MSG_ID_ATTITUDE,),
    mavlink.MAV_DATA_STREAM_EXTRA2: (mavlink.MAVLINK_MSG_ID_VFR_HUD,),
    mavlink.MAV_DATA_STREAM_EXTRA3: (
        mavlink.MAVLINK_MSG_ID_SYSTEM_TIME,
        mavlink.MAVLINK_MSG_ID_BATTERY_STATUS,
        mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT,
    ),
}
"""The messages of each group of REQUEST_DATA_STREAM; EXTENDED_SYS_STATE is in none."""
