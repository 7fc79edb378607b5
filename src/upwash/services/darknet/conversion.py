"""From cfg and weights to ONNX, once: the result is kept under a name made of what went into it."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import logging
import os
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from upwash.errors import ModelError
from upwash.services.darknet.graph import build_model
from upwash.services.darknet.layers import read_network
from upwash.services.darknet.weights import WeightsFile
from upwash.support.input_files import read_file

_log = logging.getLogger("upwash.detector")

_EDITION = b"1"  # another one whenever the same files would be converted to something else
_MOST_CFG_BYTES = 10_000_000
_MODEL, _NUMBERS = "model.onnx", "model.numbers"


@contextlib.contextmanager
def converted(cfg: Path, weights: Path) -> Iterator[Path]:
    """The ONNX model of a Darknet model, from the cache if it is there; where none can be kept, gone at the end.

    Raises ModelError, with layer and offset, for files that cannot be converted exactly.
    """
    content, digest = _read(cfg, weights)
    write = functools.partial(_write, cfg, content, weights)
    with contextlib.ExitStack() as stack:
        try:
            folder = cache_folder() / digest
            if not (folder / _MODEL).is_file():
                _keep(write, folder)
        except OSError as error:
            _log.warning("the converted model cannot be kept, and is made again at each start: %s", error)
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="upwash-")))
            write(folder)
        yield folder / _MODEL


def cache_folder() -> Path:
    """Where converted models are kept; it may be deleted whenever no detector starts. OSError where there is none."""
    home = os.environ.get("XDG_CACHE_HOME")
    try:
        return (Path(home) if home else Path("~/.cache").expanduser()) / "upwash" / "models"
    except RuntimeError as error:
        raise OSError(str(error)) from error


def _read(cfg: Path, weights: Path) -> tuple[bytes, str]:
    """The cfg's content, and the hash that tells these two files from all others."""
    try:
        content = read_file(cfg, most_bytes=_MOST_CFG_BYTES)
        if weights.exists() and not weights.is_file():
            raise ModelError(weights, "", "it is no file: check the path")
        with weights.open("rb") as file:
            digests = [hashlib.sha256(content).digest(), hashlib.file_digest(file, "sha256").digest()]
    except OSError as error:
        raise ModelError(
            Path(error.filename), "", f"cannot be read ({error.strerror}): check the path"
        ) from None
    except ValueError as error:
        raise ModelError(cfg, "", f"cannot be read ({error}): check the path") from None
    return content, hashlib.sha256(_EDITION + b"".join(digests)).hexdigest()


def _keep(write: Callable[[Path], None], folder: Path) -> None:
    """Makes the folder whole or not at all, whatever is cut off and whoever else does the same."""
    folder.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    with tempfile.TemporaryDirectory(dir=folder.parent, ignore_cleanup_errors=True) as unfinished:
        write(Path(unfinished))
        try:
            Path(unfinished).rename(folder)
        except OSError:
            if not (folder / _MODEL).is_file():  # else someone was faster
                raise


def _write(cfg: Path, content: bytes, weights: Path, folder: Path) -> None:
    network = read_network(cfg, content)
    numbers = WeightsFile(weights, network)
    with (folder / _NUMBERS).open("wb") as file:
        for parameters in numbers.parameters():
            for array in (parameters.weights, parameters.biases):
                file.write(array.astype("<f4", copy=False).tobytes())
        file.flush()
        os.fsync(file.fileno())
    with (folder / _MODEL).open("wb") as file:
        file.write(build_model(network, _NUMBERS).SerializeToString())
        file.flush()
        os.fsync(file.fileno())
