"""The client's document has the objects, their places and their pictures, and nothing of how they were computed."""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest
from tests.events import line
from tests.report.pages import SVG, Told, heads, of_class, table_named, text
from tests.view.hostile_logs import hostile_log

from upwash.cli.main import main
from upwash.errors import ConfigError
from upwash.report.client import album
from upwash.report.client.document import ClientDocument, Wording, client_document
from upwash.report.client.labels import place_labels
from upwash.report.client.mosaic import Bounds, Mosaic
from upwash.report.client.words import read_words
from upwash.report.crops import pixels_of
from upwash.report.finding_files import facts_of
from upwash.report.photos import PhotoShelf
from upwash.report.record import read_records, reviewed_of

HOME = {"latitude_deg": 39.0, "longitude_deg": 22.0}
INTERNAL = re.compile(
    r"\b(policy|polic(y|ies)|calls?|servers?|states?|READY|offload\w*|log)\b", re.IGNORECASE
)
MARKUP = "<b>שבר</b>"


def box(
    left: float = 100.0, top: float = 60.0, *, label: str = "hot-spot", score: float = 0.8
) -> dict[str, object]:
    size = {"width_px": 30.0, "height_px": 20.0}
    return {"left_px": left, "top_px": top, **size, "label": label, "score": score}


def jpeg(shade: int = 90) -> bytes:
    return cv2.imencode(".jpg", np.full((480, 640, 3), shade, np.uint8))[1].tobytes()


def flight(
    file: Path,
    *photos: Sequence[object],
    home: object = HOME,
    drone: str = "scout",
    lens: bool = True,
    apart_m: float = 4.0,
    again: Sequence[int] = (),
) -> Path:
    """A flight straight to the east: photos named 0.jpg and so on, each with the objects told of it.

    Those of the numbers `again` are second looks.
    """
    events: list[Told] = [
        (0.0, "log_opened", {"time": "2026-05-01T10:00:00+00:00", "version": 5}),
        (0.5, "vehicle_found", {"firmware": "ArduCopter", "type": "quadrotor"}),
        (0.6, "planned", {"home": home, "waypoints_m": [(0, 0), (20, 0)]}),
        (1.0, "mission_started", {"policy": "location-aware", "drone": drone}),
        (1.5, "found_running", {"server": "edge-7", "before": "CHECK", "after": "READY", "why": "a call"}),
    ]
    for number, objects in enumerate(photos):
        place = {"east_m": apart_m * number, "north_m": 0.0, "altitude_m": 10.0}
        geometry = {"position": place, "size_px": (640, 480), "lens": {"fov_deg": 62.2, "up_deg": 0.0}}
        more = ({"geometry": geometry} if lens else {}) | ({"object": 1} if number in again else {})
        events.append((10.0 * number + 5, "photo", {"source": f"{number}.jpg", "position": place, **more}))
        if objects:
            events.append((10.0 * number + 6, "notified", {"message": list(objects), "at": place}))
    events.append((100.0, "mission_completed", {}))
    file.write_bytes(b"".join(line(kind, t, **facts) for t, kind, facts in events))
    return file


@pytest.fixture
def photos(tmp_path: Path) -> Path:
    folder = tmp_path / "photos"
    folder.mkdir()
    for number in range(3):
        (folder / f"{number}.jpg").write_bytes(jpeg())
    return folder


def made(*logs: Path, photos: Path | None = None, wording: Wording | None = None) -> ClientDocument:
    return client_document(read_records(logs), [PhotoShelf(photos)] * len(logs), wording or Wording())


def parsed(document: ClientDocument) -> ElementTree.Element:
    return ElementTree.fromstring(document.html.decode().removeprefix("<!DOCTYPE html>\n"))


def said(page: ElementTree.Element) -> str:
    body = page.find("body")
    assert body is not None
    return text(body)


def client_page(*logs: Path) -> str:
    """What the document of the logs says, without pictures."""
    return said(parsed(made(*logs)))


def numbers(page: ElementTree.Element) -> list[str]:
    return [row[0] for row in table_named(page, "Objects")[1:]]


