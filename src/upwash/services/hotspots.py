"""Hot-spots in aerial photos of solar panels, found by their colour and their surroundings.

The photos carry a fused thermal overlay: hot cells glow from red over orange to yellow. Such a glow is
reported when it is warm enough, compact, and surrounded by the blue of a module. Nothing is learned and
nothing is downloaded. OpenCV is imported on first use, because a mission imports this module for its
types alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import msgspec

from upwash.errors import UsageError
from upwash.service import service

if TYPE_CHECKING:
    from cv2.typing import MatLike

Mode = Literal["light", "heavy"]

MAX_PHOTO_PIXELS = 40_000_000


class Box(msgspec.Struct, frozen=True):
    """An upright rectangle in a photo, in pixels of the full photo as it is stored."""

    left_px: float
    top_px: float
    width_px: float
    height_px: float


class Detection(Box, frozen=True, kw_only=True):
    """Something found in a photo: where, what, and how sure the detector is (`score`, 0 to 1)."""

    label: str
    score: float


class NotAPhoto(ValueError):
    """The bytes are no JPEG that can be decoded; the message says what they are instead."""


@service(name="detector", profile_by="mode")
class HotSpotDetector:
    """Finds hot-spots: `light` the large ones at a quarter of the resolution, `heavy` the small ones too."""

    def __init__(self) -> None:
        # The first calls into OpenCV are slow; an instance pays for them before it is called.
        warm_up = _warm_up_photo()
        for mode in _DECODE_FLAGS:
            self.process_photo(warm_up, mode)

    def process_photo(self, photo: bytes, mode: Mode) -> list[Detection]:
        """The hot-spots in a JPEG of at most 40 megapixels, surest first; raises NotAPhoto."""
        header = _read_header(photo)
        image = _decode(photo, mode)
        scale = header.width_px / image.shape[1]
        found = [d for glow in _glows(image) if (d := _judge(image, glow, scale)) is not None]
        return sorted(found, key=lambda detection: -detection.score)


# --- glows and what only resembles them ------------------------------------------------------------

# Both modes do the same on different resolutions. OpenCV's names, since it is not imported yet.
_DECODE_FLAGS: dict[Mode, str] = {"light": "IMREAD_REDUCED_COLOR_4", "heavy": "IMREAD_COLOR"}

# Warmth is red minus 1.5 times blue, 0 to 255. Grass, dust and modules have none and red soil stays near
# 50, well or badly exposed; a glow has 200.
_BLUE_WEIGHT = 1.5
_WARM = 60
_WARMEST = 100
_MAX_GLOWS = 200
_SMALLEST_PX = 24  # area at the working resolution; below it noise and glow look alike
_LARGEST_SHARE = 0.05  # of the photo's area: what is larger is no cell
_MAX_ELONGATION = 3.0
_MIN_FILL = 0.45  # of its box: a disc fills 0.79
_MIN_MODULE_SHARE = 0.25  # of the surroundings: in a dusty corner of a table little else is blue
_MODULE_HSV = ((92, 30, 15), (140, 255, 235))  # from deep blue to blue behind sheen, dust or a purple halo


@dataclass(frozen=True, slots=True)
class _Glow:
    """A connected warm region, in pixels of the working resolution."""

    left_px: int
    top_px: int
    width_px: int
    height_px: int
    area_px: int
    warmest: int


def _glows(image: MatLike) -> Iterator[_Glow]:
    """The largest warm regions, at most `_MAX_GLOWS` whatever the photo shows."""
    import cv2
    import numpy as np

    blue, _, red = cv2.split(image)
    warmth = cv2.addWeighted(red, 1.0, blue, -_BLUE_WEIGHT, 0.0)
    _, warm = cv2.threshold(warmth, _WARM - 1, 255, cv2.THRESH_BINARY)
    # The modules' bright grid lines shine through a glow and would cut it into cells.
    joined = cv2.morphologyEx(warm, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    _, labels, stats, _ = cv2.connectedComponentsWithStats(joined)
    areas = stats[:, cv2.CC_STAT_AREA]
    largest_px = _LARGEST_SHARE * warmth.size
    sized = np.flatnonzero((areas >= _SMALLEST_PX) & (areas <= largest_px))
    sized = sized[sized != 0]  # label 0 is everything that is not warm
    for label in sized[np.argsort(-areas[sized], kind="stable")][:_MAX_GLOWS]:
        left, top, width, height, area = (int(number) for number in stats[label])
        window = np.s_[top : top + height, left : left + width]
        warmest = int(warmth[window][labels[window] == label].max())
        yield _Glow(left, top, width, height, area, warmest)


def _judge(image: MatLike, glow: _Glow, scale: float) -> Detection | None:
    """The glow as a detection in pixels of the full photo, or None for what only resembles one."""
    long_px, short_px = max(glow.width_px, glow.height_px), min(glow.width_px, glow.height_px)
    fill = glow.area_px / (glow.width_px * glow.height_px)
    if glow.warmest < _WARMEST or long_px > _MAX_ELONGATION * short_px or fill < _MIN_FILL:
        return None
    module_share = _module_share(image, glow)
    if module_share < _MIN_MODULE_SHARE:
        return None
    return Detection(
        label="hot-spot",
        score=round((glow.warmest / 255 + min(1.0, fill / 0.79) + module_share) / 3, 3),
        left_px=glow.left_px * scale,
        top_px=glow.top_px * scale,
        width_px=glow.width_px * scale,
        height_px=glow.height_px * scale,
    )


def _module_share(image: MatLike, glow: _Glow) -> float:
    """How much of the frame around the glow, half its size wide, has the blue of a module."""
    import cv2

    margin_px = max(3, (glow.width_px + glow.height_px) // 4)
    left, top = max(0, glow.left_px - margin_px), max(0, glow.top_px - margin_px)
    right, bottom = glow.left_px + glow.width_px + margin_px, glow.top_px + glow.height_px + margin_px
    surroundings = cv2.cvtColor(image[top:bottom, left:right], cv2.COLOR_BGR2HSV)
    blue = cv2.inRange(surroundings, *_MODULE_HSV)
    frame_px = blue.size - glow.width_px * glow.height_px
    blue[
        glow.top_px - top : glow.top_px - top + glow.height_px,
        glow.left_px - left : glow.left_px - left + glow.width_px,
    ] = 0
    return cv2.countNonZero(blue) / max(1, frame_px)


# --- from bytes to pixels --------------------------------------------------------------------------

_END_OF_IMAGE = b"\xff\xd9"
_START_OF_SCAN = 0xDA
_WITHOUT_LENGTH = frozenset({0x01, *range(0xD0, 0xD8)})
_FRAME_HEADERS = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_OTHER_FORMATS = {
    b"\x89PNG": "a PNG",
    b"GIF8": "a GIF",
    b"RIFF": "a RIFF file (WebP?)",
    b"II*\x00": "a TIFF or raw photo",
    b"MM\x00*": "a TIFF or raw photo",
    b"%PDF": "a PDF",
}


@dataclass(frozen=True, slots=True)
class _Header:
    width_px: int
    height_px: int


def _read_header(photo: bytes) -> _Header:
    """Reads a JPEG's size before anything is decoded, and makes sure that the file is whole."""
    if not photo:
        raise NotAPhoto("the photo is empty (0 bytes); send the bytes of a JPEG file")
    if not photo.startswith(b"\xff\xd8\xff"):
        kind = _OTHER_FORMATS.get(photo[:4], f"{len(photo)} bytes that start with {photo[:4].hex(' ')}")
        raise NotAPhoto(f"the photo is {kind}, not a JPEG; send the bytes of a JPEG file")
    header, scan_at = _walk_segments(photo)
    pixels = header.width_px * header.height_px
    if not 0 < pixels <= MAX_PHOTO_PIXELS:
        raise NotAPhoto(
            f"the JPEG says it has {header.width_px} x {header.height_px} pixels; "
            f"photos of 1 to {MAX_PHOTO_PIXELS:,} pixels are accepted"
        )
    # Compressed data never contains this marker: it escapes every 0xff.
    if photo.find(_END_OF_IMAGE, scan_at) < 0:
        raise _truncated(photo)
    return header


