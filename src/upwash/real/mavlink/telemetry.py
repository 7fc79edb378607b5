"""A vehicle's last reports, and the differences between firmwares."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import GeoPosition, Velocity
from upwash.core.vehicle.telemetry import Attitude, FixKind, GpsFix, gps_time
from upwash.eventlog.schema import SEVERITIES, VehicleSaid
from upwash.mavlink.packets import Message
from upwash.mavlink.version import Version
from upwash.real.mavlink.batteries import Batteries
from upwash.real.mavlink.gate import RANGES, Ranges
from upwash.real.mavlink.link import COMPANION
from upwash.support.text import printable

_MOVES_US = 50  # a smaller change of a channel's pulse is noise
_JUST_S = 1.5  # the longest that a report of a new mode takes
_FRESH_S = 2.0  # an older report says nothing of now
_CHANNELS = 18
_UNUSED_US = (0, 0xFFFF)
_DEBUG = len(SEVERITIES) - 1
_UNIT_WITHIN = 0.05  # of a quaternion's length
_GIMBAL_FROM_NORTH = mavlink.GIMBAL_DEVICE_FLAGS_YAW_LOCK | mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME
_GIMBAL_FROM_NOSE = mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME
_ROUND_CDEG = 36_000  # UINT16_MAX stands for an unknown heading
_TEXTS_KEPT = 32
_LATELY_S = 3.0  # older texts are not about what has just happened
_TWO_HEARTBEATS_S = 1.25  # longer than from one to the next
_TOLD_LATE_S = 1.0  # a vehicle may say after the change of its mode why it changed
_CHUNK_BYTES = 50  # of a text; a longer text arrives in several chunks
_MOST_CHUNKS = 20
_DEAD_MAN_ACTS = "upwash: companion silent"  # as dead_man.lua says it
_EKF_DOUBTS = (
    mavlink.EKF_CONST_POS_MODE | 1 << 15
)  # ArduPilot's "GPS glitching", which has no name in the dialect
_NOT_KNOWN_YET = 0, 0  # a latitude and a longitude
_UNKNOWN_U8, _UNKNOWN_U16 = 0xFF, 0xFFFF
_FIXES: dict[int, FixKind] = {
    mavlink.GPS_FIX_TYPE_2D_FIX: "2d",
    mavlink.GPS_FIX_TYPE_3D_FIX: "3d",
    mavlink.GPS_FIX_TYPE_DGPS: "dgps",
    mavlink.GPS_FIX_TYPE_RTK_FLOAT: "rtk-float",
    mavlink.GPS_FIX_TYPE_RTK_FIXED: "rtk-fixed",
}
_IN_THE_AIR = (
    mavlink.MAV_LANDED_STATE_TAKEOFF,
    mavlink.MAV_LANDED_STATE_IN_AIR,
    mavlink.MAV_LANDED_STATE_LANDING,
)


class RemoteControl:
    """Whether the pilot's remote control has just moved, by the channels of RC_CHANNELS."""

    def __init__(self) -> None:
        self._channels_us: tuple[int, ...] = ()  # as they were when one last moved
        self._heard_s = self._moved_s = -math.inf

    def take(self, message: Message, now_s: float) -> None:
        """Take in RC_CHANNELS; a vehicle without a remote control reports no channels."""
        if not message.chancount:
            self._channels_us = ()
            return
        now_us = tuple(getattr(message, f"chan{number}_raw") for number in range(1, _CHANNELS + 1))
        self._heard_s = now_s
        if not self._channels_us:
            self._channels_us = now_us
        elif any(
            abs(after - before) >= _MOVES_US
            for before, after in zip(self._channels_us, now_us, strict=True)
            if before not in _UNUSED_US and after not in _UNUSED_US
        ):
            self._channels_us, self._moved_s = now_us, now_s

    def moved(self, now_s: float) -> bool | None:
        """Whether a stick or switch has just moved; None without a fresh report."""
        if not self._channels_us or now_s - self._heard_s > _FRESH_S:
            return None
        return now_s - self._moved_s <= _JUST_S