def test_the_map_comes_first_and_each_object_with_two_looks_and_its_photo(
    tmp_path: Path, photos: Path
) -> None:
    log = flight(tmp_path / "f.jsonl", [box(305, 230)], [box(93, 230, score=0.9)], [])
    page = parsed(made(log, photos=photos))
    assert heads(page) == [
        "Map", "What was found", "Objects", "Each object", "Photos without findings", "How the places were made",
    ]  # fmt: skip
    assert [text(each) for each in page.iter("h1")] == ["Inspection of 1 May 2026"]
    assert "scout (ArduCopter quadrotor)" in said(page)
    (_, row) = table_named(page, "Objects")
    assert row[:5] == ["1", "hot-spot", "90\N{NO-BREAK SPACE}%", "39.000000°", "22.000000°"]
    assert row[-2:] == ["2", "10.0\N{NO-BREAK SPACE}m"]
    (card,) = of_class(page, "object")
    assert [text(each) for each in card.iter("figcaption")] == [
        "The surest sighting: photo 2, 10:00:15, from 10 m, 90\N{NO-BREAK SPACE}%",
        "Another sighting: photo 1, 10:00:05, from 10 m, 80\N{NO-BREAK SPACE}%",
        "The whole of photo 2, 10:00:15",
    ]
    assert len(list(card.iter(f"{SVG}image"))) == 3
    assert [each.get("alt") for each in page.iter("img")] == ["photo 3, 10:00:25: nothing found"]
    (map_,) = of_class(page, "map")
    assert [each.get("href") for each in map_.iter(f"{SVG}a")] == ["#object-1"]


def test_the_second_look_stands_beside_the_surest_sighting(tmp_path: Path, photos: Path) -> None:
    scores = (0.5, 0.4, 0.95)
    boxes = [[box(left, 230, score=score)] for left, score in zip((305, 93, 305), scores, strict=True)]
    log = flight(tmp_path / "f.jsonl", *boxes, again=[2], apart_m=4.0)
    events = log.read_text().replace('"east_m":8.0', '"east_m":0.0')  # back over the object
    log.write_text(events)
    (card,) = of_class(parsed(made(log, photos=photos)), "object")
    titles = [text(each).partition(",")[0] for each in card.iter("figcaption")]
    assert titles == ["The surest sighting: photo 1", "The second look: photo 3", "The whole of photo 1"]


def test_a_photo_of_several_objects_is_in_the_document_once(tmp_path: Path, photos: Path) -> None:
    page = parsed(made(flight(tmp_path / "f.jsonl", [box(), box(400)]), photos=photos))
    assert [each.get("href") for each in page.iter(f"{SVG}use")] == ["#photo-0-0"]


def test_nothing_tells_how_it_was_computed(tmp_path: Path, photos: Path) -> None:
    page = parsed(made(flight(tmp_path / "f.jsonl", [box()], []), photos=photos))
    assert INTERNAL.findall(said(page)) == []
    assert not list(page.iter("script"))


def test_texts_of_others_are_texts(tmp_path: Path) -> None:
    wording = Wording(title=MARKUP, note=f"{MARKUP}\n\nsecond")
    page = parsed(made(flight(tmp_path / "f.jsonl", [box(label=MARKUP)]), wording=wording))
    assert [text(each) for each in page.iter("h1")] == [MARKUP]
    assert [text(each) for note in of_class(page, "client-note") for each in note] == [MARKUP, "second"]
    assert table_named(page, "Objects")[1][1] == MARKUP
    assert not list(page.iter("b"))


def test_numbers_are_those_of_the_other_files(tmp_path: Path) -> None:
    own = flight(tmp_path / "a.jsonl", [box()], [box(400, 300, label="crack")])
    fleet = [own, flight(tmp_path / "b.jsonl", [box(10, 400, label="hole")], drone="other")]
    assert numbers(parsed(made(*fleet))) == [
        str(facts_of(each)["number"]) for each in reviewed_of(read_records(fleet)).objects
    ]
    again = flight(tmp_path / "c.jsonl", [box()])
    page = parsed(made(own, again))
    assert numbers(page) == ["1-1", "1-2", "2-1"]
    assert "Flight 2" in said(page)