def _walk_segments(photo: bytes) -> tuple[_Header, int]:
    """The frame header and where the compressed data begins (ITU-T T.81, annex B)."""
    header: _Header | None = None
    at = 2
    while at + 4 <= len(photo):
        marker = photo[at + 1]
        if photo[at] != 0xFF or marker == 0x00:
            raise NotAPhoto(f"the JPEG is damaged: byte {at} starts no segment; take or copy the photo again")
        if marker == 0xFF:  # padding between segments
            at += 1
        elif marker in _WITHOUT_LENGTH:
            at += 2
        elif marker == _START_OF_SCAN:
            if header is None:
                raise NotAPhoto("the JPEG is damaged: it never says its size; take or copy the photo again")
            return header, at
        else:
            if marker in _FRAME_HEADERS and at + 9 <= len(photo):
                header = _Header(
                    height_px=int.from_bytes(photo[at + 5 : at + 7]),
                    width_px=int.from_bytes(photo[at + 7 : at + 9]),
                )
            at += 2 + int.from_bytes(photo[at + 2 : at + 4])
    raise _truncated(photo)


def _truncated(photo: bytes) -> NotAPhoto:
    return NotAPhoto(f"the JPEG is cut off after {len(photo):,} bytes; take or copy the photo again")


def _decode(photo: bytes, mode: Mode) -> MatLike:
    import cv2
    import numpy as np

    # Boxes are in the pixels that are stored, so the camera's "turn me" note is not followed.
    flags = getattr(cv2, _DECODE_FLAGS[mode]) | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        image = cv2.imdecode(np.frombuffer(photo, np.uint8), flags)
    except cv2.error as error:
        raise NotAPhoto(
            f"OpenCV cannot decode the JPEG ({error.err}); take or copy the photo again"
        ) from error
    if image is None:
        raise NotAPhoto("OpenCV cannot decode the JPEG; take or copy the photo again")
    return image


def _warm_up_photo() -> bytes:
    """A glow on something blue, so that every step of the detector has something to do."""
    try:
        import cv2
        import numpy as np
    except ImportError as missing:
        raise UsageError(
            f"the hot-spot detector needs OpenCV and numpy ({missing}); pip install 'upwash[detector]'"
        ) from missing
    photo = np.full((1080, 1440, 3), (90, 50, 24), np.uint8)
    cv2.circle(photo, (720, 540), 40, (40, 160, 255), -1)
    _, jpeg = cv2.imencode(".jpg", photo)
    return jpeg.tobytes()
