"""The reports of a stand-in PX4, and how often it sends them on an onboard link."""

from __future__ import annotations

import math
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.mavlink.packets import Message
from upwash.mavlink.px4 import AVAILABLE_MODES, CURRENT_MODE, AvailableModesMessage, CurrentModeMessage, Mode
from upwash.vehicle.body.firmware import Report
from upwash.vehicle.body.telemetry import StandInTelemetry, degrees_e7, made
from upwash.vehicle.px4.inputs import InputSource
from upwash.vehicle.px4.vehicle import Quadrotor

_BY_HAND = 0b0100_0001  # base modes: by hand, custom
_STABILIZED = 0b0101_0001  # and stabilized
_OFFBOARD = 0b0001_0001  # stabilized, custom
_AUTO = 0b0001_1101  # stabilized, guided, auto, custom
_MODES = {
    Mode.MANUAL: ("Manual", _BY_HAND, 0),
    Mode.ALTCTL: ("Altitude", _STABILIZED, 3),
    Mode.POSCTL: ("Position", _STABILIZED, 1),
    Mode.MISSION: ("Mission", _AUTO, 6),
    Mode.LOITER: ("Hold", _AUTO, 0),
    Mode.RTL: ("Return", _AUTO, 5),
    Mode.ACRO: ("Acro", _BY_HAND, 0),
    Mode.OFFBOARD: ("Offboard", _OFFBOARD, 0),
    Mode.STABILIZED: ("Stabilized", _STABILIZED, 0),
    Mode.TAKEOFF: ("Takeoff", _AUTO, 8),
    Mode.LAND: ("Land", _AUTO, 7),
}
"""Names, base modes, and MAV_STANDARD_MODEs."""
_ADVANCED = 1  # MAV_MODE_PROPERTY
_SENSORS_UNCHECKED = 0x321_C83F  # these four as recorded
_SENSORS, _SENSORS_ENABLED, _SENSORS_HEALTHY = 0x300_402F, 0x301_402F, 0x1320_C83F
_WITHOUT_POSITION, _HEALTHY_WITHOUT_POSITION = ~0x20, ~0x4000
_GPS_BIT = mavlink.MAV_SYS_STATUS_SENSOR_GPS
_STICKS_BIT = mavlink.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
_ESTIMATES_ALL = 831  # attitude, velocities, positions; no dead reckoning, no GPS glitch
_ESTIMATES_WITHOUT_GPS = 165


def available_modes(index: int) -> tuple[Message, ...]:
    """AVAILABLE_MODES: the one with that index from 1 on, or all for 0."""
    return tuple(
        AvailableModesMessage(
            custom_mode=int(mode),
            properties=_ADVANCED if mode in (Mode.OFFBOARD, Mode.ACRO, Mode.STABILIZED) else 0,
            number_modes=len(_MODES),
            mode_index=number,
            standard_mode=standard,
            mode_name=b"" if standard else name.encode(),
        )
        for number, (mode, (name, _, standard)) in enumerate(_MODES.items(), 1)
        if index in (0, number)
    )


