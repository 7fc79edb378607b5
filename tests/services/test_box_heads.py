"""Networks that decode their boxes themselves: recognised, and read as a plain decoder reads them, or refused."""

from __future__ import annotations

import json
import re
import runpy
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import onnx
import onnxruntime
import pytest
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper
from tests.services.darknet_models import small, write_labels, write_model

from upwash.errors import ModelError
from upwash.services import Detection, Detector, ModelFiles
from upwash.services.class_names import parse_names

Values = NDArray[Any]
SIDE_PX, CONFIDENCE = 160, 0.5
CELLS = 20 * 20 + 10 * 10 + 5 * 5
NAMES = {"names": "{0: 'person', 1: \"farmer's car\", 2: 'boat'}"}
LABELS = ["person", "farmer's car", "boat"]
RNG = np.random.default_rng(7)


def export(
    folder: Path, *outputs: Values, metadata: dict[str, str] = NAMES, side: Any = SIDE_PX
) -> ModelFiles:
    """A network with these outputs for any picture; boxes beside labels are scaled by its second input."""
    kind = TensorProto.FLOAT16 if outputs[0].dtype == np.float16 else TensorProto.FLOAT
    inputs = [helper.make_tensor_value_info("images", kind, [1, 3, side, side])]
    names = [
        ("output0",),
        ("pred_boxes", "logits"),
        ("output0", "c1", "c2"),
        ("det_boxes", "det_scores", "det_classes", "num_dets"),
    ][len(outputs) - 1]
    given = list(outputs)
    nodes = []
    if outputs[0].dtype == np.int64 and len(outputs) == 3:
        names = ("labels", "boxes", "scores")
        given[1] = outputs[1].astype(np.float32)
        inputs.append(helper.make_tensor_value_info("orig_target_sizes", TensorProto.INT64, ["N", 2]))
        nodes = [
            helper.make_node("Cast", ["orig_target_sizes"], ["sizes"], to=TensorProto.FLOAT),
            helper.make_node("Concat", ["sizes", "sizes"], ["scale"], axis=1),
            helper.make_node("Mul", ["constant boxes", "scale"], ["boxes"]),
        ]
    made = {name for node in nodes for name in node.output}
    nodes += [
        helper.make_node("Identity", [f"constant {name}"], [name]) for name in names if name not in made
    ]
    said = [
        helper.make_tensor_value_info(name, helper.np_dtype_to_tensor_dtype(output.dtype), output.shape)
        for name, output in zip(names, given, strict=True)
    ]
    constants = [
        numpy_helper.from_array(output, f"constant {name}") for name, output in zip(names, given, strict=True)
    ]
    return saved(folder, helper.make_graph(nodes, "export", inputs, said, constants), metadata)


def saved(folder: Path, graph: onnx.GraphProto, metadata: dict[str, str]) -> ModelFiles:
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(model, metadata)
    onnx.save(model, folder / "export.onnx")
    return ModelFiles(onnx=folder / "export.onnx")


