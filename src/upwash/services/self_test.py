"""The self-test of a network at loading: what it finds in a grey picture, in noise and in a bundled photo."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from upwash.services.darknet.heads import Candidates
from upwash.services.heads import COMPARE, IN_FLOATS, by

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Floats = NDArray[np.float32]

_PICTURES = ("a grey picture", "noise", "a photo")
_PHOTO = Path(__file__).with_name("models") / "solar_park.jpg"
_NOISE = 0.01  # a score that 8 bits may leave of many lower ones
_MEANS, _DEVIATIONS = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)  # of ImageNet, red to blue


@dataclass(frozen=True, slots=True)
class SelfTest:
    """What was found, for people: one line, and what a person should look at."""

    found: str
    doubts: tuple[str, ...] = ()


def test_pictures(size_px: tuple[int, int]) -> Iterator[Floats]:
    """The pictures of 1, 3, height, width, the first of them grey: red, green, blue from 0 to 1."""
    import cv2
    import numpy as np

    yield np.full((1, 3, *size_px), 0.5, np.float32)
    yield np.random.default_rng(1).random((1, 3, *size_px), np.float32)
    photo = cv2.imread(str(_PHOTO))
    assert photo is not None  # noqa: S101 - a file of this package
    yield cv2.dnn.blobFromImage(photo, 1 / 255, size_px[::-1], swapRB=True).astype(np.float32, copy=False)


def normalised(picture: Floats) -> Floats:
    """The picture as networks take it that were trained with the means and deviations of ImageNet."""
    import numpy as np

    means, deviations = (np.array(each, np.float32).reshape(1, 3, 1, 1) for each in (_MEANS, _DEVIATIONS))
    return (picture - means) / deviations


def examined(found: Sequence[Candidates], *, size_px: tuple[int, int], pads: bool) -> SelfTest:
    """What a network found in the test pictures, at any score; raises ValueError for a network that cannot work.

    A network that chooses boxes itself pads them with zeros (`pads`) where it finds nothing.
    """
    import numpy as np

    boxes, scores = (
        np.concatenate([each.boxes for each in found]),
        np.concatenate([each.scores for each in found]),
    )
    highest = ", ".join(
        f"{each.scores.max(initial=0):.3g} in {picture}"
        for picture, each in zip(_PICTURES, found, strict=False)
    )
    said = f"self-test: the highest score is {highest}"
    if not len(scores) or (pads and not boxes.any()):
        return SelfTest(said)
    doubts = []
    if len(scores) > 1 and scores.min() == scores.max():
        alike = f"all its {len(scores)} scores are {scores[0]:.3g} for {_listed(_PICTURES)}"
        if scores[0] > _NOISE:
            raise ValueError(f"{alike}, as of no network that works: {IN_FLOATS}")
        doubts.append(f"{alike}: if it finds nothing in your photos either, {IN_FLOATS}")
    elif all(np.array_equal(found[0].scores, each.scores) for each in found[1:]):
        doubts.append(
            f"its scores are the same for {_listed(_PICTURES)}, as if it did not see them: export it again, and "
            f"{COMPARE}"
        )
    height_px, width_px = size_px
    beyond = (boxes[:, 2:] < 0).any(axis=1) | (boxes[:, 0] > width_px) | (boxes[:, 1] > height_px)
    if 2 * beyond.sum() > len(boxes):
        raise ValueError(
            f"{beyond.sum()} of {len(boxes)} boxes lie outside the test pictures of {by(size_px)} pixels: export it "
            "for pictures of the size that it takes, with boxes in pixels or in shares of the picture"
        )
    return SelfTest(said, tuple(doubts))


def _listed(names: Sequence[str]) -> str:
    return f"{', '.join(names[:-1])} and {names[-1]}"