@dataclass(slots=True)
class VehicleTelemetry:
    """The vehicle's last reports; None for a value that it has not reported."""

    mode: int | None = None
    mode_s: float = -math.inf  # when the present mode was first reported
    armed: bool = False
    disarms: int = 0  # heartbeats in a row that say so, while it is not confirmed
    disarmed_s: float = -math.inf  # when its motors were last said to stop
    system_status: int = mavlink.MAV_STATE_UNINIT
    status_s: float = -math.inf  # when the present status was first reported
    landed_state: int = mavlink.MAV_LANDED_STATE_UNDEFINED
    airborne_s: float = -math.inf  # when it last reported that it flies
    position: GeoPosition | None = None
    above_sea_m: float | None = None
    velocity: Velocity | None = None  # over the ground
    heading_deg: float | None = None
    attitude: Attitude | None = None
    gimbal: Attitude | None = None
    gps: GpsFix | None = None
    wind: Velocity | None = None
    batteries: Batteries = field(default_factory=Batteries)
    home: GeoPosition | None = None  # its altitude is above the sea
    can_be_armed: bool | None = None
    knows_its_place: bool | None = None  # whether its position estimate is good enough to count as an arrival
    fence_breached: bool = False
    flown_and_intended_mode: tuple[int, int] | None = None  # PX4's: they differ in a fail-safe
    failsafe_over: bool = False  # PX4's: it flies in OFFBOARD again, which was set all the time
    armable_modes: int | None = None  # PX4's, a bit for each navigation state
    failed_checks: dict[int, tuple[int, int]] = field(default_factory=dict)  # PX4's: severity, modes as bits
    failed_checks_before: dict[int, tuple[int, int]] = field(default_factory=dict)  # in the set before that
    remote: RemoteControl = field(default_factory=RemoteControl)
    dead_man: str = ""  # why its dead man may just have chosen the mode
    unix_s: float | None = None
    texts: deque[tuple[float, VehicleSaid]] = field(default_factory=lambda: deque(maxlen=_TEXTS_KEPT))
    texts_heard: int = 0
    answers: dict[int, int] = field(default_factory=dict)  # MAV_RESULT by MAV_CMD
    _dead_man_s: float = -math.inf
    _said_armed_s: float = -math.inf
    _text: int = 0  # the number of the incomplete text, and its parts
    _chunks: list[str] = field(default_factory=list)

    def take(self, message: Message, now_s: float) -> None:
        """Take in the reports of a message."""
        self.batteries.take(message, now_s)
        match message.get_type():
            case "HEARTBEAT":
                self._take_heartbeat(message, now_s)
            case "GLOBAL_POSITION_INT" if (message.lat, message.lon) != _NOT_KNOWN_YET:
                self.position = place_of_e7(message.lat, message.lon, message.relative_alt / 1e3)
                self.above_sea_m = message.alt / 1e3
                self.velocity = Velocity(message.vy / 100, message.vx / 100, -message.vz / 100)
                self.heading_deg = message.hdg / 100 if message.hdg < _ROUND_CDEG else None
            case "ATTITUDE":
                yaw_deg = math.degrees(message.yaw) % 360
                self.attitude = Attitude(math.degrees(message.roll), math.degrees(message.pitch), yaw_deg)
            case "GIMBAL_DEVICE_ATTITUDE_STATUS":
                self.gimbal = _gimbal(message, self.attitude)
            case "GPS_RAW_INT":
                self.gps = _gps_fix(message)
            case "HOME_POSITION" if (message.latitude, message.longitude) != _NOT_KNOWN_YET:
                self.home = place_of_e7(message.latitude, message.longitude, message.altitude / 1e3)
            case "EXTENDED_SYS_STATE":
                self.landed_state = message.landed_state
                if self.in_the_air:
                    self.airborne_s = now_s
            case "STATUSTEXT" if text := self._whole_text(message):
                self.hear_text(
                    VehicleSaid(severity=min(message.severity, _DEBUG), text=printable(text)), now_s
                )
            case "COMMAND_ACK" if message.target_component in (0, COMPANION):
                self.answers[message.command] = message.result
            case _:
                self._take_health(message, now_s)

    def _take_heartbeat(self, message: Message, now_s: float) -> None:
        """Take in a heartbeat; of an armed vehicle, "disarmed" counts only once it is confirmed."""
        armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        if self.armed and not armed and not self._confirms_disarming(now_s):
            self.disarmed_s = self.disarmed_s if self.disarms else now_s
            self.disarms += 1
            return
        self.disarms = 0
        self._said_armed_s = now_s if armed else self._said_armed_s
        self.change_mode(message.custom_mode, now_s)
        self.armed = armed
        if message.system_status != self.system_status:
            self.system_status, self.status_s = message.system_status, now_s
        if now_s - self._dead_man_s > _LATELY_S:
            self.dead_man = ""

    def _confirms_disarming(self, now_s: float) -> bool:
        """Whether a further "disarmed" is the vehicle's own.

        The first one may be a bridge's old one. While the vehicle flies, another vehicle with its ids may say it
        twice between two of its own heartbeats.
        """
        heard_s = min(self._said_armed_s, self.airborne_s)
        return self.disarms > 0 and now_s - heard_s >= _TWO_HEARTBEATS_S

    def change_mode(self, mode: int, now_s: float) -> None:
        """Take in the reported mode."""
        if mode != self.mode:
            self.mode, self.mode_s = mode, now_s

    def _take_health(self, message: Message, now_s: float) -> None:
        match message.get_type():
            case "SYS_STATUS":
                if message.onboard_control_sensors_present & mavlink.MAV_SYS_STATUS_PREARM_CHECK:
                    health = message.onboard_control_sensors_health
                    self.can_be_armed = bool(health & mavlink.MAV_SYS_STATUS_PREARM_CHECK)
            case "EKF_STATUS_REPORT":
                flags = message.flags
                self.knows_its_place = bool(flags & mavlink.EKF_POS_HORIZ_ABS) and not flags & _EKF_DOUBTS
            case "RC_CHANNELS":
                self.remote.take(message, now_s)
            case "FENCE_STATUS":
                self.fence_breached = bool(message.breach_status)
            case "SYSTEM_TIME":
                self.unix_s = gps_time(message.time_unix_usec / 1e6)
            case "WIND":  # from where it blows, in degrees
                towards = math.radians(message.direction + 180)
                self.wind = Velocity(message.speed * math.sin(towards), message.speed * math.cos(towards))
            case "WIND_COV":
                self.wind = Velocity(message.wind_y, message.wind_x)

    def hear_text(self, text: VehicleSaid, now_s: float) -> None:
        """Take in a text of the vehicle."""
        self.texts.append((now_s, text))
        self.texts_heard += 1
        if text.text.startswith(_DEAD_MAN_ACTS):
            self.suspect_dead_man("its dead man, which did not hear this program", now_s)

    def suspect_dead_man(self, why: str, now_s: float) -> None:
        """Note that the dead man's switch may have acted, and may explain a change of mode in the next seconds."""
        self.dead_man, self._dead_man_s = why, now_s

    def said_since(self, since_s: float) -> str:
        """The texts since `since_s` with their severities, the most severe first, as one line; "" without any."""
        texts = sorted(
            (text for said_s, text in self.texts if said_s >= since_s), key=lambda text: text.severity
        )
        return "; ".join(dict.fromkeys(f"{text.text} ({SEVERITIES[text.severity]})" for text in texts))

    def warned_of_mode(self, *, before_s: float = _LATELY_S) -> list[str]:
        """The warnings, and worse, around the change to the present mode, the nearest first."""
        after_s = sorted(
            ((said_s - self.mode_s, text) for said_s, text in self.texts), key=lambda said: abs(said[0])
        )
        return [
            text.text
            for late_s, text in after_s
            if text.severity <= mavlink.MAV_SEVERITY_WARNING and -before_s <= late_s <= _TOLD_LATE_S
        ]

    def said_lately(self, now_s: float) -> str:
        """The texts of the last three seconds."""
        return self.said_since(now_s - _LATELY_S)

    @property
    def speed_m_s(self) -> float:
        """The speed in metres per second; infinite while not reported."""
        return self.velocity.speed_m_s if self.velocity else math.inf

    @property
    def home_above_sea_m(self) -> float:
        """The altitude of home above the sea (m), from the two reported altitudes; 0 while unknown."""
        if self.position is None or self.above_sea_m is None:
            return 0.0
        return self.above_sea_m - self.position.altitude_m

    @property
    def on_ground(self) -> bool:
        """Whether the reported landed state is on the ground."""
        return bool(self.landed_state == mavlink.MAV_LANDED_STATE_ON_GROUND)

    @property
    def stands(self) -> bool | None:
        """Whether the reported landed state is on the ground; None while unknown."""
        return None if self.landed_state == mavlink.MAV_LANDED_STATE_UNDEFINED else self.on_ground

    @property
    def in_the_air(self) -> bool:
        """Whether the reported landed state is off the ground."""
        return self.landed_state in _IN_THE_AIR

    def _whole_text(self, message: Message) -> str:
        """The text of a message; "" while parts of it are missing."""
        if not message.id:
            return str(message.text)
        if message.chunk_seq == 0 or message.id != self._text:
            self._chunks.clear()  # one text at a time: an interrupted text stays incomplete
        self._text = message.id
        self._chunks.append(message.text)
        if len(message.text) == _CHUNK_BYTES and len(self._chunks) < _MOST_CHUNKS:
            return ""
        text = "".join(self._chunks)
        self._chunks.clear()
        return text


