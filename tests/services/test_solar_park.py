"""Rendered photos: their format, their repeatability, and that their truth is true."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from upwash.services.hotspots import Box
from upwash.services.solar_park import LARGE_FROM_PX, RenderedPhoto, read_truth, render_folder, render_photo

Pixels = np.ndarray[tuple[int, ...], np.dtype[np.int16]]


@pytest.fixture(scope="module")
def photos() -> list[RenderedPhoto]:
    return [render_photo(seed) for seed in range(6000, 6020)]


def pixels(photo: RenderedPhoto) -> Pixels:
    image = cv2.imdecode(np.frombuffer(photo.jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    return image.astype(np.int16)


def longer_side_px(box: Box) -> float:
    return max(box.width_px, box.height_px)


def test_photos_are_as_large_as_the_thesis_s(photos: list[RenderedPhoto]) -> None:
    for photo in photos:
        assert pixels(photo).shape == (1080, 1440, 3)
        assert 400_000 <= len(photo.jpeg) <= 450_000


def test_the_same_seed_renders_the_same_photo() -> None:
    assert render_photo(3) == render_photo(3)
    assert render_photo(3) != render_photo(4)


def test_some_photos_have_no_hot_spots_and_the_others_have_small_and_large_ones(
    photos: list[RenderedPhoto],
) -> None:
    assert 0.2 <= sum(not photo.hot_spots for photo in photos) / len(photos) <= 0.6
    sides_px = [longer_side_px(box) for photo in photos for box in photo.hot_spots]
    assert any(side > LARGE_FROM_PX for side in sides_px)
    assert any(side < LARGE_FROM_PX for side in sides_px)
    assert all(abs(side - LARGE_FROM_PX) > 1 for side in sides_px)  # none in doubt


def test_hot_spots_are_where_the_truth_says_and_nowhere_else() -> None:
    with_heat, without = render_photo(11, hot_spots=6), render_photo(11, hot_spots=0)
    assert without.hot_spots == ()
    # The two may be compressed differently, which a threshold well above JPEG's errors leaves out.
    changed = np.abs(pixels(with_heat) - pixels(without)).max(axis=2) > 70
    expected = np.zeros_like(changed)
    for box in with_heat.hot_spots:
        left, top = int(box.left_px), int(box.top_px)
        right, bottom = int(box.left_px + box.width_px) + 1, int(box.top_px + box.height_px) + 1
        assert changed[top:bottom, left:right].mean() > 0.5
        halo_px = 8 + int(longer_side_px(box) / 4)
        expected[max(0, top - halo_px) : bottom + halo_px, max(0, left - halo_px) : right + halo_px] = True
    assert len(with_heat.hot_spots) == 6
    assert not (changed & ~expected).any()


@pytest.mark.parametrize("hot_spots", [-1, 1000])
def test_more_hot_spots_than_modules_are_refused(hot_spots: int) -> None:
    with pytest.raises(ValueError, match=r"shows \d+ whole modules"):
        render_photo(1, hot_spots=hot_spots)


def test_a_folder_holds_the_photos_of_its_seeds_and_their_truth(tmp_path: Path) -> None:
    folder = tmp_path / "new" / "photos"
    render_folder(folder, count=2, seed=4)
    assert sorted(path.name for path in folder.iterdir()) == ["photo-000.jpg", "photo-001.jpg", "truth.json"]
    truth = read_truth(folder)
    for index, name in enumerate(truth):
        photo = render_photo(4 + index)
        assert (folder / name).read_bytes() == photo.jpeg
        assert truth[name] == photo.hot_spots
