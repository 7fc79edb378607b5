"""Batches of square crops, scaled to what the network sees of a photo in light mode, in heavy mode, and between."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from cv2.typing import MatLike
from numpy.random import Generator

from training.photos import WIDTH_PX, LearningSet

CROP_PX = 224
_LIGHT_PX, _HEAVY_PX = 320, 608  # the detector's input sizes
_LEAST_VISIBLE = 0.3  # share of a box that makes it part of a crop
_AROUND_A_BOX = 0.7  # share of the crops
_GREY = 127


@dataclass(frozen=True, slots=True)
class Batch:
    """Crops (RGB) and their boxes: rows of crop index, label index, left, top, right, bottom, in pixels."""

    crops: MatLike
    boxes: MatLike


def random_batch(rng: Generator, learning: LearningSet, size: int) -> Batch:
    """Crops of photos that are chosen, turned and lit at random."""
    crops, boxes = [], []
    for index, photo in enumerate(rng.integers(0, len(learning.boxes), size)):
        crop, rows = _crop(rng, learning.photos[photo], learning.boxes[photo])
        crop, rows = _turn(rng, crop, rows)
        crops.append(_light(rng, crop))
        boxes.append(np.column_stack([np.full(len(rows), index, np.float32), rows]))
    return Batch(np.stack(crops)[..., ::-1].copy(), np.concatenate(boxes))


def _crop(rng: Generator, photo: MatLike, rows: MatLike) -> tuple[MatLike, MatLike]:
    scale = _input_width(rng) / WIDTH_PX
    size_px = round(photo.shape[1] * scale), round(photo.shape[0] * scale)
    if size_px[0] <= photo.shape[1] // 2:  # then the detector decodes a quarter of the photo
        photo = cv2.resize(photo, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    scaled = cv2.resize(photo, size_px, interpolation=cv2.INTER_AREA)
    left, top = _corner(rng, size_px, scale * rows[:, 1:])
    crop = np.full((CROP_PX, CROP_PX, 3), _GREY, np.uint8)
    seen = scaled[max(0, top) : top + CROP_PX, max(0, left) : left + CROP_PX]
    crop[max(0, -top) :, max(0, -left) :][: seen.shape[0], : seen.shape[1]] = seen
    moved = rows.copy()
    moved[:, 1:] = rows[:, 1:] * scale - np.array([left, top, left, top])
    return crop, _visible(moved)


def _input_width(rng: Generator) -> float:
    """How wide the network sees the whole photo: most often as in one of its two modes."""
    middle = (_LIGHT_PX, _HEAVY_PX, rng.uniform(_LIGHT_PX, _HEAVY_PX))[rng.choice(3, p=(0.35, 0.5, 0.15))]
    return float(middle * rng.uniform(0.93, 1.07))


def _corner(rng: Generator, size_px: tuple[int, int], boxes: MatLike) -> tuple[int, int]:
    """Anywhere on the photo, but most often with one of its boxes in view, since most of it is empty."""
    if len(boxes) and rng.random() < _AROUND_A_BOX:
        box = boxes[rng.integers(len(boxes))]
        middle = (box[:2] + box[2:]) / 2
        wished = (middle - CROP_PX * rng.uniform(0.1, 0.9, 2)).astype(int)
    else:
        wished = rng.integers(-CROP_PX, np.array(size_px) + 1)
    # Where the photo is smaller than the crop, grey surrounds it.
    spare = np.array(size_px) - CROP_PX
    left, top = np.clip(wished, np.minimum(0, spare), np.maximum(0, spare))
    return int(left), int(top)


def _visible(rows: MatLike) -> MatLike:
    cut = rows.copy()
    cut[:, 1:] = rows[:, 1:].clip(0, CROP_PX)
    return cut[_areas(cut) > _LEAST_VISIBLE * _areas(rows)]


def _areas(rows: MatLike) -> MatLike:
    areas: MatLike = (rows[:, 3] - rows[:, 1]) * (rows[:, 4] - rows[:, 2])
    return areas


def _turn(rng: Generator, crop: MatLike, rows: MatLike) -> tuple[MatLike, MatLike]:
    """Any of the eight ways to lay a square."""
    across, down, diagonal = rng.random(3) < 0.5
    label, left, top, right, bottom = rows.T
    if across:
        crop, left, right = crop[:, ::-1], CROP_PX - right, CROP_PX - left
    if down:
        crop, top, bottom = crop[::-1], CROP_PX - bottom, CROP_PX - top
    if diagonal:
        crop, left, top, right, bottom = crop.transpose(1, 0, 2), top, left, bottom, right
    return crop, np.column_stack([label, left, top, right, bottom])


def _light(rng: Generator, crop: MatLike) -> MatLike:
    gains = rng.uniform(0.85, 1.15) * rng.uniform(0.95, 1.05, 3)
    lit = crop * gains.astype(np.float32)
    lit = lit + rng.normal(0, rng.uniform(0, 3), crop.shape[:2]).astype(np.float32)[..., np.newaxis]
    clipped: MatLike = lit.clip(0, 255).astype(np.uint8)
    return clipped
