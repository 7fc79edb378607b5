"""How good detections are: average precision at an overlap of one half, as object detectors are compared by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from upwash.services import Box, Detection

_HIT_OVERLAP = 0.5


@dataclass(frozen=True, slots=True)
class Judged:
    """What was found of one label in one photo, and what truly is there."""

    found: Sequence[Detection]
    truth: Sequence[Box]


def average_precision(photos: Sequence[Judged]) -> float:
    """The area below precision over recall, with precision made to fall steadily; from 0 to 1.

    Detections are taken by score, whatever photo they are in; each may hit one box that no surer one has hit.
    """
    verdicts = sorted(
        ((score, hit) for photo in photos for score, hit in _verdicts(photo)), key=lambda each: -each[0]
    )
    if not verdicts:
        return 0.0
    hits = np.cumsum([hit for _, hit in verdicts])
    precision = hits / np.arange(1, len(verdicts) + 1)
    best_from_here = np.maximum.accumulate(precision[::-1])[::-1]
    found_more = np.diff(hits, prepend=0)
    return float((best_from_here * found_more).sum() / sum(len(photo.truth) for photo in photos))


def recall(photos: Sequence[Judged], *, confidence: float) -> float:
    """The share of the boxes that are hit by a detection of at least that score."""
    return _hits(photos, confidence) / sum(len(photo.truth) for photo in photos)


def precision(photos: Sequence[Judged], *, confidence: float) -> float:
    """The share of the detections of at least that score that are hits; 1 where there are none."""
    count = sum(each.score >= confidence for photo in photos for each in photo.found)
    return _hits(photos, confidence) / count if count else 1.0


def _hits(photos: Sequence[Judged], confidence: float) -> int:
    return sum(hit for photo in photos for score, hit in _verdicts(photo) if score >= confidence)


def _verdicts(photo: Judged) -> list[tuple[float, bool]]:
    """The score of each detection, and whether it is a hit, the surest first."""
    missed = list(photo.truth)
    verdicts = []
    for each in sorted(photo.found, key=lambda detection: -detection.score):
        best = max(missed, key=lambda box: overlap(each, box), default=None)
        hit = best is not None and overlap(each, best) >= _HIT_OVERLAP
        if hit and best is not None:
            missed.remove(best)
        verdicts.append((each.score, hit))
    return verdicts


def overlap(a: Box, b: Box) -> float:
    """The area that two boxes share over the area that they cover (IoU), 0 to 1."""
    width_px = min(a.left_px + a.width_px, b.left_px + b.width_px) - max(a.left_px, b.left_px)
    height_px = min(a.top_px + a.height_px, b.top_px + b.height_px) - max(a.top_px, b.top_px)
    shared_px = max(0.0, width_px) * max(0.0, height_px)
    return shared_px / (a.width_px * a.height_px + b.width_px * b.height_px - shared_px)
