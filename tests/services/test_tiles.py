"""Large photos in tiles: every pixel is looked at, and each object is found once, wherever borders cut it."""

from __future__ import annotations

import random
import tracemalloc
from collections.abc import Sequence
from itertools import pairwise

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.services.darknet_models import small, write_labels, write_model

from upwash.services import Box, Detection, Detector, ModelFiles, NotAPhoto
from upwash.services.photo import decode_photo
from upwash.services.solar_park import TrueBox, render_photo
from upwash.services.tiles import OVERLAP, TileBox, View, merged, tiles_of

lengths = st.integers(1, 3000)
tile_sides = st.integers(32, 700)
Object = tuple[int, View]  # its class and its place


@given(lengths, lengths, tile_sides, tile_sides)
def test_tiles_of_one_size_cover_the_photo_and_overlap(width: int, height: int, wide: int, high: int) -> None:
    tiles = tiles_of(width, height, (wide, high))
    assert {(tile.right_px - tile.left_px, tile.bottom_px - tile.top_px) for tile in tiles} == {
        (min(width, wide), min(height, high))
    }
    for starts, length, side in (
        (sorted({tile.left_px for tile in tiles}), width, wide),
        (sorted({tile.top_px for tile in tiles}), height, high),
    ):
        assert (starts[0], starts[-1]) == (0, max(0, length - side))
        assert all(0 < after - before <= side * (1 - OVERLAP) for before, after in pairwise(starts))


@pytest.mark.parametrize(
    ("width_px", "height_px", "tiles"),
    [(607, 608, 1), (608, 608, 1), (609, 608, 2), (609, 609, 4), (65_535, 1, 135), (1, 65_535, 135)],
)
def test_a_photo_has_as_many_tiles_as_it_needs(width_px: int, height_px: int, tiles: int) -> None:
    assert len(tiles_of(width_px, height_px, (608, 608))) == tiles


# --- one box for each object --------------------------------------------------------------------------------


@st.composite
def scenes(draw: st.DrawFn) -> tuple[list[View], list[Object]]:
    """Views of a photo with or without the whole, and objects; those of one class are apart."""
    width, height = draw(st.integers(64, 2000)), draw(st.integers(64, 2000))
    tiles = tiles_of(width, height, (draw(st.integers(150, 700)), draw(st.integers(150, 700))))
    rng = random.Random(draw(st.integers(0, 2**32)))
    objects: list[Object] = []
    for _ in range(draw(st.integers(0, 25))):
        wide, high = rng.randint(16, min(width, 900)), rng.randint(16, min(height, 900))
        left, top = rng.randint(0, width - wide), rng.randint(0, height - high)
        place, label = View(left, top, left + wide, top + high), rng.randint(0, 1)
        if all(other != label or shared(place, there) is None for other, there in objects):
            objects.append((label, place))
    with_whole = len(tiles) > 1 and draw(st.booleans())
    return [View(0, 0, width, height)] * with_whole + tiles, objects


def shared(one: View, other: View) -> View | None:
    low, high = map(max, one[:2], other[:2]), map(min, one[2:], other[2:])
    both = View(*low, *high)
    return both if both.left_px < both.right_px and both.top_px < both.bottom_px else None


def seen_by(view: View, objects: Sequence[Object], rng: random.Random, *, off_px: int) -> list[TileBox]:
    """What a detector finds in a view: the part of each object there, its sides as much as `off_px` off."""
    found = []
    for label, place in objects:
        part = shared(place, view)
        if part is None or (off_px and min(part[2] - part[0], part[3] - part[1]) < 16):
            continue
        left, top, right, bottom = (
            side if side == border else side + rng.randint(-off_px, off_px)
            for side, border in zip(part, view, strict=True)
        )
        found.append(TileBox(view, Box(left, top, right - left, bottom - top), rng.random(), label))
    return found


def extent(views: Sequence[View]) -> View:
    return View(0, 0, max(view.right_px for view in views), max(view.bottom_px for view in views))


def corners(box: Box) -> tuple[float, float, float, float]:
    return box.left_px, box.top_px, box.left_px + box.width_px, box.top_px + box.height_px


