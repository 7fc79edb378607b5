"""PX4's events and flight modes, and messages that pymavlink's dialect `ardupilotmega` lacks.

The messages' fields and numbers are those of MAVLink's public definitions (common.xml and development.xml), the
events' those of PX4 1.16's public event metadata, the modes' numbers PX4's custom modes. Both the driver and the
stand-in read and write with these.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from types import MappingProxyType
from typing import Any, ClassVar

from pymavlink.dialects.v20 import ardupilotmega as mavlink

EVENT = 410
REQUEST_EVENT = 412
RESPONSE_EVENT_ERROR = 413
AVAILABLE_MODES = 435
CURRENT_MODE = 436
RUN_PREARM_CHECKS = 401  # a command
CUSTOM_MODE_FLAG = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED

_EVENT_ARGUMENTS_BYTES = 40
_HEADER_BYTES, _CHECKSUM_BYTES, _SIGNATURE_BYTES = 10, 2, 13
_SIGNED = 0x01


class Mode(IntEnum):
    """PX4's flight modes, by `custom_mode` of HEARTBEAT: main mode << 16 | sub-mode << 24."""

    MANUAL = 1 << 16
    ALTCTL = 2 << 16
    POSCTL = 3 << 16
    TAKEOFF = 4 << 16 | 2 << 24
    LOITER = 4 << 16 | 3 << 24
    MISSION = 4 << 16 | 4 << 24
    RTL = 4 << 16 | 5 << 24
    LAND = 4 << 16 | 6 << 24
    ACRO = 5 << 16
    OFFBOARD = 6 << 16
    STABILIZED = 7 << 16

    @property
    def main(self) -> int:
        """Parameter 2 of MAV_CMD_DO_SET_MODE."""
        return self.value >> 16 & 0xFF

    @property
    def sub(self) -> int:
        """Parameter 3 of MAV_CMD_DO_SET_MODE."""
        return self.value >> 24


class _Message(mavlink.MAVLink_message):  # type: ignore[misc]  # pymavlink is not typed
    """A message of MAVLink 2. Its fields, in the order of sending, are its keyword arguments."""

    id: ClassVar[int]
    msgname: ClassVar[str]
    fieldnames: ClassVar[tuple[str, ...]]
    unpacker: ClassVar[struct.Struct]
    crc_extra: ClassVar[int]

    def __init__(self, **fields: Any) -> None:
        super().__init__(self.id, self.msgname)
        self._fieldnames = list(self.fieldnames)
        for name in self.fieldnames:
            setattr(self, name, fields[name])

    def pack(self, mav: Any, force_mavlink1: bool = False) -> Any:
        """Its bytes, by the codec's system and sequence number."""
        values = (getattr(self, name) for name in self.fieldnames)
        return self._pack(mav, self.crc_extra, self.unpacker.pack(*values), force_mavlink1=force_mavlink1)


class EventMessage(_Message):
    """EVENT: an event of PX4; `EVENTS` has the meaning of its `arguments`."""

    id, msgname, crc_extra = EVENT, "EVENT", 160
    fieldnames = (
        "id_of_event",
        "event_time_boot_ms",
        "sequence",
        "destination_component",
        "destination_system",
        "log_levels",
        "arguments",
    )
    unpacker = struct.Struct(f"<IIHBBB{_EVENT_ARGUMENTS_BYTES}s")

    @property
    def severity(self) -> int:
        """MAV_SEVERITY for people outside; 8 for events that are for programs only."""
        return int(self.log_levels) & 0x0F


class RequestEventMessage(_Message):
    """REQUEST_EVENT: says that events were missed."""

    id, msgname, crc_extra = REQUEST_EVENT, "REQUEST_EVENT", 33
    fieldnames = "first_sequence", "last_sequence", "target_system", "target_component"
    unpacker = struct.Struct("<HHBB")


class ResponseEventErrorMessage(_Message):
    """RESPONSE_EVENT_ERROR: the missed event is gone for good."""

    id, msgname, crc_extra = RESPONSE_EVENT_ERROR, "RESPONSE_EVENT_ERROR", 77
    fieldnames = "sequence", "sequence_oldest_available", "target_system", "target_component", "reason"
    unpacker = struct.Struct("<HHBBB")


class AvailableModesMessage(_Message):
    """AVAILABLE_MODES: one of the modes that there are."""

    id, msgname, crc_extra = AVAILABLE_MODES, "AVAILABLE_MODES", 134
    fieldnames = "custom_mode", "properties", "number_modes", "mode_index", "standard_mode", "mode_name"
    unpacker = struct.Struct("<IIBBB35s")


