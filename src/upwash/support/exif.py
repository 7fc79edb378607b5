"""Where, when and how a photo was taken, written into its JPEG as EXIF (2.32) and XMP; the picture is not touched.

    SOI [APP0 JFIF] APP1 "Exif" TIFF ...        TIFF: byte order, offset of the first directory, directories, values

The camera's own directory, if the photo has one, is copied with two more entries to the TIFF's end: all that it
refers to stays in its place.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import NamedTuple

from upwash.support.jpeg import SOI, SOS, segments_of

_APP0, _APP1 = 0xE0, 0xE1
_EXIF = b"Exif\0\0"
_LONGEST = 0xFFFF - 2  # of what a segment holds, beside its length
_XMP = b"http://ns.adobe.com/xap/1.0/\0"
_BYTE, _ASCII, _SHORT, _LONG, _RATIONAL, _UNDEFINED = 1, 2, 3, 4, 5, 7
_EXIF_DIRECTORY, _GPS_DIRECTORY = 0x8769, 0x8825  # tags of IFD0 that lead to them
_ORIENTATION = 0x0112
_ORDERS = {b"II*\0": "<", b"MM\0*": ">"}
_ENTRY, _COUNT, _OFFSET = 12, 2, 4  # bytes
_INLINE = 4  # bytes of a value that stand in its entry


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


class _Value(NamedTuple):
    kind: int
    length: int
    data: bytes


def with_place(jpeg: bytes, shot: PhotoPlace) -> bytes:
    """The photo with the place in it; as it is where it has one already, or its bytes are no whole JPEG header."""
    place, exif = len(SOI), None
    for segment in segments_of(jpeg):
        if segment.marker == _APP0 and segment.start == place:
            place = segment.end
        if segment.marker == _APP1 and jpeg.startswith(_EXIF, segment.start + 4):
            exif = segment
            break
        if segment.marker == SOS:
            break
    else:
        return jpeg
    start, end = (place, place) if exif is None else (exif.start, exif.end)
    tiff = b"II*\0" + struct.pack("<I", 0) if exif is None else jpeg[start + 4 + len(_EXIF) : end]
    located = _located(tiff, shot)
    if located is None or len(_EXIF) + len(located) > _LONGEST:
        return jpeg
    header = struct.pack(">BBH", 0xFF, _APP1, 2 + len(_EXIF) + len(located))
    return b"".join((jpeg[:start], header, _EXIF, located, memoryview(jpeg)[end:]))


def with_pose(jpeg: bytes, angles_deg: tuple[float, float, float], errors_m: tuple[float, float]) -> bytes:
    """The photo with its yaw, pitch and roll, and the errors of its place to the sides and in altitude, as XMP.

    Up in the photo points along the yaw, clockwise from north; a pitch of 0 looks straight down, of 90 ahead, as
    OpenDroneMap reads Pix4D's names. A photo that has XMP stays as it is.
    """
    at = len(SOI)
    for segment in segments_of(jpeg):
        if segment.marker == SOS:
            break
        if segment.marker in (_APP0, _APP1):
            if jpeg.startswith(_XMP, segment.start + 4):
                return jpeg
            at = segment.end
    names = ("Yaw", "Pitch", "Roll", "GPSXYAccuracy", "GPSZAccuracy")
    values = " ".join(
        f'Camera:{name}="{value:.2f}"' for name, value in zip(names, (*angles_deg, *errors_m), strict=True)
    )
    packet = (
        _XMP
        + (
            '<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?><x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF '
            'xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"><rdf:Description rdf:about="" '
            f'xmlns:Camera="http://pix4d.com/camera/1.0/" {values}/></rdf:RDF></x:xmpmeta><?xpacket end="r"?>'
        ).encode()
    )
    header = struct.pack(">BBH", 0xFF, _APP1, 2 + len(packet))
    return b"".join((jpeg[:at], header, packet, memoryview(jpeg)[at:]))


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
    if (order := _ORDERS.get(bytes(tiff[:4]))) is None:
        return jpeg
    try:
        (first,) = struct.unpack_from(f"{order}I", tiff, 4)
        (count,) = struct.unpack_from(f"{order}H", tiff, first)
        for entry in range(first + _COUNT, first + _COUNT + count * _ENTRY, _ENTRY):
            if struct.unpack_from(f"{order}H", tiff, entry)[0] == _ORIENTATION:
                struct.pack_into(f"{order}H", tiff, entry + 8, 1)
    except struct.error:
        return jpeg
    return b"".join((jpeg[: segment.end - len(tiff)], tiff, memoryview(jpeg)[segment.end :]))


def _located(tiff: bytes, shot: PhotoPlace) -> bytes | None:
    """The TIFF with a directory of the place; None where it has one, or cannot be read."""
    order = _ORDERS.get(tiff[:4])
    if order is None or len(tiff) < 8:
        return None
    (first,) = struct.unpack_from(f"{order}I", tiff, 4)
    try:
        entries, following = _entries(tiff, first, order) if first else ({}, bytes(_OFFSET))
    except struct.error:
        return None
    if _GPS_DIRECTORY in entries:
        return None
    grown = bytearray(tiff)
    grown += bytes(len(grown) % 2)
    if _EXIF_DIRECTORY not in entries and (taken := _taken(shot, order)):
        entries[_EXIF_DIRECTORY] = _pointer(_append(grown, taken, order), order)
    entries[_GPS_DIRECTORY] = _pointer(_append(grown, _gps(shot, order), order), order)
    struct.pack_into(f"{order}I", grown, 4, len(grown))
    grown += struct.pack(f"{order}H", len(entries)) + b"".join(
        struct.pack(f"{order}H", tag) + rest for tag, rest in sorted(entries.items())
    )
    return bytes(grown + following)


def _entries(tiff: bytes, at: int, order: str) -> tuple[dict[int, bytes], bytes]:
    """A directory's entries, each without its tag, and the offset of the directory after it; raises struct.error."""
    (count,) = struct.unpack_from(f"{order}H", tiff, at)
    end = at + _COUNT + count * _ENTRY
    if end + _OFFSET > len(tiff):
        raise struct.error("the directory is cut off")
    starts = range(at + _COUNT, end, _ENTRY)
    entries = {
        struct.unpack_from(f"{order}H", tiff, start)[0]: tiff[start + 2 : start + _ENTRY] for start in starts
    }
    return entries, tiff[end : end + _OFFSET]


