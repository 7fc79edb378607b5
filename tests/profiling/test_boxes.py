"""What a detector found in a person's photos, in one line."""

from __future__ import annotations

from upwash.profiling.boxes import told_boxes
from upwash.services import Detection


def box(score: float) -> Detection:
    return Detection(left_px=0, top_px=0, width_px=1, height_px=1, label="a", score=score)


def test_the_share_of_photos_with_boxes_is_the_chance_of_an_act() -> None:
    answers = [[], [box(0.3), box(0.9)], [], [box(0.5)]]
    said = "detector: 3 boxes in 2 of 4 photos, scores 0.30 to 0.90, median 0.50"
    assert told_boxes("detector", answers, as_chance=True) == f"{said}; in [event]: probability = 0.5"
    assert told_boxes("detector", answers, as_chance=False) == said


def test_a_detector_that_finds_nothing_says_so_and_another_service_says_nothing() -> None:
    assert (
        told_boxes("d", [[], []], as_chance=True)
        == "d: 0 boxes in 0 of 2 photos; in [event]: probability = 0"
    )
    assert not told_boxes("d", [[box(0.5)], 7], as_chance=True)
    assert not told_boxes("d", [], as_chance=True)
