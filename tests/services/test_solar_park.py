"""Rendered photos: their format, their repeatability, and that their truth is true."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from upwash.services.solar_park import (
    LABELS,
    Park,
    Rates,
    RenderedPhoto,
    TrueBox,
    View,
    photograph,
    render_photo,
)

Pixels = np.ndarray[tuple[int, ...], np.dtype[np.int16]]

SEED = 11
SOUND = Rates(hot_spot=0.0, broken=0.0)
FAULTY = Rates(hot_spot=0.05, broken=0.05)


@pytest.fixture(scope="module")
def photos() -> list[RenderedPhoto]:
    return [render_photo(seed) for seed in range(6_000, 6_012)]


def pixels(photo: RenderedPhoto) -> Pixels:
    image = cv2.imdecode(np.frombuffer(photo.jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    return image.astype(np.int16)


def longer_side_px(box: TrueBox) -> float:
    return max(box.width_px, box.height_px)


def test_photos_are_as_large_as_the_thesis_s(photos: list[RenderedPhoto]) -> None:
    for photo in photos:
        assert pixels(photo).shape == (1080, 1440, 3)
        assert 400_000 <= len(photo.jpeg) <= 450_000


def test_the_same_seed_renders_the_same_photo() -> None:
    assert render_photo(3) == render_photo(3)
    assert render_photo(3) != render_photo(4)


def test_photos_differ_in_what_is_on_them(photos: list[RenderedPhoto]) -> None:
    assert {box.label for photo in photos for box in photo.truth} == set(LABELS)
    sides_px = [longer_side_px(box) for photo in photos for box in photo.truth if box.label == "hot-spot"]
    assert min(sides_px) < 16
    assert max(sides_px) > 40
    brightness = [float(pixels(photo).mean()) for photo in photos]
    assert max(brightness) > 1.3 * min(brightness)


def test_faults_are_where_the_truth_says_and_nowhere_else() -> None:
    view = View(0, 0, altitude_m=14, heading_deg=7)
    faulty, sound = photograph(Park(SEED, FAULTY), view), photograph(Park(SEED, SOUND), view)
    assert sound.truth == ()
    assert len(faulty.truth) > 4
    difference = np.abs(pixels(faulty) - pixels(sound)).max(axis=2)
    expected = np.zeros_like(difference, bool)
    for box in faulty.truth:
        left, top = int(box.left_px), int(box.top_px)
        right, bottom = int(box.left_px + box.width_px) + 1, int(box.top_px + box.height_px) + 1
        assert difference[top:bottom, left:right].mean() > 10
        halo_px = 8 + int(longer_side_px(box) / 4)
        expected[max(0, top - halo_px) : bottom + halo_px, max(0, left - halo_px) : right + halo_px] = True
    # The two may be compressed differently, which a threshold well above JPEG's errors leaves out; at the border
    # are faults that are too little in the photo to be counted.
    changed = (difference > 40) & ~expected
    assert not changed[60:-60, 60:-60].any()


def test_a_place_keeps_its_faults_when_the_drone_comes_back_another_way() -> None:
    park = Park(SEED, FAULTY)
    here = photograph(park, View(5, 5, 12)).truth
    again = photograph(park, View(5, 5, 12), shot=9).truth
    assert [box.label for box in again] == [box.label for box in here]
    for one, other in zip(here, again, strict=True):
        assert one.left_px == pytest.approx(other.left_px, abs=60)  # the wind turns the camera a little


def test_the_photo_shows_what_lies_in_its_direction() -> None:
    """A fault moves across the photo as the drone does: east of it when it has flown west, below when north."""
    park = Park(SEED, FAULTY)
    middle = photograph(park, View(0, 0, 14))
    west, north = photograph(park, View(-2, 0, 14)), photograph(park, View(0, 2, 14))
    right, down = shift_px(middle, west)
    assert right > 100
    assert abs(down) < 30
    right, down = shift_px(middle, north)
    assert down > 100
    assert abs(right) < 30


def shift_px(before: RenderedPhoto, after: RenderedPhoto) -> tuple[float, float]:
    """How far the faults that are on both photos have moved, right and down."""
    moves = [
        (other.left_px - one.left_px, other.top_px - one.top_px)
        for one in before.truth
        for other in after.truth
        if one.label == other.label and abs(longer_side_px(one) - longer_side_px(other)) < 3
    ]
    right, down = np.median(np.array(moves), axis=0)
    return float(right), float(down)


def test_turning_the_camera_turns_the_photo() -> None:
    park = Park(SEED, FAULTY)
    north, south = photograph(park, View(0, 0, 14)), photograph(park, View(0, 0, 14, heading_deg=180))
    for one, other in zip(north.truth, south.truth, strict=True):
        assert one.left_px + one.width_px == pytest.approx(1440 - other.left_px, abs=60)
        assert one.top_px + one.height_px == pytest.approx(1080 - other.top_px, abs=60)


@pytest.mark.parametrize("altitude_m", [-2.0, 5_000.0])
def test_photos_can_be_taken_from_any_height(altitude_m: float) -> None:
    photo = photograph(Park(SEED), View(0, 0, altitude_m))
    assert pixels(photo).shape == (1080, 1440, 3)


def test_faults_are_as_frequent_as_they_are_said_to_be() -> None:
    view = View(0, 0, 60)
    truth = photograph(Park(SEED, Rates(hot_spot=0.04, broken=0.02)), view).truth
    labels = [box.label for box in truth]
    assert labels.count("hot-spot") == pytest.approx(2 * labels.count("broken-module"), rel=0.5)
    assert 0.5 < len(truth) / len(photograph(Park(SEED, Rates(hot_spot=0.06, broken=0.0)), view).truth) < 2