def _append(tiff: bytearray, values: Mapping[int, _Value], order: str) -> int:
    """Adds a directory with its values behind it; returns its offset."""
    at = len(tiff)
    data_at = at + _COUNT + len(values) * _ENTRY + _OFFSET
    directory, data = bytearray(struct.pack(f"{order}H", len(values))), bytearray()
    for tag, value in sorted(values.items()):
        directory += struct.pack(f"{order}HHI", tag, value.kind, value.length)
        if len(value.data) <= _INLINE:
            directory += value.data.ljust(_INLINE, b"\0")
        else:
            directory += struct.pack(f"{order}I", data_at + len(data))
            data += value.data + bytes(len(value.data) % 2)
    tiff += directory + bytes(_OFFSET) + data
    return at


def _pointer(offset: int, order: str) -> bytes:
    return struct.pack(f"{order}HII", _LONG, 1, offset)


def _gps(shot: PhotoPlace, order: str) -> dict[int, _Value]:
    """The directory of the place, by the numbers of its tags."""
    values = {
        0x00: _Value(_BYTE, 4, bytes((2, 3, 0, 0))),
        0x01: _text("N" if shot.latitude_deg >= 0 else "S"),
        0x02: _degrees(shot.latitude_deg, order),
        0x03: _text("E" if shot.longitude_deg >= 0 else "W"),
        0x04: _degrees(shot.longitude_deg, order),
        0x12: _text("WGS-84"),
    }
    if shot.above_sea_m is not None:
        values[0x05] = _Value(_BYTE, 1, bytes((shot.above_sea_m < 0,)))
        values[0x06] = _rationals(order, (round(abs(shot.above_sea_m) * 100), 100))
    if shot.heading_deg is not None:
        values[0x10] = _text("T")  # true north
        values[0x11] = _rationals(order, (round(shot.heading_deg % 360 * 100), 100))
    if (taken := _time(shot)) is not None:
        second = (taken.second * 1000 + taken.microsecond // 1000, 1000)
        values[0x07] = _rationals(order, (taken.hour, 1), (taken.minute, 1), second)
        values[0x1D] = _text(f"{taken:%Y:%m:%d}")
    return values


def _taken(shot: PhotoPlace, order: str) -> dict[int, _Value]:
    """The directory of the time, in UTC, and of the lens; empty if both are unknown."""
    values, taken = dict[int, _Value](), _time(shot)
    if taken is not None:
        values[0x9003] = _text(f"{taken:%Y:%m:%d %H:%M:%S}")
        values[0x9011] = _text("+00:00")
    if shot.focal_35mm is not None and 0.5 <= shot.focal_35mm < 0xFFFF:
        values[0xA405] = _Value(_SHORT, 1, struct.pack(f"{order}H", round(shot.focal_35mm)))
    return {0x9000: _Value(_UNDEFINED, 4, b"0232"), **values} if values else {}


def _time(shot: PhotoPlace) -> datetime | None:
    """None where the time is not known, or is outside the calendar, as a receiver's nonsense may be."""
    try:
        return None if shot.unix_s is None else datetime.fromtimestamp(shot.unix_s, UTC)
    except (ValueError, OverflowError, OSError):
        return None


def _text(words: str) -> _Value:
    data = words.encode("ascii") + b"\0"
    return _Value(_ASCII, len(data), data)


def _degrees(angle_deg: float, order: str) -> _Value:
    """Degrees, minutes and ten-thousandths of seconds: 3 mm on the ground."""
    minutes, seconds = divmod(round(abs(angle_deg) * 36_000_000), 600_000)
    return _rationals(order, (minutes // 60, 1), (minutes % 60, 1), (seconds, 10_000))


def _rationals(order: str, *pairs: tuple[int, int]) -> _Value:
    return _Value(_RATIONAL, len(pairs), struct.pack(f"{order}{2 * len(pairs)}I", *sum(pairs, ())))
