"""A detection network that runs: its model's files, and onnxruntime's session of it."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import msgspec

from upwash.errors import ModelError, UsageError
from upwash.services.darknet.conversion import converted
from upwash.services.heads import HEADS_METADATA, Head, decode_heads
from upwash.support.input_files import read_file

if TYPE_CHECKING:
    import numpy as np
    import onnxruntime
    from numpy.typing import NDArray

    Floats = NDArray[np.float32]

Provider = Literal["cpu", "cuda"]

_PROVIDERS = {"cpu": "CPUExecutionProvider", "cuda": "CUDAExecutionProvider"}
_MOST_LABELS = 100_000
_MOST_LABELS_BYTES = 10_000_000


class ModelFiles(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A network and the names of its classes: Darknet's cfg and weights, or ONNX with raw heads.

    `heads` says what an ONNX model's outputs mean, where its metadata does not.
    """

    names: Path
    cfg: Path | None = None
    weights: Path | None = None
    onnx: Path | None = None
    heads: tuple[Head, ...] = ()

    def __post_init__(self) -> None:
        given = (self.cfg is not None, self.weights is not None, self.onnx is not None)
        if given not in ((True, True, False), (False, False, True)):
            raise ValueError("no single network: give either cfg and weights, or onnx")
        if self.heads and self.onnx is None:
            raise ValueError("heads are for onnx: a cfg has its own")


