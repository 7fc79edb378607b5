"""What the user was told is on the page, with the part of the photo that it is about."""

from __future__ import annotations

import base64
import re
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest
from tests.events import event
from tests.report.pages import SVG, Told, arrivals, heads, log_of, of_class, parsed, table_named, text

from upwash.eventlog.objects import Outline
from upwash.eventlog.schema import Event
from upwash.report.crops import HEIGHT_PX, WIDTH_PX, crop_around, pixels_of
from upwash.report.findings import MOST_PICTURED, Pairing

COMPLETED: Told = (60.0, "mission_completed", {})
BOX = {
    "left_px": 100.0,
    "top_px": 60.0,
    "width_px": 30.0,
    "height_px": 20.0,
    "label": "hot-spot",
    "score": 0.874,
}
HOME = {"latitude_deg": 39.0, "longitude_deg": 22.0}
HERE = {"east_m": 20.0, "north_m": 0.0, "altitude_m": 10.0}


def jpeg(width: int = 640, height: int = 480) -> bytes:
    """Black, with white where BOX is."""
    pixels = np.zeros((height, width, 3), np.uint8)
    pixels[60:80, 100:130] = 255
    return cv2.imencode(".jpg", pixels)[1].tobytes()


def flight(file: Path, *messages: object, source: str = "1.jpg", home: object = HOME) -> Path:
    """A photo at waypoint 1, and what the user was told of it."""
    photo: Told = (15.0, "photo", {"source": source, "position": HERE})
    told: list[Told] = [(16.0, "notified", {"message": message, "at": HERE}) for message in messages]
    return log_of(file, *arrivals(0, 1), photo, *told, *arrivals(2, 3), COMPLETED, home=home)


@pytest.fixture
def photos(tmp_path: Path) -> Path:
    folder = tmp_path / "photos"
    folder.mkdir()
    (folder / "1.jpg").write_bytes(jpeg())
    return folder


def pictures(page: ElementTree.Element) -> list[ElementTree.Element]:
    return [item for gallery in of_class(page, "gallery") for item in gallery]


def test_a_finding_has_its_place_on_the_photo_and_on_the_earth(tmp_path: Path, photos: Path) -> None:
    page = parsed(flight(tmp_path / "f.jsonl", [BOX]), photos=photos)
    (picture,) = pictures(page)
    assert "1: hot-spot 87\N{NO-BREAK SPACE}%" in text(picture)
    assert "waypoint 1, at 0:15" in text(picture)
    assert "39.000000°, 22.000231°" in text(picture)
    assert table_named(page, "Findings")[1:] == [
        ["1", "0:15", "1", "39.000000°, 22.000231°", "hot-spot 87 %"]
    ]


def test_each_box_is_a_finding_of_its_own(tmp_path: Path, photos: Path) -> None:
    other = {**BOX, "label": "broken-module", "left_px": 300.0}
    page = parsed(flight(tmp_path / "f.jsonl", [BOX, other], "look here"), photos=photos)
    rows = [["1", "hot-spot 87 %"], ["2", "broken-module 87 %"]]
    assert [[row[0], row[-1]] for row in table_named(page, "Findings")[1:]] == rows
    assert [text(picture).count("2: broken-module") for picture in pictures(page)] == [0, 1]


def test_the_picture_is_the_part_of_the_photo_around_the_box(tmp_path: Path, photos: Path) -> None:
    (picture,) = pictures(parsed(flight(tmp_path / "f.jsonl", [BOX]), photos=photos))
    (image,) = picture.iter(f"{SVG}image")
    (box,) = of_class(picture, "box")
    shown = cv2.imdecode(
        np.frombuffer(
            base64.b64decode(image.get("href", "").removeprefix("data:image/jpeg;base64,")), np.uint8
        ),
        cv2.IMREAD_GRAYSCALE,
    )
    assert shown is not None
    assert shown.shape == (72, 96)
    left, top, width, height = (round(float(box.get(key, ""))) for key in ("x", "y", "width", "height"))
    inside = shown[top : top + height, left : left + width]
    assert inside.mean() > 240
    assert shown.sum() - inside.sum() < 0.1 * shown.sum()


@pytest.mark.parametrize(
    ("left", "top", "size"), [(0.0, 0.0, 10.0), (630.0, 470.0, 10.0), (0.0, 0.0, 640.0), (-5.0, 3.0, 1e308)]
)
def test_a_crop_lies_in_the_photo_and_is_small(left: float, top: float, size: float) -> None:
    pixels = pixels_of(jpeg())
    assert pixels is not None
    box = Outline(left_px=left, top_px=top, width_px=size, height_px=min(size, 480.0), label="it")
    crop = crop_around(box, pixels)
    if size > 640:
        assert crop is None
        return
    assert crop is not None
    assert 0 <= crop.left_px <= 640 - crop.width_px
    assert 0 <= crop.top_px <= 480 - crop.height_px
    shown = pixels_of(crop.jpeg)
    assert shown is not None
    assert shown.shape[1] <= WIDTH_PX
    assert shown.shape[0] <= HEIGHT_PX


def test_a_box_beside_the_photo_has_no_crop() -> None:
    pixels = pixels_of(jpeg())
    assert pixels is not None
    assert crop_around(Outline(900.0, 10.0, 5.0, 5.0, "it"), pixels) is None


