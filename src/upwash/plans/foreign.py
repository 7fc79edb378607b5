"""The kind of a file that is no plan, by its first bytes or its first element, and what a person can do with it."""

from __future__ import annotations

import io
import re
import zipfile

WANTED = (
    "expected QGroundControl's JSON (.plan), or text that begins QGC WPL 110 (.waypoints): plan the flight in "
    "QGroundControl or Mission Planner, and save it"
)
_AS_AREA = (
    "places without a flight: load it in QGroundControl as the area of a survey (Plan, Pattern, Survey, load "
    "KML or SHP), and save the plan"
)
_BY_FIRST_BYTES = (
    (b"\x00\x00\x27\x0a", f"a shapefile (SHP), {_AS_AREA}"),
    (b"\xa3\x95", "a flight log of ArduPilot"),
    (b"ULog", "a flight log of PX4"),
    (b"\x89PNG", "a picture (PNG)"),
    (b"\xff\xd8\xff", "a picture (JPEG)"),
    (b"%PDF", "a PDF document"),
    *(
        (first, "a packed file: unpack it")
        for first in (b"\x1f\x8b", b"7z\xbc\xaf", b"Rar!", b"BZh", b"\xfd7zXZ")
    ),
    (b"#ROSBAG", "a recording of ROS (bag)"),
    (b"\x89MCAP", "a recording (MCAP)"),
    (b"SQLite format 3", "a database (SQLite), as bags of ROS 2 are"),
    (b"\x1b\x67", "parameters of an ArduPilot"),
)
_MAVLINK_1, _MAVLINK_2, _PACKETS, _TIME_BYTES = 0xFE, 0xFD, 2, 8  # a log has a time before each packet
BEGINNING = 4000  # characters of a file that tell its kind
_WPML = "www.dji.com/wpmz"
_SIGNED = 1  # a flag of MAVLink 2: a signature of 13 bytes ends the packet
_BY_ELEMENT = {
    "kml": f"KML, {_AS_AREA}",
    "gpx": "GPX, tracks of a navigation device: plan the flight anew",
    "html": "a web page, not the file that it shows: download the file itself (on GitHub: Raw)",
    "flight_plan": "a flight plan of Paparazzi: plan the flight anew",
    "flight-plan": "a flight plan of Garmin (FPL): plan the flight anew",
    "mission": "a mission of INAV or MultiWii (XML): plan the flight anew",
}
_DJI = "a flight of DJI Pilot (WPML), which no ground station for MAVLink reads: plan the flight anew"
_GEOMETRIES = (
    "FeatureCollection", "Feature", "GeometryCollection", "Point", "MultiPoint", "LineString", "MultiLineString",
    "Polygon", "MultiPolygon",
)  # fmt: skip
_OLD_MISSION = frozenset({"MAV_AUTOPILOT", "complexItems", "plannedHomePosition"})
_ELEMENT = re.compile(r"<(?:\w+:)?([A-Za-z_][\w-]*)")
_PAIR = re.compile(r"\s*-?\d+(\.\d+)?[\s,]+-?\d+(\.\d+)?\s*")
_BY_FIRST_LINE = (
    (r"RALLY|FENCE", "a list of rally points or of a geofence, not of waypoints"),
    (_PAIR.pattern + "$", "pairs of numbers, as ArduPilot's older geofences have them"),
    (r"-?\d+(\.\d+)?([\s,;]+-?\d+(\.\d+)?){2,}\s*$", "a table of numbers"),
    (r"FMT, *\d", "a flight log of ArduPilot"),
    (r"(?:\d+\s+\d+\s+)?[A-Z][A-Z\d]*_[A-Z\d_]*[\s,]+-?[\d.]", "parameters of a vehicle"),
    (
        r"(?i)(?![{\[])(?=.*\blat(?:itude)?\b)(?=.*\blo?ng?(?:itude)?\b).*[,;\t]",
        "a table of places (CSV), as Litchi has them",
    ),
    (
        r"version https://git-lfs",
        "a pointer of Git LFS, not the file that it stands for: get that by git lfs pull",
    ),
    (r"\[+\s*[A-Za-z_][\w.\s-]*\]", "TOML, a configuration and no plan"),
)


def kind_of_bytes(content: bytes) -> str:
    """What a file of these bytes is, where they cannot be a plan's; "" for what may be text."""
    if not content.strip():
        return "empty"
    return _archive(content) if content.startswith(b"PK") else kind_of_beginning(content)


def kind_of_beginning(content: bytes) -> str:
    """What a file is that begins with these bytes; "" for what may be text, or an archive."""
    kind = next((kind for first, kind in _BY_FIRST_BYTES if content.startswith(first)), "")
    if not kind and any(_has_packets(content, before) for before in (0, _TIME_BYTES)):
        return "a telemetry log (tlog), the record of a flight"
    if not kind and content[16:21] == b"BUILD":
        return "a flight log of DJI"
    return kind


def _has_packets(content: bytes, before_bytes: int) -> bool:
    """Whether it begins with MAVLink packets, each with that many bytes before it."""
    at = 0
    for _ in range(_PACKETS):
        at += before_bytes
        header = content[at : at + 3]
        if len(header) < 3 or header[0] not in (_MAVLINK_1, _MAVLINK_2):
            return False
        signed = header[0] == _MAVLINK_2 and header[2] & _SIGNED
        at += header[1] + (8 if header[0] == _MAVLINK_1 else 12) + (13 if signed else 0)
    return True


def kind_of_text(text: str) -> str:
    """What a text is, other than JSON or a list of waypoints; "" for what is not known."""
    beginning = text.lstrip()[:BEGINNING]
    if not beginning:
        return "empty"
    if beginning.startswith("<"):
        if _WPML in beginning:
            return _DJI
        names = (name.lower() for name in _ELEMENT.findall(beginning))
        return next((_BY_ELEMENT[name] for name in names if name in _BY_ELEMENT), "XML")
    first = next((line for line in beginning.splitlines() if line and not line.startswith("#")), "")
    return next((kind for pattern, kind in _BY_FIRST_LINE if re.match(pattern, first)), "")


def kind_of_document(document: object) -> str:
    """What a JSON document is that is no plan; "" for what may be a plan, with mistakes in it."""
    if not isinstance(document, dict):
        return "JSON without a plan in it"
    if document.get("type") in _GEOMETRIES:
        return "GeoJSON, places without a flight: turn it into KML (QGIS does), and load that as the area of a survey"
    if "mission" not in document and _OLD_MISSION & document.keys():
        return (
            "a mission of an old QGroundControl (.mission): open it in QGroundControl, and save it as .plan"
        )
    if isinstance(mission := document.get("mission"), dict) and "routes" in mission:
        return "a mission of UgCS: plan the flight anew"
    match document.get("fileType"):
        case "GeoFence" | "RallyPoints" as kind:
            return f"QGroundControl's {kind}, not a plan: open the plan that it is of, and save that"
        case None if "mission" not in document:
            return "JSON without the `mission` of a plan"
    return ""


def _archive(content: bytes) -> str:
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            names = [name.lower() for name in archive.namelist()]
    except (zipfile.BadZipFile, ValueError, NotImplementedError, OSError):
        return "a damaged archive (ZIP)"
    if any(name.startswith("wpmz/") or name.endswith(".wpml") for name in names):
        return _DJI
    if any(name.endswith(".kml") for name in names):
        return f"KMZ, a packed KML: unpack it; it is {_AS_AREA}"
    if any(name.endswith(".shp") for name in names):
        return f"a packed shapefile: unpack it; it is {_AS_AREA}"
    return "an archive (ZIP): unpack it, and name the plan in it"
