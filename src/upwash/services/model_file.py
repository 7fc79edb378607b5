"""Why a file is no ONNX model that can be loaded, where its bytes say more than onnxruntime does."""

from __future__ import annotations

import re
from pathlib import Path
from typing import BinaryIO

from upwash.errors import ModelError

_EXPORT = "export the model to ONNX from what it was trained as (`yolo export model=best.pt format=onnx`)"
_CONVERT = "or convert it by `python -m tf2onnx.convert"
_PYTORCH = f"a zip archive, as PyTorch's .pt files are: {_EXPORT}"
_ENGINE = (
    f"an engine of TensorRT, for one kind of card alone: {_EXPORT}; the detector finds a card by itself "
    "(docs/small-computers.md)"
)
_LITE = f"a model of TensorFlow Lite: {_EXPORT}, {_CONVERT} --tflite FILE --output best.onnx`"
_TENSORFLOW = f"a model of TensorFlow: {_EXPORT}, {_CONVERT} --saved-model FOLDER --output best.onnx`"
_OPENVINO = f"a model of OpenVINO: {_EXPORT}"
_NCNN = f"a model of ncnn: {_EXPORT}"
_KINDS = (
    (
        rb"version https://git-lfs",
        "a pointer of Git LFS and not the file itself: fetch the file with `git lfs pull`",
    ),
    (rb"PK\x03\x04", _PYTORCH),
    (rb"\x80[\x02-\x05]", f"a pickle, as PyTorch's old .pt files are: {_EXPORT}"),
    (rb"\x89HDF", f"an HDF5 file, as Keras writes it: {_EXPORT}"),
    (rb"\x1f\x8b", "compressed by gzip: unpack it"),
    (rb"[fp]trt|(?s:.{4})\{\"", _ENGINE),
    (rb"(?s:.{4})TFL3", _LITE),
    (rb"7767517\s", _NCNN),
    (rb"(<\?xml[^>]*>\s*)?<net ", _OPENVINO),
    (rb"<[!?a-zA-Z]", "a web page or other XML: download the model itself"),
)
_ENDINGS = {  # of files that do not begin as their tools begin them
    ".engine": _ENGINE,
    ".plan": _ENGINE,
    ".tflite": _LITE,
    ".pb": _TENSORFLOW,
    ".xml": _OPENVINO,
    ".pt": f"no ONNX model, by its name one of PyTorch: {_EXPORT}",
}
_IN_FOLDERS = {"saved_model.pb": _TENSORFLOW, "*.xml": _OPENVINO, "*.param": _NCNN}
_AGAIN = "copy, download or export it again"
_MOST_FIELDS = 10_000
_LONGEST_START = 30  # bytes: more than a field's two numbers of at most ten bytes
_LONGEST_BEGINNING = 200  # bytes, with what tells kinds of files apart
_MOST_LETTERS = 2000
# What onnxruntime says before a reason: its own name, the file again, and places in its source.
_BEFORE_REASONS = re.compile(
    r"\[ONNXRuntimeError\] : \d+ : \w+ : (?:Load model from .*? failed:)?"
    r"|/onnxruntime_src/\S+ .*?\) (?=[A-Z\[])"
    r"|\w+\.cc:\d+ \w+ "
)
_AFTER_REASONS = re.compile(r" ; GPU=-?\d+ ;.{0,1000}?expr=[^;]*;")  # of CUDA: the computer's name, the place


def kind_of(start: bytes) -> str:
    """What a file with that start is, and what to do about it; empty for a file that may be a model."""
    return next((kind for pattern, kind in _KINDS if re.match(pattern, start)), "")


def kind_of_folder(folder: Path) -> str:
    """What model a folder has, and what to do about it; empty for no folder, and for one without a known model."""
    return next((kind for name, kind in _IN_FOLDERS.items() if any(folder.glob(name))), "")


def explained(error: ModelError) -> ModelError:
    """The error of a file that onnxruntime did not load, with what the file is instead, or the reason alone."""
    problem = _defect_of(error.file) or reason_in(error.problem)
    if re.search(r"\bopset versions\b|\bIR version\b", problem):
        problem += ": update onnxruntime, or export the model with an older opset"
    if re.search("not a registered function|No opset import for domain", problem):
        problem += ": export it for onnxruntime, without operators of TensorRT or other engines"
    return ModelError(error.file, error.where, problem)


def reason_in(text: str) -> str:
    """What onnxruntime says, without the places in its source."""
    reason = _BEFORE_REASONS.sub("", text[:_MOST_LETTERS])
    return without_places(reason).replace("std::bad_alloc", "it needs more memory than there is")


def without_places(text: str) -> str:
    """What CUDA says in onnxruntime, without the computer's name and the place in its source."""
    return _AFTER_REASONS.sub("", text)


def _defect_of(file: Path) -> str:
    try:
        size = file.stat().st_size
        with file.open("rb") as opened:
            if kind := kind_of(opened.read(_LONGEST_BEGINNING)) or _ENDINGS.get(file.suffix.lower(), ""):
                return f"it is {kind}"
            needed = _needed_bytes(opened, size)
    except OSError as error:
        return f"cannot be read ({error.strerror}): check the path"
    except ValueError:
        return f"it is no ONNX model, or damaged: {_AGAIN}"
    if not size:
        return f"it is empty: {_AGAIN}"
    return f"it is cut off: it has {size:,} of at least {needed:,} bytes: {_AGAIN}" if needed > size else ""


def _needed_bytes(file: BinaryIO, size: int) -> int:
    """How long the file has to be for its fields (protobuf); raises ValueError for what is no field."""
    end = 0
    for _ in range(_MOST_FIELDS):
        if end >= size:
            break
        file.seek(end)
        start = file.read(_LONGEST_START)
        try:
            end += _length_of(start)
        except IndexError:  # the file ends within a number
            return size + 1
    return end


def _length_of(start: bytes) -> int:
    """The length of the field that begins so."""
    tag, at = _number(start, 0)
    if not tag >> 3:
        raise ValueError
    match tag & 7:
        case 0:
            return _number(start, at)[1]
        case 1:
            return at + 8
        case 2:
            length, at = _number(start, at)
            return at + length
        case 5:
            return at + 4
        case _:
            raise ValueError


def _number(start: bytes, at: int) -> tuple[int, int]:
    """The number of seven bits a byte, and where it ends."""
    value = 0
    for bits in range(0, 70, 7):
        value |= (start[at] & 0x7F) << bits
        at += 1
        if start[at - 1] < 0x80:
            return value, at
    raise ValueError
