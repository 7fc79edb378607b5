"""Messages that every stand-in makes alike, from what it does at the time."""

from __future__ import annotations

import math
from typing import Protocol

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import GeoPosition, LocalFrame, Position, Velocity
from upwash.vehicle.body.firmware import Message

_ONLY_POSITION, _NO_POSITION = 0b110111111000, 0b110000000111
_UNKNOWN_MV = 0xFFFF
_AT_HOME = Position(0.0, 0.0)


class Site(Protocol):
    """Where a stand-in was switched on."""

    @property
    def home(self) -> GeoPosition:
        """On the Earth."""

    @property
    def home_altitude_m(self) -> float:
        """Above the sea."""


class Reporting(Protocol):
    """What a stand-in knows of itself."""

    @property
    def settings(self) -> Site:
        """Where it was switched on."""

    @property
    def frame(self) -> LocalFrame:
        """The plane around its home."""

    def uptime_s(self, now_s: float) -> float:
        """How long it has been switched on."""

    def position(self, now_s: float) -> Position:
        """Where it is, relative to its home."""

    def velocity(self, now_s: float) -> Velocity:
        """How it moves."""

    def heading_deg(self, now_s: float) -> float:
        """Where its nose points, clockwise from north."""

    def battery_v(self, now_s: float) -> float:
        """Its battery's voltage."""

    def battery_percent(self, now_s: float) -> float:
        """How full its battery is."""


def boot_ms(copter: Reporting, now_s: float) -> int:
    """How long it has been switched on, as messages hold it."""
    return round(copter.uptime_s(now_s) * 1e3) % 2**32


def degrees_e7(degrees: float) -> int:
    """Degrees as messages hold them."""
    return round(degrees * 1e7)


def above_sea_mm(copter: Reporting, position: Position) -> int:
    """The altitude of a position that is relative to its home."""
    return round((copter.settings.home_altitude_m + position.altitude_m) * 1e3)


def heading_cdeg(copter: Reporting, now_s: float) -> int:
    """Where its nose points, in hundredths of a degree."""
    return round(copter.heading_deg(now_s) * 100) % 36_000


def sys_status(copter: Reporting, now_s: float, *, sensors: tuple[int, int, int], current: int) -> Message:
    """SYS_STATUS: the sensors that are present, enabled and healthy, and its battery."""
    present, enabled, health = sensors
    return mavlink.MAVLink_sys_status_message(
        onboard_control_sensors_present=present,
        onboard_control_sensors_enabled=enabled,
        onboard_control_sensors_health=health,
        load=100,
        voltage_battery=round(copter.battery_v(now_s) * 1e3),
        current_battery=current,
        battery_remaining=math.floor(copter.battery_percent(now_s)),
        drop_rate_comm=0,
        errors_comm=0,
        errors_count1=0,
        errors_count2=0,
        errors_count3=0,
        errors_count4=0,
    )


def battery_status(
    copter: Reporting, now_s: float, *, current: int, consumed: int, charge_state: int = 0
) -> Message:
    """BATTERY_STATUS: how full the battery is, and its voltage as that of one cell."""
    return mavlink.MAVLink_battery_status_message(
        id=0,
        battery_function=mavlink.MAV_BATTERY_FUNCTION_ALL,
        type=mavlink.MAV_BATTERY_TYPE_LIPO,
        temperature=0x7FFF,
        voltages=[round(copter.battery_v(now_s) * 1e3), *[_UNKNOWN_MV] * 9],
        current_battery=current,
        current_consumed=consumed,
        energy_consumed=-1,
        battery_remaining=math.floor(copter.battery_percent(now_s)),
        charge_state=charge_state,
    )


def attitude(copter: Reporting, now_s: float) -> Message:
    """ATTITUDE: always level, nose ahead."""
    yaw = math.remainder(math.radians(copter.heading_deg(now_s)), math.tau)
    return mavlink.MAVLink_attitude_message(boot_ms(copter, now_s), 0.0, 0.0, yaw, 0.0, 0.0, 0.0)


def local_position(copter: Reporting, now_s: float) -> Message:
    """LOCAL_POSITION_NED: metres from home."""
    position, velocity = copter.position(now_s), copter.velocity(now_s)
    return mavlink.MAVLink_local_position_ned_message(
        boot_ms(copter, now_s),
        position.north_m,
        position.east_m,
        -position.altitude_m,
        velocity.north_m_s,
        velocity.east_m_s,
        -velocity.up_m_s,
    )


