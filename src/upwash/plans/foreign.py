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
    (b"\x1f\x8b", "a packed file (gzip): unpack it"),
    (b"7z\xbc\xaf", "a packed file (7z): unpack it"),
)
_BY_ELEMENT = {
    "kml": f"KML, {_AS_AREA}",
    "gpx": "GPX, tracks of a navigation device: plan the flight anew",
    "html": "a web page, not the file that it shows: download the file itself (on GitHub: Raw)",
    "flight_plan": "a flight plan of Paparazzi: plan the flight anew",
}
_DJI = (
    "a flight of DJI Pilot (KMZ with WPML), which no ground station for MAVLink reads: plan the flight anew"
)
_GEOMETRIES = (
    "FeatureCollection", "Feature", "GeometryCollection", "Point", "MultiPoint", "LineString", "MultiLineString",
    "Polygon", "MultiPolygon",
)  # fmt: skip
_ELEMENT = re.compile(r"<(?:\w+:)?([A-Za-z_]\w*)")
_PAIR = re.compile(r"\s*-?\d+(\.\d+)?[\s,]+-?\d+(\.\d+)?\s*")


def kind_of_bytes(content: bytes) -> str:
    """What a file of these bytes is, where they cannot be a plan's; "" for what may be text."""
    if not content.strip():
        return "empty"
    if content.startswith(b"PK"):
        return _archive(content)
    return next((kind for first, kind in _BY_FIRST_BYTES if content.startswith(first)), "")


def kind_of_text(text: str) -> str:
    """What a text is, other than JSON or a list of waypoints; "" for what is not known."""
    beginning = text.lstrip()[:2000]
    if beginning.startswith("<"):
        names = (name.lower() for name in _ELEMENT.findall(beginning))
        return next((_BY_ELEMENT[name] for name in names if name in _BY_ELEMENT), "XML")
    first = next((line for line in beginning.splitlines() if line and not line.startswith("#")), "")
    if first.startswith(("RALLY", "FENCE")):
        return "a list of rally points or of a geofence, not of waypoints"
    if _PAIR.fullmatch(first):
        return "pairs of numbers, as ArduPilot's older geofences have them"
    if "latitude" in first.lower() and "," in first:
        return "a table of places (CSV)"
    return ""


def kind_of_document(document: object) -> str:
    """What a JSON document is that is no plan; "" for what may be a plan, with mistakes in it."""
    if not isinstance(document, dict):
        return "JSON without a plan in it"
    if document.get("type") in _GEOMETRIES:
        return "GeoJSON, places without a flight: turn it into KML (QGIS does), and load that as the area of a survey"
    if "MAV_AUTOPILOT" in document or "complexItems" in document:
        return (
            "a mission of an old QGroundControl (.mission): open it in QGroundControl, and save it as .plan"
        )
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