class Px4Telemetry(StandInTelemetry[Quadrotor]):
    """The reports of a stand-in PX4, one method for each message."""

    drawn, consumed = -100, 0
    throttle_percent = 50
    vtol_state = mavlink.MAV_VTOL_STATE_UNDEFINED
    frame_of_targets = mavlink.MAV_FRAME_GLOBAL_INT
    capabilities = 59_647  # as recorded

    def reports(self) -> dict[float, Report]:
        """The reports on request, by message number."""
        return super().reports() | {
            mavlink.MAVLINK_MSG_ID_HEARTBEAT: self._heartbeat,
            mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: self._global_position,
            mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: self._attitude_quaternion,
            mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: self._estimator_status,
            AVAILABLE_MODES: lambda _now_s: available_modes(1)[0],
            CURRENT_MODE: self._current_mode,
        }

    def _heartbeat(self, now_s: float) -> Message | None:
        copter = self.copter
        if copter.booting(now_s):
            return None
        _, base_mode, _ = _MODES[copter.mode]
        if copter.armed:
            base_mode |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED
            status = mavlink.MAV_STATE_CRITICAL if copter.fails_safe else mavlink.MAV_STATE_ACTIVE
        else:
            status = mavlink.MAV_STATE_STANDBY if copter.armable(now_s) else mavlink.MAV_STATE_UNINIT
        return mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_PX4, base_mode, copter.mode, status, 3
        )

    def _current_mode(self, _now_s: float) -> Message:
        mode, intended = int(self.copter.mode), int(self.copter.intended)
        standard = 0 if self.copter.descends_blindly else _MODES[self.copter.mode][2]
        return CurrentModeMessage(custom_mode=mode, intended_custom_mode=intended, standard_mode=standard)

    def _sensors(self, now_s: float) -> tuple[int, int, int]:
        copter = self.copter
        present, enabled, healthy = _SENSORS, _SENSORS_ENABLED, _SENSORS_HEALTHY
        if not copter.checked(now_s):
            present, enabled, healthy = 0, 0, _SENSORS_UNCHECKED
        elif not copter.gps.placed:
            present, enabled = present & _WITHOUT_POSITION, enabled & _WITHOUT_POSITION
            healthy &= _HEALTHY_WITHOUT_POSITION
            if not copter.gps.has_fix:
                enabled, healthy = enabled | _GPS_BIT, healthy & ~_GPS_BIT
        if copter.inputs.hears(InputSource.STICKS, now_s):
            present, healthy = present | _STICKS_BIT, healthy | _STICKS_BIT
        if copter.battery_level(now_s) > 1:
            healthy &= ~mavlink.MAV_SYS_STATUS_SENSOR_BATTERY
        if not (copter.armed and copter.battery_level(now_s) < 3) and not copter.armable(now_s):
            healthy &= ~mavlink.MAV_SYS_STATUS_PREARM_CHECK
        return present, enabled, healthy

    def _receiver(self, now_s: float) -> dict[str, Any]:
        velocity, fix = self.copter.velocity(now_s), self.copter.gps.has_fix
        course_deg = math.degrees(math.atan2(velocity.east_m_s, velocity.north_m_s)) % 360
        return {
            "fix_type": mavlink.GPS_FIX_TYPE_3D_FIX if fix else mavlink.GPS_FIX_TYPE_NO_GPS,
            "eph": 70 if fix else 10_000,
            "epv": 110 if fix else 10_000,
            "cog": round(course_deg * 100) % 36_000,
            "satellites_visible": round(self.copter.parameters["SIM_GPS_USED"]) % 255 if fix else 0,
        }

    def _estimator_status(self, now_s: float) -> Message:
        flags = _ESTIMATES_ALL if self.copter.gps.placed else _ESTIMATES_WITHOUT_GPS
        return mavlink.MAVLink_estimator_status_message(self._boot_us(now_s), flags, *[0.02] * 6, 0.3, 0.4)

    def _attitude_quaternion(self, now_s: float) -> Message:
        half = math.radians(self.copter.heading_deg(now_s)) / 2
        return made(
            mavlink.MAVLink_attitude_quaternion_message,
            time_boot_ms=self._boot_ms(now_s),
            q1=math.cos(half),
            q4=math.sin(half),
        )

    def _local_position(self, now_s: float) -> Message | None:
        return super()._local_position(now_s) if self.copter.has_origin(now_s) else None

    def _global_position(self, now_s: float) -> Message | None:
        if not self.copter.has_origin(now_s):
            return None
        above_sea_mm = self._above_sea_mm(self.copter.position(now_s))
        above_home_mm = above_sea_mm - round(self.copter.home_altitude_m() * 1e3)
        return self._global_position_of(now_s, above_home_mm=above_home_mm, known=True)

    def _home(self, now_s: float) -> dict[str, int]:
        home = self.copter.settings.home
        return {
            "latitude": degrees_e7(home.latitude_deg),
            "longitude": degrees_e7(home.longitude_deg),
            "altitude": round(self.copter.home_altitude_m() * 1e3),
            "time_usec": self._boot_us(now_s),
        }

    def _mission_current(self, _now_s: float) -> Message:
        return mavlink.MAVLink_mission_current_message(0, total=0xFFFF)

    def _build(self) -> dict[str, Any]:
        settings = self.copter.settings
        return {"middleware_sw_version": settings.version.number, "board_version": 1, "uid": settings.serial}


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
