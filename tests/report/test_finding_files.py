"""Findings as files for other tools: all that was written is read back, none of it as a formula or markup."""

from __future__ import annotations

import csv
import io
import json
import re
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import cv2
import fastkml
import geojson
import numpy as np
import pytest
from tests.events import line
from tests.report.test_findings import BOX, flight, jpeg

from upwash.cli.main import main
from upwash.core.camera.georeference import Place
from upwash.core.geo import Position
from upwash.eventlog.objects import Outline
from upwash.report.finding_files import as_csv, as_geojson, as_kml, as_zip
from upwash.report.findings import OF_DRONE, OF_MISSION, OF_OBJECT, Finding
from upwash.report.numbering import FlightFindings, PlacedFinding, numbered
from upwash.report.photos import PhotoShelf
from upwash.report.record import read_records, reviewed_of

KML = "{http://www.opengis.net/kml/2.2}"
Rows = list[dict[str, str]]


def from_csv(findings: Sequence[PlacedFinding]) -> Rows:
    return list(csv.DictReader(io.StringIO(as_csv(findings))))


def from_geojson(findings: Sequence[PlacedFinding]) -> Rows:
    as_others_read_it = geojson.loads(as_geojson(findings))
    assert as_others_read_it.is_valid, as_others_read_it.errors()
    features = json.loads(as_geojson(findings))["features"]
    return [{**located(feature), **strings(feature["properties"])} for feature in features]


def located(feature: dict[str, Any]) -> dict[str, str]:
    if feature["geometry"] is None:
        return {}
    longitude, latitude = feature["geometry"]["coordinates"]
    return {"latitude_deg": str(latitude), "longitude_deg": str(longitude)}


def strings(facts: dict[str, Any]) -> dict[str, str]:
    return {name: str(value) for name, value in facts.items()}


def from_kml(findings: Sequence[PlacedFinding]) -> Rows:
    rows = []
    for placemark in ElementTree.fromstring(as_kml(findings).encode()).iter(f"{KML}Placemark"):
        row = {
            data.get("name", ""): data.findtext(f"{KML}value", "") for data in placemark.iter(f"{KML}Data")
        }
        if (place := placemark.findtext(f"{KML}Point/{KML}coordinates")) is not None:
            assert place == f"{row['longitude_deg']},{row['latitude_deg']}"
        assert placemark.findtext(f"{KML}name") == f"{row['number']}: {row['label']}"
        rows.append(row)
    return rows


def from_fastkml(findings: Sequence[PlacedFinding]) -> Rows:
    text: Any = as_kml(findings).encode()
    document: Any = fastkml.KML.from_string(text).features[0]
    rows = []
    for placemark in document.features:
        row = {data.name: data.value for data in placemark.extended_data.elements}
        if placemark.geometry is not None:
            assert (row["longitude_deg"], row["latitude_deg"]) == tuple(
                map(str, placemark.geometry.coords[0][:2])
            )
        rows.append(row)
    return rows


READERS = [from_csv, from_geojson, from_kml, from_fastkml]


def found(*logs: Path) -> list[PlacedFinding]:
    return reviewed_of(read_records(logs)).objects


@pytest.mark.parametrize("rows_of", READERS)
def test_every_file_tells_the_same(
    tmp_path: Path, rows_of: Callable[[Sequence[PlacedFinding]], Rows]
) -> None:
    log = flight(tmp_path / "f.jsonl", "look here", [BOX], {"row": 7.5})
    log.write_bytes(line("log_opened", 0.0, time="2026-05-01T12:00:00+02:00") + log.read_bytes())
    box, result = rows_of(found(log))
    expected = {
        "number": "1", "log": "f", "label": "hot-spot", "score": "0.874", "sightings": "1", "waypoint": "1",
        "t_s": "15.0",
        "time": "2026-05-01T10:00:16.000Z", "latitude_deg": "39.0", "longitude_deg": "22.0002309", "east_m": "20.0",
        "north_m": "0.0", "place_is": f"{OF_DRONE}: the camera's lens is unknown", "photo": "1.jpg",
        "left_px": "100.0", "height_px": "20.0",
    }  # fmt: skip
    assert {name: box[name] for name in expected} == expected
    assert result["number"] == "2"
    assert result["label"] == "row 7.5"
    assert result["place_is"] == OF_MISSION
    assert not result.get("score") and not result.get("left_px") and not result.get("error_m")


@pytest.mark.parametrize("rows_of", READERS)
def test_without_a_home_no_coordinates_are_told(
    tmp_path: Path, rows_of: Callable[[Sequence[PlacedFinding]], Rows]
) -> None:
    (row,) = rows_of(found(flight(tmp_path / "f.jsonl", [BOX], home=None)))
    assert not row.get("latitude_deg") and not row.get("longitude_deg")
    assert row["east_m"] == "20.0"


def test_the_coordinates_of_a_photo_are_those_that_the_vehicle_told(tmp_path: Path) -> None:
    log = flight(tmp_path / "f.jsonl", [BOX], home=None)
    told = log.read_bytes().replace(
        b'"source":"1.jpg"', b'"source":"1.jpg","latitude_deg":1.5,"longitude_deg":-2.5'
    )
    log.write_bytes(told)
    (row,) = from_csv(found(log))
    assert (row["latitude_deg"], row["longitude_deg"]) == ("1.5", "-2.5")
    log.write_bytes(told.replace(b'"latitude_deg":1.5', b'"latitude_deg":1e300'))
    (row,) = from_csv(found(log))
    assert (row["latitude_deg"], row["longitude_deg"]) == ("", "")