@given(scenes(), st.integers(0, 2**32))
def test_objects_that_borders_cut_are_found_once_each_and_whole(
    scene: tuple[list[View], list[Object]], seed: int
) -> None:
    views, objects = scene
    rng = random.Random(seed)
    sightings = [found for view in views for found in seen_by(view, objects, rng, off_px=0)]
    rng.shuffle(sightings)
    found = merged(sightings, extent(views))
    assert sorted((one.label, corners(one.box)) for one in found) == sorted(objects)
    assert [one.score for one in found] == sorted((one.score for one in found), reverse=True)
    for one in found:  # the score is the best of all that show it
        parts = [each for each in sightings if each.label == one.label and is_part(each, one.box)]
        assert one.score == max(each.score for each in parts)


def is_part(sighting: TileBox, box: Box) -> bool:
    left, top, right, bottom = corners(sighting.box)
    outer = corners(box)
    return outer[0] <= left and outer[1] <= top and right <= outer[2] and bottom <= outer[3]


@given(scenes(), st.integers(0, 2**32))
def test_a_detector_that_is_a_pixel_off_finds_each_object_once(
    scene: tuple[list[View], list[Object]], seed: int
) -> None:
    views, objects = scene
    rng = random.Random(seed)
    sightings = [found for view in views for found in seen_by(view, objects, rng, off_px=1)]
    found = merged(sightings, extent(views))
    assert len(found) == len(objects)
    for label, place in objects:
        assert any(
            one.label == label and all(abs(a - b) <= 16 for a, b in zip(corners(one.box), place, strict=True))
            for one in found
        )


def test_two_boxes_of_one_view_stay_two() -> None:
    """What a network chose within a picture is not chosen again, as with DETR."""
    view, other = View(0, 0, 100, 100), View(50, 0, 150, 100)
    near = [TileBox(view, Box(60, 10, 20, 20), 0.9, 0), TileBox(view, Box(62, 10, 20, 20), 0.8, 0)]
    photo = extent([view, other])
    assert merged(near, photo) == near
    assert len(merged([*near, *(one._replace(view=other, score=0.5) for one in near)], photo)) == 2


def test_a_small_object_of_the_whole_photo_is_that_of_a_tile_which_shows_it_in_detail() -> None:
    photo, tile = View(0, 0, 1000, 1000), View(400, 400, 600, 600)
    fine = TileBox(tile, Box(452, 451, 5, 5), 0.5, 0)
    small, large = (
        TileBox(photo, Box(450, 450, 9, 10), 0.9, 0),
        TileBox(photo, Box(410, 410, 100, 100), 0.9, 0),
    )
    assert merged([small, fine], photo) == [small._replace(box=fine.box)]
    assert merged([large, fine], photo) == [large, fine]


# --- the detector -------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> ModelFiles:
    folder = tmp_path_factory.mktemp("model")
    cfg, weights = write_model(folder, small())
    return ModelFiles(cfg=cfg, weights=weights, names=write_labels(folder, 2))


def jpeg_of(image: np.ndarray) -> bytes:
    return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()


def test_tiles_show_what_a_large_photo_is_too_large_for() -> None:
    """Sixteen photos side by side, each as the network was trained on them: borders of tiles lie elsewhere."""
    mosaic = np.zeros((4 * 456, 4 * 608, 3), np.uint8)
    truth = []
    for number in range(16):
        photo = render_photo(7000 + number)
        left, top = number % 4 * 608, number // 4 * 456
        mosaic[top : top + 456, left : left + 608] = cv2.resize(
            decode_photo(photo.jpeg), (608, 456), interpolation=cv2.INTER_AREA
        )
        truth += [(left, top, box) for box in photo.truth]
    whole = Detector(tiles="off").process_photo(jpeg_of(mosaic))
    tiled = Detector(tiles="auto").process_photo(jpeg_of(mosaic))
    hits = [sum(is_hit(found, *there) for found in tiled) for there in truth]
    assert sum(map(bool, hits)) >= 0.9 * len(truth) > 30
    assert sum(hit > 1 for hit in hits) <= 2  # in one picture the network finds them twice
    assert sum(any(is_hit(found, *there) for found in whole) for there in truth) < 0.7 * len(truth)


