"""Files that are no plans: each is told what it is, and what is expected."""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from upwash.errors import ConfigError
from upwash.plans import read_plan
from upwash.plans.foreign import kind_of_bytes, kind_of_document, kind_of_text

FOLDER = Path(__file__).parent


def packed(*names: str) -> bytes:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        for name in names:
            archive.writestr(name, "<kml/>")
    return content.getvalue()


KML = '<?xml version="1.0"?>\n<!-- drawn by hand -->\n<kml xmlns="http://www.opengis.net/kml/2.2"><Document/></kml>'
FILES = [
    # the content, and what it is
    (json.dumps({"type": "FeatureCollection", "features": []}), "GeoJSON"),
    (json.dumps({"type": "Polygon", "coordinates": []}), "GeoJSON"),
    (
        json.dumps({"MAV_AUTOPILOT": 3, "items": [], "version": 1}),
        "a mission of an old QGroundControl (.mission)",
    ),
    (json.dumps({"fileType": "GeoFence", "version": 2}), "QGroundControl's GeoFence"),
    (json.dumps([1, 2]), "JSON without a plan in it"),
    (KML, "KML"),
    (KML.encode("utf-16"), "KML"),
    ('<?xml version="1.0"?><gpx version="1.1"/>', "GPX"),
    ("<!DOCTYPE html><html><head>", "a web page"),
    ("<?xml version='1.0'?><ugcs-Transfer/>", "XML"),
    (packed("doc.kml"), "KMZ"),
    (packed("wpmz/template.kml", "wpmz/waylines.wpml"), "a flight of DJI Pilot"),
    (packed("field.shp", "field.dbf"), "a packed shapefile"),
    (packed("field.plan"), "an archive (ZIP)"),
    (packed("doc.kml")[:40], "a damaged archive"),
    (b"\x00\x00\x27\x0a" + b"\0" * 96, "a shapefile (SHP)"),
    (b"\xa3\x95\x80\x80", "a flight log of ArduPilot"),
    (b"ULog\x01", "a flight log of PX4"),
    (b"", "empty"),
    ("-35.36 149.16\n-35.37 149.17\n", "pairs of numbers"),
    ("#saved by Mission Planner\n-35.36 149.16\n", "pairs of numbers"),
    ("latitude,longitude,altitude(m)\n1,2,3\n", "a table of places (CSV)"),
    ("RALLY\t-35.36\t149.16\t100\n", "a list of rally points"),
    ("QGC WPL 110\n0 1 0 16 0 0 0 0 1 2 3 1\n1 0 3 5001 4 0 0 0 1 2 3 1\n", "a list of a geofence"),
    ("QGC WPL 110\n0 1 0 16 0 0 0 0 1 2 3 1\n1 0 3 5100 0 0 0 0 1 2 3 1\n", "a list of rally points"),
]


@pytest.mark.parametrize(("content", "what"), FILES, ids=[what for _, what in FILES])
def test_a_file_of_another_kind_is_told_what_it_is(tmp_path: Path, content: str | bytes, what: str) -> None:
    file = tmp_path / "field.plan"
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(ConfigError) as refused:
        read_plan(file)
    assert refused.value.problem.startswith(f"no plan, it is {what}")
    assert "expected QGroundControl's JSON (.plan), or text that begins QGC WPL 110" in refused.value.problem


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
@pytest.mark.parametrize("name", ["field.plan", "field.waypoints"])
def test_a_byte_order_mark_is_skipped(tmp_path: Path, name: str, encoding: str) -> None:
    file = tmp_path / name
    file.write_bytes((FOLDER / name).read_text().encode(encoding))
    assert read_plan(file) == read_plan(FOLDER / name)


@given(st.binary(max_size=60) | st.binary(max_size=40).map(packed("doc.kml").__add__))
def test_any_bytes_are_looked_at_without_harm(content: bytes) -> None:
    assert isinstance(kind_of_bytes(content), str)
    assert isinstance(kind_of_text(content.decode("latin-1")), str)


@given(
    st.recursive(
        st.none() | st.integers() | st.text(),
        lambda inner: (
            st.lists(inner)
            | st.dictionaries(st.sampled_from(["type", "fileType", "mission"]) | st.text(), inner)
        ),
        max_leaves=5,
    )
)
def test_any_document_is_looked_at_without_harm(document: object) -> None:
    assert isinstance(kind_of_document(document), str)