def place_of_e7(latitude_e7: int, longitude_e7: int, altitude_m: float = 0.0) -> GeoPosition:
    """The place from MAVLink's degrees, which are whole numbers of 1e-7 degrees."""
    return GeoPosition(latitude_e7 / 1e7, longitude_e7 / 1e7, altitude_m)


def _gimbal(message: Message, vehicle: Attitude | None) -> Attitude | None:
    """The gimbal's attitude over the ground; None if its numbers are no rotation, or the heading is unknown."""
    w, x, y, z = message.q
    length = math.hypot(w, x, y, z)
    if not abs(length - 1) < _UNIT_WITHIN:
        return None
    w, x, y, z = w / length, x / length, y / length, z / length
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x))))
    yaw_deg = math.degrees(math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))
    if not message.flags & _GIMBAL_FROM_NORTH or message.flags & _GIMBAL_FROM_NOSE:
        if vehicle is None:
            return None
        yaw_deg += vehicle.yaw_deg
    return Attitude(math.degrees(roll), math.degrees(pitch), yaw_deg % 360)


def _gps_fix(message: Message) -> GpsFix:
    satellites, eph = message.satellites_visible, message.eph
    return GpsFix(
        _FIXES.get(message.fix_type, "none" if message.fix_type < mavlink.GPS_FIX_TYPE_2D_FIX else "3d"),
        satellites=None if satellites == _UNKNOWN_U8 else satellites,
        hdop=None if eph == _UNKNOWN_U16 else eph / 100,
        error_m=message.h_acc / 1e3 if message.h_acc else None,
    )


