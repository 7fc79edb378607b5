"""Files that are no plans: each is told what it is, and what is expected."""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

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
WPML = """<?xml version="1.0" encoding="UTF-8"?>
<kml xmlns="http://www.opengis.net/kml/2.2" xmlns:wpml="http://www.dji.com/wpmz/1.0.2"><Document>
<wpml:missionConfig/><Folder><Placemark/></Folder></Document></kml>"""
OLD = {"firmwareType": 3, "groundStation": "QGroundControl", "items": [], "plannedHomePosition": [0, 0, 0]}


def telemetry(*, time_bytes: int, version: int) -> bytes:
    """Heartbeats as a ground station logs them, each after the time."""
    codec = mavlink.MAVLink(None, 1, 1)
    content = b""
    for number in range(3):
        heartbeat = mavlink.MAVLink_heartbeat_message(2, 3, 81, 4, 4, 3)
        packet = heartbeat.pack(codec, force_mavlink1=version == 1)
        content += (1_790_000_000_000_000 + number).to_bytes(time_bytes) + packet if time_bytes else packet
    return content


FILES = [
    # the content, and what it is
    (json.dumps({"type": "FeatureCollection", "features": []}), "GeoJSON"),
    (json.dumps({"type": "Polygon", "coordinates": []}), "GeoJSON"),
    (
        json.dumps({"MAV_AUTOPILOT": 3, "items": [], "version": 1}),
        "a mission of an old QGroundControl (.mission)",
    ),
    (json.dumps(OLD), "a mission of an old QGroundControl (.mission)"),
    (json.dumps({"mission": {"name": "", "routes": []}}), "a mission of UgCS"),
    (json.dumps({"fileType": "GeoFence", "version": 2}), "QGroundControl's GeoFence"),
    (json.dumps([1, 2]), "JSON without a plan in it"),
    (KML, "KML"),
    (KML.encode("utf-16"), "KML"),
    ('<?xml version="1.0"?><gpx version="1.1"/>', "GPX"),
    ("<!DOCTYPE html><html><head>", "a web page"),
    ("<?xml version='1.0'?><ugcs-Transfer/>", "XML"),
    (packed("doc.kml"), "KMZ"),
    (packed("wpmz/template.kml", "wpmz/waylines.wpml"), "a flight of DJI Pilot"),
    (WPML, "a flight of DJI Pilot (WPML)"),
    (WPML.encode("utf-16"), "a flight of DJI Pilot (WPML)"),
    (telemetry(time_bytes=8, version=1), "a telemetry log (tlog)"),
    (telemetry(time_bytes=8, version=2), "a telemetry log (tlog)"),
    (telemetry(time_bytes=0, version=2), "a telemetry log (tlog)"),
    (telemetry(time_bytes=8, version=2) + bytes(10_000_000), "a telemetry log (tlog)"),
    ("FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns\n", "a flight log of ArduPilot"),
    (bytes(16) + b"BUILD 2015-12-25", "a flight log of DJI"),
    (b"#ROSBAG V2.0\n", "a recording of ROS (bag)"),
    (b"\x89MCAP0\r\n", "a recording (MCAP)"),
    (b"SQLite format 3\0", "a database (SQLite)"),
    (b"\x1f\x8b\x08\0", "a packed file"),
    (b"\x1bg\x10\0", "parameters of an ArduPilot"),
    ("# Vehicle-Id Component-Id Name Value Type\n1\t1\tACRO_BAL_PITCH\t1.0\t9\n", "parameters of a vehicle"),
    ("ACRO_BAL_PITCH,1\n", "parameters of a vehicle"),
    ('<flight-plan xmlns="http://www8.garmin.com/xmlschemas/FlightPlan/v1"/>', "a flight plan of Garmin"),
    ('<?xml version="1.0"?><mission><missionitem no="1"/></mission>', "a mission of INAV or MultiWii"),
    ("-35.36179110,149.16605470,0.000000,0\n", "a table of numbers"),
    ("lat;lng;alt\n1;2;3\n", "a table of places (CSV)"),
    ("version https://git-lfs.github.com/spec/v1\noid sha256:00\n", "a pointer of Git LFS"),
    ('[mission]\nplan = "field.plan"\n', "TOML"),
    (b"\xef\xbb\xbf", "empty"),
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


@pytest.mark.parametrize(
    ("content", "what"), FILES, ids=[f"{number}-{what}" for number, (_, what) in enumerate(FILES)]
)
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
