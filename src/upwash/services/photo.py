"""Photos: from a JPEG's bytes to the picture that a network looks at, and from there back to the photo.

The size in a JPEG's header is looked at before anything is decoded, so that no photo takes more memory than
MAX_PHOTO_PIXELS allow. OpenCV is imported on first use: a mission imports this module for its exception alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from upwash.services.detection import Box

if TYPE_CHECKING:
    import numpy as np
    from cv2.typing import MatLike
    from numpy.typing import NDArray

    Floats = NDArray[np.float32]

MAX_PHOTO_PIXELS = 40_000_000
_GREY = 0.5  # around the photo, as Darknet has it


class NotAPhoto(ValueError):
    """The bytes are no JPEG that can be decoded; the message says what they are instead."""


@dataclass(frozen=True, slots=True)
class Letterbox:
    """A photo in a picture: as large as fits in a square, in the middle, with grey around it.

    The picture is that square or, where `cell_px` is given, only as many whole cells of it as the photo needs.
    """

    photo_width_px: int
    photo_height_px: int
    side_px: int
    cell_px: int | None = None

    @property
    def width_px(self) -> int:
        """The photo's width in the picture."""
        return max(1, self.side_px * self.photo_width_px // self._longer_px)

    @property
    def height_px(self) -> int:
        """The photo's height in the picture."""
        return max(1, self.side_px * self.photo_height_px // self._longer_px)

    def picture(self, photo: MatLike) -> Floats:
        """The photo as a network takes it: 1, 3, height, width; red, green, blue from 0 to 1.

        It may be decoded at any resolution from once to twice what is shown, where four pixels around each place
        are all that there are to be looked at.
        """
        import cv2
        import numpy as np

        scaled = cv2.resize(photo, (self.width_px, self.height_px), interpolation=cv2.INTER_LINEAR)
        shape = (1, 3, self._whole_cells(self.height_px), self._whole_cells(self.width_px))
        picture = np.full(shape, _GREY, np.float32)
        for plane, channel in zip(
            picture[0], reversed(cv2.split(scaled)), strict=True
        ):  # OpenCV has blue first
            window = plane[self._top_px :, self._left_px :][: self.height_px, : self.width_px]
            np.multiply(channel, np.float32(1 / 255), out=window)
        return picture

    def on_photo(self, box: Floats) -> Box | None:
        """A box of the picture (left, top, right, bottom), cut at the photo's borders; None where nothing is left."""
        across = self.photo_width_px / self.width_px
        down = self.photo_height_px / self.height_px
        left, right = (_within((float(x) - self._left_px) * across, self.photo_width_px) for x in box[0::2])
        top, bottom = (_within((float(y) - self._top_px) * down, self.photo_height_px) for y in box[1::2])
        if not (left < right and top < bottom):
            return None
        return Box(left_px=left, top_px=top, width_px=right - left, height_px=bottom - top)

    @property
    def _longer_px(self) -> int:
        return max(self.photo_width_px, self.photo_height_px)

    @property
    def _left_px(self) -> int:
        return (self._whole_cells(self.width_px) - self.width_px) // 2

    @property
    def _top_px(self) -> int:
        return (self._whole_cells(self.height_px) - self.height_px) // 2

    def _whole_cells(self, length_px: int) -> int:
        """The picture's width or height, of which the photo takes so much."""
        cell_px = self.cell_px or self.side_px
        return -(-length_px // cell_px) * cell_px


def read_photo(photo: bytes, side_px: int, cell_px: int | None = None) -> tuple[Floats, Letterbox]:
    """A JPEG as a picture of that longer side, and where in it the photo lies; raises NotAPhoto.

    The photo is decoded at a half, a quarter or an eighth of its resolution where that is still enough.
    """
    header = _read_header(photo)
    letterbox = Letterbox(header.width_px, header.height_px, side_px, cell_px)
    return letterbox.picture(_decode(photo, letterbox)), letterbox


def decode_photo(photo: bytes) -> MatLike:
    """The pixels of a JPEG in its full resolution, as they are stored, blue first; raises NotAPhoto."""
    import cv2

    _read_header(photo)
    return _decoded(photo, cv2.IMREAD_COLOR)


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
    # Compressed data never contains this marker, as it escapes every 0xff; in a whole file it is near the end.
    if photo.rfind(_END_OF_IMAGE, scan_at) < 0:
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


def _decode(photo: bytes, letterbox: Letterbox) -> MatLike:
    import cv2

    resolutions = {
        8: cv2.IMREAD_REDUCED_COLOR_8,
        4: cv2.IMREAD_REDUCED_COLOR_4,
        2: cv2.IMREAD_REDUCED_COLOR_2,
    }
    enough = (
        flag
        for factor, flag in resolutions.items()
        if letterbox.photo_width_px >= factor * letterbox.width_px
        and letterbox.photo_height_px >= factor * letterbox.height_px
    )
    return _decoded(photo, next(enough, cv2.IMREAD_COLOR))


def _decoded(photo: bytes, how: int) -> MatLike:
    import cv2
    import numpy as np

    # Boxes are in the pixels that are stored, so the camera's "turn me" note is not followed.
    try:
        image = cv2.imdecode(np.frombuffer(photo, np.uint8), how | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error as error:
        raise NotAPhoto(
            f"OpenCV cannot decode the JPEG ({error.err}); take or copy the photo again"
        ) from error
    if image is None:
        raise NotAPhoto("OpenCV cannot decode the JPEG; take or copy the photo again")
    return image


def _within(position: float, length_px: int) -> float:
    return min(max(position, 0.0), float(length_px))
