"""The contents of an image: the service's own files, and its Python distributions as they are installed here."""

from __future__ import annotations

import ast
import csv
import hashlib
import importlib.util
import json
import os
import shlex
import shutil
import stat
import sys
from collections.abc import Collection, Iterable, Iterator
from importlib.machinery import PathFinder
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from itertools import chain
from pathlib import Path, PurePath, PurePosixPath
from typing import TYPE_CHECKING
from urllib.parse import unquote, urlsplit

from upwash.errors import UsageError
from upwash.packaging.private_keys import private_key_in
from upwash.support.input_files import with_data
from upwash.support.loading import extra, pip
from upwash.support.text import printable

_MOST_FILES = 100_000
_MOST_BYTES = 32 * 2**30
_MOST_NAMED = 5
_LEFT_OUT = {"__pycache__", "tests"}


if TYPE_CHECKING:
    from packaging.requirements import Requirement

LIBRARY = "opt/upwash/lib"  # below the image's root
PROGRAM = "opt/upwash/program"
SETTINGS = "opt/upwash/settings"

# Of upwash's own requirements those that a service instance and its container's init import.
_OF_EVERY_INSTANCE = ("grpcio", "msgspec")


def copy_program(program: str, root: Path, *, beside: Collection[Path] = ()) -> str:
    """Copies a service's module or file, and what lies `beside` it; returns its import path in the image."""
    module, _, name = program.rpartition(":")
    for path in beside:
        if (root / PROGRAM / path.name).exists():
            raise UsageError(f"{path}: another file beside the program has that name: rename one of the two")
        _copy(path, root / PROGRAM / path.name)
    if module.endswith(".py"):
        file = Path(module)
        require_neighbours(file, beside)
        _copy(file, root / PROGRAM / file.name)
        return f"/{PROGRAM}/{file.name}:{name}"
    top = module.partition(".")[0]
    if top != "upwash":
        _copy(_source(top), root / LIBRARY / _source(top).name)
    return program


def copy_setting(file: Path, root: Path) -> Path:
    """Copies a file or folder that a setting names, and the file's data beside it.

    Returns its path in the image, the same for the same contents.
    """
    require_packable(file)
    files = with_data(file)
    folder = Path(SETTINGS, _hash(*files))
    for copied in files:
        _copy(copied, root / folder / copied.name)
    return Path("/") / folder / file.name


def copy_word(word: str, root: Path) -> str:
    """A word of a command as it is in the image: a file that it names is copied, unless it is the system's."""
    file = Path(word)
    if not file.is_absolute() or file.is_relative_to("/usr") or not file.is_file():
        return word
    copied = copy_setting(file, root)
    (root / copied.relative_to("/")).chmod(file.stat().st_mode & 0o777)
    return str(copied)


def copy_distributions(requirements: Iterable[str], root: Path) -> list[str]:
    """Copies upwash and the requirements, with their own requirements; returns names and versions, sorted."""
    library = root / LIBRARY
    _copy(_source("upwash"), library / "upwash")
    found: dict[str, Distribution] = {}
    for requirement in (*_OF_EVERY_INSTANCE, *requirements):
        _close(requirement, found)
    found.pop("upwash", None)
    for installed in found.values():
        for file, source in _files_of(installed):
            target = library / file
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source, target)
    return sorted({f"{installed.name} {installed.version}" for installed in found.values()})


def _files_of(installed: Distribution) -> Iterator[tuple[PurePath, Path]]:
    """The files of a distribution, by their places below its library.

    Raises UsageError if the installation lacks some, since the service would not start then.
    """
    name = installed.name
    origin = json.loads(installed.read_text("direct_url.json") or "{}")
    if origin.get("dir_info", {}).get("editable"):
        folder = shlex.quote(unquote(urlsplit(origin.get("url", "")).path))
        raise UsageError(
            f"{name} is an editable installation, whose code is elsewhere: "
            f"`{pip(f'install --force-reinstall --no-deps {folder}')}` installs it whole, then package again"
        )
    record = installed.read_text("RECORD")
    if record is None:
        raise UsageError(
            f"{name} has no list of its files, so it cannot be packaged: install it with "
            f"`{pip(f'install --ignore-installed {name}=={installed.version}')}` in the Python that runs upwash"
        )
    for row in csv.reader(
        record.splitlines()
    ):  # Distribution.files leaves missing files out, since Python 3.12
        file = PurePosixPath(row[0])
        source = Path(str(installed.locate_file(file)))
        if ".." in file.parts or file.is_absolute() or is_left_out(file):
            continue
        if not source.is_file():
            again = pip(f"install --force-reinstall --no-deps {name}=={installed.version}")
            raise UsageError(
                f"{source} of {name} is missing: `{again}` installs it whole, then package again"
            )
        yield file, source


