"""Reviews of findings: read from beside the log, applied by every output alike, and kept line by line."""

from __future__ import annotations

import csv
import io
import json
import subprocess
import sys
import zipfile
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import cv2
import pytest
from tests.report.pages import parsed, table_named, text
from tests.report.test_client_document import client_page
from tests.report.test_findings import BOX, flight, jpeg
from tests.report.test_numbering import seen_at

from upwash.cli.main import main
from upwash.core.geo import GeoPosition
from upwash.errors import NotWritten
from upwash.report.numbering import FlightFindings
from upwash.report.record import read_records, reviewed_of
from upwash.report.reviewed import ReviewedFindings
from upwash.report.reviewed import reviewed as fold
from upwash.report.reviews import (
    FindingKey,
    Ranked,
    Review,
    Reviews,
    Verdict,
    append_review,
    read_reviews,
    review_file,
)

NOON = datetime(2026, 5, 1, 12, 0, tzinfo=UTC)
OTHER = {**BOX, "left_px": 300.0, "label": "broken-module", "score": 0.3}
ACCEPTED, REJECTED, OPEN = Verdict.ACCEPTED, Verdict.REJECTED, Verdict.OPEN


def review(log: Path, index: int, verdict: Verdict, **more: Any) -> None:
    """One more review of the boxes in the first message of `flight`."""
    append_review(log, Review(time=NOON, finding=FindingKey(16.0, 0, index), verdict=verdict, **more))


def reviewed(*logs: Path) -> ReviewedFindings:
    return reviewed_of(read_records(logs))


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """Three objects were found: the second is rejected, the third has another label and a note."""
    log = flight(tmp_path / "f.jsonl", [BOX, OTHER, {**BOX, "left_px": 500.0}])
    review(log, 1, REJECTED, reviewer="anna")
    review(log, 2, ACCEPTED, label="shadow", note="by the pole", reviewer="anna")
    return log


def test_rejected_findings_are_left_out_and_no_number_changes(log: Path) -> None:
    found = reviewed(log)
    assert [(each.number, each.finding.words, each.note) for each in found.objects] == [
        (1, "hot-spot 87 %", ""),
        (3, "shadow 87 %", "by the pole"),
    ]
    assert found.tally.words == "2 of 3 reviewed, 1 rejected"
    assert not found.tally.remarks
    assert reviewed(log) == found, "a second read gives the same"


def rows_of(log: Path, file: Path, *options: str) -> list[list[str]]:
    """The number, the label, the review and the note of each row of a file with findings."""
    assert main(["report", str(log), "--findings", str(file), *options]) == 0
    names = ("number", "label", "review", "note")
    if file.suffix == ".zip":
        with zipfile.ZipFile(file) as archive:
            content = archive.read("findings.csv").decode()
    else:
        content = file.read_text()
    if file.suffix == ".geojson":
        return [
            [str(each["properties"].get(name, "")) for name in names]
            for each in json.loads(content)["features"]
        ]
    if file.suffix == ".kml":
        from xml.etree import ElementTree

        ns = "{http://www.opengis.net/kml/2.2}"
        placemarks = ElementTree.fromstring(content).iter(f"{ns}Placemark")
        return [
            [each.findtext(f".//{ns}Data[@name='{name}']/{ns}value", "") for name in names]
            for each in placemarks
        ]
    return [[row[name] for name in names] for row in csv.DictReader(io.StringIO(content))]


@pytest.mark.parametrize("name", ["f.csv", "f.geojson", "f.kml", "f.zip"])
def test_every_file_has_the_findings_as_reviewed(log: Path, name: str) -> None:
    file = log.with_name(name)
    assert rows_of(log, file) == [
        ["1", "hot-spot", "", ""],
        ["3", "shadow", "accepted", "by the pole"],
    ]
    assert name in {"f.csv", "f.zip"} or "2 of 3 reviewed, 1 rejected" in file.read_text()
    labels = [row[1] for row in rows_of(log, file, "--unreviewed")]
    assert labels == ["hot-spot", "broken-module", "hot-spot"]


def test_the_command_and_the_results_say_how_many_are_reviewed(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["report", str(log), str(review_file(log)), "--json"]) == 0, "*.jsonl matches both"
    told = capsys.readouterr()
    (result,) = json.loads(told.out)
    assert result["findings"] == {"found": 3, "reviewed": 2, "rejected": 1}
    assert told.err == "findings: 2 of 3 reviewed, 1 rejected\n"


def test_the_page_in_words_has_the_findings_as_reviewed(log: Path) -> None:
    page = parsed(log)
    assert [[row[0], *row[-2:]] for row in table_named(page, "Findings")] == [
        ["finding", "what the user was told", "review"],
        ["1", "hot-spot 87 %", ""],
        ["3", "shadow 87 %", "accepted: by the pole"],
    ]
    assert "2 of 3 reviewed, 1 rejected." in text(page)


