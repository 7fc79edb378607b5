"""Packets at the edges of MAVLink's framing: what is read, and that nothing after them is lost."""

from __future__ import annotations

import struct
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.mavlink.packets import PacketReader
from upwash.mavlink.px4 import CurrentModeMessage, Mode

HEARTBEAT = mavlink.MAVLink_heartbeat_message(2, 3, 81, 4, 3, 3)


def packet(
    message: Any = HEARTBEAT, *, flags: int = 0, payload: bytes | None = None, crc: int | None = None
) -> bytes:
    """The message, with those incompatibility flags, and with that payload, of any length."""
    whole = bytes(message.pack(mavlink.MAVLink(None, 1, 1)))
    body = whole[10:-2] if payload is None else payload
    head = bytes([0xFD, len(body), flags]) + whole[3:10]
    extra = message.crc_extra if crc is None else crc
    return head + body + struct.pack("<H", mavlink.x25crc(head[1:] + body + bytes([extra])).crc)


def read(*packets: bytes) -> list[str]:
    reader = PacketReader()
    return [message.get_type() for each in packets for message, _ in reader.read(each)]


@pytest.mark.parametrize("flags", [0x02, 0x80, 0xFE])
def test_a_packet_with_flags_that_nobody_understands_is_dropped_alone(flags: int) -> None:
    mode = CurrentModeMessage(custom_mode=Mode.LOITER, intended_custom_mode=Mode.LOITER, standard_mode=0)
    assert read(packet(flags=flags), packet(mode, flags=flags), packet(), packet()) == ["HEARTBEAT"] * 2


@pytest.mark.parametrize("length", range(10))
def test_zeros_at_the_end_may_be_left_out(length: int) -> None:
    whole = bytes(HEARTBEAT.pack(mavlink.MAVLink(None, 1, 1)))[10:-2]
    assert read(packet(payload=whole[:length]), packet()) == ["HEARTBEAT"] * 2


@pytest.mark.parametrize("length", [10, 100, 255])
def test_a_payload_of_a_later_version_is_read_as_far_as_it_is_known(length: int) -> None:
    whole = bytes(HEARTBEAT.pack(mavlink.MAVLink(None, 1, 1)))[10:-2]
    assert read(packet(payload=whole.ljust(length, b"x")), packet()) == ["HEARTBEAT"] * 2


def test_a_payload_of_any_length_is_a_message_or_nothing_for_every_kind() -> None:
    """A reader that raised would end a connection over TCP."""
    kinds = list(mavlink.mavlink_map.items())
    sent = []
    for number, kind in kinds:
        for length in (1, kind.unpacker.size // 2 or 1, min(kind.unpacker.size + 1, 255), 255):
            head = bytes([0xFD, length, 0, 0, 0, 1, 1]) + number.to_bytes(3, "little")
            body = bytes([0xFF]) * length
            sent.append(
                head + body + struct.pack("<H", mavlink.x25crc(head[1:] + body + bytes([kind.crc_extra])).crc)
            )
    assert len(read(*sent, packet())) == 4 * len(kinds) + 1


def test_a_wrong_checksum_costs_its_packet_alone() -> None:
    assert read(packet(crc=7), packet()) == ["HEARTBEAT"]


def test_a_flag_of_a_signature_that_is_not_there_costs_what_it_swallows() -> None:
    """The next packet's first bytes are taken for the signature: the one after that is read."""
    assert read(packet(flags=1), packet(), packet(), packet())[-1:] == ["HEARTBEAT"]
