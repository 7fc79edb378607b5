"""Files that commands leave: whole, or not at all."""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
import stat
from collections.abc import Iterable
from pathlib import Path

from upwash.errors import NotWritten
from upwash.support.spared import require_spared

_NO_FILES = (("/", "dev"), ("/", "proc"))  # the first parts of paths that are written to as they are


def write_file(file: Path, content: bytes | Iterable[bytes], *, mode: int = 0o666) -> None:
    """Write the file, and make its folder; raises NotWritten, and leaves a former file unchanged.

    The content may come in pieces. A new file has that mode, less the umask; a former file keeps its mode. Raises
    UsageError for an input of the command that runs.
    """
    require_spared(file)
    content = (content,) if isinstance(content, bytes) else content
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        if file.parts[:2] in _NO_FILES or (file.exists() and not file.is_file()):
            _write_to(file, content)
        else:
            _replace(file.resolve(), content, mode)
    except OSError as error:
        kept = "what was there before is unchanged" if file.is_file() else "nothing of it was left there"
        raise NotWritten(file, error, kept) from error


def write_all(descriptor: int, content: bytes) -> None:
    """Write all of it, in one write if possible; raises OSError after perhaps a part."""
    while content:
        content = content[os.write(descriptor, content) :]


def append_whole(descriptor: int, content: bytes) -> None:
    """Append all of it; raises OSError, and takes back what was written of it, if possible.

    No other program may append to the file meanwhile.
    """
    before_bytes = os.fstat(descriptor).st_size
    try:
        write_all(descriptor, content)
    except OSError:
        with contextlib.suppress(OSError):
            os.ftruncate(descriptor, before_bytes)
        raise


def flush_to_disk(descriptor: int) -> None:
    """Wait until the written bytes are on the disk; raises OSError."""
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno != errno.EINVAL:  # a pipe, say, has no disk
            raise


def _write_to(file: Path, content: Iterable[bytes]) -> None:
    descriptor = os.open(file, os.O_WRONLY | os.O_CLOEXEC)
    try:
        for piece in content:
            write_all(descriptor, piece)
    finally:
        os.close(descriptor)


def _look_like(former: os.stat_result, descriptor: int) -> None:
    with contextlib.suppress(PermissionError):  # without the right to give files away, the file stays ours
        os.fchown(descriptor, former.st_uid, former.st_gid)
    os.fchmod(descriptor, stat.S_IMODE(former.st_mode))


def _replace(file: Path, content: Iterable[bytes], mode: int) -> None:
    unfinished = file.with_name(f".upwash-{secrets.token_hex(4)}")
    descriptor = os.open(unfinished, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, mode)
    try:
        try:
            for piece in content:
                write_all(descriptor, piece)
            flush_to_disk(descriptor)
            if file.exists():
                _look_like(file.stat(), descriptor)
        finally:
            os.close(descriptor)
        unfinished.replace(file)
    except BaseException:
        unfinished.unlink(missing_ok=True)
        raise
