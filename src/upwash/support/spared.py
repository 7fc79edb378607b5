"""The files that a command reads are none that it writes: compared as files, not as names.

Links, other ways to write a path, and names that differ only in case or composition are the same file. Devices and
pipes are none. A command declares its files as it begins; what it reads later, and what it names itself, is compared
with these.
"""

from __future__ import annotations

import contextlib
import os
import stat
import unicodedata
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from upwash.errors import UsageError

Identity = tuple[object, ...]

_IN_FOLDERS = {
    ".jpg",
    ".jpeg",
    ".png",
    ".txt",
    ".mcap",
    ".db3",
    ".yaml",
}  # of folders of photos, labels and bags


class Output(NamedTuple):
    """What an option names: a file or a new folder, or with `is_filled` a folder that files go into."""

    option: str
    path: Path
    is_filled: bool = False


class _Declared(NamedTuple):
    """The files of a command: what names each input, and the outputs."""

    inputs: Mapping[Identity, str] = {}
    outputs: Mapping[Identity, Output] = {}


_declared = _Declared()  # by the one command that a process runs


@contextlib.contextmanager
def sparing(inputs: Iterable[tuple[str, Path]], outputs: Iterable[Output]) -> Iterator[None]:
    """While the block lasts, no output replaces one of the inputs, each with the option that names it.

    Raises UsageError, at once, for an output that is an input or another output, or that lies within another output.
    Photos, labels and bags within a folder that is an input are inputs.
    """
    global _declared  # noqa: PLW0603
    read = {identity: option for option, path in inputs if (identity := _identity(path))}
    before, _declared = _declared, _Declared(read, _written(outputs, read))
    try:
        yield
    finally:
        _declared = before


def require_unnamed(document: object, file: Path) -> None:
    """Raise UsageError where an output of the command is a file that a configuration names, wherever it does.

    A folder stands for the photos, labels or bag in it.
    """
    files = [output for output in _declared.outputs.values() if not output.is_filled and output.path.exists()]
    for word in _words(document) if files else ():
        path = file.absolute().parent / (word.rpartition(":")[0] if ".py:" in word else word)
        identity = _identity(path) if word and _exists(path) else ()
        for output in files if identity else ():
            if identity == _identity(output.path) or (
                identity in _folders(output.path) and _is_of_folder(output)
            ):
                raise UsageError(
                    f"{output.option}: {file} names {output.path}, which is read: name another output"
                )


def require_unwritten(file: Path) -> None:
    """Raise UsageError where an output of the command is this file, which the command reads by itself."""
    output = _declared.outputs.get(_identity(file)) if _exists(file) else None
    if output is not None:
        raise UsageError(f"{output.option}: {file} is read: name another output")


def require_spared(file: Path) -> None:
    """Raise UsageError for an input of the command; of an output that no option names by itself."""
    if _declared.inputs and (option := _declared.inputs.get(_identity(file))):
        raise UsageError(f"{file} would be replaced, and is read ({option}): name another output")


def _written(outputs: Iterable[Output], read: Mapping[Identity, str]) -> Mapping[Identity, Output]:
    written: dict[Identity, Output] = {}
    for output in outputs:
        if not (identity := _identity(output.path)):
            continue
        _require_place(output)
        other = written.get(identity)
        same = "" if output.is_filled and output.path.is_dir() else read.get(identity, "")
        if other is not None and not (output.is_filled and other.is_filled):
            same = other.option
        if same:
            raise UsageError(
                f"{output.option} and {same} are the same file, {output.path}: name another output"
            )
        written[identity] = output
    for output in written.values():
        for folder in _folders(output.path):
            around = written.get(folder)
            if around is not None and not around.is_filled:
                raise UsageError(
                    f"{output.option}: {output.path} would be within {around.option}: name another output"
                )
            if folder in read and _is_of_folder(output):
                raise UsageError(
                    f"{output.option}: {output.path} is a file of {read[folder]}: name another output"
                )
    return written


def _require_place(output: Output) -> None:
    if output.path.is_dir() and not output.is_filled:
        raise UsageError(
            f"{output.option}: {output.path} is a folder: give the name of a file, or of a new folder"
        )
    if output.is_filled and output.path.exists() and not output.path.is_dir():
        raise UsageError(f"{output.option}: {output.path} is a file: give the name of a folder")


def _is_of_folder(output: Output) -> bool:
    return output.path.suffix.lower() in _IN_FOLDERS and output.path.exists()


def _folders(path: Path) -> list[Identity]:
    return [_identity(folder) for folder in Path(os.path.realpath(path)).parents]


def _identity(path: Path) -> Identity:
    """The same for all names of a file, also before the file is made; empty for devices and pipes."""
    whole = Path(os.path.realpath(path))
    try:
        found = whole.stat()
    except (OSError, ValueError):
        name = unicodedata.normalize("NFC", whole.name).casefold()
        return (*_identity(whole.parent), name) if whole.parent != whole else (name,)
    is_file = stat.S_ISREG(found.st_mode) or stat.S_ISDIR(found.st_mode)
    return (found.st_dev, found.st_ino) if is_file else ()


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except (OSError, ValueError):  # no path at all
        return False


def _words(document: object) -> Iterator[str]:
    if isinstance(document, str):
        yield document
    elif isinstance(document, dict):
        for value in document.values():
            yield from _words(value)
    elif isinstance(document, list):
        for value in document:
            yield from _words(value)
