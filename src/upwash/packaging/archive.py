"""A folder as one file that is the same, byte for byte, whenever and by whomever it is made."""

from __future__ import annotations

import gzip
import hashlib
import os
import stat
import tarfile
from pathlib import Path
from typing import IO

_LONG_AGO_S = 1_700_000_000  # the time of everything in it
_COMPRESSION = 1  # higher saves a tenth and takes three times as long


def write_packed(folder: Path, file: Path) -> None:
    """Packs the folder's contents, compressed; what belongs to this user belongs to root in the archive."""
    with (
        file.open("wb") as raw,
        gzip.GzipFile(
            filename="", mode="wb", fileobj=raw, compresslevel=_COMPRESSION, mtime=_LONG_AGO_S
        ) as packed,
    ):
        _write(folder, packed)


def write_plain(folder: Path, file: Path) -> None:
    """The same, not compressed."""
    with file.open("wb") as raw:
        _write(folder, raw)


def hash_of_contents(packed: Path) -> str:
    """The SHA-256 of what a compressed file holds."""
    with gzip.open(packed) as contents:
        return hashlib.file_digest(contents, "sha256").hexdigest()


def _write(folder: Path, to: IO[bytes] | gzip.GzipFile) -> None:
    with tarfile.open(fileobj=to, mode="w", format=tarfile.GNU_FORMAT) as archive:
        for path in sorted(folder.rglob("*")):
            archive.add(path, arcname=str(path.relative_to(folder)), recursive=False, filter=_normal)


def _normal(entry: tarfile.TarInfo) -> tarfile.TarInfo:
    entry.mtime = _LONG_AGO_S
    entry.uid = 0 if entry.uid == os.getuid() else entry.uid
    entry.gid = 0 if entry.gid == os.getgid() else entry.gid
    entry.uname = entry.gname = ""
    if entry.isfile() or (entry.isdir() and not entry.mode & stat.S_ISVTX):
        # Whatever this user's umask is; and nothing in it lends its owner's rights.
        entry.mode = 0o755 if entry.mode & stat.S_IXUSR else 0o644
    return entry
