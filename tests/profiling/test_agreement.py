"""How much answers to smaller photos agree with those to whole ones, and with labels: examples computed by hand."""

from __future__ import annotations

from pathlib import Path

import pytest

from upwash.errors import UsageError
from upwash.profiling.agreement import LabelledBox, lost, mean_ap50, read_labels
from upwash.services import Detection


def found(left_px: float, *, score: float = 0.9, label: str = "hot-spot") -> Detection:
    return Detection(left_px=left_px, top_px=0, width_px=10, height_px=10, label=label, score=score)


def labelled(left_px: float, label: str = "hot-spot") -> LabelledBox:
    return LabelledBox(left_px=left_px, top_px=0, width_px=10, height_px=10, label=label)


@pytest.mark.parametrize(
    ("whole", "less", "loss"),
    [
        ([[found(0)]], [[found(2, score=0.3)]], 0.0),  # an overlap of two thirds
        ([[found(0)]], [[found(6)]], 1.0),
        ([[found(0)]], [[found(0, label="broken")]], 1.0),
        ([[found(0), found(50)], []], [[found(0)], [found(9)]], 0.5),  # 2 of 4 boxes agree
        ([[found(0)]], [[found(0), found(1)]], 1 / 3),  # a box agrees once
        ([[], []], [[], []], 0.0),
        ([1, 2, 3, 4], [1, 2, 3, 5], 0.25),
        ([["a"], []], [["b"], []], 0.5),
    ],
)
def test_the_loss_is_the_share_of_boxes_or_answers_that_differ(
    whole: list[object], less: list[object], loss: float
) -> None:
    assert lost(whole, less) == pytest.approx(loss)


def test_average_precision_counts_each_label_alone_and_takes_detections_by_score() -> None:
    truth = [[labelled(0), labelled(50)], [labelled(0, "broken")]]
    answers: list[object] = [[found(0, score=0.9), found(80, score=0.8), found(50, score=0.7)], []]
    # Of the hot-spots: 1, 1/2 and 2/3 precise, so half of the recall at 1 and half at 2/3; nothing is broken.
    assert mean_ap50(answers, truth) == pytest.approx((0.5 + 0.5 * 2 / 3 + 0.0) / 2)
    assert mean_ap50(answers, [[], []]) == 0.0


def test_labels_are_read_as_yolo_has_them_and_a_photo_without_a_file_shows_nothing(tmp_path: Path) -> None:
    (tmp_path / "classes.txt").write_text("hot-spot\nbroken\n")
    (tmp_path / "a.txt").write_text("1 0.5 0.5 0.1 0.2\n")
    read = read_labels(tmp_path, {"a.jpg": (100, 50), "b.jpg": (100, 50)})
    (box,) = read["a.jpg"]
    assert box.label == "broken"
    assert (box.left_px, box.top_px, box.width_px, box.height_px) == pytest.approx((45.0, 20.0, 10.0, 10.0))
    assert read["b.jpg"] == []


@pytest.mark.parametrize(
    "line", ["2 0.5 0.5 0.1 0.2", "-1 0.5 0.5 0.1 0.2", "hot-spot 0.5 0.5 0.1 0.2", "0 0.5 0.5 0.1"]
)
def test_a_line_that_is_no_box_is_named_with_the_remedy(line: str, tmp_path: Path) -> None:
    (tmp_path / "classes.txt").write_text("hot-spot\nbroken")
    (tmp_path / "a.txt").write_text(f"0 0.5 0.5 0.1 0.2\n{line}\n")
    with pytest.raises(UsageError, match=r"a\.txt, line 2: .*write `class x y width height`"):
        read_labels(tmp_path, {"a.jpg": (100, 50)})
