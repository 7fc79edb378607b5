"""A program's folder for its sockets, which a program that was killed leaves behind."""

from __future__ import annotations

import contextlib
import fcntl
import logging
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

_log = logging.getLogger("upwash.serving")
_PREFIX = "uw-"  # short: the path of a socket has 107 bytes


@contextlib.contextmanager
def socket_folder(beside: Path | None) -> Iterator[Path]:
    """A new folder in `beside`, or where temporary files go, until the end of the block.

    What killed programs left there is removed. The program holds a lock on its folder, which ends with the program.
    """
    parent = beside or Path(tempfile.gettempdir())
    for folder in parent.glob(f"{_PREFIX}*"):
        with contextlib.suppress(OSError):
            _remove_if_left(folder)
    made, lock = _made_and_locked(parent)
    try:
        yield made
    finally:
        shutil.rmtree(made, ignore_errors=True)
        os.close(lock)


def _made_and_locked(parent: Path) -> tuple[Path, int]:
    """A new folder, and its open lock; another program may take the folder for left before it is locked."""
    while True:
        made = Path(tempfile.mkdtemp(prefix=_PREFIX, dir=parent))
        with contextlib.suppress(FileNotFoundError):
            lock = _open(made)
            fcntl.flock(lock, fcntl.LOCK_EX)
            if made.exists():
                return made, lock
            os.close(lock)


def _remove_if_left(folder: Path) -> None:
    """Remove the folder if its program has ended, and nothing but sockets is in it; raises OSError."""
    opened = _open(folder)
    try:
        if os.fstat(opened).st_uid != os.geteuid():
            return
        fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
        inside = list(folder.iterdir())
        if all(file.is_socket() for file in inside):
            for file in inside:
                file.unlink()
            folder.rmdir()
            _log.info("%s is removed, which a killed daemon left behind", folder)
    finally:
        os.close(opened)


def _open(folder: Path) -> int:
    return os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
