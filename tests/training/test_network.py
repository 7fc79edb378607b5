"""The network that is trained, and the weights file that it writes, against OpenCV's reading of both."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs torch: training/README.md")

CFG = Path(__file__).parents[2] / "src/upwash/services/models/solar_park.cfg"


def test_the_weights_that_are_written_compute_what_was_trained(tmp_path: Path) -> None:
    """In torch and in OpenCV the same photo gives the same heads."""
    from training.network import Network

    torch.manual_seed(1)
    network = Network(CFG).eval()
    for module in network.modules():
        if isinstance(module, torch.nn.BatchNorm2d):
            module.running_mean.normal_(0, 0.1)
            module.running_var.uniform_(0.5, 2)
    network.write_weights(tmp_path / "random.weights", seen=1)
    photo = np.random.default_rng(1).random((1, 3, 320, 320), np.float32)
    with torch.no_grad():
        ours = network(torch.from_numpy(photo))

    reader = cv2.dnn.readNetFromDarknet(str(CFG), str(tmp_path / "random.weights"))
    reader.setInput(photo)
    theirs = reader.forward(reader.getUnconnectedOutLayersNames())
    for head, rows in zip(ours, theirs, strict=True):
        objects = head.raw[0, ..., 4].sigmoid().permute(1, 2, 0).reshape(-1).numpy()
        assert np.abs(objects - rows[:, 4]).max() < 1e-5
        widths = (head.raw[..., 2].exp() * head.anchors_px[:, 0, None, None])[0].permute(1, 2, 0).reshape(-1)
        assert np.abs(widths.numpy() / 320 - rows[:, 2]).max() < 1e-5
