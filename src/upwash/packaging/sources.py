"""What may be put into an image: files and folders alone, nothing that leads elsewhere, and not without bound."""

from __future__ import annotations

import ast
import os
import shlex
import stat
import sys
from collections.abc import Iterable, Iterator
from importlib.machinery import PathFinder
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


def require_neighbours(program: Path, beside: Iterable[Path]) -> None:
    """Raises UsageError where a program, or what lies beside it, imports a file of its folder that is not packed."""
    given = [program, *beside]
    names = {path.name for path in given}
    for file in (path for path in given if path.suffix == ".py" and path.is_file()):
        for module in _imported_by(file):
            found = PathFinder.find_spec(module, [*sys.path, str(program.resolve().parent)])
            places = [] if found is None else [*(found.submodule_search_locations or ()), found.origin or "/"]
            neighbour = Path(next(iter(places), "/"))
            if neighbour.parent == program.resolve().parent and neighbour.name not in names:
                raise UsageError(
                    f"{file} imports {neighbour}: pack it too, with --include {shlex.quote(str(neighbour))}"
                )


def _imported_by(file: Path) -> set[str]:
    """The top names of the modules that a file imports anywhere in it."""
    statements = list(ast.walk(ast.parse(file.read_bytes(), file)))
    named = [alias.name for each in statements if isinstance(each, ast.Import) for alias in each.names]
    named += [each.module for each in statements if isinstance(each, ast.ImportFrom) and each.module]
    return {name.partition(".")[0] for name in named}


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
