"""Files on an autopilot, over MAVLink FTP (mavlink.io/en/services/ftp.html): small ones, whole, one at a time.

pymavlink packs and parses the message that carries it; what its payload holds is packed and parsed here.
"""

from __future__ import annotations

import asyncio
import contextlib
import secrets
import struct
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import TypeVar

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.errors import AutopilotRefused, AutopilotTimeout
from upwash.real.mavlink.hearing import Message
from upwash.real.mavlink.link import COMPANION
from upwash.real.mavlink.vehicle import MavlinkVehicle

_HEAD = struct.Struct("<HBBBBBxI")  # number, session, opcode, size, opcode asked for, burst complete, offset
_PAYLOAD_BYTES = 251
MOST_DATA_BYTES = _PAYLOAD_BYTES - _HEAD.size
MOST_FILE_BYTES = 65_536  # of a file that is read: what is longer is none of ours
_ATTEMPTS = 12
_TRANSFERS = 4
_T = TypeVar("_T")


class Opcode(IntEnum):
    """MAV_FTP_OPCODE."""

    TERMINATE_SESSION = 1
    RESET_SESSIONS = 2
    LIST_DIRECTORY = 3
    OPEN_FILE_READ_ONLY = 4
    READ_FILE = 5
    CREATE_FILE = 6
    WRITE_FILE = 7
    CREATE_DIRECTORY = 9
    ACK = 128
    NAK = 129


class Trouble(IntEnum):
    """MAV_FTP_ERR: why something was refused."""

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
    """What one FILE_TRANSFER_PROTOCOL message carries."""

    number: int
    session: int
    opcode: int
    asked: int = 0
    offset: int = 0
    data: bytes = b""
    size: int | None = None  # None: of the data

    def payload(self) -> bytes:
        """As it is sent."""
        size = len(self.data) if self.size is None else self.size
        head = _HEAD.pack(self.number, self.session, self.opcode, size, self.asked, 0, self.offset)
        return (head + self.data).ljust(_PAYLOAD_BYTES, b"\0")


def read_packet(payload: bytes) -> Packet | None:
    """What a payload says; None where it contradicts itself."""
    if len(payload) < _HEAD.size:
        return None
    number, session, opcode, size, asked, _, offset = _HEAD.unpack_from(payload)
    data = payload[_HEAD.size : _HEAD.size + size]
    return Packet(number, session, opcode, asked, offset, data) if len(data) == size else None


class FileRefused(AutopilotRefused):
    """The autopilot refused to do something with a file."""

    def __init__(self, what: str, trouble: int) -> None:
        self.trouble = trouble
        name = Trouble(trouble).name if trouble in tuple(Trouble) else f"number {trouble}"
        super().__init__("files", f"the vehicle answered {name} to {what}")


