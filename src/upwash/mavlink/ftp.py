"""MAVLink FTP (mavlink.io/en/services/ftp.html): what the payload of FILE_TRANSFER_PROTOCOL holds."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum

HEAD = struct.Struct("<HBBBBBxI")  # number, session, opcode, size, opcode asked for, burst complete, offset
PAYLOAD_BYTES = 251
MOST_DATA_BYTES = PAYLOAD_BYTES - HEAD.size


class Opcode(IntEnum):
    """MAV_FTP_OPCODE."""

    NONE = 0
    TERMINATE_SESSION = 1
    RESET_SESSIONS = 2
    LIST_DIRECTORY = 3
    OPEN_FILE_READ_ONLY = 4
    READ_FILE = 5
    CREATE_FILE = 6
    WRITE_FILE = 7
    REMOVE_FILE = 8
    CREATE_DIRECTORY = 9
    ACK = 128
    NAK = 129


class Trouble(IntEnum):
    """MAV_FTP_ERR: why a request was refused."""

    FAIL = 1
    FAIL_ERRNO = 2
    INVALID_DATA_SIZE = 3
    INVALID_SESSION = 4
    NO_SESSIONS_AVAILABLE = 5
    END_OF_FILE = 6
    UNKNOWN_COMMAND = 7
    FILE_EXISTS = 8
    FILE_PROTECTED = 9
    FILE_NOT_FOUND = 10


@dataclass(frozen=True, slots=True)
class Packet:
    """The payload of one FILE_TRANSFER_PROTOCOL message."""

    number: int
    session: int
    opcode: int
    asked: int = 0
    offset: int = 0
    data: bytes = b""
    size: int | None = None  # None: of the data

    def payload(self) -> bytes:
        """The encoded payload."""
        size = len(self.data) if self.size is None else self.size
        head = HEAD.pack(self.number, self.session, self.opcode, size, self.asked, 0, self.offset)
        return (head + self.data).ljust(PAYLOAD_BYTES, b"\0")


def read_packet(payload: bytes) -> Packet | None:
    """The packet from a payload; None if it contradicts itself."""
    if len(payload) < HEAD.size:
        return None
    number, session, opcode, size, asked, _, offset = HEAD.unpack_from(payload)
    data = payload[HEAD.size : HEAD.size + size]
    return Packet(number, session, opcode, asked, offset, data) if len(data) == size else None
