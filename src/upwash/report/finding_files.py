"""Findings as files for other tools: CSV, GeoJSON, KML, and a zip file of the three with pictures."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any
from xml.etree import ElementTree

from upwash.report.crops import crop_of
from upwash.report.exports import DIGITS, as_rows, collection
from upwash.report.numbering import FlightFindings, PlacedFinding
from upwash.report.photos import PhotoShelf
from upwash.report.reviewed import reviewed
from upwash.support.text import escaped

Pictures = Mapping[int, str]  # by the findings' places in the list, counted from 0: the name of the file

_MOST_CROPS = 1000
_KML = "http://www.opengis.net/kml/2.2"
_WRITTEN = (1980, 1, 1, 0, 0, 0)  # the same findings make the same file
_COLUMNS = (
    "number", "log", "drone", "label", "score", "sightings", "waypoint", "t_s", "time",
    "latitude_deg", "longitude_deg", "east_m", "north_m", "error_m", "place_is",
    "photo", "left_px", "top_px", "width_px", "height_px", "picture", "review", "reviewer", "note",
)  # fmt: skip


def as_csv(findings: Sequence[PlacedFinding], pictures: Pictures | None = None, reviewed: str = "") -> str:
    """A row a finding; a cell is empty where a value is not known.

    How many are `reviewed` has no place in a table.
    """
    return as_rows(_COLUMNS, (map(facts.__getitem__, _COLUMNS) for facts in _facts(findings, pictures)))


def as_geojson(
    findings: Sequence[PlacedFinding], pictures: Pictures | None = None, reviewed: str = ""
) -> str:
    """A feature a finding (RFC 7946), without a geometry where its coordinates are not known.

    The collection says how many are `reviewed`, unless that is empty.
    """
    features = []
    for facts in _facts(findings, pictures):
        place = [facts.pop("longitude_deg"), facts.pop("latitude_deg")]
        known = {name: value for name, value in facts.items() if value is not None}
        point = None if None in place else {"type": "Point", "coordinates": place}
        features.append({"type": "Feature", "geometry": point, "properties": {"kind": "finding", **known}})
    return collection(features, **({"reviewed": reviewed} if reviewed else {}))


def as_kml(findings: Sequence[PlacedFinding], pictures: Pictures | None = None, reviewed: str = "") -> str:
    """A placemark a finding (KML 2.2), without a point where its coordinates are not known.

    The document says how many are `reviewed`, unless that is empty.
    """
    root = ElementTree.Element("kml", xmlns=_KML)
    document = ElementTree.SubElement(root, "Document")
    _say(document, "name", "Findings")
    if reviewed:
        _say(document, "description", reviewed)
    for facts in _facts(findings, pictures):
        placemark = ElementTree.SubElement(document, "Placemark")
        _say(placemark, "name", f"{facts['number']}: {facts['label']}")
        if facts["time"] is not None:
            _say(ElementTree.SubElement(placemark, "TimeStamp"), "when", facts["time"])
        data = ElementTree.SubElement(placemark, "ExtendedData")
        for name, value in facts.items():
            if value is not None:
                _say(ElementTree.SubElement(data, "Data", name=name), "value", str(value))
        if facts["latitude_deg"] is not None:
            place = f"{facts['longitude_deg']},{facts['latitude_deg']}"
            _say(ElementTree.SubElement(placemark, "Point"), "coordinates", place)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def as_zip(findings: Sequence[PlacedFinding], shelf: PhotoShelf, reviewed: str = "") -> bytes:
    """All three, and a picture of each finding that has one, of the first 1,000 at most."""
    pictures, file = dict[int, str](), io.BytesIO()
    are_one_list = len({finding.number for finding in findings}) == len(findings)
    with zipfile.ZipFile(file, "w") as archive:

        def add(name: str, content: str | bytes, compression: int) -> None:
            about = zipfile.ZipInfo(name, _WRITTEN)
            about.external_attr = 0o644 << 16
            archive.writestr(about, content, compression)

        for index, finding in enumerate(findings):
            if len(pictures) < _MOST_CROPS and (jpeg := crop_of(finding.finding, shelf)) is not None:
                prefix = "" if are_one_list else f"{finding.best[0] + 1}-"
                pictures[index] = f"pictures/{prefix}{finding.number}.jpg"
                add(pictures[index], jpeg, zipfile.ZIP_STORED)
        for name, write in _TEXTS.items():
            add(f"findings.{name}", write(findings, pictures, reviewed), zipfile.ZIP_DEFLATED)
    return file.getvalue()


_TEXTS: dict[str, Callable[[Sequence[PlacedFinding], Pictures | None, str], str]] = {
    "csv": as_csv,
    "geojson": as_geojson,
    "kml": as_kml,
}
FORMATS = {
    "csv": "text/csv; charset=utf-8",
    "geojson": "application/geo+json",
    "kml": "application/vnd.google-earth.kml+xml",
    "zip": "application/zip",
}


def findings_file(name: str, flights: Sequence[FlightFindings], shelf: PhotoShelf) -> bytes:
    """The findings of these flights as their reviews have them, in a format, which is a key of FORMATS."""
    found = reviewed(flights)
    if name == "zip":
        return as_zip(found.objects, shelf, found.tally.words)
    return _TEXTS[name](found.objects, None, found.tally.words).encode()


def _facts(findings: Sequence[PlacedFinding], pictures: Pictures | None) -> Iterator[dict[str, Any]]:
    for index, each in enumerate(findings):
        review = each.review
        yield {
            **facts_of(each),
            "picture": (pictures or {}).get(index),
            "review": review.verdict.value if review else None,
            "reviewer": (review.reviewer if review else "") or None,
            "note": each.note or None,
        }


def facts_of(found: PlacedFinding) -> dict[str, Any]:
    """The values of a finding by the names of the columns up to `height_px`; None if unknown."""
    finding, box = found.finding, found.finding.box
    latitude_deg, longitude_deg = (
        (round(each, DIGITS) for each in found.earth) if found.earth else (None, None)
    )
    return {
        "number": found.number,
        "log": found.flight.log,
        "drone": found.flight.drone or None,
        "label": finding.what,
        "score": finding.score,
        "sightings": found.sightings,
        "waypoint": finding.waypoint,
        "t_s": round(found.mission_s, 3),
        "time": found.time.isoformat(timespec="milliseconds").replace("+00:00", "Z") if found.time else None,
        "latitude_deg": latitude_deg,
        "longitude_deg": longitude_deg,
        "east_m": round(finding.place.east_m, 2),
        "north_m": round(finding.place.north_m, 2),
        "error_m": None if finding.error_m is None else round(finding.error_m, 2),
        "place_is": finding.place_is,
        "photo": finding.photo.shot.source if finding.photo else None,
        **{side: getattr(box, side, None) for side in ("left_px", "top_px", "width_px", "height_px")},
    }


def _say(parent: ElementTree.Element, name: str, words: str) -> None:
    """Words without angle brackets: programs that show a placemark read what these enclose as HTML."""
    shown = escaped(words).replace("<", "\u2039").replace(">", "\u203a")
    ElementTree.SubElement(parent, name).text = shown
