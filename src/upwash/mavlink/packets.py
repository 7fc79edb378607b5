"""MAVLink messages from bytes, for the driver and the stand-in; any bytes may come."""

from __future__ import annotations

from typing import Any, TypeAlias

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.mavlink.px4 import understood
from upwash.mavlink.signing import SignatureRefusal, Signing

Message: TypeAlias = Any  # pymavlink's messages are not typed

_NOT_UNDERSTOOD = (mavlink.MAVLink_bad_data, mavlink.MAVLink_unknown)  # garbage, or no checksum to verify


class PacketReader:
    """Reads a stream of bytes, or one datagram; raises nothing, and keeps no more than one packet's start.

    With `signing` each message comes with the reason for its refusal, or None.
    """

    def __init__(self, signing: Signing | None = None) -> None:
        self._signing = signing
        self._parser = mavlink.MAVLink(None)
        self._parser.robust_parsing = True  # what cannot be understood becomes a message of its own

    def read(self, data: bytes) -> list[tuple[Message, SignatureRefusal | None]]:
        """The messages that the bytes complete."""
        parser = self._parser
        found = parser.parse_buffer(data) or ()
        del parser.buf[: parser.buf_index]  # pymavlink frees it only when a packet ends with the bytes
        parser.buf_index = 0
        return [
            (message, self._signing.refusal(bytes(raw.get_msgbuf())) if self._signing else None)
            for raw in found
            if not isinstance(message := understood(raw), _NOT_UNDERSTOOD)
        ]


def packed(message: Message, codec: Any, signing: Signing | None) -> bytes:
    """The message's bytes, signed if there is a key; advances the codec's sequence number."""
    data = signing.pack(message, codec) if signing else bytes(message.pack(codec))
    codec.seq = (codec.seq + 1) % 256
    return data


def sender_of(message: Message) -> tuple[int, int]:
    """The system and component of a message's sender."""
    return message.get_srcSystem(), message.get_srcComponent()


def name_of(enum: str, number: int | None) -> str:
    """MAVLink's name for the number in that enumeration."""
    entry = mavlink.enums[enum].get(number)
    return entry.name if entry else f"number {number}"