def is_hit(found: Detection, left_px: int, top_px: int, true: TrueBox) -> bool:
    scale = 608 / 1440
    x_px = found.left_px + found.width_px / 2 - left_px - true.left_px * scale
    y_px = found.top_px + found.height_px / 2 - top_px - true.top_px * scale
    return (
        found.label == true.label
        and 0 <= x_px <= true.width_px * scale
        and 0 <= y_px <= true.height_px * scale
    )


@pytest.mark.parametrize(("width_px", "height_px"), [(300, 200), (912, 912), (912, 10)])
def test_a_photo_that_is_not_large_is_looked_at_as_without_tiles(
    model: ModelFiles, width_px: int, height_px: int
) -> None:
    rng = np.random.default_rng(3)
    photo = jpeg_of(rng.integers(0, 256, (height_px, width_px, 3), np.uint8))
    tiled, plain = Detector(model=model, tiles="auto"), Detector(model=model)
    assert tiled.process_photo(photo) == plain.process_photo(photo)
    large = jpeg_of(rng.integers(0, 256, (913, 600, 3), np.uint8))
    assert tiled.process_photo(large, "light") == plain.process_photo(large, "light")
    assert tiled.process_photo(large) != plain.process_photo(large)


@pytest.mark.parametrize(("width_px", "height_px"), [(4000, 1), (1, 4000), (609, 608), (3000, 40)])
def test_boxes_of_photos_of_any_shape_lie_on_them(model: ModelFiles, width_px: int, height_px: int) -> None:
    photo = jpeg_of(np.random.default_rng(3).integers(0, 256, (height_px, width_px, 3), np.uint8))
    for found in Detector(model=model, tiles=608).process_photo(photo, "heavy", 0.3):
        assert 0 <= found.left_px < found.left_px + found.width_px <= width_px + 0.01
        assert 0 <= found.top_px < found.top_px + found.height_px <= height_px + 0.01


def test_the_start_says_how_photos_are_tiled(model: ModelFiles, capsys: pytest.CaptureFixture[str]) -> None:
    Detector(model=model, tiles="auto")
    Detector(model=model, tiles=1000)
    Detector(model=model, tiles="off")
    assert capsys.readouterr().err.splitlines() == [
        "heavy: photos beyond 912 x 912 in tiles of 608 x 608",
        "heavy: photos beyond 1000 x 1000 in tiles of 1000 x 1000",
    ]


def test_a_photo_of_too_many_tiles_is_refused(model: ModelFiles) -> None:
    photo = jpeg_of(np.zeros((2000, 1000), np.uint8))
    with pytest.raises(NotAPhoto, match="1000 x 2000 pixels has 3200 tiles of 32 x 32, and at most 1000"):
        Detector(model=model, tiles=32).process_photo(photo)
    Detector(model=model, tiles=32).process_photo(photo, "light")


def test_tiles_need_little_memory_beside_the_photo(model: ModelFiles) -> None:
    photo_bytes = 3 * 1500 * 2000
    photo = jpeg_of(np.zeros((1500, 2000, 3), np.uint8))
    detector = Detector(model=model, tiles="auto")  # 20 pictures of 4 MB
    tracemalloc.start()
    try:
        detector.process_photo(photo)
        assert tracemalloc.get_traced_memory()[1] < photo_bytes + 30_000_000
    finally:
        tracemalloc.stop()


# --- larger photos ------------------------------------------------------------------------------------------


def test_the_bound_of_megapixels_is_a_setting(model: ModelFiles) -> None:
    png = cv2.imencode(".png", np.zeros((5000, 8200), np.uint8))[1].tobytes()
    with pytest.raises(NotAPhoto, match="photos of 1 to 40,000,000 pixels are accepted: save it as a base"):
        Detector(model=model).process_photo(png)
    assert Detector(model=model, max_photo_mpixels=41).process_photo(png, confidence=1.0) == []
    jpeg = jpeg_of(np.zeros((1000, 1001), np.uint8))
    with pytest.raises(NotAPhoto, match=r"1 to 1,000,000 pixels are accepted: .* raise .* max_photo_mpixels"):
        Detector(model=model, max_photo_mpixels=1).process_photo(jpeg)
    with pytest.raises(NotAPhoto, match="1 to 1,000,000 pixels are accepted"):
        Detector(model=model, max_photo_mpixels=1, tiles="auto").process_photo(jpeg)