@pytest.mark.parametrize("rows_of", READERS)
def test_an_object_whose_own_place_is_known_is_told_there(
    rows_of: Callable[[Sequence[PlacedFinding]], Rows],
) -> None:
    own = Place(Position(3.0, 4.0), error_m=1.5, variance=(0.3, 0.0, 0.3), apart_m=0.2)
    finding = Finding(9.0, "car", 0.5, 2, Position(0.0, 0.0), Outline(1.0, 2.0, 3.0, 4.0, "car"), None, own)
    (row,) = rows_of(numbered([FlightFindings("f", "d1", None, 1.0, None, [finding])]).objects)
    assert (row["east_m"], row["north_m"], row["error_m"], row["place_is"]) == (
        "3.0",
        "4.0",
        "1.5",
        OF_OBJECT,
    )
    assert row["drone"] == "d1"


@pytest.mark.parametrize(
    "text",
    [
        *(
            "=1+1",
            "+1",
            "-1",
            "@SUM(A1)",
            "\t=1",
            "\r=1",
            "=cmd|' /C calc'!A0",
            " =1",
            "\uff1d1",
            "x;=1",
            "x; \uff0b1",
        ),
        *('x;"=1"', "a;b;-1", "x|@SUM(A1)", "'=1", ";=1"),
    ],
)
def test_no_text_is_a_formula(tmp_path: Path, text: str) -> None:
    log = flight(tmp_path / "f.jsonl", text, [{**BOX, "label": text}], source=text)
    log.write_bytes(log.read_bytes().replace(b'"drone":""', b'"drone":' + json.dumps(text).encode()))
    for row in csv.reader(io.StringIO(as_csv(found(log)))):
        parts = [part.strip(' "') for each in row for part in re.split("[;|]", each)]
        assert not [part for part in parts if part[:1] in set("=+-@\t\r\uff1d\uff0b")]


def test_no_text_is_markup(tmp_path: Path) -> None:
    hostile = '<img src=x onerror="alert(1)"> ]]> &lt;b&gt; \x00\x1b[31m \u202e\uffff'
    log = flight(tmp_path / "f.jsonl", [{**BOX, "label": hostile}], source=hostile)
    (row,) = from_kml(found(log))
    assert "img src=x onerror" in row["label"]
    for value in row.values():
        assert "<" not in value and ">" not in value
    assert from_geojson(found(log))[0]["label"].startswith("<img"), (
        "which is text where nothing reads it as HTML"
    )


def opened(content: bytes) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        assert archive.testzip() is None
        return {name: archive.read(name) for name in archive.namelist()}


@pytest.fixture
def photos(tmp_path: Path) -> Path:
    folder = tmp_path / "photos"
    folder.mkdir()
    (folder / "1.jpg").write_bytes(jpeg())
    return folder


def test_a_zip_file_has_a_picture_of_each_box(tmp_path: Path, photos: Path) -> None:
    log = flight(tmp_path / "f.jsonl", {"row": 7.5}, [BOX, {**BOX, "left_px": 5000.0}])
    files = opened(as_zip(found(log), PhotoShelf(photos)))
    assert set(files) == {"findings.csv", "findings.geojson", "findings.kml", "pictures/2.jpg"}
    picture = cv2.imdecode(np.frombuffer(files["pictures/2.jpg"], np.uint8), cv2.IMREAD_GRAYSCALE)
    assert picture is not None and picture.max() > 240
    rows = csv.DictReader(io.StringIO(files["findings.csv"].decode()))
    assert [row["picture"] for row in rows] == ["", "pictures/2.jpg", ""]
    (named,) = [
        each["properties"]
        for each in json.loads(files["findings.geojson"])["features"]
        if "picture" in each["properties"]
    ]
    assert (named["number"], named["picture"]) == (2, "pictures/2.jpg")


def test_pictures_of_one_drones_flights_do_not_replace_each_other(tmp_path: Path, photos: Path) -> None:
    logs = [flight(tmp_path / name, [BOX]) for name in ("with.jsonl", "without.jsonl")]
    files = opened(as_zip(found(*logs), PhotoShelf(photos)))
    assert {"pictures/1-1.jpg", "pictures/2-1.jpg"} < set(files)


@pytest.mark.parametrize("name", ["f.csv", "f.geojson", "F.KML", "f.zip"])
def test_the_command_writes_the_format_of_the_files_name(tmp_path: Path, photos: Path, name: str) -> None:
    log, file = flight(tmp_path / "f.jsonl", [BOX]), tmp_path / name
    assert main(["report", str(log), "--findings", str(file), "--photos", str(photos)]) == 0
    beginnings = {"csv": b"number,", "geojson": b'{"type":"FeatureC', "kml": b"<?xml", "zip": b"PK\x03\x04"}
    assert file.read_bytes().startswith(beginnings[name.lower().rpartition(".")[2]])


@pytest.mark.parametrize("name", ["findings", "findings.xlsx", "-"])
def test_a_file_of_no_such_format_is_refused(
    tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["report", str(flight(tmp_path / "f.jsonl")), "--findings", name]) == 2
    assert ".csv, .geojson, .kml, .zip" in capsys.readouterr().err
