"""The detector, on rendered photos that nothing was tuned on and on bytes that are no photos."""

from __future__ import annotations

import random
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import msgspec
import numpy as np
import pytest

from upwash.errors import UsageError
from upwash.services.hotspots import Box, Detection, HotSpotDetector, Mode, NotAPhoto
from upwash.services.solar_park import RenderedPhoto, render_photo

LARGE_FROM_PX = 26.0  # the longer side of a large hot-spot

TEST_SEEDS = range(5000, 5040)  # thresholds were chosen on seeds 1000 to 1119
MODES: tuple[Mode, ...] = ("light", "heavy")


@pytest.fixture(scope="module")
def detector() -> HotSpotDetector:
    return HotSpotDetector()


@pytest.fixture(scope="module")
def photos() -> list[RenderedPhoto]:
    return [render_photo(seed) for seed in TEST_SEEDS]


@dataclass
class Score:
    """Counts over photos. A hit covers one true hot-spot: centre inside its box, and boxes that share 40 %."""

    hits: int = 0
    false_alarms: int = 0
    missed: int = 0
    large_hits: int = 0
    large_missed: int = 0

    def add(self, found: Sequence[Box], truth: Sequence[Box]) -> None:
        missed = list(truth)
        for box in found:
            hit = next((true for true in missed if is_hit(box, true)), None)
            if hit is None:
                self.false_alarms += 1
            else:
                missed.remove(hit)
                self.hits += 1
                self.large_hits += is_large(hit)
        self.missed += len(missed)
        self.large_missed += sum(map(is_large, missed))

    @property
    def precision(self) -> float:
        return self.hits / (self.hits + self.false_alarms)

    @property
    def recall(self) -> float:
        return self.hits / (self.hits + self.missed)

    @property
    def large_recall(self) -> float:
        return self.large_hits / (self.large_hits + self.large_missed)


def is_large(box: Box) -> bool:
    return max(box.width_px, box.height_px) >= LARGE_FROM_PX


def is_hit(found: Box, true: Box) -> bool:
    x_px, y_px = found.left_px + found.width_px / 2, found.top_px + found.height_px / 2
    centred = 0 <= x_px - true.left_px <= true.width_px and 0 <= y_px - true.top_px <= true.height_px
    return centred and shared_area(found, true) >= 0.4


def shared_area(a: Box, b: Box) -> float:
    """Intersection over union."""
    width_px = min(a.left_px + a.width_px, b.left_px + b.width_px) - max(a.left_px, b.left_px)
    height_px = min(a.top_px + a.height_px, b.top_px + b.height_px) - max(a.top_px, b.top_px)
    both_px = max(0.0, width_px) * max(0.0, height_px)
    return both_px / (a.width_px * a.height_px + b.width_px * b.height_px - both_px)


def score(detector: HotSpotDetector, photos: Sequence[RenderedPhoto], mode: Mode) -> Score:
    total = Score()
    for photo in photos:
        total.add(
            detector.process_photo(photo.jpeg, mode), [box for box in photo.truth if box.label == "hot-spot"]
        )
    return total


def jpeg_of(image: np.ndarray[tuple[int, ...], np.dtype[np.uint8]]) -> bytes:
    _, jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 90])
    return jpeg.tobytes()


def disc_on(background_bgr: tuple[int, int, int]) -> bytes:
    """A glowing disc, 80 px wide, in the upper right of a plain photo."""
    image = np.full((600, 1000, 3), background_bgr, np.uint8)
    cv2.circle(image, (800, 200), 40, (40, 160, 255), -1)
    return jpeg_of(image)


MODULE_BGR, GRASS_BGR = (92, 50, 24), (74, 118, 108)


def test_heavy_finds_hot_spots_of_all_sizes_and_little_else(
    detector: HotSpotDetector, photos: list[RenderedPhoto]
) -> None:
    heavy = score(detector, photos, "heavy")
    assert heavy.recall >= 0.95
    assert heavy.precision >= 0.85  # it takes autumn leaves on the glass for small hot-spots


def test_light_finds_large_hot_spots_and_little_else(
    detector: HotSpotDetector, photos: list[RenderedPhoto]
) -> None:
    light = score(detector, photos, "light")
    assert light.large_recall >= 0.9
    assert light.precision >= 0.95


def test_heavy_is_worth_its_price(detector: HotSpotDetector, photos: list[RenderedPhoto]) -> None:
    assert score(detector, photos, "heavy").recall >= score(detector, photos, "light").recall + 0.1


@pytest.mark.parametrize("mode", MODES)
def test_boxes_are_in_pixels_of_the_full_photo(detector: HotSpotDetector, mode: Mode) -> None:
    (found,) = detector.process_photo(disc_on(MODULE_BGR), mode)
    assert found.label == "hot-spot"
    assert 0.8 < found.score <= 1
    assert shared_area(found, Box(760, 160, 80, 80)) > 0.8


@pytest.mark.parametrize("mode", MODES)
def test_a_glow_that_no_module_surrounds_is_not_reported(detector: HotSpotDetector, mode: Mode) -> None:
    assert detector.process_photo(disc_on(GRASS_BGR), mode) == []


@pytest.mark.parametrize("mode", MODES)
def test_gray_and_tiny_photos_have_no_hot_spots(detector: HotSpotDetector, mode: Mode) -> None:
    assert detector.process_photo(jpeg_of(np.full((300, 400), 90, np.uint8)), mode) == []
    assert detector.process_photo(jpeg_of(np.full((1, 1, 3), 200, np.uint8)), mode) == []


