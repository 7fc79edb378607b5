"""PX4's events and flight modes, and messages that pymavlink's dialect `ardupilotmega` lacks.

The messages' fields and numbers are those of MAVLink's public definitions (common.xml and development.xml), the
events' those of PX4 1.16's public event metadata, the modes' numbers PX4's custom modes. Both the driver and the
stand-in read and write with these.
"""

from __future__ import annotations

import csv
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from functools import cache
from importlib.resources import files
from typing import Any, ClassVar

from pymavlink.dialects.v20 import ardupilotmega as mavlink

EVENT = 410
AVAILABLE_MODES = 435
CURRENT_MODE = 436
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
    """EVENT: an event of PX4; `px4_events` has the meaning of its `arguments`."""

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


@cache
def px4_events() -> Mapping[int, EventKind]:
    """The events that PX4 was seen to send in flights and in their fail-safes, by number."""
    table = files("upwash.mavlink").joinpath("px4_events.csv").read_text(encoding="utf-8")
    return {
        int(row["number"]): EventKind(row["name"], int(row["log_levels"], 16), row["text"], row["arguments"])
        for row in csv.DictReader(table.splitlines())
    }


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
    """The text of an event; its number if it is not in `px4_events`, "" if it is for programs only."""
    kind = px4_events().get(event.id_of_event)
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
