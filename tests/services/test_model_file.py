"""Files that are no ONNX model are refused as what they are."""

from __future__ import annotations

import os
import pickle
import tempfile
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import onnx
import pytest
from hypothesis import given
from hypothesis import strategies as st
from onnx import TensorProto, helper

from upwash.errors import ModelError, UsageError
from upwash.services import Detector, ModelFiles


def model(**versions: int) -> onnx.ModelProto:
    picture = helper.make_tensor_value_info("picture", TensorProto.FLOAT, [1, 3, 32, 32])
    boxes = helper.make_tensor_value_info("boxes", TensorProto.FLOAT, [1, 7, 21])
    graph = helper.make_graph([helper.make_node("Identity", ["numbers"], ["boxes"])], "g", [picture], [boxes])
    graph.initializer.append(helper.make_tensor("numbers", TensorProto.FLOAT, [1, 7, 21], [0.0] * 147))
    opset = helper.make_opsetid("", versions.get("opset", 17))
    made = helper.make_model(graph, opset_imports=[opset], ir_version=versions.get("ir", 8))
    helper.set_model_props(made, {"names": "['a', 'b', 'c']"})
    return made


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


def with_an_operator_of_tensorrt() -> bytes:
    changed = model()
    changed.graph.node[0].op_type, changed.graph.node[0].domain = "EfficientNMS_TRT", "TRT"
    changed.opset_import.append(helper.make_opsetid("TRT", 1))
    content: bytes = changed.SerializeToString()
    return content


def larger_than_memory(file: Path) -> None:
    large = onnx.ModelProto.FromString(elsewhere("large.bin"))
    large.graph.initializer[0].dims[:] = [2 * 10**12]
    large.graph.node[0].CopyFrom(helper.make_node("ReduceSum", ["numbers"], ["boxes"]))
    onnx.save(large, file)
    (file.parent / "large.bin").touch()
    os.truncate(file.parent / "large.bin", 8 * 10**12)


def archive(file: Path) -> None:
    with zipfile.ZipFile(file, "w") as zipped:
        zipped.writestr("archive/data.pkl", pickle.dumps([1]))


def sparse(file: Path) -> None:
    file.touch()
    os.truncate(file, 10**11)


def in_folder(name: str) -> Callable[[Path], object]:
    def make(folder: Path) -> None:
        folder.mkdir()
        (folder / name).touch()

    return make


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
    "pointer": (written(POINTER), "it is a pointer of Git LFS .*: fetch the file with `git lfs pull`"),
    "PyTorch": (archive, r"it is a zip archive, as PyTorch's \.pt files are: export the model to ONNX"),
    "old PyTorch": (written(pickle.dumps([1], 2)), r"it is a pickle, as .*: export the model to ONNX"),
    "TensorRT": (written(b"ftrt\0\0"), "it is an engine of TensorRT, .*: export .* model=best.pt format=onnx"),
    "TensorRT of Ultralytics": (written(b'\x10\0\0\0{"task": "detect"}'), "it is an engine of TensorRT"),
    "TensorFlow Lite": (written(b"\x1c\0\0\0TFL3"), "it is a model of TensorFlow Lite: .*tf2onnx.convert --tflite"),
    "OpenVINO": (written(b'<?xml version="1.0"?>\n<net name="g">'), "it is a model of OpenVINO: export the model to"),
    "OpenVINO's folder": (in_folder("best.xml"), "it is a model of OpenVINO: export the model to ONNX"),
    "SavedModel": (in_folder("saved_model.pb"), "it is a model of TensorFlow: .*tf2onnx.convert --saved-model"),
    "web page": (written(b"<!DOCTYPE html>"), "it is a web page or other XML: download the model itself"),
    "text": (written(b"hello"), "it is no ONNX model, or damaged"),
    "sparse": (sparse, "it is no ONNX model, or damaged"),
    "opset": (written(model(opset=99).SerializeToString()), LOAD + r"\(ONNX Runtime .*: update onnxruntime"),
    "version": (written(model(ir=99).SerializeToString()), LOAD + r"\(Unsupported .*: update onnxruntime"),
    "operator": (written(with_an_operator_of_tensorrt()), LOAD + ".*EfficientNMS_TRT.*: export it for onnxruntime"),
    "large": (larger_than_memory, LOAD + r"\(.*it needs more memory than there is"),
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


