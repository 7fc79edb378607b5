"""The page of the detector, on one's own model: its lines of configuration and its commands give findings."""

from __future__ import annotations

import csv
import json
import re
import shlex
from pathlib import Path

import cv2
import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper
from tests.programs import ROOT, stand_in, upwash

pytestmark = pytest.mark.system

PAGE = (ROOT / "docs" / "detector.md").read_text()
SIDE_PX, CELL_PX = 320, 16
CELLS = SIDE_PX // CELL_PX
LAMP = (500, 110)  # of 640 x 480 pixels


def export_model(file: Path) -> None:
    """A model as YOLOv8's: each cell of the picture has a box, which is a lamp if the cell is bright."""
    rows, columns = np.mgrid[0:CELLS, 0:CELLS]
    sizes = np.full((2, CELLS, CELLS), 24.0)
    boxes = np.stack([(columns + 0.5) * CELL_PX, (rows + 0.5) * CELL_PX, *sizes]).reshape(1, 4, -1)
    constants = {
        "boxes": boxes.astype(np.float32),
        "steep": np.float32(40),
        "threshold": np.float32(28),
        "shape": np.array([1, 1, CELLS**2]),
        "nothing": np.zeros((1, 1, CELLS**2), np.float32),
    }
    nodes = [
        helper.make_node("ReduceMean", ["images"], ["grey"], axes=[1]),
        helper.make_node(
            "AveragePool", ["grey"], ["mean"], kernel_shape=[CELL_PX] * 2, strides=[CELL_PX] * 2
        ),
        helper.make_node("Mul", ["mean", "steep"], ["scaled"]),
        helper.make_node("Sub", ["scaled", "threshold"], ["logits"]),
        helper.make_node("Sigmoid", ["logits"], ["shares"]),
        helper.make_node("Reshape", ["shares", "shape"], ["scores"]),
        helper.make_node("Concat", ["boxes", "scores", "nothing"], ["output0"], axis=1),
    ]
    graph = helper.make_graph(
        nodes,
        "lamps",
        [helper.make_tensor_value_info("images", TensorProto.FLOAT, [1, 3, SIDE_PX, SIDE_PX])],
        [helper.make_tensor_value_info("output0", TensorProto.FLOAT, [1, 6, CELLS**2])],
        [numpy_helper.from_array(np.array(value), name) for name, value in constants.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(model, {"task": "detect", "stride": "16", "names": "{0: 'lamp', 1: 'hole'}"})
    onnx.save(model, file)


def write_film(file: Path) -> None:
    film = cv2.VideoWriter(str(file), cv2.VideoWriter.fourcc(*"mp4v"), 10, (640, 480))
    for brightness in range(60, 80):
        frame = np.full((480, 640, 3), brightness, np.uint8)
        cv2.circle(frame, LAMP, 24, (255, 255, 255), -1)
        film.write(frame)
    film.release()


def test_a_model_and_a_film_give_findings_with_ten_lines_and_no_code(tmp_path: Path) -> None:
    (configuration,) = re.findall(r'```toml title="drone\.toml"\n(.*?)```', PAGE, re.DOTALL)
    assert len(configuration.splitlines()) <= 10
    (tmp_path / "drone.toml").write_text(configuration)
    export_model(tmp_path / "best.onnx")
    write_film(tmp_path / "film.mp4")
    commands = "".join(re.findall(r'```sh title="terminal 2"\n(.*?)```', PAGE, re.DOTALL))
    with stand_in(tmp_path) as connection:
        for command in commands.replace("udpout:127.0.0.1:14550", connection).splitlines():
            done = upwash(*shlex.split(command)[1:], folder=tmp_path)
            assert done.returncode == 0, done.stdout + done.stderr
            assert "warning" not in done.stdout, done.stdout
    with (tmp_path / "findings.csv").open(newline="") as file:
        found = list(csv.DictReader(file))
    assert [row["label"] for row in found] == ["lamp"] * len(found)
    assert {row["waypoint"] for row in found} == {"0", "1", "2"}
    assert all(
        float(row["left_px"]) < LAMP[0] < float(row["left_px"]) + float(row["width_px"]) for row in found
    )
    assert {row["place_is"] for row in found} == {"the object's own place"}
    points = json.loads((tmp_path / "findings.geojson").read_text())["features"]
    assert len([point for point in points if point["properties"]["kind"] == "finding"]) == len(found)