HOSTILE = "=1+1<img src=x onerror=alert(1)> \u202e\x1b[31m \u05e9\u05dc\u05d5\u05dd"


def test_the_clients_document_has_the_findings_as_reviewed(log: Path) -> None:
    page = client_page(log)
    assert "broken module" not in page
    for words in "2 of 3 reviewed, 1 rejected", "shadow", "by the pole":
        assert words in page


def test_no_label_and_no_note_is_markup_or_a_formula(tmp_path: Path) -> None:
    log = flight(tmp_path / "f.jsonl", [BOX])
    review(log, 0, ACCEPTED, label=HOSTILE, note=HOSTILE, reviewer=HOSTILE)
    (row,) = rows_of(log, tmp_path / "f.csv")
    assert row[1].startswith("'=1+1") and row[3].startswith("'=1+1")
    (row,) = rows_of(log, tmp_path / "f.kml")
    assert not {"<", ">"} & set("".join(row))
    page = parsed(log)
    assert not list(page.iter("img"))
    assert [each for each in page.iter("bdi") if (each.text or "").startswith("=1+1<img")]
    for file in ("f.csv", "f.kml"):
        assert not {"\u202e", "\x1b"} & set((tmp_path / file).read_text())


def test_a_review_that_is_taken_back_leaves_the_finding_open(tmp_path: Path) -> None:
    log = flight(tmp_path / "f.jsonl", [BOX])
    for verdict in (REJECTED, ACCEPTED, OPEN):
        review(log, 0, verdict)
    (found,) = reviewed(log).objects
    assert not found.is_reviewed
    assert reviewed(log).tally.words == "0 of 1 reviewed"


def test_a_review_of_any_sighting_is_one_of_the_object(tmp_path: Path) -> None:
    seen = [seen_at(10.0, 5.0, 0.7, photo=photo, at_s=1.0 + photo) for photo in range(3)]
    ranked = Ranked((NOON, 1), Review(time=NOON, finding=seen[1].key, verdict=REJECTED))
    reviews = Reviews("f", {seen[1].key: [ranked]})
    home = GeoPosition(47.0, 8.0)
    found = fold([FlightFindings("f", "d", None, 0.0, home, seen, reviews)])
    assert [(each.sightings, each.is_rejected) for each in found.everything] == [(3, True)]
    assert found.objects == []
    assert {found.of_finding(0, index).number for index in range(3)} == {1}


def test_two_reviewers_are_named_and_where_they_contradict_each_other(log: Path) -> None:
    review(log, 1, ACCEPTED, reviewer="ben")
    review(log, 0, ACCEPTED, reviewer="ben")
    tally = reviewed(log).tally
    assert tally.words == "3 of 3 reviewed"
    assert tally.remarks == [
        "2 reviewers (ben 2, anna 2): the last verdict counts",
        "reviewers contradict each other about 1 finding: 2",
    ]


def test_a_review_of_no_finding_is_told(log: Path) -> None:
    append_review(log, Review(time=NOON, finding=FindingKey(16.0, 7, 0), verdict=REJECTED))
    tally = reviewed(log).tally
    assert tally.remarks == ["1 review in f.review.jsonl is about no finding of f"]
    assert tally.words == "2 of 3 reviewed, 1 rejected"


@pytest.mark.parametrize("torn", [b'{"time":"2026-', b"\0\0\0\0", b"[1]", b"[" * 100_000, b"\xff"])
def test_a_torn_file_loses_that_line_alone(log: Path, torn: bytes) -> None:
    file = review_file(log)
    file.write_bytes(file.read_bytes() + torn)  # without an end
    review(log, 0, REJECTED, reviewer="anna")
    tally = reviewed(log).tally
    assert tally.words == "3 of 3 reviewed, 2 rejected"
    assert tally.remarks == ["1 line of f.review.jsonl is no review and left out: line 3"]


def test_a_clock_that_was_set_back_changes_no_order(log: Path) -> None:
    earlier = Review(time=NOON.replace(year=2020), finding=FindingKey(16.0, 0, 1), verdict=ACCEPTED)
    append_review(log, earlier)
    assert reviewed(log).tally.rejected == 0


