"""A photo's place in its JPEG: read back by Pillow, whatever the camera wrote before."""

from __future__ import annotations

import io
from datetime import UTC, datetime

import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import ExifTags, Image

from upwash.support.exif import PhotoPlace, with_place

GPS, TIFF_ORDERS = ExifTags.GPS, ("<", ">")
UNIX_S = datetime(2026, 3, 1, 23, 59, 58, 250_000, UTC).timestamp()


def photo(exif: Image.Exif | None = None) -> bytes:
    file = io.BytesIO()
    picture = Image.effect_noise((64, 48), 60).convert("RGB")
    picture.save(file, "JPEG", **({} if exif is None else {"exif": exif.tobytes()}))
    return file.getvalue()


PLAIN = photo()


def read(jpeg: bytes) -> Image.Exif:
    opened = Image.open(io.BytesIO(jpeg))
    opened.load()
    return opened.getexif()


def gps_of(jpeg: bytes) -> dict[int, object]:
    return dict(read(jpeg).get_ifd(ExifTags.IFD.GPSInfo))


def degrees(gps: dict[int, object], value: int, letter: int) -> float:
    parts = gps[value]
    assert isinstance(parts, tuple)
    size = sum(float(part) / 60.0**power for power, part in enumerate(parts))
    return -size if gps[letter] in ("S", "W") else size


def decoded(jpeg: bytes) -> bytes:
    return Image.open(io.BytesIO(jpeg)).tobytes()


def test_all_that_is_known_is_written() -> None:
    located = with_place(PLAIN, PhotoPlace(-20.4998, 130.2502, 415.25, 271.5, UNIX_S))
    gps = gps_of(located)
    assert degrees(gps, GPS.GPSLatitude, GPS.GPSLatitudeRef) == pytest.approx(-20.4998, abs=3e-8)
    assert degrees(gps, GPS.GPSLongitude, GPS.GPSLongitudeRef) == pytest.approx(130.2502, abs=3e-8)
    assert float(gps[GPS.GPSAltitude]) == 415.25 and gps[GPS.GPSAltitudeRef] == b"\0"  # type: ignore[arg-type]
    assert float(gps[GPS.GPSImgDirection]) == 271.5 and gps[GPS.GPSImgDirectionRef] == "T"  # type: ignore[arg-type]
    assert gps[GPS.GPSTimeStamp] == (23.0, 59.0, 58.25) and gps[GPS.GPSDateStamp] == "2026:03:01"
    assert gps[GPS.GPSMapDatum] == "WGS-84"
    taken = read(located).get_ifd(ExifTags.IFD.Exif)
    assert taken[ExifTags.Base.DateTimeOriginal] == "2026:03:01 23:59:58"
    assert taken[ExifTags.Base.OffsetTimeOriginal] == "+00:00"
    assert decoded(located) == decoded(PLAIN)
    assert len(located) - len(PLAIN) < 500


def test_what_is_not_known_is_left_out() -> None:
    located = with_place(PLAIN, PhotoPlace(39.3666, -22.9507))
    assert set(gps_of(located)) == {
        GPS.GPSVersionID,
        GPS.GPSLatitudeRef,
        GPS.GPSLatitude,
        GPS.GPSLongitudeRef,
        GPS.GPSLongitude,
        GPS.GPSMapDatum,
    }
    assert not read(located).get_ifd(ExifTags.IFD.Exif)


def test_a_place_below_the_sea_is_told_apart() -> None:
    gps = gps_of(with_place(PLAIN, PhotoPlace(31.5, 35.5, above_sea_m=-412.3)))
    assert float(gps[GPS.GPSAltitude]) == 412.3 and gps[GPS.GPSAltitudeRef] == b"\1"  # type: ignore[arg-type]


@given(
    latitude_deg=st.floats(-90, 90),
    longitude_deg=st.floats(-180, 180),
    above_sea_m=st.none() | st.floats(-500, 9000),
    heading_deg=st.none() | st.floats(0, 360),
)
def test_every_place_is_read_back(
    latitude_deg: float, longitude_deg: float, above_sea_m: float | None, heading_deg: float | None
) -> None:
    gps = gps_of(with_place(PLAIN, PhotoPlace(latitude_deg, longitude_deg, above_sea_m, heading_deg)))
    assert degrees(gps, GPS.GPSLatitude, GPS.GPSLatitudeRef) == pytest.approx(latitude_deg, abs=3e-8)
    assert degrees(gps, GPS.GPSLongitude, GPS.GPSLongitudeRef) == pytest.approx(longitude_deg, abs=3e-8)
    if heading_deg is not None:
        assert 0 <= float(gps[GPS.GPSImgDirection]) <= 360  # type: ignore[arg-type]


@pytest.mark.parametrize("order", TIFF_ORDERS)
def test_what_the_camera_wrote_is_kept(order: str) -> None:
    exif = Image.Exif()
    exif.endian = order
    exif[ExifTags.Base.Make] = "A maker of cameras with a long name"
    exif[ExifTags.Base.Orientation] = 6
    exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLength] = 4.5
    before = photo(exif)
    located = with_place(before, PhotoPlace(1.0, 2.0, 3.0, unix_s=UNIX_S))
    after = read(located)
    assert after[ExifTags.Base.Make] == "A maker of cameras with a long name"
    assert after[ExifTags.Base.Orientation] == 6
    assert float(after.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLength]) == 4.5
    assert degrees(gps_of(located), GPS.GPSLongitude, GPS.GPSLongitudeRef) == 2.0
    assert decoded(located) == decoded(before)


@pytest.mark.parametrize("unix_s", [1e13, -1e13, float("inf"), float("nan")])
def test_a_time_that_no_calendar_has_is_left_out(unix_s: float) -> None:
    located = with_place(PLAIN, PhotoPlace(1.0, 2.0, unix_s=unix_s))
    assert GPS.GPSDateStamp not in gps_of(located)
    assert not read(located).get_ifd(ExifTags.IFD.Exif)


def test_a_photo_with_a_place_is_left_as_it_is() -> None:
    located = with_place(PLAIN, PhotoPlace(1.0, 2.0))
    assert with_place(located, PhotoPlace(3.0, 4.0)) is located


@given(junk=st.binary(max_size=40))
@pytest.mark.parametrize(
    "start",
    [
        b"",
        b"\xff\xd8",
        b"\xff\xd8\xff",
        b"\xff\xd8\xff\xe1\x00\x20Exif\0\0II*\0",
        b"\xff\xd8\xff\xe1\x00\x20Exif\0\0",
    ],
)
def test_bytes_that_are_no_jpeg_are_left_or_only_grow(start: bytes, junk: bytes) -> None:
    before = start + junk
    after = with_place(before, PhotoPlace(1.0, 2.0))
    assert after is before or len(after) > len(before)


@pytest.mark.parametrize("cut", [3, 10, 30, 100])
def test_a_header_that_is_cut_off_is_left_as_it_is(cut: int) -> None:
    assert with_place(PLAIN[:cut], PhotoPlace(1.0, 2.0)) == PLAIN[:cut]


def test_a_header_without_room_is_left_as_it_is() -> None:
    exif = Image.Exif()
    exif[ExifTags.Base.Make] = "x" * 65_450
    full = photo(exif)
    assert with_place(full, PhotoPlace(1.0, 2.0)) == full


def test_a_photo_with_too_many_segments_is_left_as_it_is() -> None:
    full = PLAIN[:2] + b"\xff\xfe\0\2" * 5000 + PLAIN[2:]
    assert with_place(full, PhotoPlace(1.0, 2.0)) is full
