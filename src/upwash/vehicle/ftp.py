"""The stand-in's files, as MAVLink FTP reaches an ArduPilot's: in memory, one open at a time, whoever asks."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from enum import IntEnum

_HEAD = struct.Struct("<HBBBBBxI")  # number, session, opcode, size, opcode asked for, burst complete, offset
_PAYLOAD_BYTES = 251
_MOST_DATA_BYTES = _PAYLOAD_BYTES - _HEAD.size
_MOST_FILE_BYTES = 65_536
_MOST_FILES = 100
_IDLE_S = 3.0  # after which another session may have what is open


class _Opcode(IntEnum):
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


class _Trouble(IntEnum):
    FAIL = 1
    FAIL_ERRNO = 2
    INVALID_DATA_SIZE = 3
    INVALID_SESSION = 4
    END_OF_FILE = 6
    FILE_EXISTS = 8
    FILE_NOT_FOUND = 10


class _RefusedError(Exception):
    def __init__(self, trouble: _Trouble) -> None:
        self.trouble = trouble


@dataclass(frozen=True, slots=True)
class _Request:
    session: int
    offset: int
    size: int
    data: bytes

    @property
    def path(self) -> str:
        if not self.data:
            raise _RefusedError(_Trouble.INVALID_DATA_SIZE)
        return self.data.rstrip(b"\0").decode("latin-1").strip("/")


@dataclass(slots=True)
class _Open:
    session: int
    path: str
    writing: bool
    used_s: float


@dataclass(slots=True)
class Files:
    """Files by their paths, the directories among them, and what is open."""

    content: dict[str, bytearray] = field(default_factory=dict)
    directories: set[str] = field(default_factory=lambda: {"logs", "scripts"})
    _open: _Open | None = None
    _last: tuple[object, int, int, bytes] | None = (
        None  # to whom the last answer went, session, number, itself
    )

    def answer(self, payload: bytes, sender: object, now_s: float) -> bytes | None:
        """The answer to a request; one that is repeated gets the answer again and is not carried out again."""
        if len(payload) < _HEAD.size:
            return None
        number, session, opcode, size, _, _, offset = _HEAD.unpack_from(payload)
        if self._last is not None and self._last[:3] == (sender, session, number):
            return self._last[3]
        data = payload[_HEAD.size : _HEAD.size + size]
        request = _Request(session, offset, size, data)
        try:
            if size > _MOST_DATA_BYTES:
                raise _RefusedError(_Trouble.INVALID_DATA_SIZE)
            result, reply = _Opcode.ACK, self._carry_out(opcode, request, now_s)
        except _RefusedError as refused:
            result, reply = _Opcode.NAK, bytes([refused.trouble])
        head = _HEAD.pack((number + 1) % 2**16, session, result, len(reply), opcode, 0, offset)
        answer = (head + reply).ljust(_PAYLOAD_BYTES, b"\0")
        self._last = sender, session, number, answer
        return answer

    def _carry_out(self, opcode: int, request: _Request, now_s: float) -> bytes:
        is_open = self._open
        if opcode in (_Opcode.TERMINATE_SESSION, _Opcode.RESET_SESSIONS):
            if is_open is not None and is_open.session == request.session:
                self._open = None
            return b""
        if is_open is not None and is_open.session != request.session:
            if now_s - is_open.used_s < _IDLE_S:
                raise _RefusedError(_Trouble.INVALID_SESSION)
            self._open = None
        match opcode:
            case _Opcode.NONE:
                return b""
            case _Opcode.LIST_DIRECTORY:
                return self._listing(request)
            case _Opcode.CREATE_DIRECTORY:
                return self._make_directory(request.path)
            case _Opcode.OPEN_FILE_READ_ONLY | _Opcode.CREATE_FILE:
                return self._open_file(request, now_s, writing=opcode == _Opcode.CREATE_FILE)
            case _Opcode.READ_FILE:
                return self._read(request, now_s)
            case _Opcode.WRITE_FILE:
                return self._write(request, now_s)
            case _Opcode.REMOVE_FILE:
                if self.content.pop(request.path, None) is None:
                    raise _RefusedError(_Trouble.FILE_NOT_FOUND)
                return b""
        raise _RefusedError(_Trouble.FAIL)

    def _listing(self, request: _Request) -> bytes:
        path = request.path
        if path not in self.directories:
            raise _RefusedError(_Trouble.FILE_NOT_FOUND)
        names = sorted(name for name in self.content if name.rpartition("/")[0] == path)
        entries = [
            f"F{name.rpartition('/')[2]}\t{len(self.content[name])}\0".encode("latin-1") for name in names
        ][request.offset :]
        listing = b""
        for entry in entries:
            if len(listing) + len(entry) > _MOST_DATA_BYTES:
                break
            listing += entry
        if not listing:
            raise _RefusedError(_Trouble.END_OF_FILE)
        return listing

    def _make_directory(self, path: str) -> bytes:
        if path in self.directories:
            raise _RefusedError(_Trouble.FILE_EXISTS)
        parent = path.rpartition("/")[0]
        if (parent and parent not in self.directories) or len(self.directories) >= _MOST_FILES:
            raise _RefusedError(_Trouble.FILE_NOT_FOUND)
        self.directories.add(path)
        return b""

    def _open_file(self, request: _Request, now_s: float, *, writing: bool) -> bytes:
        path = request.path
        if self._open is not None:
            raise _RefusedError(_Trouble.FAIL)
        if writing:
            parent = path.rpartition("/")[0]
            if (parent and parent not in self.directories) or len(self.content) >= _MOST_FILES:
                raise _RefusedError(_Trouble.FILE_NOT_FOUND)
            self.content[path] = bytearray()
        elif path not in self.content:
            raise _RefusedError(_Trouble.FILE_NOT_FOUND)
        self._open = _Open(request.session, path, writing, now_s)
        return b"" if writing else struct.pack("<I", len(self.content[path]))

    def _read(self, request: _Request, now_s: float) -> bytes:
        content = self._opened(now_s, writing=False)
        part = bytes(content[request.offset : request.offset + min(request.size, _MOST_DATA_BYTES)])
        if not part:
            raise _RefusedError(_Trouble.END_OF_FILE)
        return part

    def _write(self, request: _Request, now_s: float) -> bytes:
        content = self._opened(now_s, writing=True)
        end = request.offset + len(request.data)
        if end > _MOST_FILE_BYTES:
            raise _RefusedError(_Trouble.FAIL_ERRNO)
        content.extend(b"\0" * (end - len(content)))
        content[request.offset : end] = request.data
        return b""

    def _opened(self, now_s: float, *, writing: bool) -> bytearray:
        if self._open is None or self._open.path not in self.content:
            raise _RefusedError(_Trouble.FILE_NOT_FOUND)
        if self._open.writing != writing:
            raise _RefusedError(_Trouble.FAIL)
        self._open.used_s = now_s
        return self.content[self._open.path]
