"""The programs of training/ run, on a few photos."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path

import numpy as np
import pytest
from tests.programs import printed
from training.crops import CROP_PX, random_batch
from training.photos import HEIGHT_PX, WIDTH_PX, learning_set

from upwash.services.solar_park import LABELS


@pytest.mark.system
@pytest.mark.long
def test_a_detector_is_scored() -> None:
    said = printed("training.evaluate", "--first", "2")
    for mode in "light", "heavy":
        for label in LABELS:
            assert re.search(rf"{mode} +│ {label} +│ \d+ +│ [\d.]+ │", said)
    assert re.search(r"10 to 16 px +│ 1 +│ [\d.]+ │ [\d.]+ │", said)


@pytest.mark.system
@pytest.mark.long
def test_a_detector_is_scored_from_several_altitudes() -> None:
    said = printed("training.evaluate", "altitudes", "--first", "1")
    assert re.search(
        r"\n│ 60 m +│ \d+ +│ (\d+%|-) +│( [\d.]+ +│){4} -?[\d.]+ \[-?[\d.]+, -?[\d.]+\] +│", said
    )


@pytest.mark.system
@pytest.mark.long
@pytest.mark.skipif(not importlib.util.find_spec("torch"), reason="needs torch: training/README.md")
def test_a_network_learns_for_a_step(tmp_path: Path) -> None:
    weights = tmp_path / "learned.weights"
    printed("training.train", "--steps", "1", "--first", "2", "--cache", tmp_path, "--weights", weights)
    assert weights.stat().st_size > 0


@pytest.mark.system
@pytest.mark.long
def test_photos_are_rendered_once_and_cropped_with_their_boxes(tmp_path: Path) -> None:
    learning = learning_set(range(1), tmp_path)
    assert learning.photos.shape == (1, HEIGHT_PX, WIDTH_PX, 3)
    (file,) = tmp_path.glob("*/photos.npy")
    written = file.stat().st_mtime_ns
    assert np.array_equal(learning_set(range(1), tmp_path).photos, learning.photos)
    assert file.stat().st_mtime_ns == written
    batch = random_batch(np.random.default_rng(1), learning, 16)
    assert batch.crops.shape == (16, CROP_PX, CROP_PX, 3)
    assert len(batch.boxes) > 0
    assert (batch.boxes[:, 0] < 16).all()
    assert (batch.boxes[:, 2:] >= 0).all()
    assert (batch.boxes[:, 2:] <= CROP_PX).all()
