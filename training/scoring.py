"""How good detections are: average precision at an overlap of one half, as object detectors are compared by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from upwash.profiling.agreement import verdicts
from upwash.services import Box, Detection


@dataclass(frozen=True, slots=True)
class Judged:
    """What was found of one label in one photo, and what truly is there."""

    found: Sequence[Detection]
    truth: Sequence[Box]


@dataclass(frozen=True, slots=True)
class Ranking:
    """The detections of one label in all photos, the surest first, and what photo each is in."""

    hits: NDArray[np.bool_]
    photos: NDArray[np.intp]
    boxes: NDArray[np.intp]  # by photo: how many truly are there

    @classmethod
    def of(cls, photos: Sequence[Judged]) -> Ranking:
        """The detections of all the photos."""
        ranked = sorted(
            (
                (score, hit, number)
                for number, photo in enumerate(photos)
                for score, hit in verdicts(photo.found, photo.truth)
            ),
            key=lambda each: -each[0],
        )
        return cls(
            np.array([hit for _, hit, _ in ranked], np.bool_),
            np.array([number for *_, number in ranked], np.intp),
            np.array([len(photo.truth) for photo in photos], np.intp),
        )

    def average_precision(self, weights: NDArray[np.intp]) -> float:
        """The area below precision over recall, with each photo taken as often as its weight says."""
        boxes = int((weights * self.boxes).sum())
        counted = weights[self.photos]
        seen = np.cumsum(counted)
        if not boxes or not seen.size or not seen[-1]:
            return 0.0
        found_more = np.where(self.hits, counted, 0)
        precision = np.cumsum(found_more) / np.maximum(seen, 1)
        best_from_here = np.maximum.accumulate(precision[::-1])[::-1]
        return float((best_from_here * found_more).sum() / boxes)


def average_precision(photos: Sequence[Judged]) -> float:
    """The area below precision over recall, with precision made to fall steadily; from 0 to 1.

    Detections of all photos are taken by score; each may hit one box that no better detection has hit.
    """
    return Ranking.of(photos).average_precision(np.ones(len(photos), np.intp))


def recall(photos: Sequence[Judged], *, confidence: float) -> float:
    """The share of the boxes that are hit by a detection of at least that score."""
    return _hits(photos, confidence) / sum(len(photo.truth) for photo in photos)


def precision(photos: Sequence[Judged], *, confidence: float) -> float:
    """The share of the detections of at least that score that are hits; 1 where there are none."""
    count = sum(each.score >= confidence for photo in photos for each in photo.found)
    return _hits(photos, confidence) / count if count else 1.0


def _hits(photos: Sequence[Judged], confidence: float) -> int:
    return sum(
        hit for photo in photos for score, hit in verdicts(photo.found, photo.truth) if score >= confidence
    )