def extra_of(service: str, engine: str) -> list[str]:
    """What the extra of upwash with the service's name requires; nothing where there is no such extra.

    It takes a library that the extra of the engine brings.
    """
    with extra(engine):
        from packaging.requirements import Requirement
    own = map(Requirement, distribution("upwash").requires or ())
    return [
        _without_marker(required)
        for required in own
        if required.marker is not None
        and required.marker.evaluate({"extra": service})
        and not required.marker.evaluate({"extra": ""})
    ]


def _close(text: str, found: dict[str, Distribution]) -> None:
    from packaging.requirements import Requirement

    required = Requirement(text)
    try:
        known = distribution(required.name)
    except PackageNotFoundError:
        raise UsageError(
            f"{required.name} is not installed here: install it, so that it can be packaged"
        ) from None
    wanted = {known.name, *(f"{known.name}[{extra}]" for extra in required.extras)}
    if wanted <= found.keys():
        return
    found |= dict.fromkeys(wanted, known)
    for inner in map(Requirement, known.requires or ()):
        extras = ("", *required.extras)
        if inner.marker is None or any(inner.marker.evaluate({"extra": extra}) for extra in extras):
            _close(_without_marker(inner), found)


def _without_marker(required: Requirement) -> str:
    return str(required).partition(";")[0].strip()


def _hash(*paths: Path) -> str:
    """Tells two files of one name apart."""
    found = hashlib.sha256()
    for path in paths:
        for file in filter(Path.is_file, sorted(path.rglob("*")) if path.is_dir() else [path]):
            with file.open("rb") as content:
                hashlib.file_digest(content, lambda: found)
    return found.hexdigest()[:12]


def _source(module: str) -> Path:
    spec = importlib.util.find_spec(module)
    if spec is not None and spec.submodule_search_locations:
        return Path(next(iter(spec.submodule_search_locations)))
    if spec is None or spec.origin is None:
        raise UsageError(f"{module} cannot be packaged: there is no such module here")
    return Path(spec.origin)


def _copy(source: Path, target: Path) -> None:
    require_packable(source)
    target.parent.mkdir(parents=True, exist_ok=True)
    if source.is_dir():
        left_out = shutil.ignore_patterns("*.pyc", *_LEFT_OUT)
        shutil.copytree(source, target, ignore=left_out, dirs_exist_ok=True)
    else:
        shutil.copyfile(source, target)


def is_left_out(path: PurePath) -> bool:
    """Whether images go without it."""
    return path.suffix == ".pyc" or not _LEFT_OUT.isdisjoint(path.parts)


def require_packable(source: Path) -> None:
    """Raises UsageError if a file or folder, or its contents, cannot be put into an image."""
    if not source.exists():
        raise UsageError(f"{source}: no such file: check the path")
    size, whole, keys = 0, source.resolve(), []
    for files, path in enumerate(chain([whole], _below(whole))):
        if path.is_symlink() and (path.is_dir() or not path.resolve().is_relative_to(whole)):
            raise UsageError(
                f"{path} is a link to {path.resolve()}: put the files themselves there (`cp -rL`)"
            )
        size += _size(path)
        if files > _MOST_FILES or size > _MOST_BYTES:
            raise UsageError(
                f"{source} has more than {_MOST_FILES} files or {_MOST_BYTES // 2**30} GiB: "
                "name a folder that has only what the service needs"
            )
        if path.is_file() and (kind := private_key_in(path)):
            keys.append(f"{path} is {kind}")
    if keys:
        more = f", and {len(keys) - _MOST_NAMED} more" if len(keys) > _MOST_NAMED else ""
        raise UsageError(
            f"{'; '.join(keys[:_MOST_NAMED])}{more}: everybody who gets the image would have the key. Leave it out: "
            "pack only the files that the service needs, and let the service read a key where it runs"
        )


def require_neighbours(program: Path, beside: Iterable[Path]) -> None:
    """Raises UsageError if a program, or a file beside it, imports a file of its folder that is not packed."""
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
    nodes = list(ast.walk(ast.parse(file.read_bytes(), file)))
    named = [alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names]
    named += [node.module for node in nodes if isinstance(node, ast.ImportFrom) and node.module]
    return {name.partition(".")[0] for name in named}


def _below(folder: Path) -> Iterator[Path]:
    for where, folders, files in os.walk(folder):
        folders[:] = [name for name in folders if not is_left_out(PurePath(name))]
        yield from (Path(where, name) for name in (*folders, *files) if not is_left_out(PurePath(name)))


def _size(path: Path) -> int:
    """The bytes of a file, 0 of a folder; raises UsageError for devices, pipes and sockets."""
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
        raise UsageError(f"{path} is not a file or folder: remove it")
    return found.st_size
