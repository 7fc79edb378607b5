"""Converts cfg and weights to ONNX or to ncnn's files, and caches the result under the hash of its sources."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import logging
import os
import tempfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Literal

import msgspec

from upwash.errors import ModelError
from upwash.services.darknet.graph import build_model, heads_of
from upwash.services.darknet.heads import Head
from upwash.services.darknet.layers import read_network
from upwash.services.darknet.ncnn import PLAIN_FLOATS, describe
from upwash.services.darknet.weights import WeightsFile
from upwash.services.model_file import kind_of
from upwash.support.input_files import read_file

_log = logging.getLogger("upwash.detector")

Form = Literal["onnx", "ncnn"]

# Change it with each change of the conversion.
_EDITIONS: dict[Form, bytes] = {"onnx": b"1", "ncnn": b"ncnn 1"}
_MOST_CFG_BYTES = 10_000_000
_START_BYTES = 30
_MODELS: dict[Form, str] = {"onnx": "model.onnx", "ncnn": "model.param"}
_NUMBERS = "model.numbers"
_FACTS = "facts.json"


class Facts(msgspec.Struct, frozen=True, kw_only=True):
    """Facts that the files of ncnn, which have no metadata, lack."""

    heads: tuple[Head, ...]
    stride: int  # the largest of all layers

    @classmethod
    def beside(cls, model: Path) -> Facts:
        """The facts of a converted model."""
        return msgspec.json.decode(model.with_name(_FACTS).read_bytes(), type=cls)


@contextlib.contextmanager
def converted(cfg: Path, weights: Path, form: Form = "onnx") -> Iterator[Path]:
    """A Darknet model in that form, from the cache if possible; without a cache the files are gone at the end.

    Beside ncnn's text of layers are its numbers, with the ending `.numbers`, and its Facts.

    Raises ModelError, with layer and offset, for files that cannot be converted exactly.
    """
    content, digest = _read(cfg, weights, _EDITIONS[form])
    write = functools.partial(_write, cfg, content, weights, form)
    model = _MODELS[form]
    with contextlib.ExitStack() as stack:
        try:
            folder = cache_folder() / digest
            if not (folder / model).is_file():
                _keep(write, folder, model)
        except OSError as error:
            _log.warning("the converted model cannot be kept, and is made again at each start: %s", error)
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="upwash-")))
            write(folder)
        yield folder / model


def cache_folder() -> Path:
    """The folder of converted models, which may be deleted while no detector starts; raises OSError without one."""
    home = os.environ.get("XDG_CACHE_HOME")
    try:
        return (Path(home) if home else Path("~/.cache").expanduser()) / "upwash" / "models"
    except RuntimeError as error:
        raise OSError(str(error)) from error


def _read(cfg: Path, weights: Path, edition: bytes) -> tuple[bytes, str]:
    try:
        content = read_file(cfg, most_bytes=_MOST_CFG_BYTES)
        if weights.exists() and not weights.is_file():
            raise ModelError(weights, "", "it is no file: check the path")
        with weights.open("rb") as file:
            if kind := kind_of(file.read(_START_BYTES)):
                raise ModelError(weights, "", f"it is {kind}")
            WeightsFile(weights, read_network(cfg, content))  # reading one of another length may take minutes
            file.seek(0)
            digests = [hashlib.sha256(content).digest(), hashlib.file_digest(file, "sha256").digest()]
    except OSError as error:
        raise ModelError(
            Path(error.filename), "", f"cannot be read ({error.strerror}): check the path"
        ) from None
    except ValueError as error:
        raise ModelError(cfg, "", f"cannot be read ({error}): check the path") from None
    return content, hashlib.sha256(edition + b"".join(digests)).hexdigest()


def _keep(write: Callable[[Path], None], folder: Path, model: str) -> None:
    """Make the folder whole or not at all, also after a crash or beside another process."""
    folder.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    with tempfile.TemporaryDirectory(dir=folder.parent, ignore_cleanup_errors=True) as unfinished:
        write(Path(unfinished))
        try:
            Path(unfinished).rename(folder)
        except OSError:
            if not (folder / model).is_file():  # another process may have been faster
                raise


def _write(cfg: Path, content: bytes, weights: Path, form: Form, folder: Path) -> None:
    network = read_network(cfg, content)
    mark = PLAIN_FLOATS if form == "ncnn" else b""
    numbers = WeightsFile(weights, network).parameters()
    _write_file(folder / _NUMBERS, (mark + convolution.plain() for convolution in numbers))
    if form == "ncnn":
        stride = max(layer.output.stride for layer in network.layers)
        facts = Facts(heads=tuple(heads_of(network)), stride=stride)
        _write_file(folder / _FACTS, [msgspec.json.encode(facts)])
        model = describe(network).encode()
    else:
        model = build_model(network, _NUMBERS).SerializeToString()
    _write_file(folder / _MODELS[form], [model])


def _write_file(file: Path, content: Iterable[bytes]) -> None:
    with file.open("wb") as opened:
        for part in content:
            opened.write(part)
        opened.flush()
        os.fsync(opened.fileno())
