"""The reports of every stand-in. An autopilot adds its own reports and its own numbers in a subclass."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from functools import cache
from typing import Any, ClassVar, Generic

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import Position
from upwash.mavlink.packets import Message
from upwash.vehicle.body.copter import HOME
from upwash.vehicle.body.firmware import AnyCopter, Report

_ONLY_POSITION, _NO_POSITION = 0b110111111000, 0b110000000111
_UNKNOWN_MV = 0xFFFF
_UID2_BYTES = 18


def made(kind: Any, **fields: Any) -> Message:
    """A message of that kind with those fields; all others are 0."""
    return kind(**_zeros(kind) | fields)


@cache
def _zeros(kind: Any) -> dict[str, Any]:
    lengths = zip(kind.ordered_fieldnames, kind.array_lengths, strict=True)
    return {name: [0] * length or 0 for name, length in lengths}


def degrees_e7(degrees: float) -> int:
    """Degrees as messages hold them."""
    return round(degrees * 1e7)


class StandInTelemetry(ABC, Generic[AnyCopter]):
    """What it reports, message by message. A report that is None is not known yet."""

    drawn, consumed = -1, -1  # from the battery, as messages hold it: not known
    throttle_percent: ClassVar[int]  # in flight
    vtol_state: ClassVar[int]
    frame_of_targets: ClassVar[int]
    capabilities: ClassVar[int]

    def __init__(self, copter: AnyCopter) -> None:
        self.copter = copter

    def reports(self) -> dict[float, Report]:
        """The reports on request, by message number."""
        return {
            mavlink.MAVLINK_MSG_ID_SYS_STATUS: self._sys_status,
            mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: self._system_time,
            mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: self._gps_raw,
            mavlink.MAVLINK_MSG_ID_ATTITUDE: self._attitude,
            mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: self._local_position,
            mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: self._mission_current,
            mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: self._gps_global_origin,
            mavlink.MAVLINK_MSG_ID_VFR_HUD: self._vfr_hud,
            mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT: self._position_target,
            mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: self._position_target_local,
            mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: self._battery_status,
            mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: self._autopilot_version,
            mavlink.MAVLINK_MSG_ID_HOME_POSITION: self._home_position,
            mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: self._extended_sys_state,
        }

    # --- what the autopilots tell differently ---------------------------------------------------------------

    @abstractmethod
    def _sensors(self, now_s: float) -> tuple[int, int, int]:
        """The sensors that are present, enabled and healthy, as SYS_STATUS holds them."""

    @abstractmethod
    def _receiver(self, now_s: float) -> dict[str, Any]:
        """The fields of GPS_RAW_INT that depend on the receiver's fix."""

    # --- reports --------------------------------------------------------------------------------------------

    def _sys_status(self, now_s: float) -> Message:
        present, enabled, healthy = self._sensors(now_s)
        return made(
            mavlink.MAVLink_sys_status_message,
            onboard_control_sensors_present=present,
            onboard_control_sensors_enabled=enabled,
            onboard_control_sensors_health=healthy,
            load=100,
            voltage_battery=round(self.copter.battery_v(now_s) * 1e3),
            current_battery=self.drawn,
            battery_remaining=math.floor(self.copter.main_percent(now_s)),
        )

    def _battery_status(self, now_s: float) -> tuple[Message, ...]:
        """BATTERY_STATUS of all batteries."""
        batteries = range(len(self.copter.batteries_percent(now_s)))
        return tuple(self._status_of_battery(now_s, number) for number in batteries)

    def _status_of_battery(self, now_s: float, number: int) -> Message:
        return made(
            mavlink.MAVLink_battery_status_message,
            id=number,
            battery_function=mavlink.MAV_BATTERY_FUNCTION_ALL,
            type=mavlink.MAV_BATTERY_TYPE_LIPO,
            temperature=0x7FFF,
            voltages=[round(self.copter.battery_v(now_s, number=number) * 1e3), *[_UNKNOWN_MV] * 9],
            current_battery=self.drawn,
            current_consumed=self.consumed,
            energy_consumed=-1,
            battery_remaining=math.floor(self.copter.batteries_percent(now_s)[number]),
            charge_state=self.copter.battery_level(now_s),
        )

    def _system_time(self, now_s: float) -> Message:
        return mavlink.MAVLink_system_time_message(
            round(self.copter.unix_s(now_s) * 1e6), self._boot_ms(now_s)
        )

    def _gps_raw(self, now_s: float) -> Message:
        place, velocity = self.copter.position(now_s), self.copter.velocity(now_s)
        geo = self.copter.frame.geo(place)
        fields = {
            "time_usec": self._boot_us(now_s),
            "lat": degrees_e7(geo.latitude_deg),
            "lon": degrees_e7(geo.longitude_deg),
            "alt": self._above_sea_mm(place),
            "vel": round(velocity.ground_m_s * 100),
        }
        return made(mavlink.MAVLink_gps_raw_int_message, **fields | self._receiver(now_s))

    def _attitude(self, now_s: float) -> Message:
        """ATTITUDE: always level, nose ahead."""
        yaw = math.remainder(math.radians(self.copter.heading_deg(now_s)), math.tau)
        return made(mavlink.MAVLink_attitude_message, time_boot_ms=self._boot_ms(now_s), yaw=yaw)

    def _local_position(self, now_s: float) -> Message | None:
        position, velocity = self.copter.position(now_s), self.copter.velocity(now_s)
        return mavlink.MAVLink_local_position_ned_message(
            self._boot_ms(now_s),
            position.north_m,
            position.east_m,
            -position.altitude_m,
            velocity.north_m_s,
            velocity.east_m_s,
            -velocity.up_m_s,
        )

    def _global_position_of(self, now_s: float, *, above_home_mm: int, known: bool) -> Message:
        position, velocity = self.copter.position(now_s), self.copter.velocity(now_s)
        geo = self.copter.frame.geo(position)
        return mavlink.MAVLink_global_position_int_message(
            time_boot_ms=self._boot_ms(now_s),
            lat=degrees_e7(geo.latitude_deg) if known else 0,
            lon=degrees_e7(geo.longitude_deg) if known else 0,
            alt=self._above_sea_mm(position),
            relative_alt=above_home_mm,
            vx=round(velocity.north_m_s * 100),
            vy=round(velocity.east_m_s * 100),
            vz=round(-velocity.up_m_s * 100),
            hdg=self._heading_cdeg(now_s),
        )

    def _mission_current(self, _now_s: float) -> Message:
        return mavlink.MAVLink_mission_current_message(0)

    def _gps_global_origin(self, now_s: float) -> Message | None:
        home = self.copter.settings.home
        if not self.copter.has_origin(now_s):
            return None
        return mavlink.MAVLink_gps_global_origin_message(
            degrees_e7(home.latitude_deg), degrees_e7(home.longitude_deg), self._above_sea_mm(HOME)
        )

    def _home_position(self, now_s: float) -> Message | None:
        return (
            made(mavlink.MAVLink_home_position_message, q=[1, 0, 0, 0], **self._home(now_s))
            if self.copter.has_origin(now_s)
            else None
        )

    @abstractmethod
    def _home(self, now_s: float) -> dict[str, int]:
        """The fields of HOME_POSITION."""

    def _vfr_hud(self, now_s: float) -> Message:
        velocity = self.copter.velocity(now_s)
        return mavlink.MAVLink_vfr_hud_message(
            velocity.ground_m_s,
            velocity.ground_m_s,
            round(self.copter.heading_deg(now_s)) % 360,
            self.throttle_percent if self.copter.flying(now_s) else 0,
            self._above_sea_mm(self.copter.position(now_s)) / 1e3,
            velocity.up_m_s,
        )

    def _position_target(self, now_s: float) -> Message | None:
        target = self.copter.target(now_s)
        if target is None:
            return None
        geo = self.copter.frame.geo(target)
        return made(
            mavlink.MAVLink_position_target_global_int_message,
            time_boot_ms=self._boot_ms(now_s),
            coordinate_frame=self.frame_of_targets,
            type_mask=_ONLY_POSITION,
            lat_int=degrees_e7(geo.latitude_deg),
            lon_int=degrees_e7(geo.longitude_deg),
            alt=self._above_sea_mm(target) / 1e3,
        )

    def _position_target_local(self, now_s: float) -> Message | None:
        target = self.copter.target(now_s)
        return None if target is None else self._local_target(now_s, target)

    def _local_target(self, now_s: float, target: Position | None) -> Message:
        """POSITION_TARGET_LOCAL_NED; without a target, that it follows a velocity, of 0."""
        place = target or HOME
        return made(
            mavlink.MAVLink_position_target_local_ned_message,
            time_boot_ms=self._boot_ms(now_s),
            coordinate_frame=mavlink.MAV_FRAME_LOCAL_NED,
            type_mask=_NO_POSITION if target is None else _ONLY_POSITION,
            x=place.north_m,
            y=place.east_m,
            z=-place.altitude_m,
        )

    def _extended_sys_state(self, now_s: float) -> Message:
        return mavlink.MAVLink_extended_sys_state_message(self.vtol_state, self.copter.landed_state(now_s))

    def _autopilot_version(self, _now_s: float) -> Message:
        return made(
            mavlink.MAVLink_autopilot_version_message,
            capabilities=self.capabilities,
            flight_sw_version=self.copter.settings.version.number,
            uid2=self.copter.settings.serial.to_bytes(_UID2_BYTES, "little"),
            **self._build(),
        )

    def _build(self) -> dict[str, Any]:
        """Further fields of AUTOPILOT_VERSION."""
        return {}

    # --- as messages hold it --------------------------------------------------------------------------------

    def _boot_ms(self, now_s: float) -> int:
        return round(self.copter.uptime_s(now_s) * 1e3) % 2**32

    def _boot_us(self, now_s: float) -> int:
        return round(self.copter.uptime_s(now_s) * 1e6)

    def _above_sea_mm(self, position: Position) -> int:
        return round((self.copter.settings.home_altitude_m + position.altitude_m) * 1e3)

    def _heading_cdeg(self, now_s: float) -> int:
        return round(self.copter.heading_deg(now_s) * 100) % 36_000
