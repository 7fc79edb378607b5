"""Private keys among files, found by their contents: what is packed is handed out, and a key must not be.

Known are the armoured keys of PEM, OpenSSH, OpenPGP, PuTTY, age and WireGuard, and JSON web keys. Known too are the
binary keys of PKCS #1, #8 and #12, SEC 1 and Java, and the keys for MAVLink messages that upwash makes. Archives are
looked into, and archives in these. What an archive encrypts, and a key without armour within another file, is not
found.
"""

from __future__ import annotations

import bz2
import gzip
import io
import lzma
import mmap
import re
import tarfile
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO

_MOST_MEMBER_BYTES = 2**20  # a key is smaller
_MOST_MEMBERS = 20_000
_DEEPEST = 3  # archives within each other
_HEADER_BYTES = 100
_GAP = rb"(?:[\s\"']|\\+[nr]?)*+"  # a line's end, also as JSON and programs write it
_ARMOURED = (
    (
        rb"-----?[ ]?BEGIN [A-Z0-9 ]{0,40}PRIVATE KEY(?: BLOCK)?[ ]?-----?"
        + _GAP
        + rb"(?:[A-Za-z-]{1,40}: [^\r\n\\]{0,200}"
        + _GAP
        + rb"){0,9}[A-Za-z0-9+/=]{40}",
        "a private key (PEM)",
    ),
    (rb"PuTTY-User-Key-File-\d: ", "a private key of PuTTY"),
    (rb"AGE-SECRET-KEY-1[A-Z0-9]{50}", "a private key of age"),
    (rb"(?m)^\s*PrivateKey\s*=\s*[A-Za-z0-9+/]{43}=", "a private key of WireGuard"),
    (
        rb"\"kty\"\s*:(?s:.{1,4000}?)\"[dk]\"\s*:\s*\"[A-Za-z0-9_-]{20}|"
        rb"\"[dk]\"\s*:\s*\"[A-Za-z0-9_-]{20}(?s:.{1,4000}?)\"kty\"\s*:",
        "a private key (JWK)",
    ),
)
_SEQUENCE = rb"\x30(?:[\x00-\x80]|\x81.|\x82..|\x83...)"
_PKCS = rb"\x2a\x86\x48\x86\xf7\x0d\x01"
_BINARY = (
    (
        _SEQUENCE + rb"\x02\x01\x03" + _SEQUENCE + rb"\x06\x09" + _PKCS + rb"\x07",
        "a store of keys (PKCS #12)",
    ),
    (_SEQUENCE + rb"\x02\x01[\x00\x01]" + _SEQUENCE + rb"\x06", "a private key (PKCS #8)"),
    (_SEQUENCE * 2 + rb"\x06." + _PKCS + rb"(?:\x05|\x0c\x01)", "a private key (PKCS #8, encrypted)"),
    (_SEQUENCE + rb"\x02\x01\x01\x04[\x14-\x42]", "a private key (SEC 1)"),
    (_SEQUENCE + rb"\x02\x01\x00\x02(?:[\x10-\x7f]|\x81.|\x82..)", "a private key (PKCS #1)"),
    (rb"openssh-key-v1\0", "a private key of OpenSSH"),
    (rb"(?:\xfe\xed\xfe\xed|\xce\xce\xce\xce)\0\0\0[\x01\x02]", "a store of keys (Java)"),
    (
        rb"\s*[0-9a-fA-F]{64}\s*\Z",
        "a key for signed messages (a checksum has the name of its file behind it)",
    ),
)
_BY_ARMOUR = tuple((re.compile(form), kind) for form, kind in _ARMOURED)
_BY_BEGINNING = tuple((re.compile(form, re.DOTALL), kind) for form, kind in _BINARY)
_SAID = re.compile(rb"PRIVATE|Private|PuTTY-|AGE-SECRET|\"kty\"")  # in every armoured key, and quickly found
_WIDE = "PRIVATE".encode("utf-16-le")
_PACKED = {b"\x1f\x8b": gzip.open, b"BZh": bz2.open, b"\xfd7zXZ": lzma.open}
_UNREADABLE = (
    OSError, EOFError, ValueError, RuntimeError, NotImplementedError, zlib.error, lzma.LZMAError, tarfile.TarError,
    zipfile.BadZipFile,
)  # fmt: skip


def private_key_in(file: Path) -> str:
    """What private key the file has, in words; "" without one. Raises OSError."""
    with file.open("rb") as opened:
        if not file.stat().st_size:
            return ""
        with mmap.mmap(opened.fileno(), 0, access=mmap.ACCESS_READ) as content:
            return _found(content, opened, _DEEPEST)


def _found(content: bytes | mmap.mmap, file: IO[bytes], depth: int) -> str:
    beginning = content[:_HEADER_BYTES]
    for form, kind in _BY_BEGINNING:
        if form.match(beginning):
            return kind
    if _SAID.search(content):
        for form, kind in _BY_ARMOUR:
            if form.search(content):
                return kind
    if content.find(_WIDE) >= 0 and (kind := _found(content[:].replace(b"\0", b""), file, 0)):
        return kind
    for name, member in _members(content, file) if depth else ():
        if kind := _found(member, io.BytesIO(member), depth - 1):
            return f"{kind}, as {name} in an archive"
    return ""


def _members(content: bytes | mmap.mmap, file: IO[bytes]) -> Iterator[tuple[str, bytes]]:
    """The small files of an archive; of a damaged archive, those before the damage."""
    try:
        if content[:4] == b"PK\3\4":
            with zipfile.ZipFile(file) as packed:
                for entry in packed.infolist()[:_MOST_MEMBERS]:
                    if entry.file_size <= _MOST_MEMBER_BYTES and not entry.flag_bits & 1:
                        with packed.open(entry) as member:
                            yield entry.filename, member.read(_MOST_MEMBER_BYTES)
        elif content[257:262] == b"ustar" or _PACKED.keys() & {content[:2], content[:3], content[:5]}:
            yield from _unpacked(file)
    except _UNREADABLE:
        return


def _unpacked(file: IO[bytes]) -> Iterator[tuple[str, bytes]]:
    try:
        with tarfile.open(fileobj=file, mode="r:*") as packed:
            for number, entry in enumerate(packed):
                if number >= _MOST_MEMBERS:
                    return
                if (
                    entry.isfile()
                    and entry.size <= _MOST_MEMBER_BYTES
                    and (member := packed.extractfile(entry))
                ):
                    yield entry.name, member.read()
    except tarfile.ReadError:  # a single file
        file.seek(0)
        beginning = file.read(5)
        file.seek(0)
        for first, unpack in _PACKED.items():
            if beginning.startswith(first):
                with unpack(file) as alone:  # type: ignore[operator]
                    yield "its file", alone.read(_MOST_MEMBER_BYTES)
