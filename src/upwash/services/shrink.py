"""Photos made smaller before they are sent: the detector's part on the drone."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from upwash.rpc.service import service
from upwash.services.photo import shrunk
from upwash.support.loading import extra

Px = Annotated[int, Meta(ge=32, le=16_384, description="an integer from 32 to 16384, in pixels")]
Quality = Annotated[int, Meta(ge=1, le=100, description="an integer from 1 to 100")]


@service
class Shrink:
    """Makes photos JPEGs of that quality, whose longer side has at most `px` pixels.

    They keep the size of the whole photo in a comment: the detector's boxes are in its pixels.
    """

    def __init__(self, *, px: Px = 720, quality: Quality = 85) -> None:
        with extra("detector"):
            import cv2  # noqa: F401 - now, and not in the first call
            import numpy as np  # noqa: F401
        self._px, self._quality = px, quality

    def process_photo(self, photo: bytes) -> bytes:
        """The smaller photo, or the same bytes where that is not smaller; raises NotAPhoto."""
        return shrunk(photo, self._px, self._quality)
