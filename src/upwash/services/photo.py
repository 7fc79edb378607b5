"""Photos: from the bytes of a JPEG or PNG to the input of a network, and from its boxes back to the photo.

The pixels and the scans are counted before decoding: they bound memory and time. OpenCV is imported on first use, as
missions import this module only for its exception.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from upwash.services.detection import Box
from upwash.support.jpeg import EOI, FRAMES, MOST_SEGMENTS, SOI, SOS, Segment, segments_of, size_in
from upwash.support.png import SIGNATURE, Header, header_of, shown_of

if TYPE_CHECKING:
    import numpy as np
    from cv2.typing import MatLike
    from numpy.typing import NDArray

    Floats = NDArray[np.float32]

MAX_PHOTO_PIXELS = 120_000_000  # of a JPEG of one scan, as cameras write it
MAX_HELD_PIXELS = 40_000_000  # of other photos, whose decoder holds the whole photo in memory
MAX_SCANNED_PIXELS = 16 * MAX_HELD_PIXELS  # by all scans of a JPEG; a progressive one has about 10
DARKNET_GREY = 0.5  # around the photo
ULTRALYTICS_GREY = 114 / 255


class NotAPhoto(ValueError):
    """The bytes are no decodable JPEG or PNG; the message says what they are."""


@dataclass(frozen=True, slots=True)
class Letterbox:
    """A photo scaled into a square of `side_px`, centred, with grey around it.

    With `cell_px` the picture has only as many whole cells of the square as the photo needs. A `stretched` photo
    fills the square. A `frame_px` is the picture's height and width in place of the square.
    """

    photo_width_px: int
    photo_height_px: int
    side_px: int
    cell_px: int | None = None
    grey: float = DARKNET_GREY
    stretched: bool = False
    frame_px: tuple[int, int] | None = None

    @property
    def width_px(self) -> int:
        """The photo's width in the picture."""
        return self._scaled(self.photo_width_px, self._frame_px[1])

    @property
    def height_px(self) -> int:
        """The photo's height in the picture."""
        return self._scaled(self.photo_height_px, self._frame_px[0])

    def picture(self, photo: MatLike) -> Floats:
        """The input of a network: shape 1, 3, height, width; red, green, blue from 0 to 1.

        Bilinear scaling reads four pixels around each place: a larger photo is halved before.
        """
        import cv2
        import numpy as np

        high_px, wide_px = photo.shape[:2]
        while high_px > 2 * self.height_px and wide_px > 2 * self.width_px:
            high_px, wide_px = high_px // 2, wide_px // 2
            photo = cv2.resize(photo, (wide_px, high_px), interpolation=cv2.INTER_AREA)
        scaled = cv2.resize(photo, (self.width_px, self.height_px), interpolation=cv2.INTER_LINEAR)
        shape = (1, 3, *self._sides_px)
        picture = np.full(shape, self.grey, np.float32)
        for plane, channel in zip(
            picture[0], reversed(cv2.split(scaled)), strict=True
        ):  # OpenCV has blue first
            window = plane[self._top_px :, self._left_px :][: self.height_px, : self.width_px]
            np.multiply(channel, np.float32(1 / 255), out=window)
        return picture

    def on_photo(self, box: Floats) -> Box | None:
        """A box of the picture (left, top, right, bottom) on the photo, cut at its borders; None outside."""
        across = self.photo_width_px / self.width_px
        down = self.photo_height_px / self.height_px
        left, right = (_within((float(x) - self._left_px) * across, self.photo_width_px) for x in box[0::2])
        top, bottom = (_within((float(y) - self._top_px) * down, self.photo_height_px) for y in box[1::2])
        if not (left < right and top < bottom):
            return None
        return Box(left_px=left, top_px=top, width_px=right - left, height_px=bottom - top)

    @property
    def _frame_px(self) -> tuple[int, int]:
        return self.frame_px or (self.side_px, self.side_px)

    def _scaled(self, length_px: int, frame_px: int) -> int:
        if self.stretched:
            return frame_px
        high_px, wide_px = self._frame_px
        if self.photo_width_px * high_px >= self.photo_height_px * wide_px:
            return max(1, wide_px * length_px // self.photo_width_px)
        return max(1, high_px * length_px // self.photo_height_px)

    @property
    def _left_px(self) -> int:
        return (self._sides_px[1] - self.width_px) // 2

    @property
    def _top_px(self) -> int:
        return (self._sides_px[0] - self.height_px) // 2

    @property
    def _sides_px(self) -> tuple[int, int]:
        """The height and width of the picture."""
        if self.cell_px is None:
            return self._frame_px
        return -(-self.height_px // self.cell_px) * self.cell_px, -(
            -self.width_px // self.cell_px
        ) * self.cell_px


def read_photo(
    photo: bytes,
    side_px: int,
    cell_px: int | None = None,
    *,
    grey: float = DARKNET_GREY,
    stretched: bool = False,
    frame_px: tuple[int, int] | None = None,
    most_pixels: int | None = None,
) -> tuple[Floats, Letterbox]:
    """A photo as a picture with a longer side of `side_px`, and the photo's place in it; raises NotAPhoto.

    A JPEG is decoded at a half, a quarter or an eighth of its resolution if that is enough.
    """
    png = _decoded_png(photo, most_pixels) if photo.startswith(SIGNATURE) else None
    header = _read_header(photo, most_pixels) if png is None else _Header(png.shape[1], png.shape[0])
    letterbox = Letterbox(header.width_px, header.height_px, side_px, cell_px, grey, stretched, frame_px)
    return letterbox.picture(_decode(photo, letterbox) if png is None else png), letterbox


def photo_size(photo: bytes, most_pixels: int | None = None) -> tuple[int, int]:
    """The width and height of a JPEG or PNG that may be decoded; raises NotAPhoto."""
    if photo.startswith(SIGNATURE):
        png = _png_header(photo, most_pixels)
        return png.width_px, png.height_px
    header = _read_header(photo, most_pixels)
    return header.width_px, header.height_px


def decode_photo(photo: bytes, most_pixels: int | None = None) -> MatLike:
    """The stored pixels of a JPEG or PNG at full resolution, blue first; raises NotAPhoto."""
    import cv2

    if photo.startswith(SIGNATURE):
        return _decoded_png(photo, most_pixels)
    _read_header(photo, most_pixels)
    return _decoded(photo, cv2.IMREAD_COLOR)


def shrunk(photo: bytes, side_px: int, quality: int) -> bytes:
    """A JPEG of at most `side_px` on its longer side, which names the size of the whole photo; raises NotAPhoto.

    The same bytes where that would not be smaller.
    """
    import cv2

    width_px, height_px = photo_size(photo)
    whole_px = whole_size(photo) or (width_px, height_px)
    scale = min(1.0, side_px / max(width_px, height_px))
    letterbox = Letterbox(width_px, height_px, round(scale * max(width_px, height_px)))
    pixels = _decoded_png(photo) if photo.startswith(SIGNATURE) else _decode(photo, letterbox)
    size_px = (letterbox.width_px, letterbox.height_px)
    pixels = cv2.resize(pixels, size_px, interpolation=cv2.INTER_AREA)
    jpeg = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()
    told = b"upwash photo of %dx%d" % whole_px
    smaller = SOI + b"\xff\xfe" + (2 + len(told)).to_bytes(2) + told + jpeg[len(SOI) :]
    return smaller if len(smaller) < len(photo) else photo


_WHOLE = re.compile(rb"\xff\xd8\xff\xfe..upwash photo of ([1-9]\d{0,4})x([1-9]\d{0,4})\xff", re.DOTALL)


def whole_size(photo: bytes) -> tuple[int, int] | None:
    """The width and height of the whole photo, from a smaller photo of `shrunk`; None from other photos."""
    told = _WHOLE.match(photo)
    return None if told is None else (int(told[1]), int(told[2]))


def other_format(photo: bytes) -> str:
    """The format of a photo that is no JPEG or PNG, with an article; empty for an unknown one."""
    return next((kind for start, kind in _OTHER_FORMATS if re.match(start, photo, re.DOTALL)), "")


def jpeg_of(photo: bytes) -> bytes:
    """A PNG as a JPEG of its stored pixels, other bytes unchanged; raises NotAPhoto."""
    import cv2

    if not photo.startswith(SIGNATURE):
        return photo
    return cv2.imencode(".jpg", _decoded_png(photo), [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1].tobytes()


def in_8_bits(image: MatLike) -> MatLike:
    """The image with 8 bits a channel.

    Thermal cameras give grey images of 16 bits. Their darkest and brightest thousandth of the pixels become black and
    white, unless these are less than 256 values apart. Colours keep their upper 8 bits.
    """
    import numpy as np

    if image.dtype != np.uint16:
        return image
    if image.ndim == 3 and image.shape[2] > 1:
        return np.right_shift(image, 8).astype(np.uint8)
    return stretched(image, least_span=_LEAST_SPAN)


def stretched(image: MatLike, *, least_span: float) -> MatLike:
    """The grey image with 8 bits: its darkest and brightest thousandth black and white, at least that far apart.

    What is not finite is black, and does not count. Raises NotAPhoto if nothing is finite.
    """
    import numpy as np

    known = np.isfinite(image)
    if not known.any():
        raise NotAPhoto("an image has no finite number")
    low, high = (float(value) for value in np.percentile(image[known], (_OUTLIERS, 100 - _OUTLIERS)))
    span = max(least_span, high - low)
    low = (low + high - span) / 2
    scaled: Floats = (np.where(known, image, np.float32(low)) - np.float32(low)) * np.float32(255 / span)
    return np.clip(scaled, 0, 255).astype(np.uint8)


# --- from bytes to pixels --------------------------------------------------------------------------

_JPEG_QUALITY = 95
_JPEG_BITS = 8
_OUTLIERS = 0.1  # per cent
_LEAST_SPAN = 256.0  # a sensor's noise is a few values
_DECODED_FRAMES = (0xC0, 0xC1, 0xC2)  # Huffman codes, sequential or progressive, as all cameras write
_OTHER_FORMATS = (
    (rb"GIF8", "a GIF"),
    (rb"RIFF....WEBP", "a WebP file"),
    (rb"RIFF", "a RIFF file (a film?)"),
    (rb"II[*+]\x00|MM\x00[*+]", "a TIFF or raw photo"),
    (rb"BM", "a BMP file"),
    (rb"%PDF", "a PDF"),
    (rb"\x00\x00\x00\x0cjP  |\xff\x4f\xff\x51", "a JPEG 2000 file"),
    (rb"\x00\x00\x00\x0cJXL |\xff\x0a", "a JPEG XL file"),
    (rb"....ftyp(?:hei|hev|mif|msf)", "a HEIC file, as telephones write it"),
    (rb"....ftypavi", "an AVIF file"),
    (rb"....ftyp", "a film (MP4)"),
    (rb"<", "a page of HTML or XML"),
)
_SMALLER = "have the camera take smaller photos, or raise the detector's setting max_photo_mpixels"


@dataclass(frozen=True, slots=True)
class _Header:
    width_px: int
    height_px: int

    def require_bounded(self, kind: str, most_pixels: int | None, *, scans: int, held: bool) -> None:
        """Raise NotAPhoto for too many pixels, or too many pixels visited by all scans."""
        size, pixels = f"{self.width_px} x {self.height_px} pixels", self.width_px * self.height_px
        most = most_pixels or (MAX_HELD_PIXELS if held else MAX_PHOTO_PIXELS)
        if not 0 < pixels <= most:
            saved = most_pixels is None and 0 < pixels <= MAX_PHOTO_PIXELS
            remedy = "save it as a baseline JPEG" if saved else _SMALLER
            raise NotAPhoto(
                f"the {kind} says it has {size}; photos of 1 to {most:,} pixels are accepted: {remedy}"
            )
        scanned = MAX_SCANNED_PIXELS * (most_pixels or MAX_HELD_PIXELS) // MAX_HELD_PIXELS
        if scans * pixels > scanned:
            raise NotAPhoto(
                f"the JPEG has {scans} scans of {size}; photos of that size with at most "
                f"{scanned // pixels} scans are accepted: save it as a baseline JPEG"
            )


def _read_header(photo: bytes, most_pixels: int | None = None) -> _Header:
    """The size of a JPEG without decoding; raises NotAPhoto unless the file is whole and decodes in bounded time."""
    if not photo:
        raise NotAPhoto("the photo is empty (0 bytes); send the bytes of a JPEG or PNG file")
    if not photo.startswith(b"\xff\xd8\xff"):
        if kind := other_format(photo):
            raise NotAPhoto(f"the photo is {kind}, not a JPEG or PNG; save it as one of these")
        start = f"{len(photo)} bytes that start with {photo[:4].hex(' ')}"
        raise NotAPhoto(f"the photo is {start}, not a JPEG or PNG; send the bytes of a JPEG or PNG file")
    segments = list(segments_of(photo))
    markers = [segment.marker for segment in segments]
    if EOI not in markers:
        raise _without_end(photo, segments)
    frames = [segment for segment in segments if segment.marker in FRAMES]
    if len(frames) != 1 or SOS not in markers or markers.index(SOS) < segments.index(frames[0]):
        raise NotAPhoto("the JPEG is damaged: it never says its size, or twice; take or copy the photo again")
    if frames[0].marker not in _DECODED_FRAMES:
        raise NotAPhoto(
            f"the JPEG is of a rare kind (marker ff {frames[0].marker:02x}); save it as a baseline JPEG"
        )
    if (bits := photo[frames[0].start + 4]) != _JPEG_BITS:
        raise NotAPhoto(
            f"the JPEG has {bits} bits a channel, not {_JPEG_BITS}; save it as a baseline JPEG, or as a PNG"
        )
    header = _Header(*size_in(photo, frames[0]))
    scans, progressive = markers.count(SOS), frames[0].marker == _DECODED_FRAMES[-1]
    header.require_bounded("JPEG", most_pixels, scans=scans, held=progressive or scans > 1)
    return header


def _png_header(photo: bytes, most_pixels: int | None) -> Header:
    header = header_of(photo)
    if header is None:
        raise NotAPhoto(
            f"the PNG is cut off after {len(photo):,} bytes, or damaged; take or copy the photo again"
        )
    _Header(header.width_px, header.height_px).require_bounded("PNG", most_pixels, scans=1, held=True)
    return header


def _decoded_png(photo: bytes, most_pixels: int | None = None) -> MatLike:
    import cv2
    import numpy as np

    header = _png_header(photo, most_pixels)
    png = shown_of(photo, header)
    if png is None:
        raise NotAPhoto("the PNG is damaged: it has more data than pixels; take or copy the photo again")
    how = cv2.IMREAD_GRAYSCALE if header.is_grey else cv2.IMREAD_COLOR
    pixels = in_8_bits(_decoded(png, how | cv2.IMREAD_ANYDEPTH, kind="PNG"))
    return np.repeat(pixels[:, :, np.newaxis], 3, axis=2) if header.is_grey else pixels


def _without_end(photo: bytes, segments: Sequence[Segment]) -> NotAPhoto:
    if len(segments) == MOST_SEGMENTS:
        return NotAPhoto(
            f"the JPEG has more than {MOST_SEGMENTS} segments; save it as a baseline JPEG without metadata"
        )
    at = segments[-1].end if segments else len(SOI)
    follows = photo[at : at + 4]
    in_data = any(segment.marker == SOS for segment in segments)
    if not in_data and len(follows) == 4 and follows < b"\xff\xc0":  # the least marker of a segment
        return NotAPhoto(f"the JPEG is damaged: byte {at} starts no segment; take or copy the photo again")
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


def _decoded(photo: bytes, how: int, kind: str = "JPEG") -> MatLike:
    import cv2
    import numpy as np

    # Boxes are in stored pixels, so the EXIF orientation is ignored.
    try:
        image = cv2.imdecode(np.frombuffer(photo, np.uint8), how | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error as error:
        raise NotAPhoto(
            f"OpenCV cannot decode the {kind} ({error.err}); take or copy the photo again"
        ) from error
    if image is None:
        raise NotAPhoto(f"OpenCV cannot decode the {kind}; take or copy the photo again")
    return image


def _within(position: float, length_px: int) -> float:
    return min(max(position, 0.0), float(length_px))