class Inference:
    """One network, ready to be run on pictures."""

    def __init__(self, files: ModelFiles, *, threads: int, provider: Provider) -> None:
        """Loads the model; raises ModelError for its files and UsageError for what is not installed."""
        self._provider = provider
        self._file = files.onnx or files.weights or files.names
        self._session = self._open(files, threads, provider)
        self.labels = _read_labels(files.names)
        try:
            self.heads = files.heads or self._heads_in_metadata()
            self._input = self._checked_input()
            outputs = [output.name for output in self._session.get_outputs()]
        except UnicodeDecodeError as error:
            raise self._error(f"its names or metadata are not text ({error})") from error
        for head in self.heads:
            if head.output not in outputs:
                raise self._error(f"it has no output {head.output}; its outputs are {', '.join(outputs)}")

    def require_side(self, side_px: int) -> None:
        """Raises ModelError where pictures of that size do not give what the heads say; the first run is slow."""
        import numpy as np

        fixed = {side for side in self._input.shape[2:] if isinstance(side, int)} - {side_px}
        if fixed:
            raise self._error(
                f"it takes only pictures of {_by(self._input.shape[2:])}, not {side_px}: export it "
                "with variable height and width, or set light_px and heavy_px"
            )
        if coarse := [head.stride for head in self.heads if side_px % head.stride]:
            raise UsageError(
                f"a picture of {side_px} pixels is not whole cells of {max(coarse)}: give a multiple of it"
            )
        try:
            outputs = self.run(np.full((1, 3, side_px, side_px), 0.5, np.float32))
        except Exception as error:  # onnxruntime's have no base of their own
            raise self._error(f"it cannot be run on a picture of {side_px} ({error})") from error
        for head, output in zip(self.heads, outputs, strict=True):
            cells = side_px // head.stride
            expected = (1, len(head.anchors) * (5 + len(self.labels)), cells, cells)
            if output.shape != expected:
                raise self._error(
                    f"output {head.output} is {_by(output.shape)} for a picture of {side_px}, not {_by(expected)}, "
                    f"as {len(head.anchors)} anchors, {len(self.labels)} names and stride {head.stride} say"
                )

    def cell_px(self, side_px: int) -> int | None:
        """Of what a picture's shorter side needs to be a multiple, if it need not be `side_px` like the other."""
        if self._provider == "cuda":  # which prepares itself anew for every size
            return None
        cell_px = max(head.stride for head in self.heads)
        few_px = (
            3 * cell_px
        )  # an odd number, which the cells of any coarser layer inside do not fill; one is broadcast
        return cell_px if self._can_run(few_px, side_px) and self._can_run(side_px, few_px) else None

    def run(self, picture: Floats) -> list[Floats]:
        """The heads' outputs for a picture of 1, 3, height, width: red, green, blue from 0 to 1."""
        return self._run(picture, None)

    def _run(self, picture: Floats, options: onnxruntime.RunOptions | None) -> list[Floats]:
        names = [head.output for head in self.heads]
        outputs: list[Floats] = self._session.run(names, {self._input.name: picture}, options)
        return outputs

    def _can_run(self, height_px: int, width_px: int) -> bool:
        """Whether a picture of that size gives as many cells as it has."""
        import numpy as np
        import onnxruntime

        options = onnxruntime.RunOptions()
        options.log_severity_level = 4  # not even errors: to fail is an answer
        try:
            outputs = self._run(np.full((1, 3, height_px, width_px), 0.5, np.float32), options)
        except Exception:  # noqa: BLE001 - onnxruntime's have no base of their own
            return False
        return all(
            output.shape[2:] == (height_px // head.stride, width_px // head.stride)
            for head, output in zip(self.heads, outputs, strict=True)
        )

    def _open(self, files: ModelFiles, threads: int, provider: Provider) -> onnxruntime.InferenceSession:
        import onnxruntime

        if _PROVIDERS[provider] not in onnxruntime.get_available_providers():
            raise UsageError(
                f'provider = "{provider}" is not in the onnxruntime that is installed; for cuda install '
                "onnxruntime-gpu in its place"
            )
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        options.log_severity_level = 3  # errors only: they are raised too
        with _onnx(files) as model:
            try:
                session = onnxruntime.InferenceSession(str(model), options, providers=[_PROVIDERS[provider]])
            except Exception as error:  # onnxruntime's have no base of their own
                raise ModelError(model, "", f"onnxruntime cannot load it ({error})") from error
        if _PROVIDERS[provider] not in session.get_providers():
            raise UsageError(f'provider = "{provider}" cannot run here; onnxruntime says why above')
        return session

    def _heads_in_metadata(self) -> tuple[Head, ...]:
        metadata = self._session.get_modelmeta().custom_metadata_map.get(HEADS_METADATA, "[]")
        try:
            heads = decode_heads(metadata)
        except msgspec.MsgspecError as error:
            raise self._error(f"its metadata {HEADS_METADATA} cannot be read ({error})") from error
        if not heads:
            raise self._error(f"nothing says what its outputs mean: give heads, or metadata {HEADS_METADATA}")
        return heads

    def _checked_input(self) -> onnxruntime.NodeArg:
        inputs = self._session.get_inputs()
        if len(inputs) != 1 or not _takes_pictures(inputs[0]):
            raise self._error(
                f"its inputs are {', '.join(f'{each.type} {each.shape}' for each in inputs) or 'none'}: one of float "
                "1 x 3 x height x width is needed"
            )
        return inputs[0]

    def _error(self, problem: str) -> ModelError:
        return ModelError(self._file, "", problem)


def _onnx(files: ModelFiles) -> AbstractContextManager[Path]:
    """The ONNX model's file, which the session no longer needs once it is made."""
    if files.cfg is not None and files.weights is not None:
        return converted(files.cfg, files.weights)
    assert files.onnx is not None  # noqa: S101 - it has the one or the other
    if files.onnx.exists() and not files.onnx.is_file():
        raise ModelError(files.onnx, "", "it is no file: check the path")
    return nullcontext(files.onnx)


def _takes_pictures(node: onnxruntime.NodeArg) -> bool:
    """Whether an input is 1 x 3 x height x width; what the model leaves open is a name or None."""
    if node.type != "tensor(float)" or len(node.shape) != 4:
        return False
    pictures, channels = node.shape[:2]
    return channels == 3 and (pictures == 1 or not isinstance(pictures, int))


def _read_labels(file: Path) -> list[str]:
    try:
        labels = [
            line.strip()
            for line in read_file(file, most_bytes=_MOST_LABELS_BYTES).decode().rstrip().splitlines()
        ]
    except OSError as error:
        raise ModelError(file, "", f"cannot be read ({error.strerror})") from None
    except UnicodeDecodeError as error:
        raise ModelError(file, f"byte {error.start}", "not text: give a file with one name a line") from None
    except ValueError as error:
        raise ModelError(file, "", f"cannot be read ({error}): give a file with one name a line") from None
    if not 0 < len(labels) <= _MOST_LABELS or not all(labels):
        raise ModelError(file, "", "expected the name of a class in every line")
    return labels


def _by(shape: Iterable[object]) -> str:
    return " x ".join(map(str, shape))
