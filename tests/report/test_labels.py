"""A label is text wherever findings are shown: no markup, no formula, and it turns no text around it."""

from __future__ import annotations

import csv
import io
import json
import re
from pathlib import Path
from xml.etree import ElementTree

import pytest
from tests.report.pages import parsed, table_named, text
from tests.report.test_findings import BOX, flight, jpeg

from upwash.report.finding_files import as_csv, as_geojson, as_kml
from upwash.report.record import read_records, reviewed_of
from upwash.support.text import escaped
from upwash.view.file import write_page

KML = "{http://www.opengis.net/kml/2.2}"


@pytest.mark.parametrize(
    ("label", "formula"),
    [
        ("<img src=x onerror=alert(1)></script>", False),
        ("&lt;b&gt;", False),
        ("=cmd|' /C calc'!A0", True),
        ("\uff1dcmd|' /C calc'!A0", True),  # the full-width sign
        ("\u05e9\u05d1\u05e8 \u05d1\u05de\u05d5\u05d3\u05d5\u05dc", False),  # Hebrew
        ("\u0644\u0648\u062d \u0645\u0643\u0633\u0648\u0631", False),  # Arabic
        ("a\u202eb\u2066", False),  # marks that turn the direction
    ],
)
def test_a_label_is_text_everywhere(tmp_path: Path, label: str, *, formula: bool) -> None:
    (tmp_path / "1.jpg").write_bytes(jpeg())
    log = flight(tmp_path / "f.jsonl", [{**BOX, "label": label}])
    records, shown = read_records([log]), escaped(label)
    found = reviewed_of(records).objects

    (row,) = csv.DictReader(io.StringIO(as_csv(found)))
    assert row["label"] == ("'" if formula else "") + shown
    assert json.loads(as_geojson(found))["features"][0]["properties"]["label"] == shown
    (placemark,) = ElementTree.fromstring(as_kml(found)).iter(f"{KML}Placemark")
    as_text = shown.replace("<", "\u2039").replace(">", "\u203a")
    assert placemark.findtext(f"{KML}name") == f"1: {as_text}"

    sheet = parsed(log, photos=tmp_path)
    assert table_named(sheet, "Findings")[1][-1] == f"{shown} 87 %"
    apart = [text(each) for each in sheet.iter() if each.tag.endswith("bdi")]
    assert apart == [f"{shown} 87\N{NO-BREAK SPACE}%", f"{shown} 87 %"], "it turns neither number nor place"
    page = b"".join(write_page([log], records)).decode()
    assert "<img src" not in page
    told = re.findall(r'"what":("(?:[^"\\]|\\.)*")', page)
    assert list(map(json.loads, told)) == [shown]
