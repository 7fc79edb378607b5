"""What is found of a camera before a flight, and which missions need one."""

from __future__ import annotations

import asyncio
from pathlib import Path

import cv2
import numpy as np
import pytest
from tests.events import event

from upwash.config.drone import DroneConfig
from upwash.config.drone_file import drone_config
from upwash.errors import CameraError, UsageError
from upwash.launch import cameras
from upwash.launch.cameras import Look, NoCamera, look, needs_camera, opened_album
from upwash.ports import KeptPhoto

MISSIONS = """
import helping

def shoots(drone):
    drone.camera.take_photo()

def asks_for_help(drone):
    helping.shoot(drone)
"""
FILMS = "def films(drone):\n    for frame in drone.camera.frames():\n        pass\n"
SOUNDS = "def sounds(drone):\n    drone.autopilot.arm()\n"
JPEG = cv2.imencode(".jpg", np.full((48, 64, 3), 90, np.uint8))[1].tobytes()


def configured(place: Path, *, program: str = "survey", **camera: object) -> DroneConfig:
    tables = {"mission": {"waypoints_m": [[0, 0]], "program": program}, "camera": camera}
    return drone_config(tables, place / "drone.toml")


def looked_at(folder: Path, **files: bytes) -> Look:
    """What is seen of files by their names; an ending stands behind `_`."""
    (folder / "photos").mkdir()
    for name, content in files.items():
        stem, _, ending = name.partition("_")
        (folder / "photos" / f"{stem}.{ending or 'jpg'}").write_bytes(content)
    return asyncio.run(look(configured(folder, folder="photos")))


def test_the_first_photo_of_a_folder_and_its_largest_one_are_given(tmp_path: Path) -> None:
    larger = JPEG + b"what a camera adds"
    seen = looked_at(tmp_path, a=JPEG, b=JPEG + b"it", c=larger, d=JPEG)
    assert seen == Look({"a.jpg": JPEG, "c.jpg": larger})


def test_a_png_is_given_as_a_jpeg_and_a_damaged_one_is_named(tmp_path: Path) -> None:
    png = cv2.imencode(".png", np.full((48, 64), 29_500, np.uint16))[1].tobytes()
    seen = looked_at(tmp_path, a_PNG=png, b_PNG=png[:-20])
    assert list(seen.photos) == ["a.PNG"]
    assert seen.photos["a.PNG"].startswith(b"\xff\xd8")
    (trouble,) = seen.troubles
    assert "b.PNG cannot be read: the PNG is cut off" in trouble


NOT_WHOLE = "no whole JPEG: copy it again"


@pytest.mark.parametrize(
    ("bad", "what"),
    [
        (b"", NOT_WHOLE),
        (b"a painting", NOT_WHOLE),
        (JPEG[:-20], NOT_WHOLE),
        (bytes.fromhex("0005160700020000"), NOT_WHOLE),
        (b"RIFF\0\0\0\0WEBPVP8 ", "a WebP file: save it as a JPEG"),
    ],
    ids=["empty", "other", "cut off", "AppleDouble", "WebP"],
)
def test_each_photo_that_is_no_whole_jpeg_is_named(tmp_path: Path, bad: bytes, what: str) -> None:
    seen = looked_at(tmp_path, a=JPEG, b=bad, c=JPEG)
    (trouble,) = seen.troubles
    assert f"b.jpg is {what}, or take it out of the folder" in trouble
    assert list(seen.photos) == ["a.jpg", "c.jpg"]


def test_what_is_named_and_looked_at_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cameras, "_MOST_FILES", 8)
    seen = looked_at(tmp_path, **{f"p{number}": b"" for number in range(9)})
    assert len(seen.troubles) == 6
    assert seen.troubles[-1] == "and 4 more photos like these"


def write_video(file: Path, *frames: int) -> str:
    writer = cv2.VideoWriter(str(file), cv2.VideoWriter.fourcc(*"MJPG"), 20, (64, 48))
    for brightness in frames:
        writer.write(np.full((48, 64, 3), brightness, np.uint8))
    writer.release()
    return str(file)


@pytest.mark.parametrize(
    ("frames", "said"),
    [(range(60, 250, 5), ""), (range(0, 12), "is black"), ([90] * 40, "stands still")],
)
async def test_a_device_whose_picture_is_black_or_stands_still_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, frames: list[int], said: str
) -> None:
    monkeypatch.setattr(cameras, "_APART_S", 0.05)
    seen = await look(configured(tmp_path, device=write_video(tmp_path / "flight.avi", *frames)))
    assert len(seen.photos) == 1
    assert len(seen.troubles) == bool(said)
    assert said in "".join(seen.troubles)


@pytest.mark.parametrize(
    ("program", "needs"),
    [
        ("survey", True),
        ("m.py:shoots", True),
        ("films.py:films", True),
        ("m.py:asks_for_help", True),
        ("sounds.py:sounds", False),
    ],
)
async def test_a_camera_is_needed_by_missions_that_take_photos(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, program: str, needs: bool
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "helping.py").write_text("def shoot(drone):\n    return drone.camera.take_photo()\n")
    (tmp_path / "m.py").write_text(MISSIONS)
    (tmp_path / "films.py").write_text(FILMS)
    (tmp_path / "sounds.py").write_text(SOUNDS)
    config = configured(tmp_path, program=program)
    assert needs_camera(config) == needs
    if needs:
        with pytest.raises(UsageError, match=r"no camera: say in \[camera\]"):
            await look(config)
    else:
        assert await look(config) == Look({})


async def test_a_photo_without_a_camera_says_what_to_configure() -> None:
    with pytest.raises(CameraError, match=r"say in \[camera\] where photos come from"):
        await NoCamera().take_photo(None)  # type: ignore[arg-type]


async def test_kept_photos_are_in_the_folder_of_their_flights_start_also_after_it_is_resumed(
    tmp_path: Path,
) -> None:
    photo, resumed = event("photo", 5.0), event("log_resumed", 9.0, time="2026-05-01T12:30:00+02:00")
    first, second = (event("log_opened", 0.0, time=f"2026-05-0{day}T12:00:00+02:00") for day in (1, 2))
    for events in ([first], [first, photo, resumed], [first, photo, second], [first, resumed]):
        await opened_album(tmp_path / "{time}", events).keep(KeptPhoto(JPEG, "video"))
    assert sorted(file.relative_to(tmp_path).as_posix() for file in tmp_path.rglob("*.jpg")) == [
        "2026-05-01T10-00-00Z-2/00001.jpg",  # it had taken no photo, and the folder has photos
        "2026-05-01T10-00-00Z/00001.jpg",
        "2026-05-01T10-00-00Z/00002.jpg",
        "2026-05-02T10-00-00Z/00001.jpg",
    ]
