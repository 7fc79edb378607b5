"""A photo's place in its JPEG: read back by Pillow, whatever the camera wrote before."""

from __future__ import annotations

import io
import struct
from datetime import UTC, datetime
from xml.etree import ElementTree

import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import ExifTags, Image

from upwash.support.exif import PhotoPlace, own_place, with_place, with_pose
from upwash.support.tiff import EMPTY, Value, append, pointer, rationals, text

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


def test_a_place_that_is_written_is_the_only_one() -> None:
    located = with_place(with_place(PLAIN, PhotoPlace(1.0, 2.0, 30.0)), PhotoPlace(3.0, -4.0))
    assert own_place(located) == (3.0, -4.0)
    assert GPS.GPSAltitude not in gps_of(located)


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


# --- the camera's own place ---------------------------------------------------------------------------------


def camera(gps: dict[int, Value], order: str = "<") -> bytes:
    """A photo whose camera wrote this GPS directory."""
    tiff = bytearray(EMPTY if order == "<" else b"MM\0*" + bytes(4))
    at = append(tiff, gps, order)
    struct.pack_into(f"{order}I", tiff, 4, len(tiff))
    tiff += struct.pack(f"{order}HH", 1, 0x8825) + pointer(at, order) + bytes(4)
    body = b"Exif\0\0" + tiff
    return PLAIN[:2] + b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body + PLAIN[2:]


def angle(*parts: tuple[int, int], order: str = "<") -> Value:
    return rationals(order, *parts)


VERSION = {0: Value(1, 4, b"\2\3\0\0")}
HERE = VERSION | {
    1: text("N"), 2: angle((39, 1), (22, 1), (30, 1)), 3: text("E"), 4: angle((22, 1), (57, 1), (0, 1)),
}  # fmt: skip
ZERO = angle((0, 1), (0, 1), (0, 1))
SHOT = PhotoPlace(-20.5, 130.25, 432.1, 90.0, UNIX_S)


@pytest.mark.parametrize("order", TIFF_ORDERS)
def test_a_place_of_the_camera_is_read(order: str) -> None:
    south = VERSION | {
        1: text("s"), 2: angle((20, 1), (59, 2), order=order), 3: text("W"), 4: angle((1305, 10), order=order),
        9: text("A"), 10: text("3"), 11: angle((12, 10), order=order),
    }  # fmt: skip
    assert own_place(camera(south, order)) == pytest.approx((-20 - 29.5 / 60, -130.5))
    assert own_place(camera(HERE | {2: ZERO})) == (0.0, 22.95), "on the equator"
    assert own_place(PLAIN) is own_place(b"") is None


NO_PLACES = {
    "its version alone": VERSION,
    "void": HERE | {9: text("V")},
    "void, in a small letter": HERE | {9: text("v")},
    "zeros": HERE | {2: ZERO, 4: ZERO},
    "void zeros": HERE | {2: ZERO, 4: ZERO, 9: text("V")},
    "no letter of the latitude": {tag: value for tag, value in HERE.items() if tag != 1},
    "no letter of the longitude": HERE | {3: text("")},
    "a letter of the other": HERE | {1: text("E")},
    "a longitude alone": {tag: value for tag, value in HERE.items() if tag not in (1, 2)},
    "divided by 0": HERE | {2: angle((39, 1), (22, 0), (0, 1))},
    "0 / 0": HERE | {4: angle((0, 0), (0, 0), (0, 0))},
    "beyond the pole": HERE | {2: angle((91, 1), (0, 1), (0, 1))},
    "beyond the calendar line": HERE | {4: angle((180, 1), (1, 1), (0, 1))},
    "80 minutes": HERE | {2: angle((39, 1), (80, 1), (0, 1))},
    "four parts": HERE | {2: angle((1, 1), (1, 1), (1, 1), (1, 1))},
    "an altitude alone": VERSION | {5: Value(1, 1, b"\0"), 6: angle((432, 1))},
    "no fix, by NMEA": HERE | {10: text("1")},
    "a dilution of no fix": HERE | {11: angle((9999, 100))},
    "a text for a number": HERE | {2: text("39.3")},
}


