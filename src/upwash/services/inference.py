"""A detection network that runs: its model's files, and what onnxruntime or ncnn makes of them."""

from __future__ import annotations

import math
import os
import re
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import msgspec

from upwash.errors import ModelError, UsageError
from upwash.services.class_names import MOST_LABELS, parse_names
from upwash.services.darknet.conversion import Facts, converted
from upwash.services.darknet.graph import INPUT
from upwash.services.darknet.heads import (
    HEADS_METADATA,
    Candidates,
    Head,
    best_of_each,
    decode_heads,
    read_heads,
)
from upwash.services.heads import MOST_VALUES, BoxHead, by, recognise
from upwash.services.model_file import explained, kind_of_folder, reason_in
from upwash.services.photo import DARKNET_GREY, ULTRALYTICS_GREY
from upwash.services.provider import Provider, open_session
from upwash.services.self_test import SelfTest, examined, normalised, test_pictures
from upwash.support.input_files import read_file, text_of
from upwash.support.text import counted, words_of

if TYPE_CHECKING:
    import numpy as np
    import onnxruntime
    from numpy.typing import NDArray

    Floats = NDArray[np.float32]

Engine = Literal["onnxruntime", "ncnn"]

_HALF = "tensor(float16)"
_NAMES_METADATA = "names"  # as Ultralytics writes it
_COARSEST_PX = 32  # where the metadata has no stride
_WAIT_POLICY = "OMP_WAIT_POLICY"
_MOST_LABELS_BYTES = 10_000_000
_LOWEST = 0.001  # score of a box that the self-test looks at, of raw heads
_GIVE_NAMES = "give names, a file with a line for each class"