def test_reviews_that_cannot_be_read_end_a_report(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    review_file(log).unlink()
    review_file(log).mkdir()
    assert main(["report", str(log), "--json"]) == 2
    assert "cannot read the reviews" in capsys.readouterr().err
    assert main(["report", str(log), "--json", "--unreviewed"]) == 0


def test_no_review_is_written_through_a_link(log: Path, tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.write_text("kept")
    review_file(log).unlink()
    review_file(log).symlink_to(elsewhere)
    with pytest.raises(NotWritten, match="the review was not kept"):
        review(log, 0, ACCEPTED)
    assert elsewhere.read_text() == "kept"


FULL = """
import sys
from pathlib import Path
from tests.report.test_reviews import ACCEPTED, review
from upwash.errors import NotWritten
from upwash.report.reviews import read_reviews
log, kept = Path(sys.argv[1]) / "f.jsonl", 0
try:
    while kept < 100:
        review(log, 0, ACCEPTED, note="n" * 500)
        kept += 1
except NotWritten as error:
    print(error)
reviews = read_reviews(log)
assert [len(each) for each in reviews.by_finding.values()] == ([kept] if kept else []), kept
assert not reviews.remarks
"""


@pytest.mark.parametrize(
    ("options", "why"), [("size=8192", "No space left on device"), ("ro", "Read-only file system")]
)
def test_a_disk_that_takes_no_more_keeps_what_it_has(tmp_path: Path, options: str, why: str) -> None:
    script = f'mount -t tmpfs -o {options} none "$0" && exec "$@"'
    command = ["unshare", "--map-root-user", "--mount", "sh", "-c", script, str(tmp_path)]
    done = subprocess.run(
        [*command, sys.executable, "-c", FULL, str(tmp_path)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert f"f.review.jsonl: cannot be written ({why}): the review was not kept" in done.stdout


# --- a data set -----------------------------------------------------------------------------------------------


@pytest.fixture
def photos(tmp_path: Path) -> Path:
    folder = tmp_path / "photos"
    folder.mkdir()
    (folder / "1.jpg").write_bytes(jpeg())
    return folder


def made(log: Path, folder: Path, photos: Path) -> int:
    return main(["report", str(log), "--dataset", str(folder), "--photos", str(photos)])


def labels_of(folder: Path, name: str) -> Sequence[list[float]]:
    lines = (folder / "labels" / f"{name}.txt").read_text().splitlines()
    return [[float(each) for each in line.split()] for line in lines]


@pytest.mark.parametrize("more", [[], ["--unreviewed"]], ids=["reviewed", "unreviewed"])
def test_no_output_replaces_the_reviews(
    log: Path, capsys: pytest.CaptureFixture[str], more: list[str]
) -> None:
    file = review_file(log)
    before = file.read_bytes()
    assert main(["report", str(log), "--csv", str(file), *more]) == 2
    assert f"{file} is read: name another output" in capsys.readouterr().err
    assert file.read_bytes() == before


def test_a_data_set_has_the_accepted_boxes_under_their_labels(
    log: Path, photos: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    review(log, 0, ACCEPTED)
    review(log, 2, ACCEPTED, label='odd: "name"')
    folder = tmp_path / "set"
    assert made(log, folder, photos) == 0
    assert sorted(str(each.relative_to(folder)) for each in folder.rglob("*.*")) == [
        "data.yaml",
        "images/1.jpg",
        "labels/1.txt",
    ]
    assert (folder / "data.yaml").read_text() == (
        'train: images\nval: images\nnames:\n  0: "hot-spot"\n  1: "odd: \\"name\\""\n'
    )
    first, second = labels_of(folder, "1")
    assert first[0] == 0
    assert first[1:] == pytest.approx([115 / 640, 70 / 480, 30 / 640, 20 / 480], abs=1e-6)
    assert second[:2] == [1, pytest.approx(515 / 640, abs=1e-6)]
    pixels = cv2.imread(str(folder / "images" / "1.jpg"), cv2.IMREAD_GRAYSCALE)
    assert pixels is not None and pixels[70, 115] > 240, "the box is where the photo is white"
    assert "2 boxes of 2 classes" in capsys.readouterr().err


def test_a_box_at_the_edge_is_cut_and_one_without_review_is_told(
    photos: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = flight(tmp_path / "f.jsonl", [{**BOX, "left_px": -10.0}, {**BOX, "left_px": 5000.0}, OTHER])
    review(log, 0, ACCEPTED)
    review(log, 1, ACCEPTED)
    assert made(log, tmp_path / "set", photos) == 0
    (box,) = labels_of(tmp_path / "set", "1")
    assert box[1:] == pytest.approx([10 / 640, 70 / 480, 20 / 640, 20 / 480], abs=1e-6)
    told = capsys.readouterr().err
    assert "1 accepted box left out" in told and "1 box on these photos not reviewed" in told


def test_a_data_set_replaces_nothing_and_is_never_empty(
    log: Path, photos: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "there").mkdir()
    assert made(log, tmp_path / "there", photos) == 2
    assert "there is a folder: give the name of a file, or of a new folder" in capsys.readouterr().err
    (photos / "1.jpg").unlink()
    assert made(log, tmp_path / "set", photos) == 2
    assert "none of the photos" in capsys.readouterr().err
    review_file(log).unlink()
    assert made(log, tmp_path / "set", photos) == 2
    assert "no box is accepted" in capsys.readouterr().err
    assert not (tmp_path / "set").exists()
    assert not list(tmp_path.glob(".upwash-*"))


def test_the_file_beside_a_log_has_its_name(tmp_path: Path) -> None:
    assert review_file(tmp_path / "events.jsonl").name == "events.review.jsonl"
    assert review_file(tmp_path / "flight.log").name == "flight.log.review.jsonl"
    assert not read_reviews(tmp_path / "events.jsonl").by_finding
