"""What a vehicle last reported, whatever firmware it runs."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import GeoPosition, Velocity
from upwash.core.vehicle.telemetry import Attitude, FixKind, GpsFix
from upwash.eventlog.schema import SEVERITIES
from upwash.ports import VehicleText
from upwash.real.mavlink.hearing import Message
from upwash.real.mavlink.link import COMPANION
from upwash.real.mavlink.remote import RemoteControl
from upwash.support.text import printable

_DEBUG = len(SEVERITIES) - 1
_ROUND_CDEG = 36_000  # UINT16_MAX stands for a heading that is not known
_TEXTS_KEPT = 32
_LATELY_S = 3.0  # what was said longer ago is not about what has just happened
_CHUNK_BYTES = 50  # of a text; a longer one comes in several
_MOST_CHUNKS = 20
_DEAD_MAN_ACTS = "upwash: companion silent"  # as dead_man.lua says it
_EKF_GPS_GLITCHING = 1 << 15  # ArduPilot's; the dialect has no name for it
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


@dataclass(slots=True)
class Telemetry:
    """What the vehicle last reported; None stands for what it has not said."""

    mode: int | None = None
    armed: bool = False
    disarmed_s: float = -math.inf  # when its motors were last seen to stop
    system_status: int = mavlink.MAV_STATE_UNINIT
    landed_state: int = mavlink.MAV_LANDED_STATE_UNDEFINED
    airborne_s: float = -math.inf  # when it last said that it flies
    position: GeoPosition | None = None
    above_sea_m: float | None = None
    velocity: Velocity | None = None  # over the ground
    heading_deg: float | None = None
    attitude: Attitude | None = None
    gps: GpsFix | None = None
    wind: Velocity | None = None
    battery_percent: float | None = None
    home: GeoPosition | None = None  # its altitude is above the sea
    can_be_armed: bool | None = None
    knows_its_place: bool | None = None  # whether its position estimate is good enough to count as an arrival
    fence_breached: bool = False
    flown_and_intended_mode: tuple[int, int] | None = None  # PX4's: they differ in a fail-safe
    armable_modes: int | None = None  # PX4's, a bit for each navigation state
    failed_checks: dict[int, tuple[int, int]] = field(
        default_factory=dict
    )  # PX4's: severity, and modes as bits
    failed_checks_before: dict[int, tuple[int, int]] = field(default_factory=dict)  # in the set before that
    remote: RemoteControl = field(default_factory=RemoteControl)
    dead_man: str = ""  # why its dead man may just have chosen the mode
    unix_s: float | None = None
    texts: deque[tuple[float, VehicleText]] = field(default_factory=lambda: deque(maxlen=_TEXTS_KEPT))
    texts_heard: int = 0
    answers: dict[int, int] = field(default_factory=dict)  # MAV_RESULT by MAV_CMD
    _dead_man_s: float = -math.inf
    _text: int = 0  # the number of the text that is not complete, and its parts
    _chunks: list[str] = field(default_factory=list)

    def take(self, message: Message, now_s: float) -> None:
        """Remembers what the message reports."""
        match message.get_type():
            case "HEARTBEAT":
                self.mode = message.custom_mode
                was_armed, self.armed = (
                    self.armed,
                    bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED),
                )
                if was_armed and not self.armed:
                    self.disarmed_s = now_s
                self.system_status = message.system_status
                if now_s - self._dead_man_s > _LATELY_S:
                    self.dead_man = ""
            case "GLOBAL_POSITION_INT" if (message.lat, message.lon) != _NOT_KNOWN_YET:
                self.position = GeoPosition(message.lat / 1e7, message.lon / 1e7, message.relative_alt / 1e3)
                self.above_sea_m = message.alt / 1e3
                self.velocity = Velocity(message.vy / 100, message.vx / 100, -message.vz / 100)
                self.heading_deg = message.hdg / 100 if message.hdg < _ROUND_CDEG else None
            case "ATTITUDE":
                yaw_deg = math.degrees(message.yaw) % 360
                self.attitude = Attitude(math.degrees(message.roll), math.degrees(message.pitch), yaw_deg)
            case "GPS_RAW_INT":
                self.gps = _fix(message)
            case "HOME_POSITION" if (message.latitude, message.longitude) != _NOT_KNOWN_YET:
                place = message.latitude / 1e7, message.longitude / 1e7
                self.home = GeoPosition(*place, message.altitude / 1e3)
            case "EXTENDED_SYS_STATE":
                self.landed_state = message.landed_state
                if self.in_the_air:
                    self.airborne_s = now_s
            case _:
                self._take_health(message, now_s)
                self._take_words(message, now_s)

    def _take_health(self, message: Message, now_s: float) -> None:
        match message.get_type():
            case "SYS_STATUS":
                self._take_battery(message.battery_remaining)
                if message.onboard_control_sensors_present & mavlink.MAV_SYS_STATUS_PREARM_CHECK:
                    health = message.onboard_control_sensors_health
                    self.can_be_armed = bool(health & mavlink.MAV_SYS_STATUS_PREARM_CHECK)
            case "BATTERY_STATUS" if message.id == 0:
                self._take_battery(message.battery_remaining)
            case "EKF_STATUS_REPORT":
                doubts = mavlink.EKF_CONST_POS_MODE | _EKF_GPS_GLITCHING
                self.knows_its_place = _trusts(message.flags, mavlink.EKF_POS_HORIZ_ABS, doubts)
            case "ESTIMATOR_STATUS":
                doubts = mavlink.ESTIMATOR_CONST_POS_MODE | mavlink.ESTIMATOR_GPS_GLITCH
                self.knows_its_place = _trusts(message.flags, mavlink.ESTIMATOR_POS_HORIZ_ABS, doubts)
            case "RC_CHANNELS":
                self.remote.take(message, now_s)
            case "FENCE_STATUS":
                self.fence_breached = bool(message.breach_status)
            case "SYSTEM_TIME":
                self.unix_s = message.time_unix_usec / 1e6 or None  # 0: not known
            case "WIND":  # from where it blows, in degrees
                towards = math.radians(message.direction + 180)
                self.wind = Velocity(message.speed * math.sin(towards), message.speed * math.cos(towards))
            case "WIND_COV":
                self.wind = Velocity(message.wind_y, message.wind_x)

    def _take_words(self, message: Message, now_s: float) -> None:
        match message.get_type():
            case "STATUSTEXT" if text := self._whole_text(message):
                self.hear_text(VehicleText(min(message.severity, _DEBUG), printable(text)), now_s)
            case "COMMAND_ACK" if message.target_component in (0, COMPANION):
                self.answers[message.command] = message.result

    def hear_text(self, text: VehicleText, now_s: float) -> None:
        """Remembers what it said."""
        self.texts.append((now_s, text))
        self.texts_heard += 1
        if text.text.startswith(_DEAD_MAN_ACTS):
            self.suspect_dead_man("its dead man, which did not hear this program", now_s)

    def suspect_dead_man(self, why: str, now_s: float) -> None:
        """The vehicle's dead man may have acted; a change of mode in the next seconds may be its."""
        self.dead_man, self._dead_man_s = why, now_s

    def said_since(self, since_s: float) -> str:
        """What it said from then on, the most severe first, each with its severity; empty where it said nothing."""
        texts = sorted(
            (text for said_s, text in self.texts if said_s >= since_s), key=lambda text: text.severity
        )
        return "; ".join(dict.fromkeys(f"{each.text} ({SEVERITIES[each.severity]})" for each in texts))

    def said_lately(self, now_s: float) -> str:
        """What it said in the last three seconds."""
        return self.said_since(now_s - _LATELY_S)

    @property
    def speed_m_s(self) -> float:
        """How fast it moves; infinite while it does not say."""
        return self.velocity.speed_m_s if self.velocity else math.inf

    @property
    def ground_speed_m_s(self) -> float:
        """How fast it moves over the ground; 0 while it does not say."""
        return self.velocity.ground_m_s if self.velocity else 0.0

    @property
    def home_above_sea_m(self) -> float:
        """By its two altitudes; 0 while it does not know its place."""
        if self.position is None or self.above_sea_m is None:
            return 0.0
        return self.above_sea_m - self.position.altitude_m

    @property
    def on_ground(self) -> bool:
        """Whether it says that it stands on the ground."""
        return bool(self.landed_state == mavlink.MAV_LANDED_STATE_ON_GROUND)

    @property
    def stands(self) -> bool | None:
        """Whether it says that it stands on the ground; None where it does not say."""
        return None if self.landed_state == mavlink.MAV_LANDED_STATE_UNDEFINED else self.on_ground

    @property
    def in_the_air(self) -> bool:
        """Whether it says that it has left the ground."""
        return self.landed_state in _IN_THE_AIR

    def _take_battery(self, percent: int) -> None:
        self.battery_percent = float(percent) if percent >= 0 else None  # -1: not known

    def _whole_text(self, message: Message) -> str:
        """The text, empty while parts of it are missing."""
        if not getattr(message, "id", 0):
            return str(message.text)
        if message.chunk_seq == 0 or message.id != self._text:
            self._chunks.clear()  # one text at a time: what was not completed never will be
        self._text = message.id
        self._chunks.append(message.text)
        is_whole = len(message.text) < _CHUNK_BYTES or len(self._chunks) == _MOST_CHUNKS
        if not is_whole:
            return ""
        text = "".join(self._chunks)
        self._chunks.clear()
        return text


def _fix(message: Message) -> GpsFix:
    satellites, eph = message.satellites_visible, message.eph
    return GpsFix(
        _FIXES.get(message.fix_type, "none" if message.fix_type < mavlink.GPS_FIX_TYPE_2D_FIX else "3d"),
        satellites=None if satellites == _UNKNOWN_U8 else satellites,
        hdop=None if eph == _UNKNOWN_U16 else eph / 100,
    )


def _trusts(flags: int, absolute: int, doubts: int) -> bool:
    return bool(flags & absolute) and not flags & doubts