class ModelFiles(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A network and the names of its classes: Darknet's cfg and weights, or ONNX.

    `names` may be left out where an ONNX model's metadata has names. `heads` describes YOLOv3's raw outputs of an
    ONNX model, where its metadata does not.
    """

    names: Path | None = None
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
        if self.names is None and self.onnx is None:
            raise ValueError("no names: give a file with the name of a class in every line")


def open_inference(files: ModelFiles, *, threads: int, provider: Provider, engine: Engine) -> Inference:
    """Loads the model; raises ModelError for its files and UsageError for what is not installed, or cannot be."""
    if engine == "onnxruntime":
        return open_onnx(files, threads=threads, provider=provider)
    if files.onnx is not None:
        raise UsageError('engine = "ncnn" runs Darknet models: give cfg and weights, or leave the engine out')
    if provider == "cuda":
        raise UsageError('engine = "ncnn" computes on the processor: leave either it or the provider out')
    return NcnnInference(files, threads=threads)


class Inference(ABC):
    """One network, ready to be run on pictures."""

    # Height and width that it takes; what it leaves open is no integer.
    _sides: Sequence[object] = (None, None)

    # What a photo has around it, or whether it fills the picture.
    grey = DARKNET_GREY
    stretched = False

    def __init__(self, file: Path, labels: Sequence[str], heads: tuple[Head, ...]) -> None:
        self._file = file
        self._labels = labels
        self.heads = heads
        self.tested: SelfTest | None = None

    @property
    def frame_px(self) -> tuple[int, int] | None:
        """The height and width of the only pictures that it takes."""
        height, width = self._sides
        return (height, width) if isinstance(height, int) and isinstance(width, int) else None

    @property
    def name(self) -> str:
        """The name of its file."""
        return self._file.name

    def label(self, index: int) -> str:
        """The name of a class; one beyond the names, which an end-to-end network may find, has its number."""
        return self._labels[index] if index < len(self._labels) else f"class {index}"

    def describe(self) -> str:
        """What was recognised, for people; empty where the configuration says all."""
        return ""

    def doubts(self) -> Sequence[str]:
        """What the self-test at loading leaves a person to look at."""
        return self.tested.doubts if self.tested else ()

    def find(self, picture: Floats, *, confidence: float) -> Candidates:
        """The best box of each object that scores above `confidence`, in pixels of the picture."""
        return best_of_each(read_heads(self._run_on_photo(picture), self.heads, confidence=confidence))

    def require_side(self, side_px: int) -> None:
        """Raises ModelError where pictures of that size do not give what the heads say; the first run is slow."""
        self._require_taken(side_px)
        if coarse := [head.stride for head in self.heads if side_px % head.stride]:
            raise UsageError(
                f"a picture of {side_px} pixels is not whole cells of {max(coarse)}: give a multiple of it"
            )
        size_px = self.frame_px or (side_px, side_px)
        tried = self._try(size_px)
        for head, output in zip(self.heads, tried[0], strict=True):
            cells = side_px // head.stride
            expected = (1, len(head.anchors) * (5 + len(self._labels)), cells, cells)
            if output.shape != expected:
                anchors, names = counted(len(head.anchors), "anchor"), counted(len(self._labels), "name")
                raise self._error(
                    f"output {head.output} is {by(output.shape)} for a picture of {side_px}, not {by(expected)}, "
                    f"as {anchors}, {names} and stride {head.stride} say"
                )
        self._examine([read_heads(outputs, self.heads, confidence=_LOWEST) for outputs in tried], size_px)

    def cell_px(self, side_px: int) -> int | None:
        """Of what a picture's shorter side needs to be a multiple, if it need not be `side_px` like the other."""
        cell_px = self._coarsest_px()
        # Three cells do not fill those of a coarser layer inside; one would be repeated to fit.
        few_px = 3 * cell_px
        return cell_px if self._can_run(few_px, side_px) and self._can_run(side_px, few_px) else None

    @abstractmethod
    def run(self, picture: Floats, *, quiet: bool = False) -> list[Floats]:
        """The heads' outputs for a picture of 1, 3, height, width: red, green, blue from 0 to 1.

        With `quiet` a failure is raised only, and not printed.
        """

    def _run_on_photo(self, picture: Floats) -> list[Floats]:
        try:
            return self.run(picture)
        except ModelError:
            raise
        except Exception as error:  # onnxruntime's have no base of their own
            raise self._error(f"it cannot be run on a photo ({reason_in(str(error))})") from error

    def _require_taken(self, side_px: int) -> None:
        if any(isinstance(side, int) and side != side_px for side in self._sides):
            raise self._error(
                f"it takes only pictures of {by(self._sides)}, not {side_px}: export it "
                "with variable height and width, or set light_px and heavy_px"
            )

    def _try(self, size_px: tuple[int, int]) -> list[list[Floats]]:
        """The outputs for the test pictures, or for the grey one alone after the self-test at another size."""
        pictures = islice(test_pictures(size_px), 1 if self.tested else None)
        try:
            return [self.run(picture) for picture in pictures]
        except Exception as error:  # onnxruntime's have no base of their own
            raise self._error(
                f"it cannot be run on a picture of {max(size_px)} ({reason_in(str(error))})"
            ) from error

    def _examine(self, found: Sequence[Candidates], size_px: tuple[int, int], *, pads: bool = False) -> None:
        """The self-test; raises ModelError for a network that cannot work."""
        if self.tested is not None:
            return
        try:
            self.tested = examined(found, size_px=size_px, pads=pads)
        except ValueError as error:
            raise self._error(str(error)) from error

    def _coarsest_px(self) -> int:
        return max(head.stride for head in self.heads)

    def _can_run(self, height_px: int, width_px: int) -> bool:
        import numpy as np

        try:
            outputs = self.run(np.full((1, 3, height_px, width_px), 0.5, np.float32), quiet=True)
        except Exception:  # noqa: BLE001 - onnxruntime's have no base of their own
            return False
        return self._are_whole(outputs, height_px, width_px)

    def _are_whole(self, outputs: list[Floats], height_px: int, width_px: int) -> bool:
        """Whether the outputs for a picture of that size have all its cells."""
        return all(
            output.shape[2:] == (height_px // head.stride, width_px // head.stride)
            for head, output in zip(self.heads, outputs, strict=True)
        )

    def _error(self, problem: str) -> ModelError:
        return ModelError(self._file, "", words_of(problem))


def open_onnx(files: ModelFiles, *, threads: int, provider: Provider) -> OnnxInference:
    """A network that onnxruntime runs: with the raw heads that are described, or with boxes."""
    with _onnx(files) as model:
        try:
            session = open_session(model, threads=threads, provider=provider)
        except ModelError as error:
            raise explained(error) from error
    file = files.onnx or files.weights or model
    try:
        metadata = session.get_modelmeta().custom_metadata_map
        outputs = {output.name: output.shape for output in session.get_outputs()}
        kinds = {output.type for output in session.get_outputs()}
        inputs = _checked_inputs(file, session)
    except UnicodeDecodeError as error:
        raise ModelError(file, "", f"its names or metadata are not text ({error})") from error
    labels = _read_labels(files.names) if files.names else _labels_in(file, metadata)
    heads = files.heads or _heads_in(file, metadata)
    if heads and not labels:
        raise ModelError(file, "", f"its metadata has no names: {_GIVE_NAMES}")
    network = _Loaded(session, *inputs, metadata)
    if strange := [kind for kind in sorted(kinds) if not kind.startswith("tensor(")]:
        raise ModelError(file, "", f"its outputs are {', '.join(strange)}: give a network that detects")
    if not heads:
        return BoxInference(file, labels, network, outputs)
    if outputs and all(len(shape) == 3 for shape in outputs.values()):
        boxes = ", ".join(f"{name}: {by(shape)}" for name, shape in outputs.items())
        problem = f"its outputs are boxes ({boxes}), which have no anchors: leave heads out"
        raise ModelError(file, "", words_of(problem))
    for head in heads:
        if head.output not in outputs:
            problem = f"it has no output {head.output}; its outputs are {', '.join(outputs)}"
            raise ModelError(file, "", words_of(problem))
    return OnnxInference(file, labels, heads, network)


@dataclass(frozen=True, slots=True)
class _Loaded:
    session: onnxruntime.InferenceSession
    pictures: onnxruntime.NodeArg
    sizes: onnxruntime.NodeArg | None  # width and height that boxes are scaled to
    metadata: Mapping[str, str]


class OnnxInference(Inference):
    """A network that onnxruntime runs."""

    def __init__(self, file: Path, labels: Sequence[str], heads: tuple[Head, ...], network: _Loaded) -> None:
        super().__init__(file, labels, heads)
        self._network = network
        self._sides = network.pictures.shape[2:]
        self._outputs = tuple(head.output for head in heads)

    def run(self, picture: Floats, *, quiet: bool = False) -> list[Floats]:
        """As of every network."""
        import numpy as np
        import onnxruntime

        options = onnxruntime.RunOptions()
        options.log_severity_level = 4 if quiet else 3  # errors are raised too
        pictures = self._network.pictures
        given: dict[str, NDArray[Any]] = {
            pictures.name: picture.astype(np.float16) if pictures.type == _HALF else picture
        }
        if (sizes := self._network.sizes) is not None:
            given[sizes.name] = np.array([picture.shape[:1:-1]], np.int64)
        outputs: list[Floats] = self._network.session.run(self._outputs, given, options)
        return outputs


class BoxInference(OnnxInference):
    """A network that onnxruntime runs and that decodes its boxes itself; its head is recognised at its first run."""

    grey = ULTRALYTICS_GREY

    def __init__(
        self,
        file: Path,
        labels: Sequence[str],
        network: _Loaded,
        outputs: Mapping[str, Sequence[object]],
    ) -> None:
        super().__init__(file, labels, (), network)
        if (task := network.metadata.get("task", "detect")) != "detect":
            raise self._error(f"it was exported for the task {task}: give a network that detects")
        for name, shape in outputs.items():
            if math.prod(length for length in shape if isinstance(length, int)) > MOST_VALUES:
                raise self._error(f"output {name} is {by(shape)}: at most {MOST_VALUES:,} numbers are read")
        self._outputs = tuple(outputs)
        self._head: BoxHead | None = None
        self._shapes: dict[int, tuple[int, ...]] = {}  # of the first output, by the side of a square

    def require_side(self, side_px: int) -> None:
        """As of every network."""
        self._require_taken(side_px)
        if self._varies and side_px % self._coarsest_px():
            raise UsageError(
                f"a picture of {side_px} pixels is not whole cells of {self._coarsest_px()}: give a multiple of it"
            )
        size_px = self.frame_px or (side_px, side_px)
        seen = [dict(zip(self._outputs, outputs, strict=True)) for outputs in self._try(size_px)]
        if self._head is None:
            try:
                head = recognise(seen, size_px=size_px, names=len(self._labels))
            except ValueError as error:
                raise self._error(str(error)) from error
            self._head, self._outputs, self.stretched = head, head.outputs, head.family == "DETR"
        found = [self._read([outputs[name] for name in self._outputs], size_px, -1) for outputs in seen]
        self._examine(found, size_px, pads=not self._head.overlaps)
        self._shapes[side_px] = seen[0][self._outputs[0]].shape

    def doubts(self) -> Sequence[str]:
        """As of every network."""
        assert self._head is not None  # noqa: S101 - a side was required
        return (*super().doubts(), *filter(None, [self._head.doubt]))

    def describe(self) -> str:
        """The family of its head and the number of classes."""
        assert self._head is not None  # noqa: S101 - a side was required
        return f"{self._head.family} head, {'1 class' if len(self._labels) == 1 else f'{len(self._labels)} classes'}"

    def cell_px(self, side_px: int) -> int | None:
        """As of every network."""
        if not self._varies or self.stretched:
            return None
        return super().cell_px(side_px)

    def find(self, picture: Floats, *, confidence: float) -> Candidates:
        """As of every network."""
        assert self._head is not None  # noqa: S101 - a side was required
        size_px = picture.shape[2], picture.shape[3]
        if self._head.normalised:
            picture = normalised(picture)
        outputs = self._run_on_photo(picture)
        if (values := sum(output.size for output in outputs)) > MOST_VALUES:
            raise self._error(
                f"its outputs for a photo have {values:,} numbers: at most {MOST_VALUES:,} are read"
            )
        found = self._read(outputs, size_px, confidence)
        return best_of_each(found) if self._head.overlaps else found

    def _read(self, outputs: list[Floats], size_px: tuple[int, int], confidence: float) -> Candidates:
        assert self._head is not None  # noqa: S101 - a side was required
        try:
            return self._head.read(outputs, size_px=size_px, confidence=confidence)
        except (IndexError, ValueError) as error:
            shapes = ", ".join(by(output.shape) for output in outputs)
            raise self._error(
                f"its outputs are {shapes} for a photo, unlike those for the test pictures"
            ) from error

    def _require_taken(self, side_px: int) -> None:
        if self.frame_px is None or max(self.frame_px) != side_px:
            super()._require_taken(side_px)

    @property
    def _varies(self) -> bool:
        return not any(isinstance(side, int) for side in self._sides)

    def _coarsest_px(self) -> int:
        stride = self._network.metadata.get("stride", "")
        return int(stride) if re.fullmatch(r"[1-9]\d{0,3}", stride, re.ASCII) else _COARSEST_PX

    def _are_whole(self, outputs: list[Floats], height_px: int, width_px: int) -> bool:
        """Whether the number of cells is in proportion; end-to-end networks give the same number of boxes."""
        assert self._head is not None  # noqa: S101 - a side was required
        side_px = max(height_px, width_px)
        square = self._shapes.get(side_px, ())
        if self._head.family == "end-to-end":
            return outputs[0].ndim == len(square)
        return math.prod(outputs[0].shape) * side_px**2 == math.prod(square) * height_px * width_px


def _heads_in(file: Path, metadata: Mapping[str, str]) -> tuple[Head, ...]:
    try:
        return decode_heads(metadata.get(HEADS_METADATA, "[]"))
    except msgspec.MsgspecError as error:
        problem = f"its metadata {HEADS_METADATA} cannot be read ({error})"
        raise ModelError(file, "", words_of(problem)) from error


def _labels_in(file: Path, metadata: Mapping[str, str]) -> list[str]:
    """The names of its classes, or none: then its outputs say first whether names would help."""
    if _NAMES_METADATA not in metadata:
        return []
    try:
        return parse_names(metadata[_NAMES_METADATA])
    except ValueError as error:
        problem = f"the names in its metadata cannot be read ({error}): {_GIVE_NAMES}"
        raise ModelError(file, "", words_of(problem)) from error


def _checked_inputs(
    file: Path, session: onnxruntime.InferenceSession
) -> tuple[onnxruntime.NodeArg, onnxruntime.NodeArg | None]:
    """The pictures, and the sizes that exports of RT-DETR scale boxes to."""
    inputs = session.get_inputs()
    pictures = [given for given in inputs if _takes_pictures(given)]
    sizes = [given for given in inputs if given.type == "tensor(int64)" and given.shape[1:] == [2]]
    if len(pictures) != 1 or len(sizes) > 1 or len(inputs) != len(pictures) + len(sizes):
        found = ", ".join(f"{given.type} {given.shape}" for given in inputs) or "none"
        problem = f"its inputs are {found}: one of float 1 x 3 x height x width is needed, of 32 or 16 bits"
        raise ModelError(file, "", words_of(problem))
    return pictures[0], sizes[0] if sizes else None


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
            assert files.names is not None  # noqa: S101
            super().__init__(files.weights, _read_labels(files.names), facts.heads)
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
        kind = kind_of_folder(files.onnx)
        raise ModelError(files.onnx, "", f"it is {kind}" if kind else "it is no file: check the path")
    return nullcontext(files.onnx)


def _takes_pictures(node: onnxruntime.NodeArg) -> bool:
    """Whether an input is 1 x 3 x height x width; what the model leaves open is a name or None."""
    if node.type not in ("tensor(float)", _HALF) or len(node.shape) != 4:
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
    if not 0 < len(labels) <= MOST_LABELS or not all(labels):
        raise ModelError(file, "", "expected the name of a class in every line")
    return labels