def test_without_photos_the_findings_are_a_table_with_words(tmp_path: Path) -> None:
    page = parsed(flight(tmp_path / "f.jsonl", [BOX]))
    assert not pictures(page)
    assert "--photos FOLDER" in text(page)
    assert table_named(page, "Findings")[1][-1] == "hot-spot 87 %"


def test_a_file_that_is_no_photo_has_no_picture(tmp_path: Path, photos: Path) -> None:
    (photos / "1.jpg").write_bytes(b"\xff\xd8\xff\xe0 no photo")
    page = parsed(flight(tmp_path / "f.jsonl", [BOX]), photos=photos)
    assert not pictures(page)
    assert table_named(page, "Findings")[1][-1] == "hot-spot 87 %"


def test_photos_of_a_park_are_rendered_again(tmp_path: Path) -> None:
    assert len(pictures(parsed(flight(tmp_path / "f.jsonl", [BOX, BOX], source="park 2")))) == 2


def test_a_result_needs_no_picture_and_words_are_no_finding(tmp_path: Path, photos: Path) -> None:
    page = parsed(flight(tmp_path / "f.jsonl", "look here", {"row": 7.5}, []), photos=photos)
    assert [(row[0], row[-1]) for row in table_named(page, "Findings")[1:]] == [("1", "row 7.5")]
    assert "have no picture" not in text(page)
    nothing = parsed(flight(tmp_path / "g.jsonl", [], "look here"), photos=photos)
    assert not [each for each in nothing.iter() if each.text == "Findings"]


def test_without_a_home_places_are_metres(tmp_path: Path) -> None:
    page = parsed(flight(tmp_path / "f.jsonl", [BOX], home=None))
    assert table_named(page, "Findings")[1][3] == "20.0 m east, 0.0 m north of home"


@pytest.mark.parametrize("count", [2, 5])
def test_the_findings_of_a_fleet_are_one_list(tmp_path: Path, photos: Path, count: int) -> None:
    logs = [flight(tmp_path / f"d{number}.jsonl", [BOX, BOX]) for number in range(1, count + 1)]
    for number, log in enumerate(logs, start=1):
        log.write_bytes(log.read_bytes().replace(b'"drone":""', b'"drone":"d%d"' % number))
    page = parsed(*logs, photos=photos)
    assert heads(page).count("Findings") == 1
    found = [(str(2 * number + each - 2), f"d{number}") for number in range(1, count + 1) for each in (1, 2)]
    assert [tuple(row[:2]) for row in table_named(page, "Findings")[1:]] == found
    assert f"{2 * count}: hot-spot" in text(pictures(page)[-1])
    assert f"d{count}, waypoint 1, at 0:15" in text(pictures(page)[-1])
    ids = [each.get("id") for each in page.iter() if each.get("id")]
    assert ids == [f"crop-{log}-{each}" for log in range(count) for each in (0, 1)]


def test_pictures_and_rows_are_bounded(tmp_path: Path, photos: Path) -> None:
    page = parsed(flight(tmp_path / "f.jsonl", *[[BOX]] * 400), photos=photos)
    assert len(pictures(page)) == MOST_PICTURED
    rows = table_named(page, "Findings")[1:]
    assert len(rows) == 201
    assert rows[100] == ["200 rows are left out: --findings FILE writes every finding"]
    assert rows[-1][-1] == "hot-spot 87 %", "a later finding keeps its confidence, though it has no picture"


def test_a_page_with_pictures_refers_to_nothing_outside_itself(tmp_path: Path, photos: Path) -> None:
    page = parsed(flight(tmp_path / "f.jsonl", [BOX]), photos=photos)
    hrefs = [each.get("href", "") for each in page.iter() if "href" in each.attrib]
    assert len(hrefs) == 1
    assert re.fullmatch(r"data:image/jpeg;base64,[A-Za-z0-9+/]+=*", hrefs[0])
    assert len(hrefs[0]) < 40_000


# --- the photo that a message is about ------------------------------------------------------------------------


def told_of(events: Sequence[Event]) -> list[int | None]:
    """The numbers of the photos that the messages are about."""
    pairing, numbers = Pairing(), []
    for each in events:
        pairing.take(each)
        if each.kind == "notified":
            numbers.append(pairing.told_of.number if pairing.told_of else None)
    return numbers


NOTIFIED = event("notified", 9.0, message=[BOX])
PHOTO = event("photo", 1.0, source="park 1")


def test_a_message_is_about_the_last_photo_or_the_one_that_it_names() -> None:
    assert told_of([NOTIFIED]) == [None]
    assert told_of([PHOTO, NOTIFIED, PHOTO, NOTIFIED]) == [0, 1]
    of_first, of_none = (event("notified", 9.0, message=[BOX], photo=number) for number in (0, 7))
    assert told_of([PHOTO, PHOTO, of_first, NOTIFIED, of_none]) == [0, 1, None]


def test_the_numbers_of_photos_begin_again_with_the_program() -> None:
    resumed = [PHOTO, PHOTO, event("log_resumed", 2.0), PHOTO, PHOTO]
    assert told_of([*resumed, event("notified", 9.0, message=[BOX], photo=0)]) == [2]


def test_a_bounded_number_of_photos_is_remembered() -> None:
    pairing = Pairing()
    for _ in range(10_010):
        pairing.take(PHOTO)
    assert len(pairing._taken) == 10_000
