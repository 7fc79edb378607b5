"""An image of a service: its base, its distributions and its program in one file, the same for the same contents."""

from __future__ import annotations

import compileall
import gzip
import hashlib
import json
import os
import platform
import shutil
import stat
import tarfile
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import IO, Literal

from upwash.errors import UpwashError, UsageError
from upwash.missions.bundled import LoadedService
from upwash.packaging.base import ENVIRONMENT, Base, lay_base, lay_init
from upwash.packaging.contents import (
    LIBRARY,
    PROGRAM,
    copy_distributions,
    copy_program,
    copy_setting,
    copy_word,
)
from upwash.ports import Program
from upwash.real.instances.containers import ServiceImage, reference_of
from upwash.rpc.service import spec_of
from upwash.rpc.settings import with_files

Format = Literal["lxd", "docker"]  # LXD's and Incus's, or Docker's and Podman's

_CREATED_S = 1_700_000_000  # of all files too: a constant, as the same contents are the same image
_CREATED = "2023-11-14T22:13:20Z"  # the same
_ARCHITECTURES = {"x86_64": "amd64", "aarch64": "arm64"}  # as Go names them
_COMPRESSION = 1  # higher saves a tenth and takes three times as long


@dataclass(frozen=True, slots=True)
class Recipe:
    """What goes into an image of a service."""

    service: LoadedService
    requirements: tuple[str, ...] = ()  # Python distributions, besides upwash's own
    beside: tuple[Path, ...] = ()  # files and folders that the program reads, put beside it
    base: Base = "host"
    format: Format = "lxd"

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
    except OSError as error:
        why = error.args[0][0][2] if isinstance(error, shutil.Error) else error  # of the first of many files
        raise UpwashError(
            f"{folder}: the image was not made, and nothing of it is left there: {why}"
        ) from error


def _package(recipe: Recipe, folder: Path, report: Callable[[str], None]) -> Path:
    for path in recipe.beside:
        if folder.resolve().is_relative_to(path.resolve()):
            raise UsageError(f"{folder} is in {path}, which is packed: name another folder for the image")
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="upwash-image-", dir=folder) as scratch:
        root = Path(scratch) / "root"
        root.mkdir()
        report(f"laying the base: {recipe.base}")
        lay_base(recipe.base, root)
        report("copying the service and what it imports")
        program = _copy_service(recipe, root)
        distributions = copy_distributions(recipe.requirements, root)
        (root / "opt" / "upwash" / "distributions.txt").write_text("\n".join(distributions) + "\n")
        _compile(root)
        report("packing")
        write = _write_lxd if recipe.format == "lxd" else _write_docker
        packed = write(recipe, root, Path(scratch), _image(recipe, program).properties())
        file = folder / f"{recipe.name}-{_hash(packed)[:12]}{''.join(packed.suffixes)}"
        return packed.rename(file)


def _copy_service(recipe: Recipe, root: Path) -> Program:
    given = recipe.service.program
    path = copy_program(given.path, root, beside=recipe.beside)
    kind = spec_of(recipe.service.cls).settings
    settings = with_files(kind, given.settings, lambda file: copy_setting(file, root))
    command = tuple(copy_word(word, root) for word in given.command)
    return Program(path, settings, command)


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


def _image(recipe: Recipe, program: Program) -> ServiceImage:
    spec = spec_of(recipe.service.cls)
    return ServiceImage(
        spec.name,
        program,
        recipe.base,
        platform.python_version(),
        version("upwash"),
        methods=frozenset(spec.methods),
        concurrency=spec.concurrency,
    )


def _write_lxd(recipe: Recipe, root: Path, scratch: Path, properties: Mapping[str, str]) -> Path:
    """The root beside what the engine shows of the image, and the daemon knows it by. JSON is YAML too."""
    lay_init(recipe.base, root)
    metadata = {"architecture": platform.machine(), "creation_date": _CREATED_S, "properties": properties}
    tree = scratch / "tree"
    tree.mkdir()
    (tree / "metadata.yaml").write_text(json.dumps(metadata, indent=1, sort_keys=True))
    root.rename(tree / "rootfs")
    write_packed(tree, packed := scratch / "image.tar.gz")
    return packed


def _write_docker(recipe: Recipe, root: Path, scratch: Path, properties: Mapping[str, str]) -> Path:
    """What `docker save` writes: one layer, and what the image is, by the OCI image specification's names.

    The layer is compressed, not the file: Podman 4 loads no other.
    """
    tree = scratch / "tree"
    tree.mkdir()
    write_packed(root, layer := tree / "layer.tar.gz")
    config = {
        "architecture": _ARCHITECTURES.get(platform.machine(), platform.machine()),
        "os": "linux",
        "created": _CREATED,
        "config": {"Env": [f"{name}={value}" for name, value in ENVIRONMENT.items()], "Labels": properties},
        "rootfs": {"type": "layers", "diff_ids": [f"sha256:{hash_of_contents(layer)}"]},
        "history": [{"created": _CREATED, "created_by": "upwash package"}],
    }
    about = {"Config": "config.json", "RepoTags": [reference_of(recipe.name)], "Layers": [layer.name]}
    (tree / "config.json").write_text(json.dumps(config, sort_keys=True))
    (tree / "manifest.json").write_text(json.dumps([about], sort_keys=True))
    with (packed := scratch / "image.tar").open("wb") as plain:
        _write(tree, plain)
    return packed


def _hash(file: Path) -> str:
    with file.open("rb") as content:
        return hashlib.file_digest(content, "sha256").hexdigest()


def write_packed(folder: Path, file: Path) -> None:
    """Pack the folder, compressed; files of this user belong to root in the archive."""
    with (
        file.open("wb") as raw,
        gzip.GzipFile("", "wb", compresslevel=_COMPRESSION, fileobj=raw, mtime=_CREATED_S) as packed,
    ):
        _write(folder, packed)


def hash_of_contents(packed: Path) -> str:
    """The SHA-256 of a compressed file's contents."""
    with gzip.open(packed) as contents:
        return hashlib.file_digest(contents, "sha256").hexdigest()


def _write(folder: Path, to: IO[bytes] | gzip.GzipFile) -> None:
    with tarfile.open(fileobj=to, mode="w", format=tarfile.GNU_FORMAT) as archive:
        for path in sorted(folder.rglob("*")):
            archive.add(path, arcname=str(path.relative_to(folder)), recursive=False, filter=_normal)


def _normal(entry: tarfile.TarInfo) -> tarfile.TarInfo:
    entry.mtime = _CREATED_S
    entry.uid = 0 if entry.uid == os.getuid() else entry.uid
    entry.gid = 0 if entry.gid == os.getgid() else entry.gid
    entry.uname = entry.gname = ""
    if entry.isfile() or (entry.isdir() and not entry.mode & stat.S_ISVTX):
        # The umask and set-user-ID bits are left out.
        entry.mode = 0o755 if entry.mode & stat.S_IXUSR else 0o644
    return entry
