"""The stand-in's files, as MAVLink FTP reaches an ArduPilot's: in memory, one open at a time for all peers."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

from upwash.mavlink.ftp import HEAD, MOST_DATA_BYTES, Opcode, Packet, Trouble

_MOST_FILE_BYTES = 65_536
_MOST_FILES = 100
_IDLE_S = 3.0  # after which another session may have what is open


class _RefusedError(Exception):
    def __init__(self, trouble: Trouble) -> None:
        self.trouble = trouble


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
        """The answer to a request. A repeated request gets the same answer and is not carried out again."""
        if len(payload) < HEAD.size:
            return None
        number, session, opcode, size, asked, _, offset = HEAD.unpack_from(payload)
        if self._last is not None and self._last[:3] == (sender, session, number):
            return self._last[3]
        data = payload[HEAD.size : HEAD.size + size]
        request = Packet(number, session, opcode, asked, offset, data, size)
        try:
            if size > MOST_DATA_BYTES:
                raise _RefusedError(Trouble.INVALID_DATA_SIZE)
            result, reply = Opcode.ACK, self._carry_out(request, now_s)
        except _RefusedError as refused:
            result, reply = Opcode.NAK, bytes([refused.trouble])
        answer = Packet((number + 1) % 2**16, session, result, opcode, offset, reply).payload()
        self._last = sender, session, number, answer
        return answer

    def _carry_out(self, request: Packet, now_s: float) -> bytes:
        is_open, opcode = self._open, request.opcode
        if opcode in (Opcode.TERMINATE_SESSION, Opcode.RESET_SESSIONS):
            if is_open is not None and is_open.session == request.session:
                self._open = None
            return b""
        if is_open is not None and is_open.session != request.session:
            if now_s - is_open.used_s < _IDLE_S:
                raise _RefusedError(Trouble.INVALID_SESSION)
            self._open = None
        match opcode:
            case Opcode.NONE:
                return b""
            case Opcode.LIST_DIRECTORY:
                return self._listing(request)
            case Opcode.CREATE_DIRECTORY:
                return self._make_directory(_path(request))
            case Opcode.OPEN_FILE_READ_ONLY | Opcode.CREATE_FILE:
                return self._open_file(request, now_s, writing=opcode == Opcode.CREATE_FILE)
            case Opcode.READ_FILE:
                return self._read(request, now_s)
            case Opcode.WRITE_FILE:
                return self._write(request, now_s)
            case Opcode.REMOVE_FILE:
                if self.content.pop(_path(request), None) is None:
                    raise _RefusedError(Trouble.FILE_NOT_FOUND)
                return b""
        raise _RefusedError(Trouble.FAIL)

    def _listing(self, request: Packet) -> bytes:
        path = _path(request)
        if path not in self.directories:
            raise _RefusedError(Trouble.FILE_NOT_FOUND)
        names = sorted(name for name in self.content if name.rpartition("/")[0] == path)
        entries = [
            f"F{name.rpartition('/')[2]}\t{len(self.content[name])}\0".encode("latin-1") for name in names
        ][request.offset :]
        listing = b""
        for entry in entries:
            if len(listing) + len(entry) > MOST_DATA_BYTES:
                break
            listing += entry
        if not listing:
            raise _RefusedError(Trouble.END_OF_FILE)
        return listing

    def _make_directory(self, path: str) -> bytes:
        if path in self.directories:
            raise _RefusedError(Trouble.FILE_EXISTS)
        parent = path.rpartition("/")[0]
        if (parent and parent not in self.directories) or len(self.directories) >= _MOST_FILES:
            raise _RefusedError(Trouble.FILE_NOT_FOUND)
        self.directories.add(path)
        return b""

    def _open_file(self, request: Packet, now_s: float, *, writing: bool) -> bytes:
        path = _path(request)
        if self._open is not None:
            raise _RefusedError(Trouble.FAIL)
        if writing:
            parent = path.rpartition("/")[0]
            if (parent and parent not in self.directories) or len(self.content) >= _MOST_FILES:
                raise _RefusedError(Trouble.FILE_NOT_FOUND)
            self.content[path] = bytearray()
        elif path not in self.content:
            raise _RefusedError(Trouble.FILE_NOT_FOUND)
        self._open = _Open(request.session, path, writing, now_s)
        return b"" if writing else struct.pack("<I", len(self.content[path]))

    def _read(self, request: Packet, now_s: float) -> bytes:
        content = self._opened(now_s, writing=False)
        part = bytes(content[request.offset : request.offset + min(request.size or 0, MOST_DATA_BYTES)])
        if not part:
            raise _RefusedError(Trouble.END_OF_FILE)
        return part

    def _write(self, request: Packet, now_s: float) -> bytes:
        content = self._opened(now_s, writing=True)
        end = request.offset + len(request.data)
        if end > _MOST_FILE_BYTES:
            raise _RefusedError(Trouble.FAIL_ERRNO)
        content.extend(b"\0" * (end - len(content)))
        content[request.offset : end] = request.data
        return b""

    def _opened(self, now_s: float, *, writing: bool) -> bytearray:
        if self._open is None or self._open.path not in self.content:
            raise _RefusedError(Trouble.FILE_NOT_FOUND)
        if self._open.writing != writing:
            raise _RefusedError(Trouble.FAIL)
        self._open.used_s = now_s
        return self.content[self._open.path]


def _path(request: Packet) -> str:
    if not request.data:
        raise _RefusedError(Trouble.INVALID_DATA_SIZE)
    return request.data.rstrip(b"\0").decode("latin-1").strip("/")
