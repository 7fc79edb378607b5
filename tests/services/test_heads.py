"""From a network's outputs to boxes: against OpenCV's decoder, and what suppression may and may not drop."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.services.darknet_models import Floats, opencv_boxes, opencv_heads, small, write_model, yolov3_tiny

from upwash.services.darknet.heads import (
    MOST_CANDIDATES,
    Candidates,
    Head,
    best_of_each,
    decode_heads,
    encode_heads,
    read_heads,
)
from upwash.services.darknet.layers import Yolo, read_network

ONE = Head(output="one", stride=8, anchors=((10.0, 20.0),))


# --- decoding -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("cfg", "confidence"), [(small(), 0.3), (yolov3_tiny(), 0.45)], ids=["small", "tiny"]
)
def test_boxes_are_those_of_an_independent_decoder(cfg: str, confidence: float, tmp_path: Path) -> None:
    side_px = 96
    files = write_model(tmp_path, cfg)
    picture = np.random.default_rng(3).random((1, 3, side_px, side_px), np.float32)
    heads = [
        Head(output="", stride=layer.output.stride, anchors=layer.operator.anchors)
        for layer in read_network(files[0], cfg.encode()).heads
        if isinstance(layer.operator, Yolo)
    ]
    ours = read_heads(opencv_heads(*files, picture), heads, confidence=confidence)
    rows = np.concatenate(opencv_boxes(*files, picture))
    which, classes = np.nonzero(rows[:, 5:] > confidence)
    assert 20 < len(which) < MOST_CANDIDATES
    centres, halves = rows[which, 0:2] * side_px, rows[which, 2:4] * side_px / 2
    theirs = np.column_stack([rows[which, 5 + classes], classes, centres - halves, centres + halves])
    own = np.column_stack([ours.scores, ours.classes, ours.boxes])
    np.testing.assert_allclose(in_order(own), in_order(theirs), atol=1e-3)


def in_order(rows: Floats) -> Floats:
    """By what no rounding changes: class, then place."""
    return rows[np.lexsort(np.round(rows, 2).T[[2, 3, 1]])]


def outputs(**channels: float) -> Floats:
    """One head of 2 x 2 cells where nothing is, but for these channels of the cell in row 1, column 0."""
    found = np.full((1, 7, 2, 2), -20, np.float32)
    for name, value in channels.items():
        found[0, ["x", "y", "width", "height", "objectness", "first", "second"].index(name), 1, 0] = value
    return found


def test_a_box_is_where_cell_and_anchor_say() -> None:
    said = outputs(x=0, y=0, width=0, height=np.log(2), objectness=20, first=20)
    found = read_heads([said], [ONE], confidence=0.5)
    np.testing.assert_allclose(found.boxes, [[4 - 5, 12 - 20, 4 + 5, 12 + 20]], atol=1e-4)
    np.testing.assert_allclose(found.scores, [1.0], atol=1e-4)
    assert found.classes.tolist() == [0]


def test_a_thing_may_be_of_two_classes() -> None:
    said = outputs(x=0, y=0, width=0, height=0, objectness=20, first=1, second=2)
    assert read_heads([said], [ONE], confidence=0.5).classes.tolist() == [1, 0]


def test_the_score_is_objectness_times_class_and_has_to_be_above_the_confidence() -> None:
    said = outputs(objectness=0, first=0)
    assert read_heads([said], [ONE], confidence=0.2).scores.tolist() == [0.25]
    assert len(read_heads([said], [ONE], confidence=0.25).scores) == 0
    assert len(read_heads([said], [ONE], confidence=1.0).scores) == 0


def test_outputs_out_of_all_bounds_give_no_warning_and_only_finite_boxes() -> None:
    for wild in (1e38, -1e38, np.inf, -np.inf):
        found = read_heads([np.full((1, 7, 2, 2), wild, np.float32)], [ONE], confidence=0.0)
        assert np.isfinite(found.boxes).all()
    assert len(read_heads([np.full((1, 7, 2, 2), np.nan, np.float32)], [ONE], confidence=0.0).scores) == 0


def test_of_too_many_candidates_the_surest_are_taken() -> None:
    said = np.random.default_rng(1).normal(2, 1, (1, 7, 40, 40)).astype(np.float32)
    all_scores = np.sort(read_all(said))[::-1]
    found = read_heads([said], [ONE], confidence=0.0)
    assert len(all_scores) == 3200
    np.testing.assert_array_equal(found.scores, all_scores[:MOST_CANDIDATES])


def read_all(said: Floats) -> Floats:
    """All scores of a head, a few columns at a time."""
    columns = np.array_split(said, 10, axis=3)
    return np.concatenate([read_heads([part], [ONE], confidence=0.0).scores for part in columns])


def test_heads_in_metadata_are_read_as_they_were_written() -> None:
    heads = (ONE, Head(output="two", stride=32, anchors=((1.5, 2.0), (3.0, 4.0))))
    assert decode_heads(encode_heads(heads)) == heads


# --- suppression --------------------------------------------------------------------------------------------

corners = st.tuples(*[st.integers(0, 40)] * 2, *[st.integers(0, 30)] * 2)
candidates = st.lists(st.tuples(corners, st.integers(0, 2)), max_size=40).map(
    lambda drawn: Candidates(
        np.array([[x, y, x + w, y + h] for (x, y, w, h), _ in drawn], np.float32).reshape(-1, 4),
        np.linspace(1, 0, len(drawn), endpoint=False, dtype=np.float32),
        np.array([each for _, each in drawn], np.intp),
    )
)


def overlap(one: Floats, other: Floats) -> float:
    """Intersection over union."""
    width = min(one[2], other[2]) - max(one[0], other[0])
    height = min(one[3], other[3]) - max(one[1], other[1])
    shared = max(0.0, width) * max(0.0, height)
    areas = [(box[2] - box[0]) * (box[3] - box[1]) for box in (one, other)]
    return float(shared / (sum(areas) - shared)) if shared else 0.0


@given(candidates)
def test_what_is_kept_does_not_overlap_and_what_is_dropped_does(found: Candidates) -> None:
    kept = best_of_each(found)
    chosen = set(kept.scores.tolist())  # each has a score of its own
    rank = {score: index for index, score in enumerate(found.scores.tolist())}
    indices = [rank[score] for score in kept.scores.tolist()]
    assert indices == sorted(indices)
    for index, score in enumerate(found.scores.tolist()):
        surer = [
            other
            for other in indices
            if other < index
            and found.classes[other] == found.classes[index]
            and overlap(found.boxes[other], found.boxes[index]) > 0.45
        ]
        assert bool(surer) == (score not in chosen)


@given(candidates)
def test_suppressing_twice_changes_nothing(found: Candidates) -> None:
    once = best_of_each(found)
    np.testing.assert_array_equal(best_of_each(once).boxes, once.boxes)


@given(candidates, st.integers(0, 2))
def test_classes_do_not_touch_each_other(found: Candidates, cls: int) -> None:
    alone = best_of_each(found.only(found.classes == cls))
    together = best_of_each(found)
    np.testing.assert_array_equal(alone.boxes, together.boxes[together.classes == cls])