class CurrentModeMessage(_Message):
    """CURRENT_MODE: the mode in force and the commanded mode; they differ in a fail-safe."""

    id, msgname, crc_extra = CURRENT_MODE, "CURRENT_MODE", 193
    fieldnames = "custom_mode", "intended_custom_mode", "standard_mode"
    unpacker = struct.Struct("<IIB")


_KINDS: Mapping[int, type[_Message]] = {
    kind.id: kind
    for kind in (
        EventMessage,
        RequestEventMessage,
        ResponseEventErrorMessage,
        AvailableModesMessage,
        CurrentModeMessage,
    )
}


def understood(message: Any) -> Any:
    """One of the messages here for a `MAVLink_unknown` that is one; else the same message.

    pymavlink cannot check what it does not know: an unknown message whose checksum is wrong stays unknown.
    """
    if not isinstance(message, mavlink.MAVLink_unknown):
        return message
    data = bytes(message.data)
    if len(data) < _HEADER_BYTES + _CHECKSUM_BYTES or data[0] != mavlink.PROTOCOL_MARKER_V2:
        return message
    kind = _KINDS.get(int.from_bytes(data[7:_HEADER_BYTES], "little"))
    if kind is None:
        return message
    end = len(data) - _CHECKSUM_BYTES - (_SIGNATURE_BYTES if data[2] & _SIGNED else 0)
    checksum = mavlink.x25crc(data[1:end] + bytes((kind.crc_extra,))).crc
    if end < _HEADER_BYTES or data[end : end + _CHECKSUM_BYTES] != struct.pack("<H", checksum):
        return message
    payload = data[_HEADER_BYTES:end][: kind.unpacker.size].ljust(kind.unpacker.size, b"\0")
    read = kind(**dict(zip(kind.fieldnames, kind.unpacker.unpack(payload), strict=True)))
    read._header = mavlink.MAVLink_header(
        kind.id,
        data[2],
        data[3],
        mlen=end - _HEADER_BYTES,
        seq=data[4],
        srcSystem=data[5],
        srcComponent=data[6],
    )
    read._msgbuf = bytearray(data)
    return read


# --- events -------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class EventKind:
    """An event: PX4's name for it, what its arguments are (as `struct` writes it), and what it means.

    `log_levels` are its severities, inside << 4 | outside; `text` holds places for the arguments by number.
    """

    name: str
    log_levels: int
    text: str
    arguments: str = ""

    def packed(self, *arguments: float) -> bytes:
        """The arguments as bytes of an EVENT."""
        return struct.pack(f"<{self.arguments}", *arguments).ljust(_EVENT_ARGUMENTS_BYTES, b"\0")

    def unpacked(self, arguments: bytes) -> tuple[Any, ...]:
        """The arguments from the bytes of an EVENT."""
        return struct.unpack_from(f"<{self.arguments}", arguments)


_CHECK = "IB"  # the modes that it concerns, and the health component

