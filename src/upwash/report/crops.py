"""The part of a photo around a box, small enough for a page that has many. Without OpenCV there are none."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from upwash.eventlog.objects import Outline
from upwash.report.findings import Finding
from upwash.report.photos import PhotoShelf

if TYPE_CHECKING:
    from cv2.typing import MatLike

WIDTH_PX, HEIGHT_PX = 240, 180  # of a crop, at most
_AROUND = 3.0  # times the box
_LEAST = 0.4  # of the width and the height, in pixels of the photo
_QUALITY = 80  # of the JPEG, in percent


@dataclass(frozen=True, slots=True)
class Crop:
    """A JPEG of the part of a photo that begins at `left_px`, `top_px` there and is that large there."""

    jpeg: bytes
    left_px: int
    top_px: int
    width_px: int
    height_px: int


def crop_of(finding: Finding, shelf: PhotoShelf) -> bytes | None:
    """A JPEG of the finding, None if it cannot be made; takes a while."""
    found = cut_out(finding, shelf)
    return found.jpeg if found else None


def cut_out(finding: Finding, shelf: PhotoShelf) -> Crop | None:
    """The same, with where in the photo that is."""
    if finding.box is None or finding.photo is None:
        return None
    jpeg = shelf.find(finding.photo.shot)
    pixels = None if jpeg is None else pixels_of(jpeg)
    return None if pixels is None else crop_around(finding.box, pixels)


def pixels_of(jpeg: bytes) -> MatLike | None:
    """The photo's pixels, None where it cannot be decoded, or nothing here can."""
    from upwash.services.photo import NotAPhoto, decode_photo

    try:
        return decode_photo(jpeg)
    except (ImportError, NotAPhoto):  # the extra "detector" may not be installed
        return None


def size_of(jpeg: bytes) -> tuple[int, int] | None:
    """The photo's width and height in pixels, None where nothing here can read it."""
    from upwash.services.photo import NotAPhoto, photo_size

    try:
        return photo_size(jpeg)
    except (ImportError, NotAPhoto):  # the extra "detector" may not be installed
        return None


def shrunk(jpeg: bytes, width_px: int) -> tuple[bytes, int, int] | None:
    """The photo at most that wide, and its own width and height; None where nothing here can decode the photo."""
    pixels = pixels_of(jpeg)
    if pixels is None:
        return None
    height, width = pixels.shape[:2]
    return smaller(pixels, min(1.0, width_px / width)), width, height


def crop_around(box: Outline, pixels: MatLike, *, enlarged: float = 1.0) -> Crop | None:
    """The part of the photo around the box, None where the box lies beside the photo or is larger.

    The JPEG is at most `enlarged` times as wide and high as that of a page with many.
    """
    photo_height, photo_width = pixels.shape[:2]
    across, down = box.left_px + box.width_px / 2, box.top_px + box.height_px / 2
    is_across = abs(across - photo_width / 2) <= (photo_width + box.width_px) / 2
    is_down = abs(down - photo_height / 2) <= (photo_height + box.height_px) / 2
    if not (is_across and is_down and box.width_px <= photo_width and box.height_px <= photo_height):
        return None
    scale = max(_LEAST, _AROUND * box.width_px / WIDTH_PX, _AROUND * box.height_px / HEIGHT_PX)
    width = round(min(photo_width, scale * WIDTH_PX))
    height = round(min(photo_height, scale * HEIGHT_PX))
    left = round(min(max(0.0, across - width / 2), photo_width - width))
    top = round(min(max(0.0, down - height / 2), photo_height - height))
    part = pixels[top : top + height, left : left + width]
    jpeg = smaller(part, min(1.0, enlarged * WIDTH_PX / width, enlarged * HEIGHT_PX / height))
    return Crop(jpeg, left, top, width, height)


def smaller(pixels: MatLike, scale: float) -> bytes:
    """A JPEG of the pixels at that scale."""
    import cv2

    height, width = pixels.shape[:2]
    size = max(1, round(scale * width)), max(1, round(scale * height))
    shown = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
    return cv2.imencode(".jpg", shown, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes()
