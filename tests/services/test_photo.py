"""Photos on their way to the network and back, and bytes that are no photos."""

from __future__ import annotations

import io
import random
import resource
import struct
import zlib

import cv2
import numpy as np
import pytest
from cv2.typing import MatLike
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from upwash.services.photo import (
    MAX_HELD_PIXELS,
    MAX_SCANNED_PIXELS,
    Letterbox,
    NotAPhoto,
    decode_photo,
    in_8_bits,
    photo_size,
    read_photo,
    shrunk,
    whole_size,
)
from upwash.support.jpeg import EOI, MOST_SEGMENTS, SOS, segments_of, size_of

sides = st.sampled_from([32, 320, 608, 1024])
lengths = st.integers(1, 20_000)


def jpeg_of(image: MatLike) -> bytes:
    return cv2.imencode(".jpg", image)[1].tobytes()


def gradient(width_px: int, height_px: int) -> MatLike:
    """Blue grows to the right and green downwards, so that every place has a colour of its own."""
    image = np.zeros((height_px, width_px, 3), np.uint8)
    image[:, :, 0] = np.linspace(0, 255, width_px).astype(np.uint8)
    image[:, :, 1] = np.linspace(0, 255, height_px).astype(np.uint8)[:, np.newaxis]
    image[:, :, 2] = 200
    return image


PHOTO = jpeg_of(gradient(1000, 600))