@pytest.mark.parametrize(
    ("name", "kind"),
    [("best.pb", "TensorFlow"), ("best.engine", "TensorRT"), ("best.tflite", "Lite"), ("best.pt", "PyTorch")],
)
def test_a_file_that_begins_like_no_other_is_known_by_its_ending(
    name: str, kind: str, tmp_path: Path
) -> None:
    (tmp_path / name).write_bytes(b"\n\x05\n\x03abc")
    with pytest.raises(ModelError, match=rf"{name}: it is .*{kind}.*: export the model to ONNX"):
        Detector(model=ModelFiles(onnx=tmp_path / name))


@pytest.mark.parametrize("tenths", range(1, 10))
def test_a_model_that_is_cut_off_is_refused_with_both_lengths(tenths: int, tmp_path: Path) -> None:
    cut = MODEL[: len(MODEL) * tenths // 10]
    (tmp_path / "model.onnx").write_bytes(cut)
    with pytest.raises(ModelError, match=rf"it is cut off: it has {len(cut)} of at least \d+ bytes: copy"):
        Detector(model=ModelFiles(onnx=tmp_path / "model.onnx"))


# --- fields that say something else ---------------------------------------------------------------------------

INTEGERS = (0, 1, -1, 3, 7, 32, 10**6, 2**31 - 1, -(2**31), 2**63 - 1, -(2**63))
WORDS = (
    b"",
    b"picture",
    b"numbers",
    b"boxes",
    b"Loop",
    b"Resize",
    b"TopK",
    b"{0: 'a'}",
    b"\n\x1b[2J",
    b"x" * 3000,
)
PHOTO = cv2.imencode(".jpg", np.full((30, 40, 3), 90, np.uint8))[1].tobytes()


def messages(message: Any) -> Iterator[Any]:
    """The message and each message within it."""
    yield message
    for field, value in message.ListFields():
        if field.message_type is not None:
            for part in value if field.is_repeated else [value]:
                yield from messages(part)


def change(message: Any, data: st.DataObject) -> None:
    """One of its fields is absent, there twice, or something else."""
    field = data.draw(st.sampled_from(list(message.DESCRIPTOR.fields)))
    there = getattr(message, field.name)
    if data.draw(st.booleans()):
        message.ClearField(field.name)
    elif field.message_type is not None:
        if field.is_repeated:
            there.add().CopyFrom(there[0]) if there else there.add()
        else:
            there.SetInParent()
    else:
        kinds: dict[Any, st.SearchStrategy[Any]] = {
            field.CPPTYPE_STRING: st.sampled_from(WORDS),
            field.CPPTYPE_FLOAT: st.floats(width=32),
            field.CPPTYPE_DOUBLE: st.floats(),
            field.CPPTYPE_INT32: st.sampled_from([number for number in INTEGERS if abs(number) < 2**31]),
            field.CPPTYPE_UINT64: st.sampled_from([number for number in INTEGERS if number >= 0]),
        }
        if field.enum_type is not None:  # a number that it has not is dropped as the file is read
            kinds[field.cpp_type] = st.sampled_from([each.number for each in field.enum_type.values])
        value = data.draw(kinds.get(field.cpp_type, st.sampled_from(INTEGERS)))
        if field.type == field.TYPE_STRING:
            value = value.decode()
        if field.is_repeated:
            there.append(value)
        else:
            setattr(message, field.name, value)


@given(st.data())
def test_whatever_a_model_says_of_itself_it_detects_or_is_refused_in_a_sentence(data: st.DataObject) -> None:
    changed = model()
    for _ in range(data.draw(st.integers(1, 3))):
        change(data.draw(st.sampled_from(list(messages(changed)))), data)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "model.onnx")
        file.write_bytes(changed.SerializeToString())
        try:
            Detector(model=ModelFiles(onnx=file), threads=1).process_photo(PHOTO)
        except UsageError as refusal:
            said = str(refusal)
            assert len(said) < 2500
            assert "\n" not in said
