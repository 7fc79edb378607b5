"""An image of a service: its base, its distributions and its program in one file that an engine imports."""

from __future__ import annotations

import compileall
import hashlib
import json
import platform
import shutil
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

from upwash.errors import UpwashError
from upwash.missions.bundled import LoadedService
from upwash.packaging.archive import write_archive
from upwash.packaging.base import Base, lay_base
from upwash.packaging.contents import LIBRARY, PROGRAM, copy_distributions, copy_program, copy_setting
from upwash.ports import Program
from upwash.real.lxd.image import ServiceImage
from upwash.rpc.service import spec_of
from upwash.rpc.settings import with_files

_CREATED_S = 1_700_000_000  # a constant, as the same contents are the same image


@dataclass(frozen=True, slots=True)
class Recipe:
    """What goes into an image of a service."""

    service: LoadedService
    requirements: tuple[str, ...] = ()  # Python distributions, besides upwash's own
    beside: tuple[Path, ...] = ()  # files and folders that the program reads, put beside it
    base: Base = "host"

    @property
    def name(self) -> str:
        """The service's name."""
        return spec_of(self.service.cls).name


def package(recipe: Recipe, folder: Path, *, report: Callable[[str], None]) -> Path:
    """Makes the image in the folder and returns its file, named after the service and the file's own hash.

    Raises UpwashError where a file cannot be copied or written; then nothing is left in the folder.
    """
    try:
        return _package(recipe, folder, report)
    except shutil.Error as error:  # of many files
        (_, _, why), *_ = error.args[0]
        raise UpwashError(
            f"{folder}: the image was not made, and nothing of it is left there: {why}"
        ) from error
    except OSError as error:
        raise UpwashError(
            f"{folder}: the image was not made, and nothing of it is left there: {error}"
        ) from error


def _package(recipe: Recipe, folder: Path, report: Callable[[str], None]) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="upwash-image-", dir=folder) as scratch:
        tree = Path(scratch) / "tree"
        root = tree / "rootfs"
        root.mkdir(parents=True)
        report(f"laying the base: {recipe.base}")
        lay_base(recipe.base, root)
        report("copying the service and what it imports")
        program = _copy_service(recipe, root)
        distributions = copy_distributions(recipe.requirements, root)
        _compile(root)
        _describe(tree, recipe, program, distributions)
        report("packing")
        packed = Path(scratch) / "image.tar.gz"
        write_archive(tree, packed)
        file = folder / f"{recipe.name}-{_hash(packed)[:12]}.tar.gz"
        return packed.rename(file)


def _copy_service(recipe: Recipe, root: Path) -> Program:
    """Copies the service's program and the files that its settings name; returns it as it is in the image."""
    given = recipe.service.program
    path = copy_program(given.path, root, beside=recipe.beside)
    kind = spec_of(recipe.service.cls).settings
    return Program(path, with_files(kind, given.settings, lambda file: copy_setting(file, root)))


def _compile(root: Path) -> None:
    """Compiled here once, as the service may not write in its container."""
    for part in (LIBRARY, PROGRAM):
        compileall.compile_dir(
            root / part,
            quiet=2,
            stripdir=str(root),
            prependdir="/",
            force=True,
            invalidation_mode=compileall.py_compile.PycInvalidationMode.UNCHECKED_HASH,  # type: ignore[attr-defined]
        )


def _describe(tree: Path, recipe: Recipe, program: Program, distributions: Iterable[str]) -> None:
    """What the engine shows of the image, and the daemon knows it by. JSON is YAML too."""
    spec = spec_of(recipe.service.cls)
    image = ServiceImage(
        spec.name,
        program,
        recipe.base,
        platform.python_version(),
        version("upwash"),
        methods=frozenset(spec.methods),
        concurrency=spec.concurrency,
    )
    metadata = {
        "architecture": platform.machine(),
        "creation_date": _CREATED_S,
        "properties": image.properties(),
    }
    (tree / "metadata.yaml").write_text(json.dumps(metadata, indent=1, sort_keys=True))
    (tree / "rootfs" / "opt" / "upwash" / "distributions.txt").write_text("\n".join(distributions) + "\n")


def _hash(file: Path) -> str:
    with file.open("rb") as content:
        return hashlib.file_digest(content, "sha256").hexdigest()
