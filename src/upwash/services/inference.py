"""A detection network that runs: its model's files, and what onnxruntime or ncnn makes of them."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import msgspec

from upwash.errors import ModelError, UsageError
from upwash.services.darknet.conversion import Facts, converted
from upwash.services.darknet.graph import INPUT
from upwash.services.darknet.heads import HEADS_METADATA, Head, decode_heads
from upwash.services.provider import Provider, open_session
from upwash.support.input_files import read_file, text_of
from upwash.support.text import counted, words_of

if TYPE_CHECKING:
    import numpy as np
    import onnxruntime
    from numpy.typing import NDArray

    Floats = NDArray[np.float32]

Engine = Literal["onnxruntime", "ncnn"]

_WAIT_POLICY = "OMP_WAIT_POLICY"
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


def open_inference(files: ModelFiles, *, threads: int, provider: Provider, engine: Engine) -> Inference:
    """Loads the model; raises ModelError for its files and UsageError for what is not installed, or cannot be."""
    if engine == "onnxruntime":
        return OnnxInference(files, threads=threads, provider=provider)
    if files.onnx is not None:
        raise UsageError('engine = "ncnn" runs Darknet models: give cfg and weights, or leave the engine out')
    if provider != "cpu":
        raise UsageError('engine = "ncnn" computes on the processor: leave either it or the provider out')
    return NcnnInference(files, threads=threads)


class Inference(ABC):
    """One network, ready to be run on pictures."""

    # Height and width that it takes; what it leaves open is no integer.
    _sides: Sequence[object] = (None, None)
    _prepares_for_each_size = False

    def __init__(self, files: ModelFiles, heads: tuple[Head, ...]) -> None:
        self._file = files.onnx or files.weights or files.names
        self.labels = _read_labels(files.names)
        self.heads = heads

    def require_side(self, side_px: int) -> None:
        """Raises ModelError where pictures of that size do not give what the heads say; the first run is slow."""
        import numpy as np

        if any(isinstance(side, int) and side != side_px for side in self._sides):
            raise self._error(
                f"it takes only pictures of {_by(self._sides)}, not {side_px}: export it "
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
                anchors, names = counted(len(head.anchors), "anchor"), counted(len(self.labels), "name")
                raise self._error(
                    f"output {head.output} is {_by(output.shape)} for a picture of {side_px}, not {_by(expected)}, "
                    f"as {anchors}, {names} and stride {head.stride} say"
                )

    def cell_px(self, side_px: int) -> int | None:
        """Of what a picture's shorter side needs to be a multiple, if it need not be `side_px` like the other."""
        if self._prepares_for_each_size:
            return None
        cell_px = max(head.stride for head in self.heads)
        # Three cells do not fill those of a coarser layer inside; one would be repeated to fit.
        few_px = 3 * cell_px
        return cell_px if self._can_run(few_px, side_px) and self._can_run(side_px, few_px) else None

    @abstractmethod
    def run(self, picture: Floats, *, quiet: bool = False) -> list[Floats]:
        """The heads' outputs for a picture of 1, 3, height, width: red, green, blue from 0 to 1.

        With `quiet` a failure is raised only, and not printed.
        """

    def _can_run(self, height_px: int, width_px: int) -> bool:
        import numpy as np

        try:
            outputs = self.run(np.full((1, 3, height_px, width_px), 0.5, np.float32), quiet=True)
        except Exception:  # noqa: BLE001 - onnxruntime's have no base of their own
            return False
        return all(
            output.shape[2:] == (height_px // head.stride, width_px // head.stride)
            for head, output in zip(self.heads, outputs, strict=True)
        )

    def _error(self, problem: str) -> ModelError:
        return ModelError(self._file, "", words_of(problem))


class OnnxInference(Inference):
    """A network that onnxruntime runs."""

    def __init__(self, files: ModelFiles, *, threads: int, provider: Provider) -> None:
        with _onnx(files) as model:
            self._session = open_session(model, threads=threads, provider=provider)
        super().__init__(files, files.heads)
        try:
            self._require_raw_heads()
            self.heads = files.heads or self._heads_in_metadata()
            self._input = self._checked_input()
            outputs = [output.name for output in self._session.get_outputs()]
        except UnicodeDecodeError as error:
            raise self._error(f"its names or metadata are not text ({error})") from error
        for head in self.heads:
            if head.output not in outputs:
                raise self._error(f"it has no output {head.output}; its outputs are {', '.join(outputs)}")
        self._sides = self._input.shape[2:]
        self._prepares_for_each_size = provider == "cuda"

    def run(self, picture: Floats, *, quiet: bool = False) -> list[Floats]:
        """As of every network."""
        import onnxruntime

        options = onnxruntime.RunOptions()
        options.log_severity_level = 4 if quiet else 3  # errors are raised too
        names = [head.output for head in self.heads]
        outputs: list[Floats] = self._session.run(names, {self._input.name: picture}, options)
        return outputs

    def _require_raw_heads(self) -> None:
        """Raises ModelError for a network whose outputs are decoded boxes, as YOLOv8's and later ones' are."""
        outputs = self._session.get_outputs()
        if outputs and all(len(output.shape) == 3 for output in outputs):
            boxes = ", ".join(f"{output.name}: {_by(output.shape)}" for output in outputs)
            raise self._error(
                f"its outputs are boxes ({boxes}), as of YOLOv8 and later, and it has no anchors: "
                "give a network with YOLOv3's raw heads, or run the network in a service of your own"
            )

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
            found = ", ".join(f"{given.type} {given.shape}" for given in inputs) or "none"
            raise self._error(f"its inputs are {found}: one of float 1 x 3 x height x width is needed")
        return inputs[0]


class NcnnInference(Inference):
    """A Darknet network that ncnn runs, with 32-bit floats throughout."""

    def __init__(self, files: ModelFiles, *, threads: int) -> None:
        with _threads_that_sleep():
            import ncnn

        assert files.cfg is not None  # noqa: S101 - else it is an ONNX model
        assert files.weights is not None  # noqa: S101
        self._net = ncnn.Net()
        options = self._net.opt
        options.num_threads = threads
        options.use_fp16_packed = options.use_fp16_storage = options.use_fp16_arithmetic = False
        options.use_bf16_storage = False
        with converted(files.cfg, files.weights, "ncnn") as model:
            facts = Facts.beside(model)
            super().__init__(files, facts.heads)
            self._stride = facts.stride
            if self._net.load_param(str(model)) or self._net.load_model(str(model.with_suffix(".numbers"))):
                raise ModelError(model, "", "ncnn cannot load it")

    def require_side(self, side_px: int) -> None:
        """As of every network; ncnn itself does not look whether the layers of a picture fit each other."""
        if side_px % self._stride:
            raise UsageError(
                f"a picture of {side_px} pixels is not whole cells of {self._stride}: give a multiple of it"
            )
        super().require_side(side_px)

    def cell_px(self, side_px: int) -> int | None:
        """The largest stride of all layers."""
        return self._stride

    def run(self, picture: Floats, *, quiet: bool = False) -> list[Floats]:
        """As of every network."""
        import ncnn
        import numpy as np

        extractor = self._net.create_extractor()
        extractor.input(INPUT, ncnn.Mat(picture[0]))
        outputs = []
        for head in self.heads:
            failed, output = extractor.extract(head.output)
            if failed:
                raise self._error(f"ncnn failed with {failed}")
            outputs.append(np.array(output)[np.newaxis])
        return outputs


@contextmanager
def _threads_that_sleep() -> Iterator[None]:
    """What is loaded meanwhile and has OpenMP's threads has them sleep where they wait for each other.

    Threads that spin instead cost several times the processor's time as soon as a core has something else to do.
    """
    if _WAIT_POLICY in os.environ:
        yield
        return
    os.environ[_WAIT_POLICY] = "passive"
    try:
        yield
    finally:
        del os.environ[_WAIT_POLICY]


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
            for line in text_of(read_file(file, most_bytes=_MOST_LABELS_BYTES)).rstrip().splitlines()
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