EVENTS: Mapping[int, EventKind] = MappingProxyType(
    {
        16856624: EventKind("check_modes_home_position", 0x66, "home position not set", _CHECK),
        16910493: EventKind(
            "commander_arm_denied_resolve_failures", 0x62, "arming denied: resolve failures first"
        ),
        16962474: EventKind("rtl_land_at_destination", 0x66, "return: landing at the destination"),
        17154777: EventKind("check_modes_mission", 0x66, "no valid mission available", _CHECK),
        17231145: EventKind("check_modes_manual_control", 0x44, "no manual control input", _CHECK),
        17738815: EventKind("failsafe_rc_override", 0x66, "the pilot took over from the fail-safe"),
        18523838: EventKind("commander_rc_override", 0x66, "the pilot took over using sticks"),
        18691879: EventKind("commander_health_summary", 0x88, "", "BIII"),
        19404811: EventKind("check_battery_critical", 0x22, "critical battery", _CHECK),
        19865031: EventKind("check_modes_offboard_signal", 0x33, "no offboard signal", _CHECK),
        20842799: EventKind("check_gf_violation_max_hor_dist", 0x33, "geofence: too far from home", _CHECK),
        16920235: EventKind("check_gf_violation_custom_gf", 0x33, "geofence: outside or about to be", _CHECK),
        21054825: EventKind("commander_takeoff_detected", 0x66, "take-off detected"),
        21279712: EventKind(
            "commander_failsafe_enter_generic_hold", 0x42, "fail-safe: switching to {1} in {2} seconds", "IBH"
        ),
        21826980: EventKind("check_battery_low", 0x44, "low battery", _CHECK),
        22161044: EventKind("vrtl_return_at", 0x66, "return at {0} m, {1} m above the destination", "ii"),
        22400324: EventKind("commander_rc_lost", 0x66, "manual control lost"),
        23579003: EventKind("check_rc_dl_no_dllink", 0x66, "no connection to the ground station", _CHECK),
        26266355: EventKind("commander_armed_by", 0x66, "armed by {0}", "B"),
        26528394: EventKind("commander_failsafe_enter", 0x42, "{2}: switching to {1}", "IBB"),
        26622124: EventKind("commander_landing_detected", 0x66, "landing detected"),
        26788467: EventKind("check_modes_global_pos", 0x33, "no valid global position estimate", _CHECK),
        27494155: EventKind("commander_onboard_ctrl_regained", 0x66, "companion computer regained"),
        27571288: EventKind("commander_gcs_lost", 0x64, "connection to the ground station lost"),
        27825120: EventKind("commander_arming_check_summary", 0x88, "", "BIIII"),
        27900317: EventKind("commander_mission_comp_lost", 0x22, "connection to the companion computer lost"),
        28121863: EventKind("check_battery_emergency", 0x22, "emergency battery level", _CHECK),
        28993875: EventKind("commander_failsafe_enter_low_bat", 0x64, "low battery level, return advised"),
        29146769: EventKind("check_estimator_gps_fix_too_low", 0x44, "GPS fix too low", _CHECK),
        29547634: EventKind(
            "commander_failsafe_enter_autopilot_disengaged",
            0x42,
            "fail-safe: autopilot disengaged, switching to {1}",
            "IB",
        ),
        30272452: EventKind(
            "navigator_reposition_outside_geofence", 0x63, "reposition is outside the geofence"
        ),
        30481910: EventKind(
            "commander_failsafe_enter_hold", 0x42, "{3}: switching to {1} in {2} seconds", "IBHB"
        ),
        30612409: EventKind("check_modes_local_pos", 0x33, "no valid position estimate", _CHECK),
        30700832: EventKind("check_gf_violation_max_alt", 0x33, "geofence: too high above home", _CHECK),
        31011876: EventKind("commander_dl_regained", 0x66, "ground station regained"),
        31382480: EventKind("commander_failsafe_enter_generic", 0x42, "fail-safe: switching to {1}", "IB"),
        30930440: EventKind("mc_pos_ctrl_man_vel_set", 0x44, "MPC_VEL_MANUAL is set to {0:g}", "f"),
        32686809: EventKind("mc_pos_ctrl_cruise_set", 0x44, "MPC_XY_CRUISE is set to {0:g}", "f"),
        32794487: EventKind("commander_disarmed_by", 0x66, "disarmed by {0}", "B"),
    }
)
"""The events that PX4 was seen to send in flights and in their fail-safes, by number."""

_WORDS: Mapping[tuple[str, int], Mapping[int, str]] = {
    ("commander_armed_by", 0): {4: "external command"},
    ("commander_disarmed_by", 0): {4: "external command", 6: "landing", 7: "auto preflight disarming"},
}
_ACTIONS = {2: "Position mode", 3: "Altitude mode", 5: "Hold", 6: "RTL", 7: "Land", 8: "Descend"}
_CAUSES = {
    1: "manual control loss",
    2: "GCS connection loss",
    4: "critical battery level",
    5: "emergency battery level",
}


def event_text(event: EventMessage) -> str:
    """The text of an event; its number if it is not in `EVENTS`, "" if it is for programs only."""
    kind = EVENTS.get(event.id_of_event)
    if kind is None:
        return "" if event.severity >= 8 else f"event {event.id_of_event}"
    values = struct.unpack_from(f"<{kind.arguments}", event.arguments)
    return kind.text.format(*(_word(kind.name, place, value) for place, value in enumerate(values)))


def _word(name: str, place: int, value: float) -> str | float:
    if name.startswith("commander_failsafe_enter"):
        if place == 1:
            return _ACTIONS.get(int(value), str(value))
        if (name, place) in (("commander_failsafe_enter", 2), ("commander_failsafe_enter_hold", 3)):
            return _CAUSES.get(int(value), str(value))
    words = _WORDS.get((name, place))
    return words.get(int(value), value) if words else value


# --- parameters ---------------------------------------------------------------------------------------------


def float_of_bytes(value: int) -> float:
    """The float for PARAM_VALUE or PARAM_SET whose bytes are those of an INT32."""
    return float(struct.unpack("<f", struct.pack("<i", value))[0])


def bytes_of_float(value: float) -> int:
    """The INT32 whose bytes lie in the float of PARAM_VALUE or PARAM_SET."""
    return int(struct.unpack("<i", struct.pack("<f", value))[0])
