"""The result of a detector: boxes in a photo, with a label and a score."""

from __future__ import annotations

from typing import Literal

import msgspec

Mode = Literal["light", "heavy"]


class Box(msgspec.Struct, frozen=True):
    """An upright rectangle in a photo, in pixels of the full photo as it is stored."""

    left_px: float
    top_px: float
    width_px: float
    height_px: float


class Detection(Box, frozen=True, kw_only=True):
    """An object in a photo: its box, its label, and the score of the detector (0 to 1)."""

    label: str
    score: float
