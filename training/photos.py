"""The rendered photos that the network learns from, rendered once and kept outside the repository."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import msgspec
import numpy as np
from cv2.typing import MatLike
from rich.progress import track

from upwash.services.solar_park import LABELS, TrueBox, render_photo

TRAINING_SEEDS = range(700)
VALIDATION_SEEDS = range(1_000_000, 1_000_120)  # every choice was made on these
TEST_SEEDS = range(2_000_000, 2_000_240)  # looked at once, when nothing was left to choose
ALTITUDE_SEEDS = range(3_000_000, 3_000_160)  # from each of the altitudes; nothing was chosen on these
ALTITUDES_M = (10, 15, 20, 25, 30, 40, 60)

WIDTH_PX, HEIGHT_PX = 720, 540  # half the photo: what the detector decodes, and more than it looks at
_PHOTO_WIDTH_PX = 1440


@dataclass(frozen=True, slots=True)
class LearningSet:
    """Photos at half size (BGR), and the boxes of each: rows of label index, left, top, right, bottom."""

    photos: MatLike
    boxes: list[MatLike]


def learning_set(seeds: range, cache: Path) -> LearningSet:
    """The photos of the seeds, from the cache if they are there."""
    folder = cache / f"{seeds.start}-{seeds.stop}"
    if not (folder / "truth.json").exists():
        _render(seeds, folder)
    photos = np.load(folder / "photos.npy", mmap_mode="r")
    truth = msgspec.json.decode((folder / "truth.json").read_bytes(), type=list[list[TrueBox]])
    return LearningSet(photos, [_rows(boxes) for boxes in truth])


def _render(seeds: range, folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    shape = (len(seeds), HEIGHT_PX, WIDTH_PX, 3)
    photos = np.lib.format.open_memmap(folder / "photos.npy", mode="w+", dtype=np.uint8, shape=shape)
    truth = []
    for index, (photo, boxes) in enumerate(track(_rendered(seeds), "rendering", total=len(seeds))):
        photos[index] = photo
        truth.append(boxes)
    photos.flush()
    (folder / "truth.json").write_bytes(msgspec.json.encode(truth))


def _rendered(seeds: range) -> Iterator[tuple[MatLike, tuple[TrueBox, ...]]]:
    with multiprocessing.get_context("spawn").Pool(os.cpu_count()) as pool:
        yield from pool.imap(_render_one, seeds, chunksize=4)


def _render_one(seed: int) -> tuple[MatLike, tuple[TrueBox, ...]]:
    photo = render_photo(seed)
    half = cv2.imdecode(np.frombuffer(photo.jpeg, np.uint8), cv2.IMREAD_REDUCED_COLOR_2)
    assert half is not None
    return half, photo.truth


def _rows(boxes: Sequence[TrueBox]) -> MatLike:
    half = WIDTH_PX / _PHOTO_WIDTH_PX
    rows = [
        (
            LABELS.index(box.label),
            half * box.left_px,
            half * box.top_px,
            half * (box.left_px + box.width_px),
            half * (box.top_px + box.height_px),
        )
        for box in boxes
    ]
    return np.array(rows, np.float32).reshape(-1, 5)