@pytest.mark.parametrize("lens", [True, False])
def test_without_photos_there_are_places_all_the_same(tmp_path: Path, lens: bool) -> None:
    document = made(flight(tmp_path / "f.jsonl", [box()], [], lens=lens))
    page = parsed(document)
    assert (document.photos, document.shown) == (2, 0)
    assert "The photos are not part of this document." in said(page)
    assert table_named(page, "Objects")[1][7] == (
        "not known" if not lens else table_named(page, "Objects")[1][7]
    )
    assert ("lens or direction is not known" in said(page)) is not lens
    assert len(of_class(page, "ground" if lens else "spot")) == 2
    assert not list(page.iter(f"{SVG}a"))  # it would lead to pictures


@pytest.mark.parametrize("seed", range(3))
def test_any_log_makes_a_document(tmp_path: Path, seed: int) -> None:
    log = tmp_path / "f.jsonl"
    log.write_bytes(hostile_log(seed))
    assert heads(parsed(made(log)))


def test_where_the_best_photo_is_missing_another_sighting_is_shown(tmp_path: Path, photos: Path) -> None:
    (photos / "1.jpg").unlink()
    log = flight(tmp_path / "f.jsonl", [box(305, 230)], [box(93, 230, score=0.9)])
    page = parsed(made(log, photos=photos))
    (card,) = of_class(page, "object")
    assert [text(each).partition(":")[0] for each in card.iter("figcaption")] == ["Another sighting"]
    assert len(of_class(page, "ground")) == 1
    assert "1 of 2 photos are laid over the ground" in said(page)


