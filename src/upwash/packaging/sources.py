"""What may be put into an image: files and folders alone, nothing that leads elsewhere, and not without bound."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from itertools import chain
from pathlib import Path, PurePath

from upwash.errors import UsageError
from upwash.support.text import printable

_MOST_FILES = 100_000
_MOST_BYTES = 32 * 2**30
_LEFT_OUT = {"__pycache__", "tests"}


def is_left_out(path: PurePath) -> bool:
    """Whether images go without it."""
    return path.suffix == ".pyc" or not _LEFT_OUT.isdisjoint(path.parts)


def require_packable(source: Path) -> None:
    """Raises UsageError where a file or folder, or something in it, cannot be put into an image."""
    if not source.exists():
        raise UsageError(f"{source}: no such file: check the path")
    size, whole = 0, source.resolve()
    for files, path in enumerate(chain([whole], _below(whole))):
        _require_inside(path, whole)
        size += _size(path)
        if files > _MOST_FILES or size > _MOST_BYTES:
            raise UsageError(
                f"{source} has more than {_MOST_FILES} files or {_MOST_BYTES // 2**30} GiB: "
                "name a folder that has only what the service needs"
            )


def _below(folder: Path) -> Iterator[Path]:
    for where, folders, files in os.walk(folder):
        folders[:] = [name for name in folders if not is_left_out(PurePath(name))]
        yield from (Path(where, name) for name in (*folders, *files) if not is_left_out(PurePath(name)))


def _require_inside(path: Path, whole: Path) -> None:
    """Raises UsageError for a link to a folder, or out of the `whole` that is packed."""
    if path.is_symlink() and (path.is_dir() or not path.resolve().is_relative_to(whole)):
        raise UsageError(f"{path} is a link to {path.resolve()}: put the files themselves there (`cp -rL`)")


def _size(path: Path) -> int:
    """The bytes of a file, 0 of a folder; raises UsageError for anything else."""
    shown = printable(str(path))
    if str(path) != shown:
        raise UsageError(f"{shown}: its name has characters that cannot be shown: give it another name")
    try:
        found = path.stat()
    except OSError as error:
        raise UsageError(f"{path} cannot be read ({error.strerror}): repair or remove it") from error
    if stat.S_ISDIR(found.st_mode):
        return 0
    if not stat.S_ISREG(found.st_mode):
        raise UsageError(f"{path} is neither a file nor a folder: remove it")
    return found.st_size