def photo(width_px: int = 320, height_px: int = 240) -> bytes:
    noise = RNG.integers(0, 256, (height_px // 20, width_px // 20, 3), np.uint8)
    return cv2.imencode(".jpg", cv2.resize(noise, (width_px, height_px)))[1].tobytes()


# --- each family, against loops ------------------------------------------------------------------------------


def boxes(number: int) -> Values:
    """Centres and sizes in pixels of the picture."""
    return np.hstack([RNG.uniform(0, SIDE_PX, (number, 2)), RNG.uniform(8, 50, (number, 2))])


def shares(number: int, classes: int = 3) -> Values:
    return RNG.uniform(0, 0.9, (number, classes)) ** 2


def corners(rows: Values) -> Values:
    return np.hstack([rows[:, :2] - rows[:, 2:] / 2, rows[:, :2] + rows[:, 2:] / 2])


FEW = boxes(300)
CLASSES = RNG.integers(0, 3, (300, 1))
LOGITS = RNG.normal(-1, 2, (300, 3))
WITH_NONE = np.hstack([LOGITS, RNG.normal(1, 2, (300, 1))])
SOFTMAX = np.exp(WITH_NONE) / np.exp(WITH_NONE).sum(axis=1, keepdims=True)
V5 = np.hstack([boxes(3 * CELLS), RNG.uniform(0.5, 1, (3 * CELLS, 1)), shares(3 * CELLS)])
V8 = np.hstack([boxes(CELLS), shares(CELLS)])
END = np.hstack([corners(FEW), shares(300, 1), CLASSES])
DETR = np.hstack([FEW / SIDE_PX, shares(300)])
FAMILIES = {
    "YOLOv5": [V5],
    "YOLOv5 and cells": [V5, *[np.zeros((1, 3, 4, 4, 8))] * 2],
    "YOLOv5 as YOLOv6": [np.hstack([V8[:, :4], np.ones((CELLS, 1)), V8[:, 4:]])],
    "YOLOv5 of one class": [
        np.hstack([V5[:, :4], V5[:, 5:6], np.full((3 * CELLS, 1), 0.5)])
    ],  # as YOLOv7 leaves the class
    "YOLOv5 as YOLOv6 of one class": [np.hstack([V8[:, :4], np.ones((CELLS, 1)), V8[:, 4:5]])],
    "YOLOv8": [V8.T],
    "YOLOv8 turned": [V8],
    "end-to-end": [END],
    "end-to-end of YOLOv7": [np.hstack([np.zeros((300, 1)), END[:, :4], CLASSES, END[:, 4:5]])],
    "end-to-end in shares": [np.hstack([END[:, :4] / SIDE_PX, END[:, 4:]])],
    "end-to-end of YOLO-NAS": [np.hstack([np.zeros((300, 1)), END])],
    "end-to-end in four": [END[:, :4], END[:, 4], CLASSES[:, 0], np.array([300])],  # YOLOv6 and YOLO-NAS
    "DETR": [DETR],
    "DETR that chooses": [np.hstack([FEW / SIDE_PX, END[:, 4:]])],  # RT-DETR of Ultralytics
    "DETR with none": [FEW / SIDE_PX, WITH_NONE],  # DETR and YOLOS of transformers
    "DETR with none, after softmax": [FEW / SIDE_PX, SOFTMAX],
    "DETR in two": [FEW / SIDE_PX, LOGITS],
    "DETR in three": [CLASSES[:, 0], corners(FEW) / SIDE_PX, END[:, 4]],
}


APART = ("DETR in two", "DETR with none", "DETR with none, after softmax")


def plainly(family: str, outputs: list[Values]) -> list[Detection]:
    """What a photo of 320 x 240 pixels shows by these outputs, one box after another."""
    kind = family.partition(" ")[0]
    first = outputs[0].astype(float)
    if family == "DETR in three":
        first = np.column_stack([*outputs[1:], outputs[0]])
    if family == "end-to-end in four":
        first = np.column_stack(outputs[:3])
    if family == "end-to-end in shares":
        first[:, :4] *= SIDE_PX
    if family == "YOLOv8":
        first = first.T
    found = []
    for index, row in enumerate(first):
        score, cls, (left, top, right, bottom) = plain_row(
            family, outputs[1][index] if family in APART else row[4:], row
        )
        if score <= CONFIDENCE:
            continue
        if kind == "DETR":  # the photo fills the picture
            left, right, top, bottom = left * 320, right * 320, top * 240, bottom * 240
        else:  # grey of 20 pixels above and below the photo
            left, right, top, bottom = left * 2, right * 2, (top - 20) * 2, (bottom - 20) * 2
        found.append((float(score), int(cls), (left, top, right, bottom)))
    found.sort(key=lambda item: -item[0])
    kept: list[tuple[float, int, tuple[float, ...]]] = []
    for item in found:
        if kind not in ("YOLOv5", "YOLOv8") or all(
            other[1] != item[1] or overlap(other[2], item[2]) <= 0.45 for other in kept
        ):
            kept.append(item)
    return [detection for item in kept if (detection := cut(*item)) is not None]


def plain_row(family: str, values: Values, row: Values) -> tuple[float, int, Values]:
    if family == "end-to-end of YOLOv7":
        return row[6], row[5], row[1:5]
    if family == "end-to-end of YOLO-NAS":
        return row[5], row[6], row[1:5]
    if family == "DETR in three" or family.startswith("end-to-end"):
        return row[4], row[5], row[:4]
    scores = list(values)
    if family == "YOLOv5 of one class":
        scores = [row[4]]
    elif family.startswith("YOLOv5"):
        scores = list(row[5:] * row[4])
    elif family == "DETR that chooses":
        scores = [row[4] if cls == row[5] else 0.0 for cls in range(3)]
    elif family == "DETR with none, after softmax":
        scores = list(values[:3])
    elif family == "DETR with none":
        powers = [np.exp(float(logit)) for logit in values]
        scores = [power / sum(powers) for power in powers[:3]]
    elif family == "DETR in two":
        scores = [1 / (1 + np.exp(-float(logit))) for logit in values]
    score = max(scores)
    x, y, width, height = row[:4]
    corners = np.array([x - width / 2, y - height / 2, x + width / 2, y + height / 2])
    return score, scores.index(score), corners


def overlap(one: tuple[float, ...], other: tuple[float, ...]) -> float:
    width = min(one[2], other[2]) - max(one[0], other[0])
    height = min(one[3], other[3]) - max(one[1], other[1])
    if width <= 0 or height <= 0:
        return 0.0
    areas = [(box[2] - box[0]) * (box[3] - box[1]) for box in (one, other)]
    return width * height / (sum(areas) - width * height)


def cut(score: float, cls: int, box: tuple[float, ...]) -> Detection | None:
    left, right = (min(max(x, 0), 320) for x in box[0::2])
    top, bottom = (min(max(y, 0), 240) for y in box[1::2])
    if left >= right or top >= bottom:
        return None
    return Detection(
        left_px=left,
        top_px=top,
        width_px=right - left,
        height_px=bottom - top,
        label=LABELS[cls],
        score=score,
    )


def rows(found: list[Detection]) -> list[Any]:
    return [
        [each.score, LABELS.index(each.label), each.left_px, each.top_px, each.width_px, each.height_px]
        for each in found
    ]


IN_STEPS = (
    r"boxes and scores together in steps of 2\.51, as of 8 bits|classes in its output output0 are no whole"
)


def in_8_bits(output: Values) -> Values:
    """What is left of an output of a network for 640 pixels that was quantised with its head."""
    step = (640 if output.max() > 20 else float(output.max() - min(0, output.min())) or 1.0) / 255
    return (np.rint(output / step) * step).astype(np.float32)


@pytest.mark.parametrize("kind", [np.float32, np.float16, np.uint8])
@pytest.mark.parametrize("family", FAMILIES)
def test_a_family_is_recognised_and_its_boxes_are_those_of_a_plain_decoder(
    family: str, kind: type[Any], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    outputs = [
        output if output.dtype == int else in_8_bits(output) if kind == np.uint8 else output.astype(kind)
        for output in FAMILIES[family]
    ]
    whole = family in ("end-to-end of YOLOv7", "end-to-end of YOLO-NAS")
    given = [output if whole or output.ndim == 5 else output[np.newaxis] for output in outputs]
    names, classes = ({"names": "['person']"}, "1 class") if "one class" in family else (NAMES, "3 classes")
    together = kind == np.uint8 and min(outputs[0].shape) > 4
    if together and (outputs[0].max() > 20 or family in ("end-to-end in shares", "DETR that chooses")):
        with pytest.raises(ModelError, match=IN_STEPS):
            Detector(model=export(tmp_path, *given, metadata=names), threads=1)
        return
    detector = Detector(model=export(tmp_path, *given, metadata=names), threads=1)
    assert f"light: {family.partition(' ')[0]} head, {classes}, 160 x 160\n" in capfd.readouterr().err
    expected = plainly(family, outputs)
    assert len(expected) > 20
    np.testing.assert_allclose(
        rows(detector.process_photo(photo(), "light", CONFIDENCE)), rows(expected), rtol=1e-4, atol=2e-3
    )


# --- pictures ------------------------------------------------------------------------------------------------


def convolution(folder: Path, *sides: Any, shape: list[Any] | None = None) -> ModelFiles:
    """A network as YOLOv8's with one layer, whose boxes and scores depend on the picture."""
    scale = np.array([30, 30, 10, 10, 3, 3, 3], np.float32).reshape(-1, 1, 1, 1)
    weights = RNG.normal(0, 0.1, (7, 3, 8, 8)).astype(np.float32) * scale
    biases = np.array([150, 150, 40, 40, 0, 0, 0], np.float32)
    constants = {"w": weights, "b": biases, "s": np.array([1, 7, -1]), "parts": np.array([4, 3])}
    nodes = [
        helper.make_node("Conv", ["images", "w", "b"], ["cells"], strides=[8, 8]),
        helper.make_node("Reshape", ["cells", "s"], ["flat"]),
        helper.make_node("Split", ["flat", "parts"], ["boxes", "raw"], axis=1),
        helper.make_node("Sigmoid", ["raw"], ["scores"]),
        helper.make_node("Concat", ["boxes", "scores"], ["output0"], axis=1),
    ]
    graph = helper.make_graph(
        nodes,
        "export",
        [helper.make_tensor_value_info("images", TensorProto.FLOAT, ["batch", 3, *sides])],
        [helper.make_tensor_value_info("output0", TensorProto.FLOAT, shape)],
        [numpy_helper.from_array(value, name) for name, value in constants.items()],
    )
    return saved(folder, graph, NAMES)


@pytest.mark.parametrize(("sides", "margin"), [((320, 320), 48), ((256, 320), 16), (("height", "width"), 0)])
def test_a_picture_is_a_letterbox_of_grey_114_and_where_sizes_vary_has_the_photos_shape(
    sides: tuple[Any, Any], margin: int, tmp_path: Path
) -> None:
    files, jpeg = convolution(tmp_path, *sides), photo(400, 280)
    found = Detector(model=files, threads=1).process_photo(jpeg, "light", 0.6)
    decoded = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert decoded is not None
    scaled = cv2.resize(decoded, (320, 224))
    grey = cv2.copyMakeBorder(scaled, margin, margin, 0, 0, cv2.BORDER_CONSTANT, value=(114, 114, 114))
    session = onnxruntime.InferenceSession(files.onnx or "", providers=["CPUExecutionProvider"])
    (output,) = session.run(None, {"images": cv2.dnn.blobFromImage(grey, 1 / 255, swapRB=True)})
    best = output[0, 4:].max(axis=0)
    surest = int(best.argmax())
    assert found[0].score == pytest.approx(float(best[surest]), abs=1e-4)
    x, y, width, height = output[0, :4, surest]
    assert found[0].width_px == pytest.approx(width * 1.25, abs=0.01)
    assert found[0].left_px == pytest.approx((x - width / 2) * 1.25, abs=0.01)
    assert found[0].top_px == pytest.approx((y - margin - height / 2) * 1.25, abs=0.01)


def test_light_may_be_another_network(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    cfg, weights = write_model(tmp_path, small())
    raw = ModelFiles(cfg=cfg, weights=weights, names=write_labels(tmp_path, 2))
    detector = Detector(
        model=export(tmp_path, END[np.newaxis].astype(np.float32)), light_model=raw, threads=1
    )
    said = capfd.readouterr().err
    assert said.startswith("heavy: end-to-end head, 3 classes, 160 x 160\nexport.onnx: self-test: ")
    assert "light" not in said
    assert {each.label for each in detector.process_photo(photo(), "heavy")} == set(LABELS)
    assert {each.label for each in detector.process_photo(photo(), "light", 0.3)} <= {"thing 0", "thing 1"}


def test_the_service_that_the_page_shows_reads_an_end_to_end_network(tmp_path: Path) -> None:
    page = (Path(__file__).parents[2] / "docs" / "detector.md").read_text()
    (code,) = re.findall(r'```python title="my_network.py"\n(.*?)```', page, re.DOTALL)
    (tmp_path / "my_network.py").write_text(code)
    files = export(tmp_path, END[np.newaxis].astype(np.float32), side=640)
    found = runpy.run_path(str(tmp_path / "my_network.py"))["MyNetwork"](onnx=files.onnx).process_photo(
        photo()
    )
    assert len(found) == (END[:, 4] > 0.25).sum()
    surest = END[END[:, 4].argmax()]
    assert max(found, key=lambda one: one.score).left_px == pytest.approx(surest[0] / 2, abs=1e-3)


# --- refusals ------------------------------------------------------------------------------------------------


def like(*shape: int, fill: float = 0.5) -> Values:
    return np.full(shape, fill, np.float32)


NOT_UNDERSTOOD = r"its outputs are not understood \(output0: {}.*docs/detector\.md shows one of 20 lines"
MASKED = np.hstack([END, RNG.normal(0, 1, (300, 32))])[np.newaxis]
NONE_OF_SIX = np.hstack([LOGITS, WITH_NONE[:, :3], 9 + LOGITS[:, :1]])
DETECTS = "export a network of the task detect, or run it in a service of your own"
ANGLE = r"each box has an angle \(rotated boxes\) beside its scores .*" + DETECTS
REFUSED = {
    "too few names": (
        [V8.T[np.newaxis, :6]],
        r"output0 is 1 x 6 x 525, as of YOLOv8 with 2 classes, but there are 3",
    ),
    "more names": ([like(1, 84, 525)], r"as of YOLOv8 with 80 classes, but there are 3 names: give names"),
    "rows": (
        [like(1, 1575, 85)],
        r"as of YOLOv5 with 80 classes or DETR with 81 classes, but there are 3 names",
    ),
    "a class beyond": ([like(1, 300, 6, fill=7)], r"end-to-end head that has class 7, but there are 3 names"),
    "DETR's names": (
        [like(1, 300, 4), like(1, 300, 80)],
        r"logits is 1 x 300 x 80, as of DETR with 80 classes, but",
    ),
    "a class beyond, of YOLOv7": ([like(9, 7, fill=7)], r"output0 has class 7, but there are 3 names"),
    "a label beyond": (
        [np.full((1, 9), 3), like(1, 9, 4), like(1, 9)],
        r"output labels has class 3, but there are 3 names",
    ),
    "other labels": (
        [np.zeros((1, 8), int), like(1, 9, 4), like(1, 9)],
        r"not understood \(labels: 1 x 8 int64",
    ),
    "boxes in pixels": (
        [like(1, 300, 4, fill=9), like(1, 300, 3)],
        r"not understood \(pred_boxes: 1 x 300 x 4 ",
    ),
    "another number": ([like(1, 300, 4), like(1, 200, 3)], r"not understood \(pred_boxes: 1 x 300 x 4 "),
    "no classes": ([like(1, 4, 525)], NOT_UNDERSTOOD.format("1 x 4 x 525 float32")),
    "nothing": ([like(1, 0, 0)], NOT_UNDERSTOOD.format("1 x 0 x 0 float32")),
    "no batch": ([like(7, 525)], NOT_UNDERSTOOD.format("7 x 525 float32")),
    "a scalar": ([np.array(1, np.float32)], NOT_UNDERSTOOD.format(" float32")),
    "two pictures": ([like(2, 7, 525)], NOT_UNDERSTOOD.format("2 x 7 x 525 float32")),
    "integers": ([np.zeros((1, 7, 525), np.int64)], NOT_UNDERSTOOD.format("1 x 7 x 525 int64")),
    "cells": ([like(1, 3, 20, 20, 8)], NOT_UNDERSTOOD.format("1 x 3 x 20 x 20 x 8 float32")),
    "masks": (
        [like(1, 7, 525), like(1, 32, 40, 40)],
        r"masks beside boxes \(pred_boxes: 1 x 7 x 525 .*" + DETECTS,
    ),
    "masks that are chosen": (
        [MASKED],
        "32 numbers .*" + DETECTS,
    ),
    "rotated boxes": ([np.vstack([V8.T, RNG.uniform(-0.7, 2, (1, CELLS))])[np.newaxis]], ANGLE),
    "rotated boxes, with a name more": (
        [np.vstack([V8.T[:6], RNG.uniform(-0.7, 2, (1, CELLS))])[np.newaxis]],
        ANGLE,
    ),
    "rotated boxes that are chosen": ([np.hstack([END, RNG.uniform(-0.7, 2, (300, 1))])[np.newaxis]], ANGLE),
    "key points": (
        [np.vstack([V8.T, RNG.uniform(0, SIDE_PX, (51, CELLS))])[np.newaxis]],
        r"51 numbers \(key points or masks\) beside its scores .*" + DETECTS,
    ),
    "a class of the whole picture": (
        [like(1, 1000)],
        "says what a picture shows, and not where .*" + DETECTS,
    ),
    "scores alike": (
        [np.vstack([V8.T[:4], np.full((3, CELLS), 0.5)])[np.newaxis]],
        "all its 1575 scores are 0.5 for a grey picture, noise and a photo, as of no network that works: leave",
    ),
    "boxes of another size": (
        [np.vstack([V8.T[:4] + 400, V8.T[4:]])[np.newaxis]],
        r"1575 of 1575 boxes lie outside the test pictures of 160 x 160 pixels: export it for pictures of the size",
    ),
    "the background": (
        [like(1, 300, 4), np.hstack([9 + LOGITS[:, :1], LOGITS])[np.newaxis]],
        "the first class in its output logits is the background, as of SSD: run it in a service of your own",
    ),
    "too few names for no object": (
        [like(1, 300, 4), NONE_OF_SIX[np.newaxis]],
        r'as of DETR with 6 classes and "no object", but there are 3 names',
    ),
    "NaN": (
        [like(1, 7, 525, fill=np.nan)],
        r"infinite or none \(NaN\) for a grey picture, noise or a photo: export it with 32-bit",
    ),
    "raw scores": (
        [like(1, 7, 525, fill=-9)],
        r"like those of YOLOv8 networks, but scores are from -9 to -9, not from 0 to 1",
    ),
    "YOLOX": ([like(1, 525, 8)], r"525 cells of one box and an objectness, as of YOLOX"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_outputs_that_are_not_understood_are_refused_with_what_was_seen(case: str, tmp_path: Path) -> None:
    outputs, problem = REFUSED[case]
    with pytest.raises(ModelError, match=rf"export\.onnx: .*{problem}"):
        Detector(
            model=export(
                tmp_path,
                *[output if output.dtype == int else output.astype(np.float32) for output in outputs],
            )
        )


@pytest.mark.parametrize(
    ("metadata", "problem"),
    [
        ({}, "its metadata has no names: give names, a file"),
        ({"names": "{}"}, "an empty name, no names or too many"),
        ({"names": "['a', '']"}, "an empty name"),
        ({"names": "{0: 'a', 2: 'b'}"}, "its numbers are not those from 0 to 1"),
        ({"names": "[" * 100_000 + "]" * 100_000}, "no name at letter 2"),
        ({"names": "{0: __import__('os').getcwd()}"}, "no name at letter 2"),
        ({"names": "['a' 'b']"}, "no name at letter 2"),
        ({"names": r"['\x']"}, "names in its metadata cannot be read"),
        ({**NAMES, "task": "segment"}, "it was exported for the task segment: give a network that detects"),
    ],
)
def test_metadata_that_does_not_fit_is_refused(
    metadata: dict[str, str], problem: str, tmp_path: Path
) -> None:
    with pytest.raises(ModelError, match=problem):
        Detector(model=export(tmp_path, V8.T[np.newaxis].astype(np.float32), metadata=metadata))


@pytest.mark.parametrize(
    ("outputs", "said"),
    [
        (
            V8.T,
            "warning: export.onnx: its scores are the same for a grey picture, noise and a photo, as if it did",
        ),
        (
            np.vstack([V8.T[:4], np.zeros((3, CELLS))]),
            "export.onnx: all its 1575 scores are 0 for a grey picture, n",
        ),
        (
            V8.T[:, :510],
            "warning: export.onnx: its 510 boxes are not those of the cells of 160 x 160 pixels: compare",
        ),
    ],
    ids=["alike", "zero", "rows"],
)
def test_what_a_person_should_look_at_is_a_warning(
    outputs: Values, said: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    Detector(model=export(tmp_path, outputs[np.newaxis].astype(np.float32)), threads=1)
    assert said in capfd.readouterr().err


def test_a_network_that_suppresses_and_finds_nothing_at_loading_is_used(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    empty = np.zeros((1, 300, 6), np.float32)
    assert Detector(model=export(tmp_path, empty), threads=1).process_photo(photo()) == []
    assert "warning" not in capfd.readouterr().err


def test_names_are_asked_for_only_where_they_would_help(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="has class 2, but its metadata has no names: give names, a file"):
        Detector(model=export(tmp_path, END[np.newaxis].astype(np.float32), metadata={}))
    with pytest.raises(ModelError, match="not where") as refusal:
        Detector(model=export(tmp_path, like(1, 1000), metadata={}))
    assert "give names" not in str(refusal.value)


def test_names_are_read_as_python_and_json_write_them() -> None:
    names = ["person", "farmer's car", 'a "boat"', "Löwe, alt", "back\\slash"]
    assert parse_names(str(dict(enumerate(names)))) == names
    assert parse_names(str(names)) == names
    assert parse_names(json.dumps(dict(enumerate(names)))) == parse_names(json.dumps(names)) == names
    assert parse_names("{1: 'b', 0: 'a',}") == ["a", "b"]


def two_faced(folder: Path, for_photos: Values, node: str = "Identity") -> ModelFiles:
    """A network that gives boxes as of YOLOv8, and other values for a bright photo."""
    branches = []
    for name, values in {"then": V8.T[np.newaxis], "else": for_photos}.items():
        said = helper.make_tensor_value_info(f"{name} out", TensorProto.FLOAT, None)
        kind = node if name == "else" else "Identity"
        numbers = numpy_helper.from_array(values if values.dtype == int else values.astype(np.float32), name)
        made = helper.make_node(kind, [name], [f"{name} out"])
        branches.append(helper.make_graph([made], name, [], [said], [numbers]))
    nodes = [
        helper.make_node("ReduceMean", ["images"], ["mean"], keepdims=0),
        helper.make_node("Less", ["mean", "bright"], ["dark"]),
        helper.make_node("If", ["dark"], ["output0"], then_branch=branches[0], else_branch=branches[1]),
    ]
    picture = helper.make_tensor_value_info("images", TensorProto.FLOAT, [1, 3, SIDE_PX, SIDE_PX])
    output = helper.make_tensor_value_info("output0", TensorProto.FLOAT, None)
    bright = numpy_helper.from_array(np.array(0.7, np.float32), "bright")
    return saved(folder, helper.make_graph(nodes, "export", [picture], [output], [bright]), NAMES)


WHITE = cv2.imencode(".jpg", np.full((240, 320, 3), 255, np.uint8))[1].tobytes()


@pytest.mark.parametrize("wild", [np.nan, np.inf, -np.inf, 3e38])
def test_boxes_of_a_photo_that_have_no_place_or_score_are_left_out(wild: float, tmp_path: Path) -> None:
    outputs = V8.T.copy()
    outputs[:5, ::2] = wild  # boxes, and the score of the first class
    found = Detector(model=two_faced(tmp_path, outputs[np.newaxis]), threads=1).process_photo(WHITE)
    every_other = plainly("YOLOv8", [outputs[:, 1::2]])
    assert len(found) >= len(every_other) > 20
    assert all(0 <= each.left_px <= 320 and 0 < each.width_px <= 320 for each in found)


@pytest.mark.parametrize(
    ("outputs", "said"),
    [
        (like(525), "its outputs are 525 for a photo, unlike those for the test pictures"),
        (like(0, 0, 0), "its outputs are 0 x 0 x 0 for a photo, unlike"),
        (like(1, 7, 600), "its outputs for a photo have 4,200 numbers: at most 4,000 are read"),
    ],
    ids=["another shape", "nothing", "too many"],
)
def test_outputs_for_a_photo_that_are_unlike_those_for_grey_end_the_call(
    outputs: Values, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("upwash.services.inference.MOST_VALUES", 4000)
    detector = Detector(model=two_faced(tmp_path, outputs), threads=1)
    with pytest.raises(ModelError, match=said):
        detector.process_photo(WHITE)


def test_a_network_that_cannot_be_run_on_a_photo_ends_the_call_with_the_reason(tmp_path: Path) -> None:
    files = two_faced(tmp_path, np.array([1, 7, 10**15]), "ConstantOfShape")
    detector = Detector(model=files, threads=1)
    with pytest.raises(
        ModelError, match=r"it cannot be run on a photo \(.*Failed to allocate memory"
    ) as refusal:
        detector.process_photo(WHITE)
    assert "onnxruntime_src" not in str(refusal.value)


@pytest.mark.parametrize("side", [100_000, 8, 0])
def test_a_picture_of_an_impossible_size_is_refused(side: int, tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=f"it takes only pictures of {side} x {side}, not 320"):
        Detector(model=export(tmp_path, like(1, 7, 525), side=side))


def test_an_output_of_a_size_out_of_all_bounds_is_refused_before_it_is_computed(tmp_path: Path) -> None:
    said = "output0 is 1 x 7 x 1000000000: at most 50,000,000 numbers are read"
    with pytest.raises(ModelError, match=said):
        Detector(model=convolution(tmp_path, 320, 320, shape=[1, 7, 10**9]))


def test_boxes_without_a_place_are_left_out_and_only_the_surest_thousand_count(tmp_path: Path) -> None:
    wild = np.hstack(
        [boxes(3000), np.linspace(1, 0.5, 3000)[:, np.newaxis], CLASSES[:1].repeat(3000, axis=0)]
    ).astype(np.float32)
    wild[:, 0] /= 2
    wild[:, 2:4] += wild[:, :2]
    wild[:, 1], wild[:, 3] = 60, 90  # on the photo
    wild[0, :4] = 3e38
    found = Detector(model=export(tmp_path, wild[np.newaxis]), threads=1).process_photo(photo(), "heavy", 0.0)
    assert len(found) == 999
