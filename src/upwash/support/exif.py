"""Where, when and how a photo was taken, in its JPEG as EXIF (2.32) and XMP; the picture is not touched.

    SOI [APP0 JFIF] APP1 "Exif" TIFF, APP1 XMP ...

A place that is written replaces the camera's GPS directory. What the camera's XMP says of a place becomes blanks, as
some programs read XMP first.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import NamedTuple

from upwash.support.jpeg import SOI, SOS, Segment, segments_of
from upwash.support.tiff import (
    BYTE,
    COUNT,
    EMPTY,
    ENTRY,
    ORDERS,
    SHORT,
    UNDEFINED,
    Directory,
    Value,
    append,
    pointer,
    rationals,
    text,
)

_APP0, _APP1 = 0xE0, 0xE1
_EXIF = b"Exif\0\0"
_LONGEST = 0xFFFF - 2  # of what a segment holds, beside its length
_XMP = b"http://ns.adobe.com/xap/1.0/\0"
_EXIF_DIRECTORY, _GPS_DIRECTORY = 0x8769, 0x8825  # tags of IFD0 that lead to them
_ORIENTATION = 0x0112
_STATUS, _MODE, _DOP, _DIRECTION = 0x09, 0x0A, 0x0B, 0x11  # of the GPS directory
_NO_FIX_MODES = ("0", "1")  # of NMEA; 2 and 3 are those of a fix
_NO_FIX_DOP = 50.0  # receivers without a fix write 99.99
_SAME_DEG = 0.02  # two numbers that round one angle
_XMP_NAME = rb"(?!xmlns:)[\w-]+:(?:(?i:GPS)|Rtk|AbsoluteAltitude)\w*"  # of properties of the place
_XMP_PLACE = re.compile(
    rb"\s"
    + _XMP_NAME
    + rb"\s*=\s*(?:\"[^\"<]*\"|'[^'<]*')|<("
    + _XMP_NAME
    + rb")(?:\s[^<>]*)?(?:/>|>[^<]*</\1\s*>)"
)
_XMP_YAW = re.compile(rb":\w*Yaw\w*\s*[=>]")


@dataclass(frozen=True, slots=True)
class PhotoPlace:
    """Where a photo was taken: degrees (WGS 84), metres above the sea, clockwise from north, seconds since 1970.

    `focal_35mm` is the focal length as of a lens on film of 35 mm. None stands for what is not known.
    """

    latitude_deg: float
    longitude_deg: float
    above_sea_m: float | None = None
    heading_deg: float | None = None
    unix_s: float | None = None
    focal_35mm: float | None = None


class _Head(NamedTuple):
    """Where a JPEG has its EXIF and XMP; EXIF starts at `start`."""

    start: int
    exif: Segment | None
    xmp: list[Segment]

    def tiff(self, jpeg: bytes) -> bytes:
        return jpeg[self.exif.start + 4 + len(_EXIF) : self.exif.end] if self.exif else EMPTY


def own_place(jpeg: bytes) -> tuple[float, float] | None:
    """The latitude and longitude, in degrees, that a camera with a fix wrote as EXIF; None without them.

    A directory without letters or with broken numbers, a void one, and 0 and 0 are no place.
    """
    gps = _gps_directory(jpeg)
    if gps is None or gps.text(_STATUS).upper() == "V" or gps.text(_MODE) in _NO_FIX_MODES:
        return None
    if any(dilution >= _NO_FIX_DOP for dilution in gps.numbers(_DOP)):
        return None
    latitude_deg, longitude_deg = _read_degrees(gps, 1, "NS", 90), _read_degrees(gps, 3, "EW", 180)
    if latitude_deg is None or longitude_deg is None or latitude_deg == longitude_deg == 0:
        return None
    return latitude_deg, longitude_deg


def with_place(jpeg: bytes, shot: PhotoPlace) -> bytes:
    """The photo with this place and no other; the same object where its header is cut off, unreadable or full."""
    head = _head(jpeg)
    if head is None:
        return jpeg
    if any(_XMP_YAW.search(jpeg, segment.start, segment.end) for segment in head.xmp):
        shot = replace(shot, heading_deg=None)  # the camera knows its own
    start, end = (head.start, head.start) if head.exif is None else head.exif[1:]
    located = _located(head.tiff(jpeg), shot)
    if located is None or len(_EXIF) + len(located) > _LONGEST:
        return jpeg
    unplaced = _without_xmp_place(jpeg, head.xmp)
    return b"".join((unplaced[:start], _app1(_EXIF + located), memoryview(unplaced)[end:]))


def with_pose(jpeg: bytes, angles_deg: tuple[float, float, float], errors_m: tuple[float, float]) -> bytes:
    """The photo with its yaw, pitch and roll, and the errors of its place to the sides and in altitude, as XMP.

    Up in the photo points along the yaw, clockwise from north; a pitch of 0 looks straight down, of 90 ahead, as
    OpenDroneMap reads Pix4D's names. A photo that has XMP, or another direction as EXIF, stays as it is.
    """
    head, gps = _head(jpeg), _gps_directory(jpeg)
    if head is None or head.xmp:
        return jpeg
    for direction_deg in gps.numbers(_DIRECTION) if gps else ():
        if abs(math.remainder(direction_deg - angles_deg[0], 360)) > _SAME_DEG:
            return jpeg
    at = head.start if head.exif is None else max(head.start, head.exif.end)
    names = ("Yaw", "Pitch", "Roll", "GPSXYAccuracy", "GPSZAccuracy")
    values = " ".join(
        f'Camera:{name}="{value:.2f}"' for name, value in zip(names, (*angles_deg, *errors_m), strict=True)
    )
    packet = (
        '<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?><x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF '
        'xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"><rdf:Description rdf:about="" '
        f'xmlns:Camera="http://pix4d.com/camera/1.0/" {values}/></rdf:RDF></x:xmpmeta><?xpacket end="r"?>'
    ).encode()
    return b"".join((jpeg[:at], _app1(_XMP + packet), memoryview(jpeg)[at:]))


def unturned(jpeg: bytes) -> bytes:
    """The photo without its note to turn it, which browsers follow: boxes are in stored pixels."""
    for segment in segments_of(jpeg):
        if segment.marker == SOS:
            return jpeg
        if segment.marker == _APP1 and jpeg.startswith(_EXIF, segment.start + 4):
            tiff = bytearray(jpeg[segment.start + 4 + len(_EXIF) : segment.end])
            break
    else:
        return jpeg
    if (order := ORDERS.get(bytes(tiff[:4]))) is None:
        return jpeg
    try:
        (first,) = struct.unpack_from(f"{order}I", tiff, 4)
        (count,) = struct.unpack_from(f"{order}H", tiff, first)
        for entry in range(first + COUNT, first + COUNT + count * ENTRY, ENTRY):
            if struct.unpack_from(f"{order}H", tiff, entry)[0] == _ORIENTATION:
                struct.pack_into(f"{order}H", tiff, entry + 8, 1)
    except struct.error:
        return jpeg
    return b"".join((jpeg[: segment.end - len(tiff)], tiff, memoryview(jpeg)[segment.end :]))


def _app1(content: bytes) -> bytes:
    return struct.pack(">BBH", 0xFF, _APP1, 2 + len(content)) + content


def _head(jpeg: bytes) -> _Head | None:
    """None where the header is cut off, or the bytes are no JPEG."""
    start, exif, xmp = len(SOI), None, list[Segment]()
    for segment in segments_of(jpeg):
        if segment.marker == SOS:
            return _Head(start, exif, xmp)
        if segment.marker == _APP0 and segment.start == start:
            start = segment.end
        if segment.marker == _APP1 and jpeg.startswith(_XMP, segment.start + 4):
            xmp.append(segment)
        elif segment.marker == _APP1 and exif is None and jpeg.startswith(_EXIF, segment.start + 4):
            exif = segment
    return None


def _gps_directory(jpeg: bytes) -> Directory | None:
    head = _head(jpeg)
    first = head and Directory.first_of(head.tiff(jpeg))
    return first.inner(_GPS_DIRECTORY) if first else None


def _read_degrees(gps: Directory, letter: int, letters: str, most_deg: float) -> float | None:
    """Degrees, minutes and seconds beside the letter of their half of the Earth; None where they are no angle."""
    half, parts = gps.text(letter).upper(), gps.numbers(letter + 1)
    if len(half) != 1 or half not in letters or not 1 <= len(parts) <= 3:
        return None
    angle_deg = sum(part / 60.0**power for power, part in enumerate(parts))
    if not angle_deg <= most_deg or any(part > 60 for part in parts[1:]):
        return None
    return -angle_deg if half == letters[1] else angle_deg


def _without_xmp_place(jpeg: bytes, xmp: list[Segment]) -> bytes:
    """The photo whose XMP, of the same length, says nothing of a place."""

    def parts() -> Iterator[bytes]:
        done = 0
        for segment in xmp:
            yield jpeg[done : segment.start]
            yield _XMP_PLACE.sub(lambda found: b" " * len(found[0]), jpeg[segment.start : segment.end])
            done = segment.end
        yield jpeg[done:]

    return b"".join(parts()) if xmp else jpeg


def _located(tiff: bytes, shot: PhotoPlace) -> bytes | None:
    """The TIFF with a directory of the place; None where it cannot be read."""
    directory = Directory.first_of(tiff)
    if directory is None:
        return None
    order, entries = directory.order, dict(directory.entries)
    grown = bytearray(tiff)
    grown += bytes(len(grown) % 2)
    if _EXIF_DIRECTORY not in entries and (taken := _taken(shot, order)):
        entries[_EXIF_DIRECTORY] = pointer(append(grown, taken, order), order)
    entries[_GPS_DIRECTORY] = pointer(append(grown, _gps(shot, order), order), order)
    struct.pack_into(f"{order}I", grown, 4, len(grown))
    grown += struct.pack(f"{order}H", len(entries)) + b"".join(
        struct.pack(f"{order}H", tag) + rest for tag, rest in sorted(entries.items())
    )
    return bytes(grown + directory.following)


def _gps(shot: PhotoPlace, order: str) -> dict[int, Value]:
    """The directory of the place, by the numbers of its tags."""
    values = {
        0x00: Value(BYTE, 4, bytes((2, 3, 0, 0))),
        0x01: text("N" if shot.latitude_deg >= 0 else "S"),
        0x02: _degrees(shot.latitude_deg, order),
        0x03: text("E" if shot.longitude_deg >= 0 else "W"),
        0x04: _degrees(shot.longitude_deg, order),
        0x12: text("WGS-84"),
    }
    if shot.above_sea_m is not None:
        values[0x05] = Value(BYTE, 1, bytes((shot.above_sea_m < 0,)))
        values[0x06] = rationals(order, (round(abs(shot.above_sea_m) * 100), 100))
    if shot.heading_deg is not None:
        values[0x10] = text("T")  # true north
        values[0x11] = rationals(order, (round(shot.heading_deg % 360 * 100), 100))
    if (taken := _time(shot)) is not None:
        second = (taken.second * 1000 + taken.microsecond // 1000, 1000)
        values[0x07] = rationals(order, (taken.hour, 1), (taken.minute, 1), second)
        values[0x1D] = text(f"{taken:%Y:%m:%d}")
    return values


def _taken(shot: PhotoPlace, order: str) -> dict[int, Value]:
    """The directory of the time, in UTC, and of the lens; empty if both are unknown."""
    values, taken = dict[int, Value](), _time(shot)
    if taken is not None:
        values[0x9003] = text(f"{taken:%Y:%m:%d %H:%M:%S}")
        values[0x9011] = text("+00:00")
    if shot.focal_35mm is not None and 0.5 <= shot.focal_35mm < 0xFFFF:
        values[0xA405] = Value(SHORT, 1, struct.pack(f"{order}H", round(shot.focal_35mm)))
    return {0x9000: Value(UNDEFINED, 4, b"0232"), **values} if values else {}


def _time(shot: PhotoPlace) -> datetime | None:
    """None where the time is not known, or is outside the calendar, as a receiver's nonsense may be."""
    try:
        return None if shot.unix_s is None else datetime.fromtimestamp(shot.unix_s, UTC)
    except (ValueError, OverflowError, OSError):
        return None


def _degrees(angle_deg: float, order: str) -> Value:
    """Degrees, minutes and ten-thousandths of seconds: 3 mm on the ground."""
    minutes, seconds = divmod(round(abs(angle_deg) * 36_000_000), 600_000)
    return rationals(order, (minutes // 60, 1), (minutes % 60, 1), (seconds, 10_000))