def test_without_opencv_there_are_no_pictures(
    tmp_path: Path, photos: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = flight(tmp_path / "f.jsonl", [box()], [])
    monkeypatch.setitem(sys.modules, "cv2", None)
    assert made(log, photos=photos).shown == 0
    assert main(["report", str(log), "-o", str(tmp_path / "page.html"), "--photos", str(photos)]) == 0


def test_of_no_findings_the_document_says_so(tmp_path: Path, photos: Path) -> None:
    page = parsed(made(flight(tmp_path / "f.jsonl", [], []), photos=photos))
    assert heads(page) == ["Map", "Objects", "Photos without findings"]
    assert "Nothing was found on the photos." in said(page)


def test_each_site_has_a_map_and_what_lies_far_away_is_named(tmp_path: Path) -> None:
    near = flight(tmp_path / "a.jsonl", [box()])
    far = flight(tmp_path / "b.jsonl", [box()], home={"latitude_deg": 39.5, "longitude_deg": 22.0})
    assert heads(parsed(made(near, far)))[:2] == ["Map of site 1", "Map of site 2"]
    log = flight(tmp_path / "c.jsonl", [box()])
    message = line("notified", 50.0, message=["a heap"], at={"east_m": 9000.0, "north_m": 0.0})
    log.write_bytes(
        log.read_bytes().replace(line("mission_completed", 100.0), message + line("mission_completed", 100.0))
    )
    assert "Beyond the map: 2." in said(parsed(made(log)))


def test_pictures_have_a_bound(tmp_path: Path, photos: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = flight(tmp_path / "f.jsonl", [box()], [], [])
    whole = made(log, photos=photos)
    assert not whole.is_full
    monkeypatch.setattr(album, "MOST_BYTES", 3000)
    bound = made(log, photos=photos)
    assert bound.is_full
    assert len(bound.html) < len(whole.html)


def test_the_photo_whose_middle_is_nearest_is_laid_uppermost() -> None:
    mosaic = Mosaic(Bounds(0.0, 0.0, 30.0, 10.0))
    for west, shade in ((0.0, 50), (10.0, 200)):
        corners = [(west, 10.0), (west + 20, 10.0), (west + 20, 0.0), (west, 0.0)]
        mosaic.lay(np.full((40, 80, 3), shade, np.uint8), corners)
    assert mosaic.jpeg is not None
    pixels = pixels_of(mosaic.jpeg)
    assert pixels is not None
    height, width = pixels.shape[:2]
    row = [int(pixels[height // 2, round(east / 30 * width), 0]) for east in (2, 14, 16, 28)]
    assert row == pytest.approx([50, 50, 200, 200], abs=3)


def test_numbers_on_the_map_cover_neither_each_other_nor_points() -> None:
    points = [(float(x), float(y)) for x in range(5, 300, 30) for y in range(5, 300, 30)]
    labels = place_labels(points, [(24.0, 14.0)] * len(points), (300.0, 300.0))
    placed = [each for each in labels if each is not None]
    assert len(placed) > 40
    for number, one in enumerate(placed):
        assert 12 <= one.x <= 288
        assert 7 <= one.y <= 293
        assert not any(abs(one.x - other.x) < 24 and abs(one.y - other.y) < 14 for other in placed[:number])
        assert not any(abs(one.x - x) < 12 and abs(one.y - y) < 7 for x, y in points)
    assert place_labels([(5.0, 5.0)], [(24.0, 14.0)], (20.0, 20.0)) == [None]


def test_the_client_has_words_of_its_own(tmp_path: Path) -> None:
    file = tmp_path / "names.csv"
    file.write_text("\ufefflabel;name;severity;colour\ncrack;Riss;urgent;#FFEE00\nhot-spot;Heiße Zelle;;\n")
    log = flight(
        tmp_path / "f.jsonl", [box(), box(300), box(400, 300, label="crack"), box(20, 400, label="hole")]
    )
    page = parsed(made(log, wording=Wording(words=read_words(file))))
    assert [row[:3] for row in table_named(page, "Objects by label")[1:]] == [
        ["Riss", "urgent", "1"], ["Heiße Zelle", "", "2"], ["hole", "", "1"],
    ]  # fmt: skip
    (number,) = [each for each in page.iter(f"{SVG}text") if each.text == "3"]
    assert number.get("fill") == "#000000"  # on yellow


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        ("", "line 1: the columns are nothing: name them"),
        ("name,colour\nx,#000000\n", "line 1: the columns are name, colour"),
        ("label,size\nx,1\n", "line 1: the columns are label, size"),
        ("label,label\nx,x\n", "line 1: the columns"),
        ("label,name\n", "line 1: no rows"),
        ("label,name\nx,a\n\ny,b\nx,c\n", "line 5: the label 'x' is on line 2 too: leave one of them out"),
        ("label,name\nx,a,b\n", "line 2: 3 values for 2 columns"),
        ("label,name\n,a\n", "line 2: no label"),
        ("label,colour\nx,red\n", "line 2: 'red' is no colour: write #rrggbb"),
        (f"label,name\nx,{'a' * 61}\n", "line 2: the name is longer than 60 characters"),
        ('label,name\nx,"a\n', "close each quotation mark"),
        ("label\n" + "".join(f"{number}\n" for number in range(1001)), "more than 1000 labels"),
    ],
)
def test_a_bad_file_of_words_ends_in_a_sentence(tmp_path: Path, content: str, problem: str) -> None:
    file = tmp_path / "names.csv"
    file.write_text(content)
    with pytest.raises(ConfigError, match=re.escape(problem)):
        read_words(file)


def test_each_flight_has_its_own_folder_of_photos(
    tmp_path: Path, photos: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = tmp_path / "other"
    other.mkdir()
    (other / "0.jpg").write_bytes(jpeg(220))
    logs = [str(flight(tmp_path / name, [box()])) for name in ("a.jsonl", "b.jsonl")]
    out = tmp_path / "inspection.html"
    command = ["report", *logs, "--client", "-o", str(out), "--title", "Field 3"]
    assert main([*command, "--photos", str(photos), "--photos", str(other)]) == 0
    assert "MB, with pictures of 2 of 2 photos" in capsys.readouterr().err
    page = out.read_text()
    assert '<h1 dir="auto">Field 3</h1>' in page
    pictures = re.findall(r'id="photo-\d-0" href="([^"]+)"', page)
    assert len(set(pictures)) == 2
    assert main([*command, "--photos", str(photos), "--photos", str(other), "--photos", str(other)]) == 2
    assert "name one folder for all, or one for each log" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        (["--client"], "--client goes with -o"),
        (["-o", "x.html", "--title", "x"], "--title, --note and --labels go with --client"),
        (["-o", "x.html", "--client", "--title", "x" * 201], "--title has 201 characters: shorten it to 200"),
        (["-o", "x.html", "--client", "--scenario", "x.toml"], "--scenario goes with -o, without --client"),
        (["-o", "x.html", "--photos", "a", "--photos", "b"], "several --photos go with --client alone"),
        (["-o", "x.html", "--client", "--labels", "gone.csv"], "no such file"),
    ],
)
def test_options_that_cannot_work_are_refused(
    tmp_path: Path, options: Sequence[str], problem: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["report", str(flight(tmp_path / "f.jsonl", [])), *options]) == 2
    assert problem in capsys.readouterr().err