def global_position(copter: Reporting, now_s: float, *, above_home_mm: int, known: bool = True) -> Message:
    """GLOBAL_POSITION_INT: where it is and how it moves; latitude and longitude are 0 until that is known."""
    position, velocity = copter.position(now_s), copter.velocity(now_s)
    geo = copter.frame.geo(position)
    return mavlink.MAVLink_global_position_int_message(
        time_boot_ms=boot_ms(copter, now_s),
        lat=degrees_e7(geo.latitude_deg) if known else 0,
        lon=degrees_e7(geo.longitude_deg) if known else 0,
        alt=above_sea_mm(copter, position),
        relative_alt=above_home_mm,
        vx=round(velocity.north_m_s * 100),
        vy=round(velocity.east_m_s * 100),
        vz=round(-velocity.up_m_s * 100),
        hdg=heading_cdeg(copter, now_s),
    )


def vfr_hud(copter: Reporting, now_s: float, *, throttle: int) -> Message:
    """VFR_HUD: speeds, heading and height, as a pilot reads them."""
    velocity = copter.velocity(now_s)
    ground_m_s = math.hypot(velocity.east_m_s, velocity.north_m_s)
    return mavlink.MAVLink_vfr_hud_message(
        ground_m_s,
        ground_m_s,
        round(copter.heading_deg(now_s)) % 360,
        throttle,
        above_sea_mm(copter, copter.position(now_s)) / 1e3,
        velocity.up_m_s,
    )


def position_target_global(copter: Reporting, now_s: float, target: Position, *, frame: int) -> Message:
    """POSITION_TARGET_GLOBAL_INT: the target in force."""
    geo = copter.frame.geo(target)
    return mavlink.MAVLink_position_target_global_int_message(
        boot_ms(copter, now_s),
        frame,
        _ONLY_POSITION,
        degrees_e7(geo.latitude_deg),
        degrees_e7(geo.longitude_deg),
        above_sea_mm(copter, target) / 1e3,
        *[0.0] * 8,
    )


def position_target_local(copter: Reporting, now_s: float, target: Position | None) -> Message:
    """POSITION_TARGET_LOCAL_NED: the same in metres; without a target, that it follows a velocity, of 0."""
    place = target or _AT_HOME
    return mavlink.MAVLink_position_target_local_ned_message(
        boot_ms(copter, now_s),
        mavlink.MAV_FRAME_LOCAL_NED,
        _NO_POSITION if target is None else _ONLY_POSITION,
        place.north_m,
        place.east_m,
        -place.altitude_m,
        *[0.0] * 8,
    )


def gps_global_origin(copter: Reporting) -> Message:
    """GPS_GLOBAL_ORIGIN: what local positions count from."""
    home = copter.settings.home
    return mavlink.MAVLink_gps_global_origin_message(
        degrees_e7(home.latitude_deg), degrees_e7(home.longitude_deg), above_sea_mm(copter, _AT_HOME)
    )


def home_position(
    copter: Reporting, *, altitude_mm: int, place: Position = _AT_HOME, time_us: int = 0
) -> Message:
    """HOME_POSITION: where it returns to."""
    geo = copter.frame.geo(place)
    return mavlink.MAVLink_home_position_message(
        latitude=degrees_e7(geo.latitude_deg),
        longitude=degrees_e7(geo.longitude_deg),
        altitude=altitude_mm,
        x=0,
        y=0,
        z=0,
        q=[1, 0, 0, 0],
        approach_x=0,
        approach_y=0,
        approach_z=0,
        time_usec=time_us,
    )


def autopilot_version(
    *, capabilities: int, version: int, middleware_version: int, board_version: int
) -> Message:
    """AUTOPILOT_VERSION: what a client may expect."""
    return mavlink.MAVLink_autopilot_version_message(
        capabilities=capabilities,
        flight_sw_version=version,
        middleware_sw_version=middleware_version,
        os_sw_version=0,
        board_version=board_version,
        flight_custom_version=[0] * 8,
        middleware_custom_version=[0] * 8,
        os_custom_version=[0] * 8,
        vendor_id=0,
        product_id=0,
        uid=1,
    )
