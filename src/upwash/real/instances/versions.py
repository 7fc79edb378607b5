"""The version of a service on the disk: a fingerprint of its code and of the files that it reads."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Iterator
from itertools import islice
from pathlib import Path

from upwash.ports import Program
from upwash.real.instances.sandbox import code_of, files_in

_UPWASH = Path(__file__).parents[2]
_MOST_FILES = 4096
_MOST_READ_BYTES = 2**28  # beyond this only the size and the time of the last change count


def version_of(program: Program, readable: Iterable[Path] = ()) -> str:
    """A fingerprint of the program's code, of the files that its settings and its command name, and of `readable`.

    It includes the `*.py` files and packages beside a `path/to/file.py`; it does not include upwash or libraries. At
    most 4096 files of each folder are included, and 256 MiB are read in all. The folder around them does not count.
    """
    code = [place for place in code_of(program.path) if not place.is_relative_to(_UPWASH)]
    if program.path.rpartition(":")[0].endswith(".py"):
        code += [neighbour for place in code for neighbour in _neighbours(place)]
    return _fingerprint([*code, *files_in(program.settings), *files_in(program.command), *readable])


def version_of_upwash() -> str:
    """A fingerprint of upwash's own code."""
    return _fingerprint([_UPWASH])


def _neighbours(file: Path) -> Iterator[Path]:
    for place in file.parent.iterdir():
        if place.suffix == ".py" or (place / "__init__.py").exists():
            yield place


def _fingerprint(places: Iterable[Path]) -> str:
    found, left = hashlib.sha256(), _MOST_READ_BYTES
    for place in sorted(set(places)):
        for file in islice(_files(place), _MOST_FILES):
            found.update(f"\0{file.relative_to(place.parent)}\0".encode(errors="surrogateescape"))
            content, read = _content(file, left)
            found.update(content)
            left -= read
    return found.hexdigest()


def _files(place: Path) -> Iterator[Path]:
    """The file, or the folder's files in a fixed order, without hidden files and bytecode."""
    if not place.is_dir():
        yield place
        return
    for folder, folders, files in os.walk(place):
        folders[:] = sorted(name for name in folders if name != "__pycache__" and not name.startswith("."))
        yield from (Path(folder, name) for name in sorted(files) if not name.startswith("."))


def _content(file: Path, at_most: int) -> tuple[bytes, int]:
    """A digest of the file, its size and time, or the error; and how many bytes were read for it."""
    try:
        known = file.stat()
        if not file.is_file() or known.st_size > at_most:
            return f"{known.st_size} {known.st_mtime_ns}".encode(), 0
        with file.open("rb") as opened:
            return hashlib.file_digest(opened, "sha256").digest(), known.st_size
    except OSError as error:
        return str(error.errno).encode(), 0
