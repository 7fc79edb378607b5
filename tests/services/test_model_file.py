"""Files that are no ONNX model are refused as what they are."""

from __future__ import annotations

import os
import pickle
import zipfile
from collections.abc import Callable
from pathlib import Path

import onnx
import pytest
from onnx import TensorProto, helper

from upwash.errors import ModelError
from upwash.services import Detector, ModelFiles


def model(**versions: int) -> onnx.ModelProto:
    picture = helper.make_tensor_value_info("picture", TensorProto.FLOAT, [1, 3, 32, 32])
    boxes = helper.make_tensor_value_info("boxes", TensorProto.FLOAT, [1, 7, 21])
    graph = helper.make_graph([helper.make_node("Identity", ["numbers"], ["boxes"])], "g", [picture], [boxes])
    graph.initializer.append(helper.make_tensor("numbers", TensorProto.FLOAT, [1, 7, 21], [0.0] * 147))
    opset = helper.make_opsetid("", versions.get("opset", 17))
    return helper.make_model(graph, opset_imports=[opset], ir_version=versions.get("ir", 8))


MODEL = model().SerializeToString()


def elsewhere(where: str) -> bytes:
    """A model whose numbers are in another file."""
    changed = model()
    numbers = changed.graph.initializer[0]
    numbers.ClearField("float_data")
    numbers.data_location = TensorProto.EXTERNAL
    location = numbers.external_data.add()
    location.key, location.value = "location", where
    content: bytes = changed.SerializeToString()
    return content


def archive(file: Path) -> None:
    with zipfile.ZipFile(file, "w") as zipped:
        zipped.writestr("archive/data.pkl", pickle.dumps([1]))


def sparse(file: Path) -> None:
    file.touch()
    os.truncate(file, 10**11)


def written(content: bytes) -> Callable[[Path], object]:
    return lambda file: file.write_bytes(content)


LOAD = "onnxruntime cannot load it "
POINTER = b"version https://git-lfs.github.com/spec/v1\noid sha256:0f\nsize 5\n"
FILES: dict[str, tuple[Callable[[Path], object], str]] = {
    "none": (lambda _: None, r"cannot be read \(No such file or directory\): check the path"),
    "folder": (Path.mkdir, "it is no file: check the path"),
    "pipe": (os.mkfifo, "it is no file: check the path"),
    "circle": (lambda file: file.symlink_to(file), r"cannot be read \(Too many levels of symbolic links"),
    "empty": (written(b""), "it is empty: copy, download or export it again"),
    "pointer": (written(POINTER), "it is a pointer of Git LFS .*: fetch that with `git lfs pull`"),
    "PyTorch": (archive, r"it is a zip archive, as PyTorch's \.pt files are: export the model to ONNX"),
    "old PyTorch": (written(pickle.dumps([1], 2)), r"it is a pickle, as .*: export the model to ONNX"),
    "web page": (written(b"<!DOCTYPE html>"), "it is a web page or other XML: download the model itself"),
    "text": (written(b"hello"), "it is no ONNX model, or damaged"),
    "sparse": (sparse, "it is no ONNX model, or damaged"),
    "opset": (written(model(opset=99).SerializeToString()), LOAD + r"\(ONNX Runtime .*: update onnxruntime"),
    "version": (written(model(ir=99).SerializeToString()), LOAD + r"\(Unsupported .*: update onnxruntime"),
    "no data": (written(elsewhere("numbers.bin")), LOAD + r"\(External data path .* does not exist"),
    "other data": (written(elsewhere("../../numbers.bin")), LOAD + r"\(External data path .* not exist|escapes"),
}  # fmt: skip


@pytest.mark.parametrize("kind", FILES)
def test_a_file_that_is_no_model_is_refused_as_what_it_is(kind: str, tmp_path: Path) -> None:
    make, problem = FILES[kind]
    make(tmp_path / "model.onnx")
    with pytest.raises(ModelError, match=rf"model\.onnx: {problem}") as refusal:
        Detector(model=ModelFiles(onnx=tmp_path / "model.onnx"))
    assert "onnxruntime_src" not in str(refusal.value)


@pytest.mark.parametrize("tenths", range(1, 10))
def test_a_model_that_is_cut_off_is_refused_with_both_lengths(tenths: int, tmp_path: Path) -> None:
    cut = MODEL[: len(MODEL) * tenths // 10]
    (tmp_path / "model.onnx").write_bytes(cut)
    with pytest.raises(ModelError, match=rf"it is cut off: it has {len(cut)} of at least \d+ bytes: copy"):
        Detector(model=ModelFiles(onnx=tmp_path / "model.onnx"))
