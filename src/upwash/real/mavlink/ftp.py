"""Files on an autopilot, over MAVLink FTP (mavlink.io/en/services/ftp.html): small files, whole, one at a time.

pymavlink packs and parses the message that carries it, `upwash.mavlink.ftp` its payload.
"""

from __future__ import annotations

import contextlib
import secrets
from collections.abc import Awaitable, Callable
from typing import TypeVar

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.errors import AutopilotRefused, AutopilotTimeout
from upwash.mavlink.ftp import MOST_DATA_BYTES, Opcode, Packet, Trouble, read_packet
from upwash.mavlink.packets import Message
from upwash.real.mavlink.link import COMPANION
from upwash.real.mavlink.vehicle import MavlinkVehicle

MOST_FILE_BYTES = 65_536  # of a file that is read: upwash writes no longer ones
_ATTEMPTS = 12
_TRANSFERS = 4
_LONGEST_S = 600.0  # of a transfer with its repetitions
_T = TypeVar("_T")


class FileRefused(AutopilotRefused):
    """The autopilot refused an operation on a file."""

    def __init__(self, what: str, trouble: int) -> None:
        self.trouble = trouble
        name = Trouble(trouble).name if trouble in tuple(Trouble) else f"number {trouble}"
        super().__init__("files", f"the vehicle answered {name} to {what}")


class FileClient:
    """The files of one vehicle; each method returns when it is done, or raises AutopilotError."""

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
        """Makes a directory, unless it exists."""
        try:
            await self._ask(f"make {path}", Opcode.CREATE_DIRECTORY, data=path.encode())
        except FileRefused as refused:
            if refused.trouble != Trouble.FILE_EXISTS:
                raise

    async def read(self, path: str) -> bytes | None:
        """The contents of the file; None if it does not exist."""
        return await self._again(lambda: self._read(path))

    async def write(self, path: str, content: bytes) -> None:
        """Writes or replaces the file, and reads it back; AutopilotRefused if the content differs."""
        await self._again(lambda: self._write(path, content))

    async def _again(self, transfer: Callable[[], Awaitable[_T]]) -> _T:
        """Repeat the whole transfer after a refusal, as a late request may have disturbed it."""
        async with self._vehicle.limited("files", _LONGEST_S):
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
        """The next bytes of the file from `offset`; empty at its end."""
        place = f"read {path}", Opcode.READ_FILE
        try:
            answer = await self._ask(*place, session=session, offset=offset, size=MOST_DATA_BYTES)
        except FileRefused as refused:
            if refused.trouble == Trouble.END_OF_FILE:
                return b""
            raise
        return answer.data

    async def _reset(self) -> None:
        """Close open files, which also writes them: ArduPilot has one file open at a time, for all clients."""
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
        """The vehicle's answer to a request; a repeated request keeps its number, so that it is carried out once."""
        vehicle, self._number = self._vehicle, (self._number + 1) % 2**16
        request = Packet(self._number, session, opcode, offset=offset, data=data, size=size)
        payload = list(request.payload())
        answers: list[Packet] = []

        def hear(message: Message) -> None:
            answer = _answer_in(message)
            if answer is not None and _answers(request, answer):
                answers.append(answer)

        with vehicle.listening(hear):
            question = mavlink.MAVLink_file_transfer_protocol_message(0, *vehicle.ids, payload)
            asked = vehicle.answered("files", lambda: vehicle.ask(question), lambda: answers, times=_ATTEMPTS)
            if not await asked:
                raise AutopilotTimeout("files", f"no answer to: {what}", vehicle.said_lately)
        answer = answers[0]
        if answer.opcode == Opcode.ACK:
            return answer
        raise FileRefused(what, answer.data[0] if answer.data else Trouble.FAIL)


def _answers(request: Packet, answer: Packet) -> bool:
    """Whether it is the answer to the request; a part of a file must be at the requested place."""
    is_part = request.opcode == Opcode.READ_FILE and answer.opcode == Opcode.ACK
    is_elsewhere = is_part and (answer.session, answer.offset) != (request.session, request.offset)
    is_next = answer.number == (request.number + 1) % 2**16
    return is_next and answer.asked == request.opcode and not is_elsewhere


def _answer_in(message: Message) -> Packet | None:
    if message.get_type() != "FILE_TRANSFER_PROTOCOL" or message.target_component not in (0, COMPANION):
        return None
    answer = read_packet(bytes(message.payload))
    return answer if answer is not None and answer.opcode in (Opcode.ACK, Opcode.NAK) else None