def test_the_cameras_note_to_turn_the_photo_does_not_move_the_boxes(detector: HotSpotDetector) -> None:
    photo = disc_on(MODULE_BGR)
    turn_right = bytes.fromhex("4d4d002a00000008 0001 0112 0003 00000001 00060000 00000000")
    exif = b"Exif\0\0" + turn_right
    turned = photo[:2] + b"\xff\xe1" + (len(exif) + 2).to_bytes(2) + exif + photo[2:]
    followed = cv2.imdecode(np.frombuffer(turned, np.uint8), cv2.IMREAD_COLOR)
    assert followed is not None
    assert followed.shape[:2] == (1000, 600)
    assert detector.process_photo(turned, "heavy") == detector.process_photo(photo, "heavy")


def test_a_photo_full_of_glows_gets_a_bounded_answer(detector: HotSpotDetector) -> None:
    image = np.full((1080, 1440, 3), MODULE_BGR, np.uint8)
    for x_px in range(15, 1440, 30):
        for y_px in range(15, 1080, 30):
            cv2.circle(image, (x_px, y_px), 6, (40, 160, 255), -1)
    assert 100 < len(detector.process_photo(jpeg_of(image), "heavy")) <= 200


def test_the_surest_comes_first(detector: HotSpotDetector, photos: list[RenderedPhoto]) -> None:
    found = max((detector.process_photo(photo.jpeg, "heavy") for photo in photos), key=len)
    assert len(found) > 1
    assert found == sorted(found, key=lambda detection: -detection.score)


def test_detections_travel() -> None:
    found = Detection(label="hot-spot", score=0.9, left_px=1, top_px=2, width_px=3, height_px=4)
    assert msgspec.msgpack.decode(msgspec.msgpack.encode([found]), type=list[Detection]) == [found]


# --- bytes that are no photo -----------------------------------------------------------------------


def with_size(photo: bytes, *, width_px: int, height_px: int) -> bytes:
    at = photo.index(b"\xff\xc0") + 5
    return photo[:at] + height_px.to_bytes(2) + width_px.to_bytes(2) + photo[at + 4 :]


def png() -> bytes:
    return cv2.imencode(".png", np.zeros((8, 8, 3), np.uint8))[1].tobytes()


@pytest.mark.parametrize(
    ("photo", "complaint"),
    [
        (b"", r"empty \(0 bytes\)"),
        (b"\x00\x01\x02\x03\x04", r"5 bytes that start with 00 01 02 03, not a JPEG"),
        (png(), r"is a PNG, not a JPEG"),
        (b"\xff\xd8\xff", r"cut off after 3 bytes"),
        (b"\xff\xd8\xff\xe0\x00\x04ab" + bytes(100), r"byte 8 starts no segment"),
        (b"\xff\xd8\xff\x00\xff\xff" + bytes(100), r"byte 2 starts no segment"),
        (b"\xff\xd8\xff\xda" + bytes(100) + b"\xff\xd9", r"never says its size"),
        (disc_on(MODULE_BGR)[:-2], r"cut off after [\d,]+ bytes"),
        (disc_on(MODULE_BGR)[: len(disc_on(MODULE_BGR)) // 2], r"cut off after [\d,]+ bytes"),
        (with_size(disc_on(MODULE_BGR), width_px=65_000, height_px=65_000), r"65000 x 65000 pixels"),
        (with_size(disc_on(MODULE_BGR), width_px=1000, height_px=0), r"1000 x 0 pixels"),
    ],
    ids=[
        "empty",
        "noise",
        "png",
        "stub",
        "zeros",
        "no-marker",
        "sizeless",
        "no-end",
        "half",
        "giant",
        "flat",
    ],
)
def test_what_is_no_photo_is_refused_with_what_it_is(
    detector: HotSpotDetector, photo: bytes, complaint: str
) -> None:
    with pytest.raises(NotAPhoto, match=complaint):
        detector.process_photo(photo, "light")


def test_a_giant_is_refused_before_it_is_decoded(
    detector: HotSpotDetector, monkeypatch: pytest.MonkeyPatch
) -> None:
    def decode(*_: object) -> None:
        pytest.fail("a photo of 65000 x 65000 pixels reached the decoder")

    giant = with_size(disc_on(MODULE_BGR), width_px=65_000, height_px=65_000)
    monkeypatch.setattr(cv2, "imdecode", decode)
    with pytest.raises(NotAPhoto):
        detector.process_photo(giant, "heavy")


def test_every_cut_is_noticed(detector: HotSpotDetector) -> None:
    photo = disc_on(MODULE_BGR)
    for length in range(0, len(photo), 61):
        with pytest.raises(NotAPhoto):
            detector.process_photo(photo[:length], "light")


def test_damaged_headers_raise_nothing_but_not_a_photo(detector: HotSpotDetector) -> None:
    photo, chance = disc_on(MODULE_BGR), random.Random(7)
    refused = 0
    for _ in range(300):
        damaged = bytearray(photo)
        for _ in range(3):
            damaged[chance.randrange(2, 640)] = chance.randrange(256)
        try:
            detector.process_photo(bytes(damaged), "light")
        except NotAPhoto:
            refused += 1
    assert 0 < refused < 300


# --- what importing costs --------------------------------------------------------------------------


def test_importing_the_detector_imports_neither_opencv_nor_numpy() -> None:
    program = "import sys, upwash.services; sys.exit(bool({'cv2', 'numpy'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0


def test_without_opencv_the_detector_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cv2", None)
    with pytest.raises(UsageError, match=r"pip install 'upwash\[detector\]'"):
        HotSpotDetector()
