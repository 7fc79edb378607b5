"""The reports of a stand-in ArduCopter."""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.mavlink.packets import Message
from upwash.vehicle.ardupilot.copter import CameraShot, Copter
from upwash.vehicle.ardupilot.fence import Breach
from upwash.vehicle.ardupilot.settings import CopterMode
from upwash.vehicle.body.copter import FaultKind, LandedState
from upwash.vehicle.body.firmware import Report
from upwash.vehicle.body.telemetry import StandInTelemetry, degrees_e7, made

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


class CopterTelemetry(StandInTelemetry[Copter]):
    """The reports of a stand-in ArduCopter, one method for each message."""

    throttle_percent = 35
    vtol_state = mavlink.MAV_VTOL_STATE_MC
    frame_of_targets = mavlink.MAV_FRAME_GLOBAL
    capabilities = (
        mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_FLOAT
        | mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
        | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
        | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT
        | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_GLOBAL_INT
        | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    )

    _batteries_told = -1

    def reports(self) -> dict[float, Report]:
        """The reports on request, by message number."""
        return super().reports() | {
            mavlink.MAVLINK_MSG_ID_HEARTBEAT: self._heartbeat,
            mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: self._global_position,
            mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: self._ekf_status,
            mavlink.MAVLINK_MSG_ID_FENCE_STATUS: self._fence_status,
            mavlink.MAVLINK_MSG_ID_WIND: lambda _now_s: None,  # it estimates none
        }

    def _battery_status(self, now_s: float) -> tuple[Message, ...]:
        """BATTERY_STATUS of one battery after the other, as ArduPilot sends it."""
        all_batteries = super()._battery_status(now_s)
        self._batteries_told += 1
        return (all_batteries[self._batteries_told % len(all_batteries)],)

    def _heartbeat(self, now_s: float) -> Message:
        copter = self.copter
        armed, booting = copter.armed(now_s), copter.booting(now_s)
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
        autopilot = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
        return mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_QUADROTOR, autopilot, base_mode, copter.mode, status, 3
        )

    def _sensors(self, now_s: float) -> tuple[int, int, int]:
        health = _SENSORS
        if not self.copter.armable(now_s):
            health &= ~mavlink.MAV_SYS_STATUS_PREARM_CHECK
        if self.copter.suffers(FaultKind.GPS, now_s):
            health &= ~mavlink.MAV_SYS_STATUS_SENSOR_GPS
        if self.copter.suffers(FaultKind.BATTERY, now_s):
            health &= ~mavlink.MAV_SYS_STATUS_SENSOR_BATTERY
        return _SENSORS, _SENSORS, health

    def _receiver(self, now_s: float) -> dict[str, Any]:
        course = {"cog": self._heading_cdeg(now_s)}
        if not self.copter.hears_satellites(now_s):
            nowhere = {"fix_type": mavlink.GPS_FIX_TYPE_NO_GPS, "lat": 0, "lon": 0}
            return course | nowhere | {"eph": 65535, "epv": 65535, "satellites_visible": 0}
        heard = course | {"eph": 121, "epv": 200}
        if not self.copter.has_fix(now_s):
            nowhere = {"fix_type": mavlink.GPS_FIX_TYPE_NO_FIX, "lat": 0, "lon": 0}
            return heard | nowhere | {"satellites_visible": _TOO_FEW_SATELLITES}
        return heard | {"fix_type": mavlink.GPS_FIX_TYPE_RTK_FIXED, "satellites_visible": _SATELLITES}

    def _ekf_status(self, now_s: float) -> Message:
        return mavlink.MAVLink_ekf_status_report_message(
            self.copter.ekf_flags(now_s), 0.02, 0.02, 0.02, 0.02, 0.0
        )

    def _global_position(self, now_s: float) -> Message:
        above_home_m = self.copter.position(now_s).altitude_m - self.copter.home.altitude_m
        known = self.copter.has_origin(now_s) or self.copter.has_fix(now_s)
        return self._global_position_of(now_s, above_home_mm=round(above_home_m * 1e3), known=known)

    def _position_target_local(self, now_s: float) -> Message | None:
        if self.copter.mode is not CopterMode.GUIDED or not self.copter.armed(now_s):
            return None
        return self._local_target(now_s, self.copter.target(now_s) or self.copter.climbs_to)

    def _home(self, now_s: float) -> dict[str, int]:
        home = self.copter.home
        geo = self.copter.frame.geo(home)
        return {
            "latitude": degrees_e7(geo.latitude_deg),
            "longitude": degrees_e7(geo.longitude_deg),
            "altitude": self._above_sea_mm(home),
        }

    def _fence_status(self, now_s: float) -> Message:
        fence, uptime_s = self.copter.fence, self.copter.uptime_s(now_s)
        return mavlink.MAVLink_fence_status_message(
            breach_status=int(fence.breach is not Breach.NONE),
            breach_count=fence.breaches,
            breach_type=fence.breach,
            breach_time=round((uptime_s - (now_s - fence.breached_s)) * 1e3) if fence.breaches else 0,
            breach_mitigation=mavlink.FENCE_MITIGATE_NONE,
        )

    def camera_feedback(self, shot: CameraShot) -> Message:
        """CAMERA_FEEDBACK: a photo that was taken."""
        geo = self.copter.frame.geo(shot.position)
        return made(
            mavlink.MAVLink_camera_feedback_message,
            time_usec=round(self.copter.unix_s(shot.taken_s) * 1e6),  # with a feedback pin since the boot
            img_idx=shot.number,
            lat=degrees_e7(geo.latitude_deg),
            lng=degrees_e7(geo.longitude_deg),
            alt_msl=self._above_sea_mm(shot.position) / 1e3,
            alt_rel=shot.position.altitude_m,
            yaw=self.copter.heading_deg(shot.taken_s),
            flags=mavlink.CAMERA_FEEDBACK_PHOTO,
            completed_captures=shot.number,
        )


STREAM_GROUPS: dict[int, tuple[int, ...]] = {
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