class FileClient:
    """The files of one vehicle. Each verb returns when it is done, and raises AutopilotError otherwise."""

    def __init__(self, vehicle: MavlinkVehicle) -> None:
        self._vehicle = vehicle
        self._number = secrets.randbelow(2**16)  # not one of an earlier program's, whose answers are kept

    async def has_directory(self, path: str) -> bool:
        """Whether there is a directory of that name."""
        try:
            await self._ask(f"list {path}", Opcode.LIST_DIRECTORY, data=path.encode())
        except FileRefused as refused:
            return refused.trouble == Trouble.END_OF_FILE  # it is empty
        return True

    async def make_directory(self, path: str) -> None:
        """Makes a directory, unless it is there."""
        try:
            await self._ask(f"make {path}", Opcode.CREATE_DIRECTORY, data=path.encode())
        except FileRefused as refused:
            if refused.trouble != Trouble.FILE_EXISTS:
                raise

    async def read(self, path: str) -> bytes | None:
        """The whole file; None where there is none."""
        return await self._again(lambda: self._read(path))

    async def write(self, path: str, content: bytes) -> None:
        """Makes the file, or replaces it, and reads it back; AutopilotRefused where that is something else."""
        await self._again(lambda: self._write(path, content))

    async def _again(self, transfer: Callable[[], Awaitable[_T]]) -> _T:
        """The whole transfer anew where a part of it is refused: a request that came late may have spoilt it."""
        for _ in range(_TRANSFERS - 1):
            with contextlib.suppress(FileRefused):
                return await transfer()
        return await transfer()

    async def _read(self, path: str) -> bytes | None:
        await self._reset()
        try:
            opened = await self._ask(f"open {path}", Opcode.OPEN_FILE_READ_ONLY, data=path.encode())
        except FileRefused as refused:
            if refused.trouble == Trouble.FILE_NOT_FOUND:
                return None
            raise
        content = b""
        while part := await self._read_part(path, opened.session, len(content)):
            content += part
            if len(content) > MOST_FILE_BYTES:
                raise AutopilotRefused("files", f"{path} is longer than {MOST_FILE_BYTES} bytes")
        await self._reset()
        return content

    async def _write(self, path: str, content: bytes) -> None:
        await self._reset()
        session = (await self._ask(f"create {path}", Opcode.CREATE_FILE, data=path.encode())).session
        for offset in range(0, len(content), MOST_DATA_BYTES):
            part = content[offset : offset + MOST_DATA_BYTES]
            await self._ask(f"write {path}", Opcode.WRITE_FILE, session=session, offset=offset, data=part)
        if await self._read(path) != content:
            raise FileRefused(f"read back what was written to {path}", Trouble.FAIL)

    async def _read_part(self, path: str, session: int, offset: int) -> bytes:
        """Empty at the end of the file."""
        try:
            answer = await self._ask(
                f"read {path}", Opcode.READ_FILE, session=session, offset=offset, size=MOST_DATA_BYTES
            )
        except FileRefused as refused:
            if refused.trouble == Trouble.END_OF_FILE:
                return b""
            raise
        return answer.data

    async def _reset(self) -> None:
        """Closes what is open, which writes it: ArduPilot has one file open at a time, whoever opened it."""
        await self._ask("close all files", Opcode.RESET_SESSIONS)

    async def _ask(
        self,
        what: str,
        opcode: Opcode,
        *,
        session: int = 0,
        offset: int = 0,
        data: bytes = b"",
        size: int | None = None,
    ) -> Packet:
        """The vehicle's answer; a request that is repeated has the number of the first, and is carried out once."""
        vehicle, self._number = self._vehicle, (self._number + 1) % 2**16
        request = Packet(self._number, session, opcode, offset=offset, data=data, size=size)
        answers: asyncio.Queue[Packet] = asyncio.Queue()

        def hear(message: Message) -> None:
            answer = _answer_in(message)
            if (
                answer is not None
                and answer.number == (request.number + 1) % 2**16
                and answer.asked == opcode
            ):
                answers.put_nowait(answer)

        with vehicle.listening(hear):
            for _ in range(_ATTEMPTS):
                vehicle.ask(
                    lambda system, component: mavlink.MAVLink_file_transfer_protocol_message(
                        0, system, component, list(request.payload())
                    )
                )
                if await vehicle.happens(
                    "files", lambda: not answers.empty(), within_s=vehicle.patience.answer_s
                ):
                    break
            else:
                raise AutopilotTimeout("files", f"no answer to: {what}", vehicle.said_lately)
        answer = answers.get_nowait()
        if answer.opcode == Opcode.ACK:
            return answer
        raise FileRefused(what, answer.data[0] if answer.data else Trouble.FAIL)


def _answer_in(message: Message) -> Packet | None:
    if message.get_type() != "FILE_TRANSFER_PROTOCOL" or message.target_component not in (0, COMPANION):
        return None
    answer = read_packet(bytes(message.payload))
    return answer if answer is not None and answer.opcode in (Opcode.ACK, Opcode.NAK) else None
