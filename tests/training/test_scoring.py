"""Average precision, against examples that were computed by hand."""

from __future__ import annotations

import numpy as np
import pytest
from training.scoring import Judged, Ranking, average_precision, precision, recall

from upwash.profiling.agreement import overlap
from upwash.services import Box, Detection


def box(left_px: float, width_px: float = 10) -> Box:
    return Box(left_px=left_px, top_px=0, width_px=width_px, height_px=10)


def found(left_px: float, score: float, width_px: float = 10) -> Detection:
    return Detection(
        left_px=left_px, top_px=0, width_px=width_px, height_px=10, label="hot-spot", score=score
    )


def test_overlap_is_what_is_shared_of_what_is_covered() -> None:
    assert overlap(box(0), box(0)) == 1
    assert overlap(box(0), box(5)) == pytest.approx(50 / 150)
    assert overlap(box(0), box(0, width_px=20)) == pytest.approx(0.5)
    assert overlap(box(0), box(10)) == 0
    assert overlap(box(0), box(30)) == 0


def test_average_precision_of_an_example_computed_by_hand() -> None:
    """Five boxes in two photos; by score: hit, miss, hit, hit, miss; one box is never found, another twice.

    Precision after each hit: 1/1, 2/3, 3/4; made to fall steadily: 1, 3/4, 3/4. Each is worth a fifth of recall.
    """
    photos = [
        Judged([found(0, 0.9), found(1, 0.8), found(100, 0.6)], [box(0), box(100), box(200)]),
        Judged([found(51, 0.7), found(300, 0.5)], [box(50), box(400)]),
    ]
    assert average_precision(photos) == pytest.approx((1 + 3 / 4 + 3 / 4) / 5)
    assert recall(photos, confidence=0.5) == pytest.approx(3 / 5)
    assert precision(photos, confidence=0.5) == pytest.approx(3 / 5)
    assert recall(photos, confidence=0.65) == pytest.approx(2 / 5)
    assert precision(photos, confidence=0.95) == 1


def test_everything_found_and_nothing_else_is_1() -> None:
    assert average_precision([Judged([found(0, 0.3), found(50, 0.9)], [box(0), box(50)])]) == 1


def test_nothing_found_is_0() -> None:
    assert average_precision([Judged([], [box(0)])]) == 0
    assert average_precision([Judged([found(6, 0.9)], [box(0)])]) == 0


def test_a_false_alarm_in_a_photo_without_boxes_counts() -> None:
    hit, alarm = Judged([found(0, 0.5)], [box(0)]), Judged([found(0, 0.9)], [])
    assert average_precision([hit, alarm]) == pytest.approx(1 / 2)


def test_a_detection_hits_the_box_that_it_overlaps_most() -> None:
    photo = Judged([found(4, 0.9), found(0, 0.8)], [box(0), box(3)])
    assert average_precision([photo]) == 1


def test_a_photo_that_is_taken_twice_counts_as_two() -> None:
    first = Judged([found(0, 0.9), found(50, 0.6)], [box(0), box(20)])
    second = Judged([found(0, 0.8)], [box(0)])
    third = Judged([found(30, 0.7)], [box(0)])
    ranking = Ranking.of([first, second, third])
    assert ranking.average_precision(np.array([1, 1, 1])) == average_precision([first, second, third])
    repeated = average_precision([first, second, second])
    assert ranking.average_precision(np.array([1, 2, 0])) == pytest.approx(repeated)
    assert ranking.average_precision(np.array([0, 0, 1])) == 0