def _nothing_more(_telemetry: VehicleTelemetry, _message: Message, _now_s: float) -> None:
    """Take in nothing, for a firmware without reports of its own."""


STREAMS_HZ: Mapping[int, float] = {
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 10.0,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 4.0,
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT: 5.0,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: 4.0,
    mavlink.MAVLINK_MSG_ID_RC_CHANNELS: 5.0,  # tells a pilot's change of the mode
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 1.0,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: 1.0,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: 1.0,  # of all batteries, an ArduPilot's in turn
}
"""The reports that the driver needs of each firmware, by message."""


@dataclass(frozen=True, slots=True)
class FirmwareProfile:
    """The properties of one kind of autopilot.

    `mode_name` names a custom mode; the program steers in `own_mode`. `failsafe` returns why a fail-safe may have
    chosen the mode of that name, or "". `streams_hz` has the rates of the reports that the driver needs, by message;
    the vehicle sends those in `sent_at_times` only on occasion, some also at the rate of `sent_anyway_hz` unless the
    requested rate is lower. All versions have the parameter `always_has`. `oldest` is the oldest version that can be
    flown: older versions lack what upwash `needs`. `take` takes in reports that only this firmware sends.
    """

    name: str
    autopilot: int  # MAV_AUTOPILOT
    own_mode: str
    mode_name: Callable[[int], str]
    failsafe: Callable[[VehicleTelemetry, str], str]
    streams_hz: Mapping[int, float]
    always_has: str
    oldest: Version
    needs: str
    ranges: Ranges = field(default_factory=lambda: RANGES)
    keeps_targets: bool = False  # in `own_mode` it reports the last target that it was sent to
    sent_at_times: frozenset[int] = frozenset()
    sent_anyway_hz: Mapping[int, float] = field(default_factory=dict)
    take: Callable[[VehicleTelemetry, Message, float], None] = _nothing_more
    sends_parameters_as_bytes: bool = False  # an integer's bytes lie in the float that carries a parameter
