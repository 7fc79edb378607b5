"""What the stand-in reports, message by message."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeAlias

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import LocalFrame
from upwash.vehicle.copter import Copter, Mode

Message: TypeAlias = Any  # pymavlink's messages are not typed

_HOVERS_BY_ITSELF = mavlink.MAV_MODE_FLAG_GUIDED_ENABLED
_BASE_MODE = (
    mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
    | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
    | mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
)


def heartbeat(copter: Copter, now_s: float) -> Message:
    """HEARTBEAT: the mode, whether armed, whether flying."""
    armed = copter.armed(now_s)
    base_mode = _BASE_MODE
    if armed:
        base_mode |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    if copter.mode is not Mode.STABILIZE:
        base_mode |= _HOVERS_BY_ITSELF
    if copter.flying(now_s):
        status = mavlink.MAV_STATE_ACTIVE
    elif copter.armable(now_s):
        status = mavlink.MAV_STATE_STANDBY
    else:
        status = mavlink.MAV_STATE_BOOT
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, base_mode, copter.mode, status, 3
    )


def sys_status(copter: Copter, now_s: float) -> Message:
    """SYS_STATUS: whether the checks before arming pass, and a battery that is always full."""
    check = mavlink.MAV_SYS_STATUS_PREARM_CHECK
    return mavlink.MAVLink_sys_status_message(
        onboard_control_sensors_present=check,
        onboard_control_sensors_enabled=check,
        onboard_control_sensors_health=check if copter.armable(now_s) else 0,
        load=0,
        voltage_battery=12_600,
        current_battery=-1,
        battery_remaining=100,
        drop_rate_comm=0,
        errors_comm=0,
        errors_count1=0,
        errors_count2=0,
        errors_count3=0,
        errors_count4=0,
    )


def global_position(copter: Copter, now_s: float) -> Message:
    """GLOBAL_POSITION_INT: where it is and how it moves; latitude and longitude are 0 until that is known."""
    position = copter.position(now_s)
    velocity = copter.velocity(now_s)
    geo = LocalFrame(copter.settings.home).geo(position)
    known = copter.armable(now_s)
    altitude_mm = round(position.altitude_m * 1e3)
    return mavlink.MAVLink_global_position_int_message(
        time_boot_ms=round(copter.uptime_s(now_s) * 1e3) % 2**32,
        lat=round(geo.latitude_deg * 1e7) if known else 0,
        lon=round(geo.longitude_deg * 1e7) if known else 0,
        alt=altitude_mm,
        relative_alt=altitude_mm,
        vx=round(velocity.north_m_s * 100),
        vy=round(velocity.east_m_s * 100),
        vz=round(-velocity.up_m_s * 100),
        hdg=round(math.degrees(math.atan2(velocity.east_m_s, velocity.north_m_s)) * 100) % 36_000,
    )


def home_position(copter: Copter, _now_s: float) -> Message:
    """HOME_POSITION: where it returns to."""
    home = copter.settings.home
    return mavlink.MAVLink_home_position_message(
        latitude=round(home.latitude_deg * 1e7),
        longitude=round(home.longitude_deg * 1e7),
        altitude=0,
        x=0,
        y=0,
        z=0,
        q=[1, 0, 0, 0],
        approach_x=0,
        approach_y=0,
        approach_z=0,
    )


def extended_sys_state(copter: Copter, now_s: float) -> Message:
    """EXTENDED_SYS_STATE: on the ground, in the air, or between."""
    return mavlink.MAVLink_extended_sys_state_message(
        mavlink.MAV_VTOL_STATE_UNDEFINED, copter.landed_state(now_s)
    )


REPORTS: dict[float, Callable[[Copter, float], Message]] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: heartbeat,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: sys_status,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: global_position,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: home_position,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: extended_sys_state,
}
"""What can be asked for, by message number; a request's number arrives as a float."""