HEADERS = {
    "JPEG": jpeg_of(gradient(40, 30)),
    "progressive": cv2.imencode(".jpg", gradient(40, 30), [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1].tobytes(),
    "PNG": cv2.imencode(".png", gradient(40, 30))[1].tobytes(),
}


# --- to the network and back --------------------------------------------------------------------------------


@given(lengths, lengths, sides)
def test_a_photo_fits_its_picture_in_the_middle(width_px: int, height_px: int, side_px: int) -> None:
    box = Letterbox(width_px, height_px, side_px)
    assert max(box.width_px, box.height_px) == side_px
    assert min(box.width_px, box.height_px) >= 1
    whole = box.on_photo(np.array([0, 0, side_px, side_px], np.float32))
    assert whole is not None
    assert (whole.left_px, whole.top_px) == (0, 0)
    assert (whole.width_px, whole.height_px) == pytest.approx((width_px, height_px))


@given(lengths, lengths, sides, st.data())
def test_a_box_on_the_picture_is_where_its_thing_is_on_the_photo(
    width_px: int, height_px: int, side_px: int, data: st.DataObject
) -> None:
    box = Letterbox(width_px, height_px, side_px)
    left, right = sorted(data.draw(st.tuples(*[st.floats(0, width_px)] * 2)))
    top, bottom = sorted(data.draw(st.tuples(*[st.floats(0, height_px)] * 2)))
    # As a picture shows it: scaled, and half of what is left over to each side, whole pixels.
    x = [(side_px - box.width_px) // 2 + each * box.width_px / width_px for each in (left, right)]
    y = [(side_px - box.height_px) // 2 + each * box.height_px / height_px for each in (top, bottom)]
    back = box.on_photo(np.array([x[0], y[0], x[1], y[1]], np.float64))
    near = max(width_px, height_px) / side_px * 1e-3
    if back is None:
        assert right - left <= near or bottom - top <= near
        return
    assert back.left_px == pytest.approx(left, abs=near)
    assert back.top_px == pytest.approx(top, abs=near)
    assert back.left_px + back.width_px == pytest.approx(right, abs=near)
    assert back.top_px + back.height_px == pytest.approx(bottom, abs=near)


@given(lengths, lengths, sides, st.lists(st.floats(-1e9, 1e9, width=32), min_size=4, max_size=4))
def test_no_box_leaves_the_photo(width_px: int, height_px: int, side_px: int, corners: list[float]) -> None:
    box = Letterbox(width_px, height_px, side_px).on_photo(np.array(corners, np.float32))
    if box is not None:
        assert 0 <= box.left_px < box.left_px + box.width_px <= width_px + 1e-6
        assert 0 <= box.top_px < box.top_px + box.height_px <= height_px + 1e-6


@pytest.mark.parametrize("side_px", [320, 608, 1024])
@pytest.mark.parametrize(("width_px", "height_px"), [(1440, 1080), (1080, 1440), (5000, 700), (200, 150)])
def test_a_picture_shows_the_photo_at_any_resolution(width_px: int, height_px: int, side_px: int) -> None:
    photo = gradient(width_px, height_px)
    picture, box = read_photo(jpeg_of(photo), side_px)
    assert picture.shape == (1, 3, side_px, side_px)
    assert picture.dtype == np.float32
    left, top = (side_px - box.width_px) // 2, (side_px - box.height_px) // 2
    shown = picture[0, :, top : top + box.height_px, left : left + box.width_px]
    # Sampled by hand from the whole photo: the middle of what each pixel of the picture shows.
    rows = ((np.arange(box.height_px) + 0.5) * height_px / box.height_px).astype(int)
    columns = ((np.arange(box.width_px) + 0.5) * width_px / box.width_px).astype(int)
    expected = photo[rows][:, columns, ::-1].transpose(2, 0, 1) / 255
    assert np.abs(shown - expected).mean() < 0.01
    assert np.abs(shown - expected).max() < 0.06
    outside = picture.copy()
    outside[0, :, top : top + box.height_px, left : left + box.width_px] = 0.5
    assert (outside == 0.5).all()


def test_fine_stripes_of_a_png_become_grey_as_those_of_a_jpeg() -> None:
    stripes = np.zeros((900, 1300, 3), np.uint8)
    stripes[:, ::4] = stripes[::4] = 255
    picture = read_photo(cv2.imencode(".png", stripes)[1].tobytes(), 96)[0]
    assert np.abs(picture - read_photo(jpeg_of(stripes), 96)[0]).max() < 0.2


@given(lengths, lengths, sides, st.sampled_from([8, 16, 32]))
def test_a_picture_of_whole_cells_holds_the_photo_and_little_else(
    width_px: int, height_px: int, side_px: int, cell_px: int
) -> None:
    square, cut = Letterbox(width_px, height_px, side_px), Letterbox(width_px, height_px, side_px, cell_px)
    assert (cut.width_px, cut.height_px) == (square.width_px, square.height_px)
    photo = np.zeros((1, 1, 3), np.uint8)
    _, _, rows, columns = cut.picture(photo).shape
    assert (rows % cell_px, columns % cell_px) == (0, 0)
    assert 0 <= rows - cut.height_px < cell_px
    assert 0 <= columns - cut.width_px < cell_px
    whole = cut.on_photo(np.array([0, 0, columns, rows], np.float32))
    assert whole is not None
    assert (whole.width_px, whole.height_px) == pytest.approx((width_px, height_px))


@pytest.mark.parametrize(("width_px", "height_px"), [(1440, 1080), (1080, 1440), (5000, 700), (608, 608)])
def test_a_picture_of_whole_cells_is_the_middle_of_the_square(width_px: int, height_px: int) -> None:
    jpeg = jpeg_of(gradient(width_px, height_px))
    square, in_square = read_photo(jpeg, 608)
    cut, in_cut = read_photo(jpeg, 608, 32)
    top, left = ((608 - length) // 2 for length in cut.shape[2:])
    np.testing.assert_array_equal(cut, square[:, :, top : top + cut.shape[2], left : left + cut.shape[3]])
    corners = np.array([40, 10, 70, 30], np.float32)
    assert in_cut.on_photo(corners) == in_square.on_photo(np.add(corners, [left, top, left, top]))


def test_gray_and_tiny_photos_are_photos() -> None:
    assert read_photo(jpeg_of(np.full((300, 400), 90, np.uint8)), 320)[0].shape == (1, 3, 320, 320)
    assert read_photo(jpeg_of(np.full((1, 1, 3), 200, np.uint8)), 320)[1] == Letterbox(1, 1, 320)


def test_the_cameras_note_to_turn_the_photo_is_not_followed() -> None:
    turn_right = bytes.fromhex("4d4d002a00000008 0001 0112 0003 00000001 00060000 00000000")
    exif = b"Exif\0\0" + turn_right
    turned = PHOTO[:2] + b"\xff\xe1" + (len(exif) + 2).to_bytes(2) + exif + PHOTO[2:]
    followed = cv2.imdecode(np.frombuffer(turned, np.uint8), cv2.IMREAD_COLOR)
    assert followed is not None
    assert followed.shape[:2] == (1000, 600)
    np.testing.assert_array_equal(read_photo(turned, 320)[0], read_photo(PHOTO, 320)[0])


def saved(image: MatLike | Image.Image, kind: str = "PNG") -> bytes:
    file = io.BytesIO()
    (image if isinstance(image, Image.Image) else Image.fromarray(image)).save(file, kind, quality=95)
    return file.getvalue()


@pytest.mark.parametrize(
    ("mode", "kind", "error"),
    [
        ("1", "PNG", 0), ("L", "PNG", 0), ("LA", "PNG", 0), ("P", "PNG", 0), ("RGB", "PNG", 0), ("RGBA", "PNG", 0),
        ("L", "JPEG", 1), ("CMYK", "JPEG", 2),
    ],
)  # fmt: skip
def test_all_kinds_of_photos_have_the_pixels_that_another_decoder_sees(
    mode: str, kind: str, error: float
) -> None:
    photo = saved(Image.fromarray(gradient(300, 200)).convert(mode), kind)
    seen = np.array(Image.open(io.BytesIO(photo)).convert("RGB"))[:, :, ::-1]
    pixels = decode_photo(photo)
    assert np.abs(pixels.astype(int) - seen).mean() <= error
    picture, box = read_photo(photo, 320)
    np.testing.assert_array_equal(picture, box.picture(pixels))


def test_a_photo_of_120_megapixels_takes_little_memory() -> None:
    photo = jpeg_of(np.zeros((10_000, 12_000), np.uint8))
    before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert read_photo(photo, 608)[1] == Letterbox(12_000, 10_000, 608)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb < 100_000


# --- 16 bits -------------------------------------------------------------------------------------------------


def thermal() -> MatLike:
    """Hundredths of a kelvin, with a hot and a broken pixel."""
    image = np.full((200, 300), 29_500, np.uint16)
    image[:, 150:] = 30_500
    image[100, 100:110] = 31_800
    image[0, 0] = 0
    return image


def test_a_thermal_photo_is_stretched_between_its_darkest_and_brightest_pixels() -> None:
    pixels = decode_photo(saved(thermal()))
    assert pixels.dtype == np.uint8
    assert [pixels[at].tolist() for at in [(50, 50), (50, 200), (100, 105), (0, 0)]] == [
        [0] * 3, [255] * 3, [255] * 3, [0] * 3,
    ]  # fmt: skip


def test_the_noise_of_an_even_thermal_photo_is_not_stretched() -> None:
    even = np.full((200, 300), 29_500, np.uint16)
    even[::2] += 4
    assert 120 <= in_8_bits(even).min() < in_8_bits(even).max() <= 135


def test_of_colours_of_16_bits_the_upper_8_are_kept() -> None:
    image = gradient(300, 200)
    photo = cv2.imencode(".png", image.astype(np.uint16) * 257)[1].tobytes()
    np.testing.assert_array_equal(decode_photo(photo), image)


# --- bytes that are no photo --------------------------------------------------------------------------------


def with_size(photo: bytes, *, width_px: int, height_px: int) -> bytes:
    at = photo.index(b"\xff\xc0") + 5
    return photo[:at] + height_px.to_bytes(2) + width_px.to_bytes(2) + photo[at + 4 :]


def chunk(kind: bytes, content: bytes) -> bytes:
    return len(content).to_bytes(4) + kind + content + zlib.crc32(kind + content).to_bytes(4)


def png(
    data: bytes = bytes(8 * 25),
    *,
    width_px: int = 8,
    height_px: int = 8,
    before: bytes = b"",
    end: bytes = b"",
) -> bytes:
    header = struct.pack(">IIBBBBB", width_px, height_px, 8, 2, 0, 0, 0)
    chunks = (chunk(b"IHDR", header), before, chunk(b"IDAT", zlib.compress(data)), end or chunk(b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


@pytest.mark.parametrize(
    ("photo", "complaint"),
    [
        (b"", r"empty \(0 bytes\)"),
        (b"\x00\x01\x02\x03\x04", r"5 bytes that start with 00 01 02 03, not a JPEG or PNG"),
        (b"GIF89a", r"is a GIF, not a JPEG or PNG"),
        (png()[:-12], r"PNG is cut off after [\d,]+ bytes"),
        (png()[:20], r"PNG is cut off after 20 bytes"),
        (png(end=bytes(12) * 60_000 + chunk(b"IEND", b"")), r"PNG is cut off .*, or damaged"),
        (png(bytes(8 * 24)), r"cannot decode the PNG"),
        (
            png(width_px=9000, height_px=9000),
            r"PNG says .* 9000 x 9000 .* to 40,000,000 .*: save it as a base",
        ),
        (png(width_px=2**31, height_px=2**31), r"to 40,000,000 .*: have the camera take smaller"),
        (png(height_px=0), r"8 x 0 pixels"),
        (png(bytes(10**8)), r"more data than pixels"),
        (b"\xff\xd8\xff", r"cut off after 3 bytes"),
        (b"\xff\xd8\xff\xe0\x00\x04ab" + bytes(100), r"byte 8 starts no segment"),
        (b"\xff\xd8\xff\x00\xff\xff" + bytes(100), r"byte 2 starts no segment"),
        (b"\xff\xd8\xff\xda" + bytes(100) + b"\xff\xd9", r"never says its size"),
        (PHOTO[:-2], r"cut off after [\d,]+ bytes"),
        (PHOTO[: len(PHOTO) // 2], r"cut off after [\d,]+ bytes"),
        (
            with_size(PHOTO, width_px=12_000, height_px=12_000),
            r"12000 x 12000 pixels; photos of 1 to 120,000,000",
        ),
        (with_size(PHOTO, width_px=1000, height_px=0), r"1000 x 0 pixels"),
    ],
    ids=[
        "empty",
        "noise",
        "gif",
        "png-no-end",
        "png-stub",
        "png-chunks",
        "png-no-pixels",
        "png-large",
        "png-giant",
        "png-flat",
        "png-long",
        "stub",
        "zeros",
        "no-marker",
        "sizeless",
        "no-end",
        "half",
        "giant",
        "flat",
    ],
)
def test_what_is_no_photo_is_refused_with_what_it_is(photo: bytes, complaint: str) -> None:
    with pytest.raises(NotAPhoto, match=complaint):
        read_photo(photo, 320)


def test_a_true_photo_of_more_megapixels_is_refused_before_it_is_decoded() -> None:
    giant = jpeg_of(np.zeros((10_000, 12_001), np.uint8))
    before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(NotAPhoto, match="12001 x 10000 pixels"):
        read_photo(giant, 608)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb < 1000


def test_what_a_png_holds_beside_its_pixels_takes_no_memory() -> None:
    texts = chunk(b"zTXt", b"it\0\0" + zlib.compress(bytes(7_900_000))) * 200
    before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    read_photo(png(before=texts), 320)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb < 100_000


def test_the_size_is_read_without_decoding_and_of_no_photo_there_is_none() -> None:
    _, encoded = cv2.imencode(".jpg", np.zeros((48, 64, 3), np.uint8))
    photo = encoded.tobytes()
    assert size_of(photo) == (64, 48)
    assert size_of(photo[:20]) is size_of(b"") is size_of(b"\x89PNG") is None


def test_every_cut_is_noticed() -> None:
    for length in range(0, len(PHOTO), 61):
        with pytest.raises(NotAPhoto):
            read_photo(PHOTO[:length], 320)


def test_damaged_headers_raise_nothing_but_not_a_photo() -> None:
    chance, refused = random.Random(7), 0
    for _ in range(300):
        damaged = bytearray(PHOTO)
        for _ in range(3):
            damaged[chance.randrange(2, 640)] = chance.randrange(256)
        try:
            read_photo(bytes(damaged), 320)
        except NotAPhoto:
            refused += 1
    assert 0 < refused < 300


@pytest.mark.parametrize(
    ("kind", "what"),
    [
        ("TIFF", "a TIFF or raw photo"), ("WEBP", "a WebP file"), ("BMP", "a BMP file"), ("GIF", "a GIF"),
        ("JPEG2000", "a JPEG 2000 file"), ("PDF", "a PDF"),
    ],
)  # fmt: skip
def test_photos_of_other_formats_are_refused_as_what_they_are(kind: str, what: str) -> None:
    with pytest.raises(NotAPhoto, match=f"the photo is {what}, not a JPEG or PNG; save it as one of these"):
        read_photo(saved(gradient(40, 30), kind), 320)


def test_of_several_pictures_in_a_file_the_first_is_the_photo() -> None:
    file, pictures = io.BytesIO(), [Image.fromarray(gradient(40, 30)), Image.new("RGB", (40, 30))]
    pictures[0].save(file, "PNG", save_all=True, append_images=pictures[1:])
    np.testing.assert_array_equal(decode_photo(file.getvalue())[:, :, ::-1], gradient(40, 30))


@pytest.mark.parametrize("bits", [0, 12, 16])
def test_a_jpeg_of_other_than_8_bits_is_refused(bits: int) -> None:
    at = PHOTO.index(b"\xff\xc0") + 4
    with pytest.raises(
        NotAPhoto, match=f"{bits} bits a channel, not 8; save it as a baseline JPEG, or as a PNG"
    ):
        read_photo(PHOTO[:at] + bytes([bits]) + PHOTO[at + 1 :], 320)


@given(st.sampled_from(["JPEG", "progressive", "PNG"]), st.data())
def test_whatever_a_header_says_a_photo_has_the_stated_size_or_is_refused(
    kind: str, data: st.DataObject
) -> None:
    photo = bytearray(HEADERS[kind])
    for _ in range(data.draw(st.integers(1, 4))):
        photo[data.draw(st.integers(2, min(len(photo), 700) - 1))] = data.draw(st.integers(0, 255))
    try:
        box, pixels = read_photo(bytes(photo), 320)[1], decode_photo(bytes(photo))
    except NotAPhoto as refusal:
        assert len(str(refusal)) < 300
        return
    assert pixels.shape == (box.photo_height_px, box.photo_width_px, 3)


# --- photos that would take long ----------------------------------------------------------------------------


def progressive(photo: MatLike, *, more_scans: int = 0, padding: bytes = b"") -> bytes:
    """A JPEG of 10 scans, and so many copies of the last one, each with the tables that it needs."""
    jpeg = cv2.imencode(".jpg", photo, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1].tobytes()
    segments = list(segments_of(jpeg))
    scans = [index for index, segment in enumerate(segments) if segment.marker == SOS]
    tables, end = segments[scans[-2] + 1], segments[-1]
    last = jpeg[tables.start : end.start]
    return jpeg[: end.start] + (padding + last) * more_scans + jpeg[end.start :]


def markers_of(jpeg: bytes) -> list[int]:
    return [segment.marker for segment in segments_of(jpeg)]


@pytest.mark.parametrize("padding", [b"", b"\xff\xff", b"\0\1\2", b"\xff\xd0", b"\xff\xfe\0\4\xff\xd9"])
def test_every_scan_is_counted(padding: bytes) -> None:
    found = markers_of(progressive(gradient(40, 30), more_scans=5, padding=padding))
    assert found.count(SOS) == 15
    assert found[-1] == EOI


def test_a_photo_that_its_decoder_holds_in_memory_may_have_fewer_pixels() -> None:
    photo = progressive(gradient(40, 30))
    at = photo.index(b"\xff\xc2") + 5
    large = photo[:at] + (6001).to_bytes(2) + (MAX_HELD_PIXELS // 6000).to_bytes(2) + photo[at + 4 :]
    with pytest.raises(NotAPhoto, match="1 to 40,000,000 pixels are accepted: save it as a baseline JPEG"):
        read_photo(large, 320)


def test_a_photo_of_as_many_scans_as_its_size_allows_is_read_and_of_one_more_is_not() -> None:
    photo = gradient(2000, 1000)
    most = MAX_SCANNED_PIXELS // 2_000_000
    read_photo(progressive(photo, more_scans=most - 10), 320)
    with pytest.raises(
        NotAPhoto, match=f"{most + 1} scans of 2000 x 1000 pixels; .* at most {most} scans .* baseline"
    ):
        read_photo(progressive(photo, more_scans=most - 9), 320)


@pytest.mark.parametrize("kind", [0xC3, 0xC5, 0xC9, 0xCA, 0xCF])
def test_kinds_that_no_camera_writes_are_refused(kind: int) -> None:
    with pytest.raises(NotAPhoto, match=f"rare kind \\(marker ff {kind:02x}\\); save it as a baseline JPEG"):
        read_photo(PHOTO.replace(b"\xff\xc0", bytes((0xFF, kind))), 320)


def test_a_photo_that_says_its_size_twice_is_refused() -> None:
    at = PHOTO.index(b"\xff\xc0")
    small = with_size(PHOTO, width_px=8, height_px=8)[at : at + 19]
    with pytest.raises(NotAPhoto, match="never says its size, or twice"):
        read_photo(PHOTO[:at] + small + PHOTO[at:], 320)


def test_a_photo_of_too_many_segments_is_refused() -> None:
    comment = b"\xff\xfe\0\2"
    few = MOST_SEGMENTS - len(markers_of(PHOTO))
    read_photo(PHOTO[:2] + comment * few + PHOTO[2:], 320)
    with pytest.raises(NotAPhoto, match=f"more than {MOST_SEGMENTS} segments"):
        read_photo(PHOTO[:2] + comment * (few + 1) + PHOTO[2:], 320)


def test_photos_within_a_photo_and_after_it_do_not_count() -> None:
    thumbnail = progressive(gradient(40, 30), more_scans=500)
    exif = b"\xff\xe1" + (len(thumbnail) + 2).to_bytes(2) + thumbnail
    with_both = PHOTO[:2] + exif + PHOTO[2:] + progressive(gradient(40, 30), more_scans=1000)
    assert markers_of(with_both).count(SOS) == 1
    np.testing.assert_array_equal(read_photo(with_both, 320)[0], read_photo(PHOTO, 320)[0])


@pytest.mark.parametrize("kind", ["JPEG", "PNG"])
@pytest.mark.parametrize(("width_px", "height_px"), [(1440, 1080), (1080, 1441), (4001, 37)])
def test_a_smaller_photo_has_the_shape_of_the_whole_one_and_says_its_size(
    width_px: int, height_px: int, kind: str
) -> None:
    noise = np.random.default_rng(1).integers(0, 255, (height_px, width_px, 3), np.uint8)
    whole = saved(noise, kind)
    smaller = shrunk(whole, 720, 85)
    small_px = photo_size(smaller)
    assert max(small_px) == 720
    assert small_px[0] / width_px == pytest.approx(small_px[1] / height_px, abs=1 / height_px)
    assert whole_size(smaller) == whole_size(shrunk(smaller, 360, 50)) == (width_px, height_px)
    assert whole_size(whole) is None


def test_a_photo_that_would_not_be_smaller_is_sent_as_it_is() -> None:
    small = jpeg_of(gradient(64, 48))
    assert shrunk(small, 720, 100) == small


def test_what_is_no_photo_is_not_made_smaller() -> None:
    with pytest.raises(NotAPhoto):
        shrunk(b"\xff\xd8\xff garbage", 720, 85)