@pytest.mark.parametrize("gps", NO_PLACES.values(), ids=NO_PLACES)
def test_a_directory_without_a_place_is_replaced(gps: dict[int, Value]) -> None:
    photo = camera(gps)
    assert own_place(photo) is None
    placed = with_place(photo, SHOT)
    assert own_place(placed) == pytest.approx((-20.5, 130.25))
    assert not {GPS.GPSStatus, GPS.GPSDOP, GPS.GPSMeasureMode} & set(gps_of(placed))
    assert decoded(placed) == decoded(photo)


def test_a_directory_that_is_cut_off_is_no_place() -> None:
    photo = camera(HERE)
    at = photo.index(b"Exif\0\0") + 6
    for wrong in (0xFFFF_FFFF, 0xFFFF):
        far = bytearray(photo)
        (first,) = struct.unpack_from("<I", far, at + 4)
        struct.pack_into("<I", far, at + first + 2 + 8, wrong)
        assert own_place(bytes(far)) is None
        assert own_place(with_place(bytes(far), SHOT)) == pytest.approx((-20.5, 130.25))


# --- EXIF and XMP ---------------------------------------------------------------------------------------------


def with_xmp(photo: bytes, *properties: str, elements: str = "") -> bytes:
    packet = (
        '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
        '<rdf:Description xmlns:d="http://www.dji.com/drone-dji/1.0/" xmlns:Gps="http://x/" rdf:about="" '
        f"{' '.join(properties)}>{elements}</rdf:Description></rdf:RDF></x:xmpmeta>"
    )
    body = b"http://ns.adobe.com/xap/1.0/\0" + packet.encode()
    return photo[:2] + b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body + photo[2:]


def xmp_of(photo: bytes) -> str:
    start = photo.index(b"<x:xmpmeta")
    return photo[start : photo.index(b"</x:xmpmeta>") + 12].decode()


def test_what_xmp_says_of_the_place_goes_where_a_place_is_written() -> None:
    photo = with_xmp(
        camera(VERSION),
        'd:GpsLatitude="+39.1"', "d:GpsLongtitude='+22.9'", 'd:AbsoluteAltitude="+12.3"', 'd:RtkFlag="50"',
        'd:Model="FC6310"',
        elements="<d:GPSLatitude>39,6N</d:GPSLatitude><d:GpsStatus/><d:Lens>8.8</d:Lens>",
    )  # fmt: skip
    placed = with_place(photo, SHOT)
    assert own_place(placed) == pytest.approx((-20.5, 130.25))
    described = ElementTree.fromstring(xmp_of(placed))[0][0]
    dji = "{http://www.dji.com/drone-dji/1.0/}"
    assert {name.replace(dji, "") for name in described.attrib if dji in name} == {"Model"}
    assert [child.tag.replace(dji, "") for child in described] == ["Lens"]
    assert gps_of(placed)[GPS.GPSImgDirection] == 90.0
    assert decoded(placed) == decoded(photo)


def test_angles_of_the_cameras_own_are_the_only_ones() -> None:
    for own in ('d:GimbalYawDegree="12.0"', 'd:Yaw="12.0"'):
        placed = with_place(with_xmp(PLAIN, own), SHOT)
        assert GPS.GPSImgDirection not in gps_of(placed)
        assert with_pose(placed, (90.0, 0.0, 0.0), (1.0, 1.0)) == placed
    own_direction = camera(HERE | {0x10: text("T"), 0x11: angle((12, 1))})
    assert with_pose(own_direction, (90.0, 0.0, 0.0), (1.0, 1.0)) == own_direction
    assert b'Camera:Yaw="12.01"' in with_pose(own_direction, (12.01, 0.0, 0.0), (1.0, 1.0))
