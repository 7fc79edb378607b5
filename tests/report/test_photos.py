"""Photos are found by what the log says of them, and nothing else is."""

from __future__ import annotations

import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

from upwash.core.geo import Position
from upwash.report.photos import PhotoShelf, Shot
from upwash.services.solar_park import Park, View, photograph
from upwash.support.jpeg import size_of

JPEG = b"\xff\xd8\xff\xe0 a photo"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    photos = tmp_path / "photos"
    photos.mkdir()
    (photos / "1.jpg").write_bytes(JPEG)
    (photos / "2.jpg").write_bytes(b"no photo")
    (tmp_path / "secret.jpg").write_bytes(JPEG)
    return photos


def test_photos_of_a_folder_are_found_by_name(folder: Path) -> None:
    shelf = PhotoShelf(folder)
    assert shelf.keeps("1.jpg")
    assert shelf.find(Shot("1.jpg", None, 0)) == JPEG


@pytest.mark.parametrize(
    "source", ["2.jpg", "3.jpg", "../secret.jpg", "..", ".", "", "a\0b", "/etc/passwd", "x" * 5000]
)
def test_nothing_else_is_found(folder: Path, source: str) -> None:
    assert PhotoShelf(folder).find(Shot(source, None, 0)) is None


def test_a_png_is_found_as_a_jpeg_and_a_damaged_one_is_not(folder: Path) -> None:
    png = cv2.imencode(".png", np.full((30, 40), 90, np.uint8))[1].tobytes()
    (folder / "3.png").write_bytes(png)
    (folder / "4.png").write_bytes(png[:-20])
    found = PhotoShelf(folder).find(Shot("3.png", None, 0))
    assert found is not None
    assert size_of(found) == (40, 30)
    assert PhotoShelf(folder).find(Shot("4.png", None, 0)) is None


@pytest.mark.parametrize("order", ["<", ">"])
def test_a_browser_does_not_turn_a_photo_whose_boxes_are_in_stored_pixels(folder: Path, order: str) -> None:
    mark = {"<": b"II*\0", ">": b"MM\0*"}[order]
    jpeg = cv2.imencode(".jpg", np.zeros((30, 40), np.uint8))[1].tobytes()
    for turned in (1, 6):
        tiff = mark + struct.pack(f"{order}IHHHIHHI", 8, 1, 0x0112, 3, 1, turned, 0, 0)
        exif = b"Exif\0\0" + tiff
        (folder / f"{turned}.jpg").write_bytes(
            jpeg[:2] + b"\xff\xe1" + (len(exif) + 2).to_bytes(2) + exif + jpeg[2:]
        )
    shelf = PhotoShelf(folder)
    assert shelf.find(Shot("6.jpg", None, 0)) == (folder / "1.jpg").read_bytes()


def test_without_a_folder_no_file_is_found() -> None:
    shelf = PhotoShelf(None)
    assert not shelf.keeps("1.jpg")
    assert shelf.find(Shot("1.jpg", None, 0)) is None


def test_photos_of_a_park_are_rendered_as_they_were() -> None:
    shelf = PhotoShelf(None)
    assert shelf.keeps("park 2")
    taken = photograph(Park(2), View(20.0, 0.0, 10.0), shot=3).jpeg
    assert shelf.find(Shot("park 2", Position(20.0, 0.0, 10.0), 3)) == taken


@pytest.mark.parametrize("position", [None, Position(1e300, 0.0, 10.0)])
def test_a_park_has_no_photo_from_nowhere(position: Position | None) -> None:
    assert PhotoShelf(None).find(Shot("park 2", position, 0)) is None
