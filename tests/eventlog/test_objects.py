"""Objects on photos are recognised in messages by the names of their fields; nothing else is."""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from upwash.eventlog.narration import in_one_line
from upwash.eventlog.objects import Outline, found_objects
from upwash.services import Detection

BOX = Outline(10.0, 20.0, 30.0, 40.0, "car", 0.5)


@dataclass
class Corners:
    x1: float
    y1: float
    x2: float
    y2: float
    class_name: str
    confidence: float


@pytest.mark.parametrize(
    "message",
    [
        Detection(10.0, 20.0, 30.0, 40.0, label="car", score=0.5),
        Corners(10, 20, 40, 60, "car", 0.5),
        {"x": 10, "y": 20, "w": 30, "h": 40, "name": "car", "probability": 0.5},
        {"left": 10, "top": 20, "right": 40, "bottom": 60, "kind": "car", "score": 0.5},
        {"xmin": 10, "ymin": 20, "xmax": 40, "ymax": 60, "category": "car", "score": 0.5},
        {
            "bbox": {"x": 10, "y": 20, "width": 30, "height": 40},
            "species": "car",
            "score": 0.5,
            "photo": "1.jpg",
        },
    ],
)
def test_a_box_is_recognised_by_the_names_of_its_fields(message: object) -> None:
    plain = msgspec.to_builtins(message)
    assert found_objects(plain) == [BOX]
    assert found_objects([plain, plain]) == [BOX, BOX]


def test_a_point_is_an_object_too() -> None:
    (found,) = found_objects({"x_px": 3, "y_px": 4, "label": "weed"}) or []
    assert found.middle_and_size == (3.0, 4.0, 0.0, 0.0)
    assert found.score is None


@pytest.mark.parametrize(
    "message",
    [
        None,
        "a car at 3, 4",
        67.5,
        {"brightness": 67.5, "spots": 2},
        {"x": 3, "y": 4},
        {"label": "car", "score": 0.9},
        {"label": "car", "x": "3", "y": 4},
        {"label": "car", "x": True, "y": 4},
        {"label": "car", "x": float("nan"), "y": 4},
        {"label": "car", "x": 1e300, "y": 4},
        {"label": "car", "x": 10, "y": 20, "width": -1, "height": 5},
        {"label": "car", "x1": 10, "y1": 20, "x2": 9, "y2": 30},
        {"label": 7, "x": 3, "y": 4},
        [{"label": "car", "x": 3, "y": 4}, "and a car"],
    ],
)
def test_a_message_that_has_more_or_less_is_none(message: object) -> None:
    assert found_objects(message) is None


def test_an_empty_list_is_a_list_of_no_objects() -> None:
    assert found_objects([]) == []


@given(
    st.recursive(
        st.none() | st.booleans() | st.floats() | st.text(max_size=5),
        lambda inner: (
            st.lists(inner, max_size=3)
            | st.dictionaries(
                st.sampled_from(["label", "x", "y", "box", "bbox", "width", "x1"]), inner, max_size=4
            )
        ),
    )
)
def test_any_message_is_read_or_left(message: object) -> None:
    found = found_objects(message)
    assert found is None or all((item.label and item.width_px >= 0) or not item.label for item in found)


@pytest.mark.parametrize(
    ("message", "words"),
    [
        ([{"x": 1, "y": 2, "species": "thistle"}] * 2, "2 thistles"),
        ({"brightness": 67.5, "bright_spots": 2}, "brightness 67.5, 2 bright spots"),
        ({"bright_spots": 1}, "1 bright spot"),
        ({"number": 41, "counted": False}, "41 number, not counted"),
        ([{"x": 1, "y": 2, "label": ""}], "1 object"),
        ([], ""),
        ("as it is", "as it is"),
        ([1, 2], "[1, 2]"),
    ],
)
def test_plain_results_are_told_readably(message: object, words: str) -> None:
    assert in_one_line(message) == words
